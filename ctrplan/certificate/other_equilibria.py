"""Whether the start of a motion, or a sign corner along it, has another equilibrium than the one that was walked to.

Nobody knows what the robot did before a plan. Corners of friction are solved from the frictionless shape. Where a
corner has a second equilibrium, far from it, an approach may end there and break the bound. Approaches are simulated:
all pairs turned by APPROACH_DEG at once, from either side each, which loads friction fully. Every branch with clearance
and friction is solved from the equilibria without them (`ctrplan.mechanics.equilibria`). Unless turns are known, the
robot may be on each of them, limits of its joints or not: it may have been turned where it was drawn back, and pushed
out again. Of robots that are not enumerated, turns are simulated. Where turns count, rotations straight from home lead
to the start, and have to end in the shape that is walked from.

Corners of friction are solved from the frictionless shape. A robot may come to the same corner from another one, or by
a turn, and stand elsewhere. Along the path each corner is solved from the shapes of all others, and from the equilibria
without clearance where there may be several. At the ends of legs it is also walked to from turns of all pairs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import cores
from ctrplan.certificate.friction_states import BEYOND_BOUND_M
from ctrplan.certificate.variants import Point, Variants
from ctrplan.certificate.walked_piece import Piece
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.equilibria import (
    SAME_SHAPE_M,
    Torus,
    branches,
    is_unique,
    other_branches,
    refuse_other_kinds,
)
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.guide import Guide
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity
from ctrplan.robot.robot import Robot

if TYPE_CHECKING:
    from ctrplan.mechanics.equilibria import Branch
    from ctrplan.mechanics.shapes import Bound
    from ctrplan.scenario.scenario import Scenario, StartTurns

APPROACH_DEG = 90.0  # of Section V of Ha et al. 2019
UNWIND = "to unwind it"
MOST_TURNS = 2  # of a joint before the start
MOST_WINDINGS = 8  # whole turns of joints before the start that are simulated: all of three tubes, a budget

_KNOWN: WeakKeyDictionary[Robot, dict[bytes, str]] = WeakKeyDictionary()


def other_start(scenario: Scenario, joints: Array) -> str:
    """A sentence about another equilibrium at joints (m,), beyond the bound there; empty if none is known.

    Where the scenario says what friction is like at its start, no approach comes before it, and where turns count there
    is no winding. What an observer found says nothing for the bound, which is that of every friction state.
    """
    robot = scenario.robot
    is_loaded = scenario.start_friction not in ("released", "oscillated")
    known = _KNOWN.setdefault(robot.unguided, {})
    key = joints.tobytes() + bytes([is_loaded]) + scenario.start_turns.encode()
    key += b"" if robot.guide is None else robot.guide.tip_m[0].tobytes()
    if key not in known:
        known[key] = _other_start(scenario, joints, is_loaded, scenario.start_turns)
    return known[key]


def _other_start(scenario: Scenario, joints: Array, is_loaded: bool, turns: StartTurns) -> str:
    robot = scenario.robot
    theta_b, l_b = robot.drive.collars(joints)
    if robot.n == 1:
        return ""
    bound = robot.mechanics.bound(theta_b, l_b)
    if not np.isfinite(bound.position_m):
        return ""
    approaches = [*_approaches(robot.n - 1)] if is_loaded and robot.friction.any() else []
    is_counted = turns != "unknown"
    if turns == "absolute" and robot.guide is None:
        turned, is_counted = _turned_from_home(robot, joints, bound)
        if turned:
            return turned
    if turns != "followed" or robot.guide is not None:
        try:
            if elsewhere := _elsewhere(robot, joints, bound, is_loaded, is_counted, turns):
                return elsewhere
        except InputError:  # of a kind whose equilibria are not enumerated
            approaches += _windings(robot, joints) if turns == "unknown" else []
    if not approaches:
        return ""

    def beyond(turns: Array) -> float:
        from_side = theta_b - np.concatenate([[0.0], np.cumsum(turns)])
        history, way = robot.history(), np.array([from_side, theta_b])
        try:
            if robot.guide is not None:  # it comes from where its own branch leads to without a snap
                out = history.follow(np.array([theta_b, from_side]), np.array([l_b, l_b]))
                if np.nansum(out.snaps) or out.status[-1] >= Status.FAILED:
                    return 0.0
            path = history.follow(way, np.array([l_b, l_b]))
            let_go = history.tip_beside(np.zeros(robot.n - 1))
        except SolverError:  # there is no equilibrium to come from
            return 0.0
        away = float(np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m)) - bound.position_m
        # Where friction is let go of, another branch shows even if it is nearer than the bound.
        apart = float(np.linalg.norm(let_go - bound.frictionless.tip_m))
        return float(np.nan_to_num(max(away, apart if apart > SAME_SHAPE_M else 0.0)))

    with ThreadPoolExecutor() as pool:
        result = list(pool.map(beyond, approaches))
    worst = int(np.argmax(result))
    if result[worst] <= BEYOND_BOUND_M:
        return ""
    turned = ", ".join(f"{np.degrees(turn):+.0f}" for turn in approaches[worst])
    away_mm, bound_mm = result[worst] * MM_PER_M, bound.position_m * MM_PER_M
    return (
        f"The start has another equilibrium: approached by relative turns of ({turned}) deg the tip stands "
        f"{away_mm:.1f} mm beyond what friction does there ({bound_mm:.2f} mm)"
    )


def _turned_from_home(robot: Robot, joints: Array, bound: Bound) -> tuple[str, bool]:
    """A sentence if rotations straight from home, at the start's translations, end in another shape, empty if not; and
    whether they say which: what a snap ends in, nobody promises.
    """
    home = np.where(robot.drive.is_rotation, 0.0, joints)
    theta_b, l_b = robot.drive.collars(np.array([home, joints]))
    if np.allclose(np.diff(np.diff(theta_b), axis=0), 0.0) or is_unique(robot, l_b[-1]):
        return "", True
    nearest = joints - 2 * np.pi * np.where(robot.drive.is_rotation, np.round(joints / (2 * np.pi)), 0.0)
    history, free = robot.history(), np.zeros(robot.n - 1)
    try:
        wound = history.follow(theta_b, l_b)
        let_go = history.tip_beside(free)
        unwound = history.follow(*robot.drive.collars(np.array([joints, home, nearest])))
        back = history.tip_beside(free)
    except SolverError:  # there is no equilibrium to come from
        return "", False
    away = float(np.linalg.norm(let_go - bound.frictionless.tip_m))
    if not away > SAME_SHAPE_M:
        return "", not np.nansum(wound.snaps)
    is_back = np.linalg.norm(back - bound.frictionless.tip_m) < SAME_SHAPE_M
    is_smooth = not (np.nansum(wound.snaps) or np.nansum(unwound.snaps))
    way = nearest - joints
    ways = f"{UNWIND} {_moved(robot, way)}" if is_back and is_smooth and way.any() else ""
    sentence = (
        f"The start has another stable equilibrium, where rotations straight from home end: the tip stands "
        f"{away * MM_PER_M:.1f} mm away there; {ways or 'start within half a turn of home, or where there is no other'}"
    )
    return sentence, True


def unwinding(scenario: Scenario) -> str:
    """How a robot that is followed on a branch of its own comes back to where one that was never wound up stands.

    Empty where that is not known, or where it stands there.
    """
    robot, joints = scenario.robot.unguided, scenario.start
    if scenario.robot.guide is None or robot.n == 1:
        return ""
    sentence, _ = _turned_from_home(robot, joints, robot.bound(*robot.drive.collars(joints)))
    return sentence[sentence.index(UNWIND) :] if UNWIND in sentence else ""


def other_start_within(scenario: Scenario, variants: Variants, joints: Array) -> str:
    """A sentence if a robot within what is stated has another equilibrium at joints (m,), empty if none has one.

    Ends of all axes are looked at, and the corner of the box where a second one is likeliest. Raises InputError for
    robots whose equilibria are not enumerated.
    """
    refuse_other_kinds(scenario.robot)
    is_loaded = scenario.start_friction not in ("released", "oscillated")
    for point in (*variants.ends(), _likeliest(variants, joints)):
        other, collars = variants.robot(point), variants.collars(point, joints[None])
        theta_b, l_b = collars[0][0], collars[1][0]
        if is_unique(other, l_b):
            continue
        bound = other.mechanics.bound(theta_b, l_b)
        tips = np.array([shape.tip_m for shape in (bound.frictionless, *bound.corners)])
        each = other_branches(branches(other, theta_b, l_b), tips)
        away = [one.apart_m if is_loaded else one.apart_m[:1] for one in each]
        if (apart := float(np.nan_to_num(away).max(initial=0.0))) > 0:
            stated = ", ".join(variants.title(int(axis)) for axis in np.flatnonzero(point))
            return (
                f"The start has another stable equilibrium, {apart * MM_PER_M:.1f} mm away, by what is stated of "
                f"{stated}; start where no robot within that has another"
            )
    return ""


def _likeliest(variants: Variants, joints: Array) -> Point:
    """The corner of the box where a second equilibrium at joints (m,) is likeliest, to first order.

    It comes with an unstable one, where the determinant of the tips' torus is negative and leads to the collars. At
    every place of the torus axes are put to the ends that lower the determinant, or bring it nearer to the collars.
    """

    def mapped(point: Point) -> tuple[Array, Array]:
        theta_b, l_b = variants.collars(point, joints[None])
        R, determinant = Torus(variants.robot(point).tubes, l_b[0]).map()
        off = R - np.diff(theta_b[0])
        return off - 2 * np.pi * np.round(off / (2 * np.pi)), determinant

    off, determinant = mapped(variants.end(-1))
    ends = [mapped(variants.end(axis)) for axis in range(variants.count)]
    turned = np.array([end - off for end, _ in ends])  # (A, Q, P)
    turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
    lowered = np.array([end - determinant for _, end in ends])  # (A, Q)
    best, least = variants.end(-1), np.inf
    for q in range(len(determinant)):
        signs = np.where(lowered[:, q] > 0, -1.0, 1.0)
        for axis in (None, *range(variants.count)):
            tried = signs if axis is None else np.where(np.arange(variants.count) == axis, -signs, signs)
            left = off[q] + tried @ turned[:, q]
            far = max(0.0, determinant[q] + tried @ lowered[:, q]) + float(np.linalg.norm(left))
            if far < least:
                best, least, signs = tuple(tried.tolist()), far, tried
    return best


def _moved(robot: Robot, by: Array) -> str:
    """A motion (m,) of joints in words: rotations, then translations."""
    named = list(zip(robot.drive.names, by.tolist(), robot.drive.is_rotation, strict=True))
    turned = ", ".join(f"{name} by {np.degrees(x):+.0f} deg" for name, x, is_turn in named if is_turn and x)
    pushed = ", ".join(f"{name} by {x * MM_PER_M:+.1f} mm" for name, x, is_turn in named if x and not is_turn)
    return " and ".join([f"turn {turned}"] * bool(turned) + [f"move {pushed}"] * bool(pushed))


def _elsewhere(robot: Robot, joints: Array, bound: Bound, is_loaded: bool, is_counted: bool, turns: StartTurns) -> str:
    """A sentence about another stable shape that turns lead to, whole ones where these do not count; empty without."""
    theta_b, l_b = robot.drive.collars(joints)
    if is_unique(robot, l_b):
        return ""
    states = [bound.frictionless, *bound.corners]
    for other in other_branches(branches(robot, theta_b, l_b), np.array([shape.tip_m for shape in states])):
        seen = other.apart_m if is_loaded else other.apart_m[:1]
        if np.isnan(seen).all() or (is_counted and other.turns.any()):
            continue
        way = _unturned(robot, joints, other.turns)
        if way is None:
            way = _way_home(robot, joints, other.branch, other.branch.first)
        twisted = ", ".join(f"{np.degrees(x):+.0f}" for x in other.branch.twist_rad[other.branch.first])
        away_mm, bound_mm = float(np.nanmax(seen)) * MM_PER_M, bound.position_m * MM_PER_M
        sentence = (
            f"The start has another stable equilibrium with clearance and friction, {away_mm:.1f} mm away, where "
            f"friction moves the tip by {bound_mm:.2f} mm: the pairs of tubes are twisted by ({twisted}) deg"
        )
        if way.any():
            sentence += f"; {UNWIND} {_moved(robot, way)}"
        if is_loaded and np.isnan(seen[0]):
            sentence += '; friction alone holds it: with friction = "oscillated" in [start] there is none'
        if turns == "absolute" and not is_counted:
            return f"{sentence}; rotations straight from home snap on the way, and may end in either"
        if other.turns.any():
            sentence += '; a drive that was homed, whose turns count, says so by turns = "absolute" in [start]'
        return sentence
    return ""


def _unturned(robot: Robot, joints: Array, turns: NDArray[np.int_]) -> Array | None:
    """(m,) [rad] whole turns that take the pairs' `turns` back, of the fewest joints; None if limits forbid them."""
    drive, most = robot.drive, range(MOST_TURNS, -MOST_TURNS - 1, -1)
    whole = itertools.product(*[most if is_turn else (0,) for is_turn in drive.is_rotation])
    for back in (2 * np.pi * np.array(turns) for turns in sorted(whole, key=lambda turns: sum(map(abs, turns)))):
        before = joints + back
        fits = np.all((before >= drive.lower) & (before <= drive.upper))
        if fits and np.allclose(np.diff(drive.matrix_theta @ back), -2 * np.pi * turns):
            return back
    return None


def way_to_unwind(robot: Robot, joints: Array, tip_m: Array, own_m: Array) -> str:
    """How tips (1 + C, 3), frictionless and of the corners, that were walked to joints (m,) come back to those that
    are solved there (1 + C, 3); empty where unknown.
    """
    theta_b, l_b = robot.drive.collars(joints)
    apart = np.linalg.norm(tip_m - own_m, axis=1)
    state = int(np.argmax(apart > SAME_SHAPE_M))
    if is_unique(robot, l_b) or not apart[state] > SAME_SHAPE_M:
        return ""
    try:
        each = branches(robot, theta_b, l_b)
    except InputError:  # of a kind whose equilibria are not enumerated
        return ""
    there = [branch for branch in each if np.linalg.norm(branch.tip_m[state] - tip_m[state]) < SAME_SHAPE_M]
    way = _way_home(robot, joints, there[0], state) if there else np.zeros(len(joints))
    return f"{UNWIND} {_moved(robot, way)}" if way.any() else ""


def _way_home(robot: Robot, joints: Array, branch: Branch, state: int) -> Array:
    """Rotations (m,) within limits that lead a branch, without a leap, to the shape that is solved at their end.

    In one of its friction states. Zeros where none was found. Few joints turn before many, as far as they may.
    """
    drive, mechanics = robot.drive, robot.unguided.mechanics
    theta_b, l_b = drive.collars(joints)
    s_m, _ = Torus(robot.tubes, l_b).shapes(np.zeros((1, robot.n - 1)), [0.0])
    phi = np.vstack([np.zeros(robot.n - 1), corner_signs(robot.n - 1)])[state]
    shapes = branch.angles_rad[state][None], branch.tip_m[state][None]
    for way in _signs(robot):
        led, there = Guide(theta_b[None], l_b[None], s_m, *shapes, phi), joints
        for turned in np.arange(TURN_RAD, 2 * np.pi + TURN_RAD, TURN_RAD):
            before, there = there, np.clip(joints + way * turned, drive.lower, drive.upper)
            turned_b, moved_b = drive.collars(there[None])
            led = led.along(mechanics, turned_b, moved_b).at(-1)
            if np.array_equal(there, before) or not np.array_equal(led.theta_b, turned_b):
                break
            own = mechanics.tips_with_friction(turned_b, moved_b, phi[None]).position_m
            if np.linalg.norm(own - led.tip_m) < SAME_SHAPE_M:
                return np.asarray(there - joints)
    return np.zeros(len(joints))


def _signs(robot: Robot) -> list[Array]:
    """(m,) signs of rotations of joints that turn collars against each other, few joints first."""
    signs = itertools.product(*[(0.0, 1.0, -1.0) if turns else (0.0,) for turns in robot.drive.is_rotation])
    relative = ((way, np.diff(robot.drive.matrix_theta @ way)) for way in map(np.array, signs))
    return sorted((way for way, turned in relative if turned.any()), key=np.count_nonzero)


def _approaches(pairs: int) -> Iterator[Array]:
    """(P,) relative turns [rad] that end at the configuration, of all pairs."""
    for signs in itertools.product((1.0, -1.0), repeat=pairs):
        yield np.radians(APPROACH_DEG) * np.array(signs)


def _windings(robot: Robot, joints: Array) -> list[Array]:
    """(P,) relative turns [rad] by whole turns of joints, or as far as limits let them; at most MOST_WINDINGS."""
    drive, results = robot.drive, list[Array]()
    for way in _signs(robot):
        before = np.clip(joints - 2 * np.pi * way, drive.lower, drive.upper)
        relative = np.diff(drive.matrix_theta @ np.where(drive.is_rotation, joints - before, 0.0))
        if relative.any() and not any(np.allclose(relative, other) for other in results):
            results.append(relative)
    return results[:MOST_WINDINGS]


EVERY_MM = 5.0  # of joint length
# Of each pair. Of 1,000 random configurations of the three-tube robot walks from 30 deg found all six that any of 30,
# 60 and 90 deg did; from 60 deg three, from 90 deg two.
TURN_RAD = np.radians(30.0)
COARSE = PathDensity(rotation_rad=0.26, translation_m=8e-3, motion_m=15e-3)


@dataclass(frozen=True)
class OtherEquilibrium:
    """The farthest that was found."""

    leg: int
    apart_m: float  # of bodies of one corner
    reached_by: str

    @property
    def sentence(self) -> str:
        """For the problems of a certificate."""
        return (
            f"On leg {self.leg + 1}: another equilibrium exists for the same joints and friction, "
            f"{self.apart_m * 1e3:.1f} mm away, reached {self.reached_by}."
        )


def other_equilibrium(robot: Robot, pieces: Sequence[Piece], lengths_mm: Sequence[float]) -> OtherEquilibrium | None:
    """The farthest other equilibrium of a corner found along walked pieces, each of a joint length; None if none."""
    if robot.n == 1 or not robot.friction.any():
        return None

    def look(item: tuple[int, Piece]) -> OtherEquilibrium:
        number, piece = item
        rows = _rows(piece, lengths_mm[number])
        results = [OtherEquilibrium(piece.leg, _from_corners(robot, piece, k), "from another corner") for k in rows]
        beside = (_from_branches(robot, piece, k) for k in rows)
        results += [OtherEquilibrium(piece.leg, apart_m, "from a shape without clearance") for apart_m in beside]
        ends = [0] if number == 0 else []
        if number + 1 == len(pieces) or pieces[number + 1].leg != piece.leg:
            ends.append(len(piece.l_b) - 1)
        results += [OtherEquilibrium(piece.leg, _from_turns(robot, piece, k), "by a turn") for k in dict.fromkeys(ends)]
        return max(results, key=lambda other: other.apart_m)

    with ThreadPoolExecutor(cores()) as pool:
        farthest = max(pool.map(look, enumerate(pieces)), key=lambda other: other.apart_m)
    return farthest if farthest.apart_m > SAME_SHAPE_M else None


def _rows(piece: Piece, length_mm: float) -> list[int]:
    """Samples of a piece about EVERY_MM apart, its end among them."""
    count = max(1, int(np.ceil(length_mm / EVERY_MM)))
    wanted = np.searchsorted(piece.samples.fraction, np.arange(1, count + 1) / count)
    return [int(k) for k in np.unique(np.minimum(wanted, len(piece.l_b) - 1))]


def _from_corners(robot: Robot, piece: Piece, sample: int) -> float:
    apart = robot.mechanics.corners_apart(piece.theta_b[sample], piece.l_b[sample], accuracy=piece.accuracy)
    return float(apart.max())


def _from_branches(robot: Robot, piece: Piece, sample: int) -> float:
    """[m] largest distance of another branch that no whole turns lie between, from the tips of the piece."""
    theta_b, l_b, samples = piece.theta_b[sample], piece.l_b[sample], piece.samples
    if is_unique(robot, l_b):
        return 0.0
    try:
        each = branches(robot, theta_b, l_b, accuracy=piece.accuracy)
    except InputError:  # of a kind whose equilibria are not enumerated
        return 0.0
    others = other_branches(each, np.vstack([samples.tip_m[sample], samples.corner_tip_m[sample]]))
    return max((float(np.nanmax(other.apart_m)) for other in others if not other.turns.any()), default=0.0)


def _from_turns(robot: Robot, piece: Piece, sample: int) -> float:
    """[m] largest distance of a corner's tip that was walked to by a turn from that of the piece."""
    theta_b, here = piece.theta_b[sample], piece.samples.corner_tip_m[sample]
    tips = [
        _walked_tips(robot, theta_b - np.append(0.0, np.cumsum(TURN_RAD * np.array(signs))), piece, sample)
        for signs in itertools.product((1.0, -1.0), repeat=robot.n - 1)
    ]
    apart = (float(np.linalg.norm(there - here, axis=1).max()) for there in tips if there is not None)
    return max(apart, default=0.0)


def _walked_tips(robot: Robot, begin: Array, piece: Piece, sample: int) -> Array | None:
    """(C, 3) tips of the corners, walked from base rotations `begin`; None where the robot snaps on the way.

    A robot on a branch of its own begins where that leads to; None where it ends before.
    """
    theta_b, l_b = np.array([begin, piece.theta_b[sample]]), np.array([piece.l_b[sample]] * 2)
    if robot.guide is not None:
        turned = robot.guide.near(theta_b[1], l_b[1]).along(robot.unguided.mechanics, theta_b[:1], l_b[:1])
        if not np.array_equal(turned.theta_b[-1], begin):
            return None
        robot = robot.guided(turned)
    result = robot.mechanics.check_path(theta_b, l_b, density=COARSE, accuracy=piece.accuracy)
    arrived = result.fraction[-1] == 1 and result.status[-1] < Status.UNSTABLE
    return result.corner_tip_m[-1] if arrived else None
