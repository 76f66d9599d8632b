"""What a robot file says beside its tubes: [home] and [[joint]] in degrees and millimetres -> Drive, and [uncertainty],
95 % intervals of the file's own numbers, and how their errors go together -> StatedIntervals.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from ctrplan.base.arguments import or_meant
from ctrplan.base.arrays import Array, read_only
from ctrplan.drive.drive import DEFAULT_MOTION, UNITS, Drive, ExecutionTolerance, Joint, Kind
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Tube
from ctrplan.robot.named_numbers import MAGNITUDE, value_of
from ctrplan.robot.robot import KEYS, Robot, StatedIntervals
from ctrplan.storage.toml_document import Angle, Document, Name, Step, interval_fault

Travel = Annotated[float, Meta(ge=-5000, le=5000)]  # mm; beyond it the value is in another unit
Gear = Annotated[float, Meta(ge=-1000, le=1000)]
Rate = Annotated[float, Meta(ge=1e-3, le=1e6)]  # deg or mm, and s: slower joints never arrive


class MovesEntry(Struct, forbid_unknown_fields=True):
    """moves = { theta = [...] } or { l = [...] }: one number per tube, per unit of the joint."""

    theta: list[Gear] | None = None
    l: list[Gear] | None = None  # noqa: E741 (as in the equations)


class JointEntry(Struct, forbid_unknown_fields=True):
    """[[joint]]: one per actuator, in the order of the drive."""

    name: Name
    moves: MovesEntry
    min_deg: Angle | None = None
    max_deg: Angle | None = None
    min_mm: Travel | None = None
    max_mm: Travel | None = None
    max_velocity_deg_s: Rate | None = None
    max_velocity_mm_s: Rate | None = None
    max_acceleration_deg_s2: Rate | None = None
    max_acceleration_mm_s2: Rate | None = None
    max_jerk_deg_s3: Rate | None = None
    max_jerk_mm_s3: Rate | None = None


class HomeEntry(Struct, forbid_unknown_fields=True):
    """[home]: the collars when all joints are zero."""

    theta_deg: list[Angle] | None = None
    l_mm: list[Travel] | None = None


class ExecutionEntry(Struct, forbid_unknown_fields=True):
    """[execution]: how exactly the drive follows a trajectory, see `ExecutionTolerance`."""

    rotation_deg: Annotated[float, Meta(ge=0, le=20)] = 0.2
    translation_mm: Annotated[float, Meta(ge=0, le=5)] = 0.05


def build_drive(
    home: HomeEntry,
    entries: Sequence[JointEntry] | None,
    execution: ExecutionEntry,
    tubes: Sequence[Tube],
    document: Document,
) -> Drive:
    """Drive of a robot file; without [[joint]], a rotation and a translation per tube. Raises InputError."""
    n = len(tubes)
    for key, values in (("theta_deg", home.theta_deg), ("l_mm", home.l_mm)):
        if values is not None and len(values) != n:
            raise document.fault(f"must have one value per tube, {n}", "home", key)
    theta = np.zeros(n) if home.theta_deg is None else np.radians(home.theta_deg)
    l = _foremost(tubes) if home.l_mm is None else np.array(home.l_mm) * 1e-3  # noqa: E741
    if entries is None:
        joints = _joint_per_tube(tubes, l)
    else:
        joints = tuple(_joint(entry, j, n, document) for j, entry in enumerate(entries))
    for j, joint in enumerate(joints):
        if joint.name in [other.name for other in joints[:j]]:
            raise document.fault("must differ from the names of the other joints", "joint", j, "name")
        if _in_columns(joint.name) in [_in_columns(other.name) for other in joints[:j]]:
            rule = "must differ from the names of the other joints by more than blanks and underscores"
            raise document.fault(rule, "joint", j, "name")
    tolerance = ExecutionTolerance(math.radians(execution.rotation_deg), execution.translation_mm * 1e-3)
    return Drive(joints, read_only(theta), read_only(l), execution=tolerance)


def _in_columns(name: str) -> str:
    """The name as the columns of trajectory.csv have it."""
    return "_".join(name.split())


def _foremost(tubes: Sequence[Tube]) -> Array:
    """Base translations [m] (n,) with every base as far in front as the collars allow."""
    return -np.cumsum([0.0, *(tube.collar_length_m for tube in tubes[1:])])


def _joint_per_tube(tubes: Sequence[Tube], home_l_m: Array) -> tuple[Joint, ...]:
    """Unlimited rotations; translations from the tip at the front plate to the base as far in front as it goes."""
    unit_moves = np.eye(len(tubes))
    rotations = [
        _with_default_motion(f"rotate {i + 1}", "rotation", unit_moves[i], -math.inf, math.inf)
        for i in range(len(tubes))
    ]
    translations = [
        _with_default_motion(f"translate {i + 1}", "translation", unit_moves[i], -tube.length_m - home, foremost - home)
        for i, (tube, home, foremost) in enumerate(zip(tubes, home_l_m, _foremost(tubes), strict=True))
    ]
    return (*rotations, *translations)


def _with_default_motion(name: str, kind: Kind, moves: Array, lower: float, upper: float) -> Joint:
    si = UNITS[kind][1]
    velocity, acceleration, jerk = (value * si for value in DEFAULT_MOTION[kind])
    return Joint(name, kind, read_only(moves), float(lower), float(upper), velocity, acceleration, jerk)


def _joint(entry: JointEntry, j: int, n: int, document: Document) -> Joint:
    if not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "joint", j, "name")
    kind, moves = _moves(entry.moves, j, n, document)
    _refuse_other_units(entry, kind, j, document)
    unit, si = UNITS[kind]
    lower, upper = _limits(entry, kind, moves, j, document)
    rates = (
        getattr(entry, f"max_{rate}_{unit}_s{power}")
        for rate, power in (("velocity", ""), ("acceleration", "2"), ("jerk", "3"))
    )
    velocity, acceleration, jerk = (
        (default if rate is None else rate) * si for rate, default in zip(rates, DEFAULT_MOTION[kind], strict=True)
    )
    return Joint(entry.name, kind, moves, lower * si, upper * si, velocity, acceleration, jerk)


def _moves(entry: MovesEntry, j: int, n: int, document: Document) -> tuple[Kind, Array]:
    if (entry.theta is None) == (entry.l is None):
        raise document.fault("must have either theta or l", "joint", j, "moves")
    kind: Kind = "translation" if entry.theta is None else "rotation"
    values = entry.l if entry.theta is None else entry.theta
    if values is None or len(values) != n or not any(values):
        key = "l" if entry.theta is None else "theta"
        raise document.fault(f"must have one value per tube, {n}, not all zero", "joint", j, "moves", key)
    return kind, read_only(values)


def _refuse_other_units(entry: JointEntry, kind: Kind, j: int, document: Document) -> None:
    moved, own, foreign = ("theta", "_deg", "_mm") if kind == "rotation" else ("l", "_mm", "_deg")
    for key in entry.__struct_fields__:
        if foreign in key and getattr(entry, key) is not None:
            rule = f"does not go with a {kind} joint (moves.{moved}), expected {key.replace(foreign, own)}"
            raise document.fault(rule, "joint", j, key)


def _limits(entry: JointEntry, kind: Kind, moves: Array, j: int, document: Document) -> tuple[float, float]:
    unit = UNITS[kind][0]
    lower, upper = getattr(entry, f"min_{unit}"), getattr(entry, f"max_{unit}")
    if lower is None and upper is None and kind == "rotation":
        if np.any(moves != np.round(moves)):  # a full turn of the joint would not bring the tubes back
            rule = "must be whole numbers for an unlimited rotation, else give min_deg and max_deg"
            raise document.fault(rule, "joint", j, "moves", "theta")
        return -math.inf, math.inf
    for key, value in (("min", lower), ("max", upper)):
        if value is None:
            reason = "a translation is limited" if kind == "translation" else "give both limits or neither"
            raise document.fault(f"is missing, {reason}", "joint", j, f"{key}_{unit}")
    if not lower < upper:
        locked = ": leave out a joint that does not move, [home] says where it stands" if lower == upper else ""
        raise document.fault(f"must be smaller than max_{unit} = {upper:g} {unit}{locked}", "joint", j, f"min_{unit}")
    return lower, upper


class UncertaintyEntry(Struct, forbid_unknown_fields=True):
    """[uncertainty]: 95 % intervals of the file's own numbers, and how errors go together."""

    ci95: dict[str, Any] = {}
    correlated: list[str] = []
    correlation: list[list[Annotated[float, Meta(ge=-1.001, le=1.001)]]] = []  # rounded ones too


ROUNDING = 1e-3  # of correlations
PLACE = ("uncertainty", "ci95")


def build_intervals(entry: UncertaintyEntry | None, robot: Robot, document: Document) -> StatedIntervals:
    """The table in SI. Raises InputError for what is no number of the file, no interval, or no correlation."""
    if entry is None:
        return StatedIntervals()
    results: dict[str, tuple[float, float]] = {}
    for path, ends in _flat(entry.ci95):
        name, si = _named(path, robot, document)
        value = value_of(robot, name)
        if fault := interval_fault(ends, value / si):
            raise document.fault(fault, *PLACE, *path)
        if name.endswith(MAGNITUDE) and value == 0:
            raise document.fault("has no direction, the section is straight", *PLACE, *path)
        results[name] = float(ends[0]) * si, float(ends[1]) * si
    names = tuple(_correlated(name, robot, results, document) for name in entry.correlated)
    return StatedIntervals(results, names, _correlation(entry, document))


def _flat(table: Mapping[str, Any], path: tuple[Step, ...] = ()) -> Iterator[tuple[tuple[Step, ...], Any]]:
    """Keys as `tube.2.poisson_ratio`, written in quotes or as tables in tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, (*path, key))
        else:
            yield (*path, key), value


def _named(path: tuple[Step, ...], robot: Robot, document: Document) -> tuple[str, float]:
    """The number's name and the SI value of its unit in the file."""
    stem, _, key = ".".join(map(str, path)).rpartition(".")
    try:
        name, si = KEYS[key]
        value_of(robot, f"{stem}.{name}")
    except (KeyError, InputError):
        known = ", ".join(KEYS)
        rule = (
            f"is no number of this file that may have an interval, such as tube.1.poisson_ratio; those end in {known}"
            f"{or_meant(key, KEYS)}"
        )
        raise document.fault(rule, *PLACE, *path) from None
    return f"{stem}.{name}", si


def _correlated(name: str, robot: Robot, results: Mapping[str, Any], document: Document) -> str:
    """The name, SI, if it has an interval."""
    kind, *rest = name.split(".")
    if kind == "effects" and len(rest) == 2:
        table = robot.effects.get(rest[0], {})
        if isinstance(table, dict) and rest[1] in table.get("ci95", {}):
            return name
    stem, _, key = name.rpartition(".")
    if key in KEYS and f"{stem}.{KEYS[key][0]}" in results:
        return f"{stem}.{KEYS[key][0]}"
    raise document.fault(f'"{name}" has no 95 % interval in this file', "uncertainty", "correlated")


def _correlation(entry: UncertaintyEntry, document: Document) -> Array | None:
    count = len(entry.correlated)
    if any(len(row) != count for row in entry.correlation) or len(entry.correlation) != count:
        raise document.fault(f"must be {count} rows of {count} numbers, as `correlated`", "uncertainty", "correlation")
    if len(set(entry.correlated)) != count:
        raise document.fault("names a parameter twice", "uncertainty", "correlated")
    if not count:
        return None
    result = np.array(entry.correlation)
    symmetric = np.allclose(result, result.T, rtol=0, atol=ROUNDING) and np.allclose(np.diag(result), 1, rtol=0)
    if not symmetric or np.linalg.eigvalsh((result + result.T) / 2).min() < -count * ROUNDING:
        rule = "must be a correlation: symmetric, 1 on its diagonal, no negative eigenvalue"
        raise document.fault(rule, "uncertainty", "correlation")
    return read_only((result + result.T) / 2)
