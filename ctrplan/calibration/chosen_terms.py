"""What a fit varies: names that were asked for, as terms of the chain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ctrplan.calibration.base_parameters import ABSOLUTE_STIFFNESS, BaseParameters
from ctrplan.calibration.named_parameters import NamedParameters
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.named_numbers import value_of
from ctrplan.robot.robot import Robot

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
                raise InputError(f"unknown effect, known ones are {', '.join(CATALOGUE)}", key=name)
            if rest[1] not in {parameter.name for parameter in CATALOGUE[rest[0]].parameters(robot)}:
                raise InputError(f"is not a parameter of {rest[0]}", key=name)
            sorted_names.setdefault(rest[0], []).append(rest[1])
        else:
            if name not in base:
                _check_named(robot, name)
            sorted_names.setdefault("base" if name in base else "named", []).append(name)
    effects: dict[str, Effect] = {"base": BaseParameters()} | dict(CATALOGUE)
    effects["named"] = NamedParameters(sorted_names.get("named", []), priors, bounds)
    order = sorted(sorted_names, key=lambda kind: ("base", "named").index(kind) if kind in ("base", "named") else 2)
    return [term(effects[kind], sorted_names[kind], robot) for kind in order]


def _check_named(robot: Robot, name: str) -> None:
    value_of(robot, name)
    if name.rsplit(".", 1)[-1] not in IN_FILES:
        rule = f"has no key in a robot file, use effects.NAME.PARAMETER with NAME of {', '.join(CATALOGUE)}"
        raise InputError(rule, key=name)
