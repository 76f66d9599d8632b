"""Places and parts of a scenario that are most likely in another unit, by the robot's own length and by each other.

A goal cannot be much nearer to the base than the robot is long, nor farther; lumens hold the goals. Where the same
numbers in another unit are where they can be, that unit is named. And loads, which are not in the anatomy's frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.base.arrays import UNITS_M, Array, are_degrees, are_radians, in_radians
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Loads
from ctrplan.robot.magnitudes import in_words, reach_m
from ctrplan.robot.robot import Robot

NEAR = 0.01  # share of the robot's length: a tip that is nearer to the base lies in the plate
PLAUSIBLE = 0.05, 1.05  # shares of it at which goals are
BESIDE = 2.0  # lengths of the robot within which obstacles may be meant that it does not reach
LARGEST_PART = 25.0  # lengths of the robot
USUAL_PART = 0.02, 5.0  # of a part that is meant to be next to it
FACTORS = {  # by which numbers are too small or too large that are read in the wrong one of two units, usual ones first
    1e3: "1000 times too small (m read as mm)",
    1e-3: "1000 times too large (mm read as m)",
    10.0: "10 times too small (cm read as mm)",
    0.1: "10 times too large (mm read as cm)",
    25.4: "25.4 times too small (inches read as mm)",
    1 / 25.4: "25.4 times too large (mm read as inches)",
}
SMALLEST_FACTOR = min(factor for factor in FACTORS if factor > 1)
LONGEST_LUMEN_M = 1.0  # the vessels from groin to heart, the longest that a tube is led through
WITHIN_M = 1e-5, 1e-4, 0.02  # least tolerance, margin or deviation; and those that are usual
WITHIN = 0.2  # share of the robot's length that is the most of them
FINE_M = 1e-4  # m, to which a base is placed at best, by a tracker
TURNED_DEG = 0.02, 0.1, 20.0  # least deviation or tolerance of a direction; and those that are usual


class SizeDoubt(NamedTuple):
    """rule: the end of a sentence about the number. is_sure: whether nothing but another unit explains it."""

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
    near = max(NEAR * length, nearest_tip_m(robot))
    if near <= away <= length * PLAUSIBLE[1] and not outside:
        return None
    units = [
        unit
        for unit in _others(read_in)
        for moved in [tip_m * UNITS_M[unit] / UNITS_M[read_in]]
        if PLAUSIBLE[0] * length <= float(np.linalg.norm(moved - base_m)) <= PLAUSIBLE[1] * length
        and float(np.linalg.norm(moved)) >= NEAR * length  # else every goal beside a distant base would be one in um
        and (not lumens or _inside_any(lumens, moved))
    ]
    if not units:
        return None
    sure = outside or units[0] in ("m", "mm", "um")
    where = " and outside all lumens" if outside else ""
    return SizeDoubt(_away(away, length, f"are these in {in_words(units)}?", where), sure)


def load_notes(robot: Robot, base_R: Array) -> tuple[str, ...]:
    """That loads of a robot are in its own frame, where a base turned by (3, 3) makes another one of the anatomy's."""
    if robot.loads == Loads() or np.allclose(base_R, np.eye(3), atol=1e-6):
        return ()
    return (f"{robot.path or robot.name}: effects: has loads, which are in the robot's frame: the base turns them.",)


def refuse_loads(robot: Robot, file: str | None, key: str) -> None:
    """Raises InputError for loads where the base is looked for or varied, which would turn them along."""
    if robot.loads != Loads():
        rule = "has loads, which are stated in the robot's frame and would turn along with another base"
        raise InputError(f"{rule}: place it without", file=file, key=key)


def nearest_tip_m(robot: Robot) -> float:
    """Distance [m] from the base that the tip of a robot without loads keeps within the drive's limits.

    A curve that bends by less than a circle ends farther away than an arc of that circle as long (Schur's theorem), and
    tubes inside one another bend by less than the most bent one of them.
    """
    tube, most = robot.tubes[-1], max(section.curvature_per_m for each in robot.tubes for section in each.sections)
    ahead = float(robot.drive.travel_m[0][-1]) + tube.length_m
    if robot.loads != Loads() or robot.effects or ahead <= 0 or most * ahead >= 2 * np.pi:
        return 0.0
    return float(2 / most * np.sin(most * ahead / 2)) if most * ahead > 1e-6 else ahead


def joint_doubts(robot: Robot, values: Mapping[str, object]) -> Iterator[tuple[str, SizeDoubt]]:
    """Values of joints, by name in deg or mm, that are most likely in radians or in metres: names and doubts."""
    joints = {joint.name: joint for joint in robot.drive.joints}
    given = {name: float(x) for name, x in values.items() if name in joints and isinstance(x, (int, float))}
    angles = {name: x for name, x in given.items() if joints[name].kind == "rotation" and x}
    if (k := in_radians([*angles.values()])) is not None:
        alike = ", as its neighbours are: are these" if are_radians(angles.values()) else ": is it"
        yield [*angles][k], SizeDoubt(f"is a whole part of a turn in radians{alike} in radians?", False)
    if are_degrees(np.round(np.radians(list(angles.values())), 9)):
        rule = "is a whole number of radians, as its neighbours are: are these degrees given for radians?"
        yield next(iter(angles)), SizeDoubt(rule, False)
    ways = {name: x for name, x in given.items() if joints[name].kind == "translation" and x}
    most, length = max(map(abs, ways.values()), default=0.0), reach_m(robot)
    if 0 < most * UNITS_M["mm"] < NEAR / 10 * length and PLAUSIBLE[0] * length <= most <= length:
        rule = f"moves by {most:.3g} mm, the robot is {length * 1e3:.3g} mm long: are these in metres?"
        yield max(ways, key=lambda name: abs(ways[name])), SizeDoubt(rule, False)


def base_doubt(robot: Robot, tips_m: Sequence[Array], base_m: Array, read_in: str = "mm") -> SizeDoubt | None:
    """What speaks against the unit of a base's position (3,) [m] whose goals (3,) [m] are all beyond reach."""
    length = reach_m(robot)
    offset = float(np.linalg.norm(base_m))
    if (
        read_in == "mm"
        and 0 < offset < FINE_M
        and PLAUSIBLE[0] * length <= offset * UNITS_M["m"] / UNITS_M["mm"] <= USUAL_PART[1] * length
    ):
        rule = f"moves the base by {offset / UNITS_M['mm']:.2g} mm, finer than a base is placed: is it in metres?"
        return SizeDoubt(rule, False, "position_mm")
    away = [float(np.linalg.norm(tip - base_m)) for tip in tips_m]
    if not away or min(away) <= length * PLAUSIBLE[1] or not base_m.any():
        return None
    units = [
        unit
        for unit in _others(read_in)
        for moved in [[float(np.linalg.norm(tip - base_m * UNITS_M[unit] / UNITS_M[read_in])) for tip in tips_m]]
        if all(PLAUSIBLE[0] * length <= one <= PLAUSIBLE[1] * length for one in moved)
    ]
    rule = f"puts the goals {min(away) * 1e3:.3g} mm or more from the base, the robot is {length * 1e3:.3g} mm long"
    return SizeDoubt(f"{rule}: is the base in {in_words(units)}?") if units else None


def turn_doubts(base: Mapping[str, object]) -> Iterator[SizeDoubt]:
    """What speaks against how the table [base] of a scenario's file says that the base is turned."""
    roll, quaternion = base.get("roll_deg"), base.get("quaternion_wxyz")
    if isinstance(roll, (int, float)) and are_radians([roll]):
        yield SizeDoubt("is a whole part of a turn in radians: is it in radians?", False, "roll_deg")
    if isinstance(quaternion, (list, tuple)) and [*quaternion] == [0, 0, 0, 1]:
        rule = "turns the base by 180 deg: is it the identity of those who write x, y, z, w? Here w comes first"
        yield SizeDoubt(rule, False, "quaternion_wxyz")


def part_doubts(
    robot: Robot, parts: Sequence[AnatomyPart], tips_m: Sequence[Array], base_m: Array
) -> Iterator[tuple[int, SizeDoubt]]:
    """Parts, by number from 0, that are out of all proportion to the robot, or that hold none or all of the goals."""
    length, thinnest = reach_m(robot), robot.tubes[-1].outer_diameter_m
    lumens = [part for part in parts if part.role == "inside"]
    lost = bool(lumens) and not any(_inside_any(lumens, tip) for tip in tips_m)
    for k, part in enumerate(parts):
        of_file = part.shape.kind in ("mesh", "surface")
        if part.role == "avoid" and tips_m and part.shape.kind != "surface" and _hold([part], tips_m):
            rule = 'holds every goal, which nothing may enter: is it a lumen (role = "inside"), or the target itself?'
            yield k, SizeDoubt(rule, False, "role")
        low, high = part.box
        size, far = float((high - low).max()), _away_from(base_m, low, high)[0]
        said = f"is {size * 1e3:.3g} mm across, the robot {length * 1e3:.3g} mm long"
        small, large = size < thinnest / 2, size > LARGEST_PART * length
        if far > LARGEST_PART * length:
            rule = f"lies {far:.3g} m from the base, the robot is {length * 1e3:.3g} mm long: is it in another unit?"
            yield k, SizeDoubt(rule, False, _key(part))
            continue
        if not of_file and part.role == "avoid":
            if small and USUAL_PART[0] <= size * 1e3 / length <= USUAL_PART[1]:
                yield k, SizeDoubt(f"{said}: is it in metres?", False, [*part.shape.keys()][-1])
            continue
        usual = [f for f in FACTORS if USUAL_PART[0] <= size * f / length <= USUAL_PART[1]]
        if part.role == "inside" and tips_m:
            inside = [f for f in usual if any(_holds(part, tip / f) for tip in tips_m)]
            roomy = [f for f in usual if _hold(lumens, [tip / f for tip in tips_m], thinnest / 2 / f)]
            if lost and inside:
                sure = not USUAL_PART[0] <= size / length <= USUAL_PART[1]
                rule = f"{said} and none of the goals is in it: is it {_words(inside)}?"
                yield k, SizeDoubt(rule, sure and of_file, _key(part))
            elif not lost and size > LONGEST_LUMEN_M and (less := [f for f in roomy if f < 1]):
                yield k, SizeDoubt(f"{said}: is it {_words(less)}?", False, _key(part))
            continue
        if usual and (small or large):
            yield k, SizeDoubt(f"{said}: is it {_words(usual)}?", False, _key(part))


def scene_doubts(
    robot: Robot, parts: Sequence[AnatomyPart], tips_m: Sequence[Array], base_m: Array
) -> Iterator[tuple[int, SizeDoubt]]:
    """Parts, by number from 0, whose scene as a whole is of another size than the robot's way.

    Obstacles that all end before a tenth of the way to the goals, or begin far beyond the robot, hinder nothing;
    goals that are nearer to the wall of a lumen than the thinnest tube is wide are reached by no tube.
    """
    length, thinnest = reach_m(robot), robot.tubes[-1].outer_diameter_m
    way = max((float(np.linalg.norm(tip - base_m)) for tip in tips_m), default=length)
    obstacles = [k for k, part in enumerate(parts) if part.role == "avoid"]
    boxes = [parts[k].box for k in obstacles]

    def on_the_way(factor: float) -> bool:
        """Whether any of the obstacles is where the robot may be, their numbers multiplied by a factor."""
        ends = [_away_from(base_m, low * factor, high * factor) for low, high in boxes]
        return any(nearest <= BESIDE * length and farthest > way / SMALLEST_FACTOR for nearest, farthest in ends)

    if boxes and not on_the_way(1.0) and (likely := [factor for factor in FACTORS if on_the_way(factor)]):
        ends = [_away_from(base_m, *box) for box in boxes]
        nearest, farthest = min(end[0] for end in ends), max(end[1] for end in ends)
        where = f"ends {farthest * 1e3:.3g} mm from the base, the goals are {way * 1e3:.3g} mm away"
        rule = f"{where}: is it {_words(likely)}?"
        if nearest > length:
            where = f"begins {nearest * 1e3:.3g} mm from the base, the robot is {length * 1e3:.3g} mm long"
            rule = f"{where}: is it {_words(likely)}, or in another frame than [base]?"
        yield obstacles[0], SizeDoubt(rule, False, _key(parts[obstacles[0]]))
    lumens = [k for k, part in enumerate(parts) if part.role == "inside"]
    rooms = [max(-float(parts[k].shape.distance(tip[None])[0]) for k in lumens) for tip in tips_m if lumens]
    if rooms and 0 < max(rooms) < thinnest / 2:
        near = nearest_tip_m(robot)
        grown = [
            factor
            for factor in FACTORS
            if max(rooms) * factor > thinnest / 2
            and all(near <= np.linalg.norm(tip * factor - base_m) <= PLAUSIBLE[1] * length for tip in tips_m)
        ]
        if grown:
            rule = (
                f"leaves the goals {max(rooms) * 1e3:.2g} mm to its wall, the thinnest tube is {thinnest * 1e3:.3g} mm "
                f"wide: are anatomy and goals {_words(grown)}?"
            )
            yield lumens[0], SizeDoubt(rule, False, _key(parts[lumens[0]]))


def tolerance_doubts(
    robot: Robot, values: Mapping[tuple[str | int, ...], float], read_in: str = "mm"
) -> Iterator[tuple[tuple[str | int, ...], SizeDoubt]]:
    """Tolerances, margins and deviations, in mm or deg by the end of their keys, that are most likely in another unit.

    Lengths were written in `read_in`. Those that are 0 are exact, and in no doubt.
    """
    most = WITHIN * reach_m(robot) / UNITS_M["mm"]
    for key, value in values.items():
        if not value:
            continue
        if str(key[-1]).endswith("_deg"):
            if value < TURNED_DEG[0] and TURNED_DEG[1] <= np.degrees(value) <= TURNED_DEG[2]:
                yield key, SizeDoubt("is finer than anything is turned: is it in radians?", False)
            elif are_radians([value]):
                yield key, SizeDoubt("is a whole part of a turn in radians: is it in radians?", False)
            elif key[-1] == "rotation_sigma_deg" and value > TURNED_DEG[2]:
                unit = ": is it in degrees?" if read_in == "m" else ""
                yield key, SizeDoubt(f"is more than a base is ever off by{unit}", False)
            continue
        is_fine = value < WITHIN_M[0] / UNITS_M["mm"]
        number = value * UNITS_M["mm"] / UNITS_M[read_in]
        units = [unit for unit in _others(read_in) if WITHIN_M[1] <= number * UNITS_M[unit] <= WITHIN_M[2]]
        is_coarse = value > most and key[-1] != "radius_mm"
        if units and is_fine or is_coarse and (units or key[-1] == "tolerance_mm"):
            rule = "is finer than any tracker sees" if is_fine else "is more than a fifth of the robot's length"
            yield key, SizeDoubt(f"{rule}: is it in {in_words(units)}?" if units else rule, False)


def _words(factors: Sequence[float]) -> str:
    return " or ".join(FACTORS[factor] for factor in factors)


def _key(part: AnatomyPart) -> str:
    """The key of a part's table that says its size: the unit of a file, the first number of a formula."""
    return "unit" if part.shape.kind in ("mesh", "surface") else next(iter(part.shape.keys()))


def _away_from(base_m: Array, low: Array, high: Array) -> tuple[float, float]:
    """Least and greatest distance [m] of a box from the base (3,) [m]."""
    far = np.maximum(np.abs(low - base_m), np.abs(high - base_m))
    return float(np.linalg.norm(np.clip(base_m, low, high) - base_m)), float(np.linalg.norm(far))


def _inside_any(lumens: Sequence[AnatomyPart], tip_m: Array) -> bool:
    """Whether a place (3,) [m] is in any of the lumens."""
    return any(_holds(part, tip_m) for part in lumens)


def _hold(parts: Sequence[AnatomyPart], tips_m: Sequence[Array], room_m: float = 0.0) -> bool:
    """Whether each of the places (3,) [m] is in one of the parts, so far from its surface."""
    return all(any(_holds(part, tip, room_m) for part in parts) for tip in tips_m)


def _holds(part: AnatomyPart, tip_m: Array, room_m: float = 0.0) -> bool:
    """Whether a place (3,) [m] is in a part, so far from its surface."""
    low, high = part.box
    if not (np.all(low <= tip_m) and np.all(tip_m <= high)):
        return False
    return float(part.shape.distance(tip_m[None])[0]) <= -room_m


def _others(read_in: str) -> list[str]:
    return [unit for unit in UNITS_M if unit != read_in]


def _away(away_m: float, length_m: float, question: str, where: str = "") -> str:
    return f"lies {away_m * 1e3:.3g} mm from the base{where}, the robot is {length_m * 1e3:.3g} mm long: {question}"
