"""Which effects of the catalogue these data can test, in which variants, and why not the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.parametric_chain import DRIVEN_ALREADY
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Candidates:
    """Variants of every testable effect, and the reasons why the rest is not testable."""

    terms: tuple[Term, ...]
    not_testable: Mapping[str, str]

    def beside(self, chosen: Sequence[Term]) -> list[Term]:
        """Variants that are not chosen yet and can act: what they need is chosen or can be chosen with them."""
        keys, known = {t.key for t in chosen}, {t.name for t in self.terms} | {t.name for t in chosen}
        return [t for t in self.terms if t.key not in keys and (not t.effect.needs or t.effect.needs in known)]

    def completed(self, chosen: Sequence[Term], added: Term) -> list[Term]:
        """The chosen terms, what the added one needs, and it."""
        missing = added.effect.needs not in ("", *(t.name for t in chosen))
        needed = [t for t in self.terms if missing and t.name == added.effect.needs]
        return [*chosen, *needed, added]


def reduced(catalogue: Mapping[str, Effect], without: Sequence[str], *, key: str = "without") -> dict[str, Effect]:
    """The catalogue without some of its effects. Raises InputError, about `key`, for a name that it does not have."""
    for name in without:
        if name not in catalogue:
            raise InputError(f"must be an effect of the catalogue: {', '.join(catalogue)}", key=key, value=name)
    return {name: effect for name, effect in catalogue.items() if name not in without}


def candidates(robot: Robot, data: Measurements, catalogue: Mapping[str, Effect] = CATALOGUE) -> Candidates:
    """Everything in the catalogue, sorted into testable and not."""
    terms: list[Term] = []
    reasons: dict[str, str] = {}
    for name, effect in catalogue.items():
        driven = data.of_collars and effect.stage == "drive"
        if reason := DRIVEN_ALREADY if driven else effect.untestable(robot, data):
            reasons[name] = reason
        elif name in robot.effects:
            reasons[name] = "is in the robot file already"
        else:
            terms += [term(effect, names, robot) for names in effect.variants(robot, data) if names]
    return Candidates(tuple(terms), reasons)
