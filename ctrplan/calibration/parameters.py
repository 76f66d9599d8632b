"""What a fit varies: precurvatures, stiffness ratios, named numbers of the robot, and effects, as terms of the
chain.

Gauges: without loads the shape depends on ratios of stiffness only, so that the stiffness of tube 1 keeps its prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ctrplan.base.arguments import or_meant
from ctrplan.base.arrays import Array
from ctrplan.effects.effect import CATALOGUE, Effect, Parameter, Values
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.named_numbers import MOST_RATIO, value_of
from ctrplan.robot.robot import Robot

CURVATURE_PRIOR, STIFFNESS_PRIOR, POISSON_PRIOR, FRICTION_PRIOR = 0.1, 0.2, 0.15, 0.1

ABSOLUTE_STIFFNESS = "stiffness_factor_1"


class BaseParameters(Effect):
    """Ordinary calibration as a term of the mechanics, always present; factors on what the robot file says."""

    name = "calibration"
    stage = "mechanics"
    of_the_file = True

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Precurvatures, stiffnesses, Poisson's ratios and friction of every tube and pair, with their priors."""
        numbered = list(enumerate(robot.tubes, start=1))
        curvatures = [
            Parameter(f"precurvature_factor_{i}_{k}", CURVATURE_PRIOR, neutral=1.0, lower=0.3, upper=3.0)
            for i, tube in numbered
            for k, section in enumerate(tube.sections, start=1)
            if section.curvature_per_m > 0
        ]
        stiffnesses = [
            Parameter(f"stiffness_factor_{i}", STIFFNESS_PRIOR, neutral=1.0, lower=0.1, upper=10.0) for i, _ in numbered
        ]
        ratios = [_ratio(f"poisson_ratio_{i}", tube.poisson_ratio) for i, tube in numbered]
        frictions = [
            Parameter(f"friction_coefficient_{i}", FRICTION_PRIOR, neutral=mu, lower=0.0, upper=2.0)
            for i, mu in enumerate(robot.friction[:, 1].tolist(), start=1)
            if mu > 0
        ]
        return (*curvatures, *stiffnesses, *ratios, *frictions)

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        """The robot's numbers, by name, that these values change."""
        changed: dict[str, float] = {}
        for name, value in values.items():
            kind, *place = name.rsplit("_", 2) if name.startswith("precurvature") else name.rsplit("_", 1)
            i = int(place[0])
            if kind == "precurvature_factor":
                section = robot.tubes[i - 1].sections[int(place[1]) - 1]
                stem = f"tube.{i}.section.{place[1]}"
                changed[f"{stem}.curvature_x_per_m"] = section.curvature_x_per_m * value
                changed[f"{stem}.curvature_y_per_m"] = section.curvature_y_per_m * value
            elif kind == "stiffness_factor":
                changed[f"tube.{i}.bending_stiffness_Nm2"] = robot.tubes[i - 1].bending_stiffness_Nm2 * value
            elif kind == "poisson_ratio":
                changed[f"tube.{i}.poisson_ratio"] = value
            else:
                changed[f"contact.{i}.friction_coefficient"] = value
        return changed


def calibrated_moves(robot: Robot, theta_b: Array, l_b: Array) -> Array:
    """(K, P, 3) [m] by which parameters of ordinary calibration, as far off as their priors have it, move tips."""
    base, changes, names = BaseParameters(), list[dict[str, float]](), dict[str, None]()
    for q in base.parameters(robot):
        there, here = (base.mechanics({q.name: value}, robot) for value in (q.neutral + q.prior, q.neutral))
        changes.append({name: there[name] - here[name] for name in there})
        names |= dict.fromkeys(there)
    released = np.zeros((len(theta_b), robot.n - 1))
    by = robot.mechanics.tips_with_friction(theta_b, l_b, released, parameters=list(names)).position_by
    moves: Array = by @ np.array([[change.get(name, 0.0) for change in changes] for name in names])
    return moves.transpose(0, 2, 1)


RELATIVE_PRIOR = 0.2  # of a named number: share of its size, or of one where it is zero


class NamedParameters(Effect):
    """Numbers of the robot by their names, `parameters.py`, as a term of the mechanics."""

    name = "named"
    stage = "mechanics"
    of_the_file = True

    def __init__(self, names: Sequence[str], priors: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]):
        """priors: name -> standard deviation; bounds: name -> (lowest, highest); usual ones for names not in them."""
        self.names, self.priors, self.bounds = tuple(names), priors, bounds

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The named numbers, with the priors and bounds that were given for them."""
        return tuple(self._parameter(robot, name) for name in self.names)

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        """The robot's numbers are the parameters themselves."""
        return dict(values)

    def _parameter(self, robot: Robot, name: str) -> Parameter:
        value = value_of(robot, name)
        low, high = self.bounds.get(name, _usual_bounds(name, value))
        is_ratio = name.endswith("poisson_ratio")
        usual = _ratio(name, value).prior if is_ratio else RELATIVE_PRIOR * (abs(value) or 1.0)
        prior = self.priors.get(name, usual)
        return Parameter(name, prior, neutral=value, lower=low, upper=high)


def _ratio(name: str, value: float) -> Parameter:
    """Poisson's ratio, or EI / GJ - 1 of stiffnesses that were fitted apart, as uncertain as that is large."""
    times = max(1.0, (1 + value) / (1 + MOST_RATIO))
    return Parameter(name, POISSON_PRIOR * times, neutral=value, lower=min(-0.95, value), upper=3.0 * times - 1)


def _usual_bounds(name: str, value: float) -> tuple[float, float]:
    key = name.rsplit(".", 1)[-1]
    if key == "poisson_ratio":
        ratio = _ratio(name, value)
        return ratio.lower, ratio.upper
    if key in ("bending_stiffness_Nm2", "clearance_m", "length_m"):
        return 1e-9, float("inf")
    if key == "friction_coefficient":
        return 0.0, 2.0
    return -float("inf"), float("inf")


IN_FILES = (  # keys that a robot file has
    "bending_stiffness_Nm2",
    "poisson_ratio",
    "curvature_x_per_m",
    "curvature_y_per_m",
    "length_m",
    "clearance_m",
    "friction_coefficient",
)


def _base_names(robot: Robot) -> list[str]:
    return [p.name for p in BaseParameters().parameters(robot) if p.name != ABSOLUTE_STIFFNESS]


def spelled_out(names: Sequence[str], robot: Robot, data: Measurements) -> list[str]:
    """Names with "calibration" and whole effects in the place of their parameters."""
    spelled: list[str] = []
    for name in names:
        kind, _, effect = name.partition(".")
        if name == BaseParameters.name:
            spelled += _base_names(robot)
        elif kind == "effects" and effect in CATALOGUE:
            if reason := CATALOGUE[effect].untestable(robot, data):
                raise InputError(f"can't be fitted: {reason}", file=data.file, key=name)
            widest = max(CATALOGUE[effect].variants(robot, data), key=len)
            spelled += [f"{name}.{parameter}" for parameter in widest]
        else:
            spelled.append(name)
    return spelled


def require_apart(robot: Robot, names: Sequence[str]) -> None:
    """Raises InputError for a name that is there twice, and for a number that another of the names scales."""
    base, owners = BaseParameters(), dict[str, str]()
    scaled = {p.name: base.mechanics({p.name: p.neutral}, robot) for p in base.parameters(robot)}
    for name in names:
        numbers = scaled.get(name, {name: 1.0})
        for number in (n for n, value in numbers.items() if value or len(numbers) == 1):  # a factor leaves 0 alone
            if (other := owners.setdefault(number, name)) != name:
                raise InputError(f"and {other} are one number: fit either", key=name)
        if list(names).count(name) > 1:
            raise InputError("is named twice", key=name)


def chosen_terms(
    robot: Robot, names: Sequence[str], priors: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> list[Term]:
    """Terms with the named parameters: ordinary calibration, numbers of the robot, then effects.

    Raises InputError for names that nothing has, and for numbers that no robot file can hold.
    """
    base = {parameter.name for parameter in BaseParameters().parameters(robot)}
    sorted_names: dict[str, list[str]] = {}
    for name in names:
        kind, *rest = name.split(".")
        if kind == "effects":
            if len(rest) != 2 or rest[0] not in CATALOGUE:
                meant = or_meant(rest[0] if rest else "", CATALOGUE)
                raise InputError(f"unknown effect, known ones are {', '.join(CATALOGUE)}{meant}", key=name)
            own = [parameter.name for parameter in CATALOGUE[rest[0]].parameters(robot)]
            if rest[1] not in own:
                raise InputError(f"is not a parameter of {rest[0]}{or_meant(rest[1], own)}", key=name)
            sorted_names.setdefault(rest[0], []).append(rest[1])
        else:
            if name not in base:
                _check_named(robot, name)
            sorted_names.setdefault("base" if name in base else "named", []).append(name)
    effects: dict[str, Effect] = {"base": BaseParameters()} | dict(CATALOGUE)
    effects["named"] = NamedParameters(sorted_names.get("named", []), priors, bounds)
    order = sorted(sorted_names, key=lambda kind: ("base", "named").index(kind) if kind in ("base", "named") else 2)
    terms = [term(effects[kind], sorted_names[kind], robot) for kind in order]
    return [Term(t.effect, tuple(_as_told(t.effect, p, priors, bounds) for p in t.parameters)) for t in terms]


def _as_told(
    effect: Effect, parameter: Parameter, priors: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> Parameter:
    """A parameter with the prior and bounds that were given for its name, inside its own bounds."""
    name = parameter.name if effect.of_the_file else f"effects.{effect.name}.{parameter.name}"
    low, high = bounds.get(name, (parameter.lower, parameter.upper))
    lower, upper = max(low, parameter.lower), min(high, parameter.upper)
    if lower > upper:
        rule = f"must leave something of {parameter.lower:g} to {parameter.upper:g}"
        raise InputError(rule, key=f"bounds of {name}", value=(low, high))
    return replace(parameter, prior=priors.get(name, parameter.prior), lower=lower, upper=upper)


def _check_named(robot: Robot, name: str) -> None:
    value_of(robot, name)
    if name.rsplit(".", 1)[-1] not in IN_FILES:
        rule = f"has no key in a robot file, use effects.NAME.PARAMETER with NAME of {', '.join(CATALOGUE)}"
        raise InputError(rule, key=name)
