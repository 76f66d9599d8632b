"""Places and parts of a scenario that are most likely in another unit, by the robot's own length and by each other.

A goal cannot be much nearer to the base than the robot is long, nor farther; lumens hold the goals. Where the same
numbers in another unit are where they can be, that unit is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.base.arrays import Array, are_degrees, are_radians
from ctrplan.robot.magnitudes import IN_WORDS, UNITS_M, reach_m
from ctrplan.robot.robot import Robot

NEAR = 0.01  # share of the robot's length: a tip that is nearer to the base lies in the plate
PLAUSIBLE = 0.05, 1.05  # shares of it at which goals are
LARGEST_PART = 25.0  # lengths of the robot
LUMEN = 0.2, 5.0  # of a lumen whose size gives no reason to doubt it, wherever the goals are
USUAL_PART = 0.02, 5.0  # of a part that is meant to be next to it
WITHIN_M = 1e-5, 1e-4, 0.02  # least tolerance, margin or deviation; and those that are usual
WITHIN = 0.2  # share of the robot's length that is the most of them
FINE_M = 1e-4  # to which a base is placed at best
TURNED_DEG = 0.02, 0.1, 20.0  # least deviation or tolerance of a direction; and those that are usual


class SizeDoubt(NamedTuple):
    """unit: the likely one. rule: the end of a sentence about the number. is_sure: whether nothing else explains it."""

    unit: str
    rule: str
    is_sure: bool = True
    key: str = "unit"


def place_doubt(
    robot: Robot, tip_m: Array, base_m: Array, read_in: str, parts: Sequence[AnatomyPart] = ()
) -> SizeDoubt | None:
    """What speaks against the unit of a place (3,) [m] that the tip is to reach, its base at (3,) [m]; None: nothing.

    Only where another unit explains it: what is merely out of reach, or outside all lumens among the parts, is for
    whoever looks for a way.
    """
    length, away = reach_m(robot), float(np.linalg.norm(tip_m - base_m))
    lumens = [part for part in parts if part.role == "inside"]
    outside = bool(lumens) and away < PLAUSIBLE[0] * length and not _inside_any(lumens, tip_m)
    if NEAR * length <= away <= length * PLAUSIBLE[1] and not outside:
        return None
    for unit in _others(read_in):
        moved = tip_m * UNITS_M[unit] / UNITS_M[read_in]
        if not PLAUSIBLE[0] * length <= float(np.linalg.norm(moved - base_m)) <= PLAUSIBLE[1] * length:
            continue
        if lumens and not _inside_any(lumens, moved):
            continue
        sure = outside or unit in ("m", "mm", "um")
        where = " and outside all lumens" if outside else ""
        return SizeDoubt(unit, _away(away, length, f"are these in {IN_WORDS[unit]}?", where), sure)
    return None


def joint_doubts(robot: Robot, values: Mapping[str, object]) -> Iterator[tuple[str, SizeDoubt]]:
    """Values of joints, by name in deg or mm, that are most likely in radians or in metres: names and doubts."""
    joints = {joint.name: joint for joint in robot.drive.joints}
    given = {name: float(x) for name, x in values.items() if name in joints and isinstance(x, (int, float))}
    angles = {name: x for name, x in given.items() if joints[name].kind == "rotation" and x}
    if are_radians(angles.values()):
        rule = "is a whole part of a turn in radians, as its neighbours are: are these in radians?"
        yield next(iter(angles)), SizeDoubt("rad", rule, False)
    if are_degrees(np.round(np.radians(list(angles.values())), 9)):
        rule = "is a whole number of radians, as its neighbours are: are these degrees given for radians?"
        yield next(iter(angles)), SizeDoubt("deg", rule, False)
    ways = {name: x for name, x in given.items() if joints[name].kind == "translation" and x}
    most, length = max(map(abs, ways.values()), default=0.0), reach_m(robot)
    if 0 < most * UNITS_M["mm"] < NEAR / 10 * length and PLAUSIBLE[0] * length <= most <= length:
        rule = f"moves by {most:.3g} mm, the robot is {length * 1e3:.3g} mm long: are these in metres?"
        yield max(ways, key=lambda name: abs(ways[name])), SizeDoubt("m", rule, False)


def base_doubt(robot: Robot, tips_m: Sequence[Array], base_m: Array) -> SizeDoubt | None:
    """What speaks against the unit [mm] of a base's position (3,) [m] whose goals (3,) [m] are all beyond reach."""
    length = reach_m(robot)
    offset = float(np.linalg.norm(base_m))
    if 0 < offset < FINE_M and PLAUSIBLE[0] * length <= offset * UNITS_M["m"] / UNITS_M["mm"] <= LUMEN[1] * length:
        rule = f"moves the base by {offset / UNITS_M['mm']:.2g} mm, finer than a base is placed: is it in metres?"
        return SizeDoubt("m", rule, False, "position_mm")
    away = [float(np.linalg.norm(tip - base_m)) for tip in tips_m]
    if not away or min(away) <= length * PLAUSIBLE[1] or not base_m.any():
        return None
    for unit in _others("mm"):
        moved = [float(np.linalg.norm(tip - base_m * UNITS_M[unit] / UNITS_M["mm"])) for tip in tips_m]
        if all(PLAUSIBLE[0] * length <= one <= PLAUSIBLE[1] * length for one in moved):
            return SizeDoubt(unit, _away(min(away), length, f"is the base in {IN_WORDS[unit]}?"))
    return None


def turn_doubts(base: Mapping[str, object]) -> Iterator[SizeDoubt]:
    """What speaks against how the table [base] of a scenario's file says that the base is turned."""
    roll, quaternion = base.get("roll_deg"), base.get("quaternion_wxyz")
    if isinstance(roll, (int, float)) and are_radians([roll]):
        yield SizeDoubt("rad", "is a whole part of a turn in radians: is it in radians?", False, "roll_deg")
    if isinstance(quaternion, (list, tuple)) and [*quaternion] == [0, 0, 0, 1]:
        rule = "turns the base by 180 deg: is it the identity of those who write x, y, z, w? Here w comes first"
        yield SizeDoubt("", rule, False, "quaternion_wxyz")


def part_doubts(
    robot: Robot, parts: Sequence[AnatomyPart], tips_m: Sequence[Array], base_m: Array
) -> Iterator[tuple[int, SizeDoubt]]:
    """Parts, by number from 0, that are out of all proportion to the robot, or lumens that hold none of the goals."""
    length, thinnest = reach_m(robot), robot.tubes[-1].outer_diameter_m
    lumens = [part for part in parts if part.role == "inside"]
    lost = bool(lumens) and not any(_inside_any(lumens, tip) for tip in tips_m)
    for k, part in enumerate(parts):
        if (
            part.role == "avoid"
            and tips_m
            and part.shape.kind != "surface"
            and all(_holds(part, t, 1.0) for t in tips_m)
        ):
            rule = 'holds every goal, which nothing may enter: is it a lumen (role = "inside"), or the target itself?'
            yield k, SizeDoubt("", rule, False, "role")
        low, high = part.shape.box()
        size, far = float((high - low).max()), float(np.linalg.norm(np.clip(base_m, low, high) - base_m))
        said = f"is {size * 1e3:.3g} mm across, the robot {length * 1e3:.3g} mm long"
        small, large = size < thinnest / 2, size > LARGEST_PART * length
        if far > LARGEST_PART * length:
            rule = f"lies {far:.3g} m from the base, the robot is {length * 1e3:.3g} mm long: is it in another unit?"
            yield k, SizeDoubt("", rule, False, next(iter(part.shape.keys())))
            continue
        if part.shape.kind not in ("mesh", "surface"):
            if small and USUAL_PART[0] <= size * 1e3 / length <= USUAL_PART[1]:
                yield k, SizeDoubt("m", f"{said}: is it in metres?", False, [*part.shape.keys()][-1])
            continue
        likely = [
            words
            for words, factor in _factors()
            if USUAL_PART[0] <= size * factor / length <= USUAL_PART[1]
            and (part.role != "inside" or not tips_m or any(_holds(part, tip, factor) for tip in tips_m))
        ]
        missed = lost and part.role == "inside" and bool(tips_m) and not LUMEN[0] <= size / length <= LUMEN[1]
        if likely and (small or large or missed):
            where = " and none of the goals is in it" if missed else ""
            sure = missed and not USUAL_PART[0] <= size / length <= USUAL_PART[1]
            yield k, SizeDoubt(likely[0], f"{said}{where}: is it {' or '.join(likely)}?", sure)


def tolerance_doubts(
    robot: Robot, values: Mapping[tuple[str | int, ...], float]
) -> Iterator[tuple[tuple[str | int, ...], SizeDoubt]]:
    """Tolerances, margins and deviations, in mm or deg by the end of their keys, that are most likely in another unit.

    Those that are 0 are exact, and in no doubt.
    """
    most = WITHIN * reach_m(robot) / UNITS_M["mm"]
    for key, value in values.items():
        if not value:
            continue
        if str(key[-1]).endswith("_deg"):
            if value < TURNED_DEG[0] and TURNED_DEG[1] <= np.degrees(value) <= TURNED_DEG[2]:
                yield key, SizeDoubt("rad", "is finer than anything is turned: is it in radians?", False)
            elif are_radians([value]):
                yield key, SizeDoubt("rad", "is a whole part of a turn in radians: is it in radians?", False)
            continue
        is_fine = value < WITHIN_M[0] / UNITS_M["mm"]
        units = [unit for unit in _others("mm") if WITHIN_M[1] <= value * UNITS_M[unit] <= WITHIN_M[2]]
        if units and (is_fine or value > most):
            rule = "is finer than any tracker sees" if is_fine else "is more than a fifth of the robot's length"
            yield key, SizeDoubt(units[0], f"{rule}: is it in {IN_WORDS[units[0]]}?", False)


def _factors() -> Iterator[tuple[str, float]]:
    """By how much numbers are too small or too large that are read in the wrong one of two units, and its words."""
    for name, factor in (("1000", 1e3), ("25.4", 25.4), ("10", 10.0)):
        units = {"1000": "m read as mm", "25.4": "inches read as mm", "10": "cm read as mm"}[name]
        yield f"{name} times too small ({units})", factor
        reverse = {"1000": "mm read as m", "25.4": "mm read as inches", "10": "mm read as cm"}[name]
        yield f"{name} times too large ({reverse})", 1 / factor


def _inside_any(lumens: Sequence[AnatomyPart], tip_m: Array) -> bool:
    """Whether a place (3,) [m] is in any of the lumens."""
    return any(_holds(part, tip_m, 1.0) for part in lumens)


def _holds(part: AnatomyPart, tip_m: Array, factor: float) -> bool:
    """Whether a place is in a part whose numbers are multiplied by a factor."""
    low, high = part.shape.box()
    at = tip_m / factor
    if not (np.all(low <= at) and np.all(at <= high)):
        return False
    return float(part.shape.distance(at[None])[0]) <= 0


def _others(read_in: str) -> list[str]:
    return [unit for unit in UNITS_M if unit != read_in]


def _away(away_m: float, length_m: float, question: str, where: str = "") -> str:
    return f"lies {away_m * 1e3:.3g} mm from the base{where}, the robot is {length_m * 1e3:.3g} mm long: {question}"
