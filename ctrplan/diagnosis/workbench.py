"""Fits of the base with sets of effects, their linearisations, and the effects that the data can test."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import StageProgress
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.calibration.parameters import ABSOLUTE_STIFFNESS, BaseParameters
from ctrplan.calibration.residuals import UNSOUND, Noise, residuals, robust_square
from ctrplan.diagnosis.linear_fit import Linear, widths_of
from ctrplan.effects.effect import CATALOGUE, Effect, Values
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import DRIVEN_ALREADY, ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.pipeline.tip_table import FrictionCorrection
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Candidates:
    """Variants of every testable effect, and the reasons why the rest is not testable."""

    terms: tuple[Term, ...]
    not_testable: Mapping[str, str]
    variants: Mapping[str, int]  # of each effect, of which one acts

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


def candidates(
    robot: Robot,
    data: Measurements,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    more: Mapping[str, int] | None = None,
) -> Candidates:
    """Everything in the catalogue, sorted into testable and not; more: effects of whose variants the data have one."""
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
    return Candidates(tuple(terms), reasons, {**Counter(t.name for t in terms), **(more or {})})


WORTH_ANOTHER = 2.0  # of the loss, to fit a set again from another place
CORRECTIONS = {False: 1, True: 2}  # rounds, of poses at rest and of a continuous motion


@dataclass(frozen=True, eq=False)
class Scored:
    """A set of effects and its fit together with the base."""

    terms: tuple[Term, ...]  # without the base
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(t.name for t in self.terms)

    @cached_property
    def failed(self) -> NDArray[np.bool_]:
        """(K,) poses for which the solver found no equilibrium, so that the fit says nothing about them."""
        unsound: NDArray[np.bool_] = np.isclose(self.fit.residuals.raw_norm, UNSOUND)
        return self.fit.chain.predict(self.fit.p, derivatives=False).failed if unsound.any() else unsound


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A linearisation in the parameters of many effects, (effect, parameter), of which any set can be asked."""

    keys: tuple[tuple[str, str], ...]
    whole: Linear

    def places(self, terms: Sequence[Term]) -> list[int]:
        """Where the parameters of some terms are; the others stay where they are."""
        wanted = {(t.name, q.name) for t in terms for q in t.parameters}
        return [k for k, key in enumerate(self.keys) if key in wanted]


@dataclass(frozen=True, eq=False)
class Screened:
    """A variant beside a fit, linearised there."""

    term: Term
    linear: Linear  # of the columns of base, fit and variant
    owners: tuple[str, ...]  # (P,) the effect of each column
    panel: Linearisation | None = None  # of all variants that act in proportion, if it is among them
    places: Sequence[int] = ()  # (P,) of the columns there


@dataclass(frozen=True)
class SelectionStep:
    """One step of the path: how much more probable (logarithm) the poses are with it."""

    action: str  # "compare", "build"
    effect: str
    parameters: tuple[str, ...]
    gain: float
    taken: bool


class Interrupted(Exception):
    """Ctrl-C between two fits."""


HELD_OUT_SHARE = 0.95  # of the work done when the held-out set is asked


@dataclass(eq=False)
class Teller:
    """Names the steps to whoever watches, and stops between fits when asked to."""

    progress: StageProgress | None = None
    interrupted: threading.Event | None = None
    share: float = 0.05

    def pause(self) -> None:
        """Where a run may stop."""
        if self.interrupted is not None and self.interrupted.is_set():
            raise Interrupted

    def __call__(self, step: str) -> None:
        """A step begins."""
        self.pause()
        self.share += 0.25 * (HELD_OUT_SHARE - self.share)  # how many steps there will be is not known
        if self.progress:
            self.progress(step, self.share)


Bench = TypeVar("Bench", bound="Workbench")
Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False)
class Workbench:
    """Everything that stays the same while sets of effects are compared.

    A value: an answer depends on its question alone, and the same question has it at once.
    """

    robot: Robot
    data: Measurements
    noise: Noise
    group: NDArray[np.int_]  # (K,) poses that are left out together
    correction: FrictionCorrection | None = None  # what friction states leave out of positions and tangents
    _answers: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def _once(self, question: Hashable, answer: Callable[[], Answer]) -> Answer:
        """The answer to a question with all that it depends on, worked out once."""
        if question not in self._answers:
            self._answers[question] = answer()
        known: Answer = self._answers[question]
        return known

    @cached_property
    def whitening_group(self) -> NDArray[np.int_]:
        """(K,) poses that share the model's own numerical error."""
        return np.arange(self.data.count) if self.data.is_stream else self.data.configuration

    def base(self, terms: Sequence[Term]) -> Term:
        """Ordinary calibration; the stiffness of tube 1 only where something else than stiffness carries forces."""
        effect, loaded = BaseParameters(), any(t.effect.scales_with_stiffness for t in terms)
        names = [parameter.name for parameter in effect.parameters(self.robot)]
        return term(effect, [name for name in names if loaded or name != ABSOLUTE_STIFFNESS], self.robot)

    def basis(self, terms: Sequence[Term]) -> list[Term]:
        """What is fitted besides `terms`, whatever they are."""
        return [self.base(terms)]

    def scored(self, terms: Sequence[Term], *near: Fit | None) -> Scored:
        """The base and `terms` fitted together, from the most promising of the places `near`: values of fits, where
        they have them; None stands for where a fit starts without any.
        """
        question = "scored", tuple(terms), near
        return self._once(question, lambda: self._fitted(terms, near or (None,)))

    def _fitted(self, terms: Sequence[Term], near: Sequence[Fit | None]) -> Scored:
        chain = self.chain([*self.basis(terms), *terms])
        start, _ = self._start(chain, near)
        return Scored(tuple(terms), fit(chain, self.noise, self.whitening_group, start))

    def improved(self, known: Scored, near: Fit) -> Scored:
        """A set fitted again from another place, if that promises more and keeps it: the first fit may have ended in
        another valley, or where robots snap.
        """
        start, promised = self._start(known.fit.chain, [near], compared=True)
        if promised >= known.fit.residuals.loss - WORTH_ANOTHER:
            return known
        again = replace(known, fit=fit(known.fit.chain, self.noise, self.whitening_group, start))
        return again if again.fit.loss < known.fit.loss else known

    def continued(self, scored: Scored) -> Scored:
        """A set whose fit has used up its steps, fitted on from there until it converges or gets no better."""
        while not scored.fit.converged:
            further = replace(scored, fit=fit(scored.fit.chain, self.noise, self.whitening_group, scored.fit.p))
            if further.fit.loss > scored.fit.loss - WORTH_ANOTHER:
                break
            scored = further
        return scored

    def chain(self, terms: Sequence[Term]) -> ParametricChain:
        """The chain of terms, with friction as it is known by now."""
        chain = ParametricChain(self.robot, self.data, terms)
        if self._has_friction(terms):
            chain.correction = self.correction
        return chain

    def _has_friction(self, terms: Sequence[Term]) -> bool:
        return bool(self.robot.friction.any()) or any(t.name == "friction" for t in terms)

    def corrected(self: Bench, scored: Scored) -> tuple[Bench, Scored]:
        """A bench that has what friction states leave out of a set, and the set fitted there."""
        bench = self
        for _ in range(CORRECTIONS[self.data.is_stream] if self._has_friction(scored.terms) else 0):
            bench = replace(bench, correction=friction_correction(scored.fit.chain, scored.fit.p))
            scored = bench.scored(scored.terms, scored.fit)
        return bench, scored

    def stands(self, scored: Scored) -> bool:
        """Whether a set that another bench fitted is what this one would fit: all but friction states is the same."""
        chain = scored.fit.chain
        is_like = chain.data is self.data and scored.fit.noise is self.noise
        return is_like and (not self._has_friction(scored.terms) or chain.correction is self.correction)

    def _start(self, chain: ParametricChain, near: Sequence[Fit | None], compared: bool = False) -> tuple[Fit, float]:
        """What a fit would be at the one of several starts whose first step promises most, and the loss promised.

        Without anything to compare with nothing is promised.
        """
        places = near or (None,)
        starts = [start for place in places for start in self._starts(chain, place, alone=len(places) == 1)]
        if len(starts) == 1 and not compared:
            starts = [np.clip(starts[0], chain.lower, chain.upper)]
        fits = [fit_at(chain, self.noise, self.whitening_group, start) for start in starts]
        if len(starts) == 1 and not compared:
            return fits[0], np.nan
        promised = [float(robust_square(np.linalg.norm(linear(f).refitted().r, axis=1)).sum()) for f in fits]
        best = int(np.argmin(promised))
        return fits[best], promised[best]

    def _starts(self, chain: ParametricChain, near: Fit | None, alone: bool = True) -> list[Array]:
        """Known values of the parameters, and the effects' own suggestions for those not known yet.

        Far from any fit, and not `alone`, only the one that is nearest to the poses.
        """
        known = near.chain.keys if near else ()
        starts = [valued(chain, near, chain.start)]
        for t in chain.terms:
            if all((t.name, q.name) in known for q in t.parameters):
                continue
            suggestions = t.effect.starts([q.name for q in t.parameters])
            if suggestions != [{}]:
                starts = [_suggested(start, chain, t, values) for start in starts for values in suggestions]
        return starts if near or alone or len(starts) == 1 else [min(starts, key=lambda start: self._off(chain, start))]

    def _off(self, chain: ParametricChain, p: Array) -> float:
        """The loss of the poses at parameters (P,)."""
        seen = chain.predict(np.clip(p, chain.lower, chain.upper), derivatives=False)
        return residuals(self.data, seen, self.noise, self.whitening_group).loss

    def handed_over(self, scored: Scored) -> Scored:
        """The set for predictions of poses that were not fitted."""
        return self.sized(scored)

    def sized(self, scored: Scored) -> Scored:
        """The set with priors of its effects as wide as is most probable, where that is wider than stated.

        Priors say where to look. The size of an effect that is there is for the data to say: a prior that it exceeds
        would draw it in and make its interval too narrow.
        """
        return self._once(("sized", scored), lambda: self._sized(scored))

    def _sized(self, scored: Scored) -> Scored:
        chain = scored.fit.chain
        widths = widths_of(linear(scored.fit), chain.owners, scored.names)
        wide = {name: width.over_stated for name, width in widths.items()}
        if max(wide.values(), default=1.0) <= 1:
            return scored
        terms = [_widened(t, max(1.0, wide.get(t.name, 1.0))) for t in chain.terms]
        return replace(scored, fit=fit(chain.with_terms(terms), self.noise, self.whitening_group, scored.fit.p))

    def screened(self, here: Scored, others: Sequence[Term], known: Candidates) -> list[Screened]:
        """Variants, with what they need of the known ones, beside a fit by one Gauss-Newton step each: cheap, for
        choosing what to fit.
        """
        return self._once(("screened", here, tuple(others), known), lambda: self._screened(here, others, known))

    def _screened(self, here: Scored, others: Sequence[Term], known: Candidates) -> list[Screened]:
        panel, screened = self.panel(here, others), list[Screened]()
        for other in others:
            if not self._is_as_in_panel(other):
                screened.append(self._tried_out(here, other, known))
                continue
            same = [t for t in here.terms if t.name != other.name]
            together = [*self.basis([*same, other]), *same, other]
            places = panel.places(together)
            owners = tuple(panel.keys[k][0] for k in places)
            screened.append(Screened(other, panel.whole.columns(places).refitted(), owners, panel, places))
        return screened

    def _is_as_in_panel(self, other: Term) -> bool:
        """Whether a variant acts in proportion, and the parameters that it lacks do nothing where they are neutral."""
        own = {q.name for q in other.parameters}
        return other.effect.is_linear and not any(
            q.neutral for q in other.effect.parameters(self.robot) if q.name not in own
        )

    def panel(self, here: Scored, others: Sequence[Term]) -> Linearisation:
        """A fit linearised in its own parameters and those of other variants, which vanish there."""
        merged = _merged([*here.terms, *others], self.robot)
        chain = self.chain([*self.basis(merged), *merged])
        p = valued(chain, here.fit, np.array([_vanishing(q.start, q.neutral) * q.si for q in chain.parameters]))
        result = residuals(self.data, chain.predict(p), self.noise, self.whitening_group)
        weight = here.fit.residuals.weight
        whole = Linear(result.r, result.J, weight, 1 / chain.prior**2, p - chain.neutral, result.given)
        return Linearisation(chain.keys, whole)

    def _tried_out(self, here: Scored, other: Term, known: Candidates) -> Screened:
        """A variant that does not act in proportion, linearised where its first step promises most."""
        terms = known.completed([t for t in here.terms if t.name != other.name], other)
        chain = self.chain([*self.basis(terms), *terms])
        start, _ = self._start(chain, [here.fit])
        return Screened(other, linear(start).refitted(), chain.owners)


def _widened(t: Term, factor: float) -> Term:
    """With priors so many times as wide."""
    return Term(t.effect, tuple(replace(q, prior=factor * q.prior) for q in t.parameters))


def linear(result: Fit) -> Linear:
    """A fit's own linearisation."""
    parts = result.residuals
    return Linear(parts.r, parts.J, parts.weight, result.precision, result.p - result.chain.neutral, parts.given)


def valued(chain: ParametricChain, near: Fit | None, otherwise: Array, but: Collection[str] = ()) -> Array:
    """(P,) SI values of a chain's parameters: those of a fit `near`, else `otherwise` (P,), as for effects in `but`."""
    known = dict(zip(near.chain.keys, near.p.tolist(), strict=True)) if near else {}
    known = {key: value for key, value in known.items() if key[0] not in but}
    return np.array([known.get(key, value) for key, value in zip(chain.keys, otherwise.tolist(), strict=True)])


def _suggested(start: Array, chain: ParametricChain, t: Term, values: Values) -> Array:
    """A start (P,) with values of a term, in the units of their names, that its effect suggests."""
    changed = start.copy()
    for name, value in values.items():
        place = chain.keys.index((t.name, name))
        changed[place] = value * chain.si[place]
    return changed


def _merged(terms: Sequence[Term], robot: Robot) -> list[Term]:
    """One term per effect with the parameters of all its variants."""
    wanted: dict[str, dict[str, None]] = {}
    effects = {t.name: t.effect for t in terms}
    for t in terms:
        wanted.setdefault(t.name, {}).update(dict.fromkeys(p.name for p in t.parameters))
    return [term(effects[name], list(names), robot) for name, names in wanted.items()]


def _vanishing(start: float | None, neutral: float) -> float:
    """Where a variant is linearised: where it vanishes, or as near as its derivative exists."""
    return start if start is not None and 0 < abs(start - neutral) <= 1e-2 else neutral
