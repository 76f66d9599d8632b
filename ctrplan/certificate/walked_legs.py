"""Finished legs walked for a certificate: everything that it rests on but simulated histories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress
from ctrplan.certificate.certificate import CertificateSamples
from ctrplan.certificate.every_state import in_every_friction_state
from ctrplan.certificate.friction_cube import WITHIN_M, refuse_many_tubes
from ctrplan.certificate.friction_states import bound_allowance_m, mesh_allowance_m
from ctrplan.certificate.narrow_samples import at_worst_ends, closely_solved, strained_as_solved
from ctrplan.certificate.other_equilibria import other_equilibrium, other_start, other_start_within
from ctrplan.certificate.problems import (
    BRANCH_TOLERANCE_M,
    PARTED,
    StatedBounds,
    apart_m,
    frictionless_miss,
    problems_of_limits,
    problems_of_walk,
    stated_bounds,
)
from ctrplan.certificate.uneven_friction import with_uneven_friction
from ctrplan.certificate.variants import MOST_LARGE, Variants
from ctrplan.certificate.walked_piece import (
    Piece,
    checked_samples,
    joined_samples,
    walk_pieces,
    walked,
    walked_finely,
)
from ctrplan.drive.legs import merge_legs
from ctrplan.drive.trajectory import too_fast
from ctrplan.errors import InputError
from ctrplan.mechanics.equilibria import SAME_SHAPE_M, is_unique
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.motion.checker import left_at_end
from ctrplan.motion.limits import TOO_CLOSE, path_limits
from ctrplan.scenario.joint_space import JointSpace, terms_mm
from ctrplan.scenario.prediction import start_load
from ctrplan.scenario.scenario import path_cost_mm
from ctrplan.scenario.start_branch import followed, standing

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario


_KNOWN: WeakKeyDictionary[Robot, dict[bytes, str]] = WeakKeyDictionary()
WITHIN = (
    "The start has another stable equilibrium, where rotations straight from home may end by what is stated of the "
    "robot; start within half a turn of home, or where there is no other"
)
FINER = 2  # times that thin clearances are walked anew: by the solved shapes, and by friction states between them
Look = Callable[["Scenario", list[Piece]], list[Piece]]  # at pieces, more closely


@dataclass(frozen=True, eq=False)
class WalkedLegs:
    """Legs walked for a certificate: what it rests on, before histories are simulated."""

    scenario: Scenario
    corners: Array  # (K, m)
    accuracy: Accuracy
    pieces: list[Piece]
    samples: CertificateSamples
    bounds: StatedBounds
    problems: list[str]  # but whether the goal is met
    spare_m: float = np.inf  # of clearance beyond what the scenario asks for: more than that is not looked for
    timing: Trajectory | None = None  # that a late drive is followed by; None for the motion that ctrplan makes
    walked: Sequence[Piece] = ()  # with all shapes, as walked; kept where the legs failed, for the next that are tried

    @property
    def failure(self) -> str:
        """The first reason not to certify the legs, or that the frictionless tip misses the goal; empty if none."""
        return next(iter(self.problems + frictionless_miss(self.scenario, self.samples.tip_m)), "")

    @property
    def broken_mm(self) -> Array:
        """(B,) joint lengths from the start at which a limit of clearance, stability or strain is found broken."""
        limits, samples = path_limits(self.scenario), self.samples
        is_broken = (samples.clearance_m < limits.clearance_m) | (samples.stability < limits.stability)
        is_broken |= samples.max_strain > limits.max_strain
        broken: Array = samples.path_mm[is_broken]
        return broken

    @property
    def length_mm(self) -> float:
        """Joint length."""
        return float(self.samples.path_mm[-1])

    @property
    def legs(self) -> int:
        """Pieces driven without a stop."""
        return len(merge_legs(self.corners)) - 1

    @cached_property
    def unknown_m(self) -> float:
        """What friction leaves of the tip's error at the end that no compensation knows [m], by the friction law."""
        loaded_m = float(self.samples.released_m[-1])
        return left_at_end(self.scenario, self.corners, self.pieces[-1].samples, loaded_m, start_load(self.scenario))

    @cached_property
    def cost_mm(self) -> float:
        """By the scenario's weights, its own terms included."""
        samples = self.samples
        return sum(terms_mm(self.scenario, self.corners)) + path_cost_mm(
            self.scenario.cost,
            length_mm=self.length_mm,
            legs=self.legs,
            integral_mm=self.integral_mm(samples.released_m),
            left_m=self.bounds.goal_m + self.unknown_m,
        )

    def integral_mm(self, error_m: Array) -> float:
        """The integral of an error [m] at every sample, (K,), along the path: 1 for 1 mm over 1 rad."""
        return float(np.trapezoid(error_m * MM_PER_M, self.samples.path_mm)) / self.scenario.cost.mm_per_rad


def walk_legs(
    scenario: Scenario,
    corners: Array,
    *,
    accuracy: Accuracy = "search",
    spare_m: float = np.inf,
    progress: Progress | None = None,
    failed: WalkedLegs | None = None,
    timing: Trajectory | None = None,
) -> WalkedLegs:
    """What decides whether the polyline `corners` (K, m) is valid, see `certify`.

    How much clearance is left is told where it is less than `spare_m` beyond what the scenario asks for; of more it is
    only known that it is more, which takes less time. What is refused already is not looked at more closely. Pieces of
    legs that `failed` in the same scenario are not walked again. `timing` is what a late drive is followed by, None the
    motion that ctrplan makes of the legs. Raises InputError for too many tubes, and for a timing that no drive follows.
    """
    refuse_many_tubes(scenario.robot)
    for name, speed, limit in () if timing is None else too_fast(scenario.robot.drive, timing.time_s, timing.position):
        rule = f"turns or moves {name} {speed / limit:.3g} times as fast as it can go"
        raise InputError(rule, file=scenario.path, key="timing")
    scenario = standing(scenario, corners)
    space = JointSpace.of(scenario)
    known = failed.walked if failed and failed.scenario is scenario else ()
    as_walked = walk_pieces(scenario, space, corners, accuracy, progress, known, timing)
    judged = _closely_judged(scenario, space, corners, as_walked, spare_m)
    if _may_keep_more(judged, path_limits(scenario).clearance_m):
        wider = walk_pieces(scenario, space, corners, accuracy, progress, as_walked, timing, most_large=MOST_LARGE[1])
        if wider[0].variants.large != as_walked[0].variants.large:
            judged = _closely_judged(scenario, space, corners, wider, spare_m)
    light = [piece.light() for piece in judged.pieces]
    kept = as_walked if judged.problems else ()
    figures = judged.samples, judged.bounds, judged.problems
    return WalkedLegs(scenario, corners, accuracy, light, *figures, spare_m, timing, kept)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Pieces looked at as closely as their problems allow."""

    pieces: list[Piece]
    samples: CertificateSamples
    bounds: StatedBounds
    problems: list[str]
    beyond_m: float  # what friction that differs along contacts, and the ends of small axes, took beyond allowances

    @property
    def is_too_close(self) -> bool:
        """Whether the anatomy is all that is in the way."""
        return bool(self.problems) and all(TOO_CLOSE in problem for problem in self.problems)


def _closely_judged(
    scenario: Scenario, space: JointSpace, corners: Array, pieces: list[Piece], spare_m: float
) -> _Judged:
    """What is said of walked pieces, which are walked in shorter steps where these may clear them.

    Cells of friction states tell no more clearance than is asked for: what is taken off it later is asked for then.
    """
    judged, limit_m = _judged(scenario, space, corners, pieces, spare_m), path_limits(scenario).clearance_m
    for _ in range(FINER):
        if judged.is_too_close and judged.beyond_m:
            judged = _judged(scenario, space, corners, pieces, spare_m, judged.beyond_m + WITHIN_M)
        finer = walked_finely(judged.pieces, pieces, limit_m, space) if judged.is_too_close else None
        if finer is None:
            break
        pieces, judged = finer, _judged(scenario, space, corners, finer, spare_m)
    return judged


def _may_keep_more(judged: _Judged, limit_m: float) -> bool:
    """Whether all that is too close has enough but for lengths of small axes, which are added up."""
    if not judged.is_too_close:
        return False
    return all(bool((piece.clearance_m + piece.added_up_m >= limit_m).all()) for piece in judged.pieces)


def _judged(
    scenario: Scenario, space: JointSpace, corners: Array, pieces: list[Piece], spare_m: float, more_m: float = 0.0
) -> _Judged:
    """What keeps walked pieces of the polyline `corners` (K, m) from being valid; the cheap reasons come first.

    Friction states are asked for `more_m` of clearance beyond the scenario's.
    """
    pieces = strained_as_solved(scenario, pieces)
    samples = joined_samples(scenario, space, pieces)
    with ThreadPoolExecutor(1) as beside:  # a few bounds and a few narrow samples leave half of the machine idle each
        stated = beside.submit(_bounds, scenario, samples, pieces)

        def looked(look_closer: Look, pieces: list[Piece]) -> tuple[list[Piece], CertificateSamples, list[str]]:
            pieces = look_closer(scenario, pieces)
            result = problems_of_walk(scenario, space, corners, pieces)
            closer = checked_samples(samples, pieces)
            return pieces, closer, result + problems_of_limits(scenario, pieces, closer, stated.result)

        other = other_start(scenario, corners[0]) or _other_within(scenario, space, pieces[0])
        problems = [f"{other}."] if other else []
        problems += problems_of_walk(scenario, space, corners, pieces)
        problems = problems or _parted_at_end(scenario, space, pieces[-1])
        for look_closer in (closely_solved, in_every_friction_state):
            if not problems:
                pieces, samples, problems = looked(partial(look_closer, spare_m=spare_m, more_m=more_m), pieces)
        before = pieces
        if not problems:
            equilibria = beside.submit(_other_equilibria, scenario, space, pieces)
            pieces, samples, problems = looked(with_uneven_friction, pieces)
            problems = problems or equilibria.result()
        bounds = stated.result()
    if not problems:
        pieces, samples, problems = looked(at_worst_ends, pieces)
    changed = ((a, b) for a, b in zip(before, pieces, strict=True) if a is not b)
    beyond_m = max((float((a.clearance_m - b.clearance_m).max()) for a, b in changed), default=0.0)
    return _Judged(pieces, samples, bounds, problems, beyond_m)


def _other_within(scenario: Scenario, space: JointSpace, first: Piece) -> str:
    """A sentence if robots within what is stated may stand elsewhere at the start than where their walks begin.

    Each has one equilibrium there; or turns count, and all are led from home as the file's robot is: walked like a leg,
    they meet no fold, and end where the first piece (of the whole walk) begins.
    """
    variants, joints, turns = first.variants, first.joints[0], scenario.start_turns
    if not variants.count or turns == "followed" or scenario.robot.n == 1:
        return ""
    known = _KNOWN.setdefault(scenario.robot.unguided, {})
    key = joints.tobytes() + repr((turns, scenario.start_friction, variants.large, first.accuracy)).encode()
    if key not in known:
        if turns == "unknown" or scenario.robot.guide is None:
            try:
                known[key] = other_start_within(scenario, variants, joints)
            except InputError:  # of a kind whose equilibria are not enumerated
                known[key] = "" if turns == "unknown" else WITHIN
        else:
            known[key] = WITHIN
        if known[key] and turns == "absolute":
            known[key] = _turned_within(scenario, space, first)
    return known[key]


def _turned_within(scenario: Scenario, space: JointSpace, first: Piece) -> str:
    """WITHIN, unless rotations straight from home lead all robots within what is stated to where `first` begins."""
    home = np.where(space.drive.is_rotation, 0.0, first.joints[0])
    way = np.array([home, first.joints[0]])
    if np.allclose(np.diff(np.diff(space.drive.collars(way)[0]), axis=0), 0.0):
        return ""
    there = replace(scenario, robot=scenario.robot.unguided, start=home, via=(), anatomy=(), start_turns="followed")
    there = standing(followed(there, home), way)
    pieces = walk_pieces(there, space, way, first.accuracy, None, large=first.variants.large)
    is_soft = min(float(piece.margins[0].min()) for piece in pieces) < scenario.margins.stability
    is_apart = apart_m(scenario, pieces[-1], first) > BRANCH_TOLERANCE_M
    return WITHIN if is_soft or is_apart or problems_of_walk(there, space, way[-1:], pieces) else ""


def _parted_at_end(scenario: Scenario, space: JointSpace, last: Piece) -> list[str]:
    """A sentence if a motion that begins where the walk ended would begin in another shape."""
    guide = scenario.robot.guide
    there = scenario if guide is None else replace(scenario, robot=scenario.robot.guided(guide.at(-1)))
    variants = Variants.of(there, last.joints[-1:], last.variants.large)
    again = walked(variants, space, last.leg, last.joints[-1:], last.accuracy)
    apart = apart_m(scenario, last, again)
    return [] if apart <= BRANCH_TOLERANCE_M else [f"On leg {last.leg + 1}: {PARTED[0]}, several equilibria exist."]


def miscounted(scenario: Scenario, joints: Array, tip_m: Array) -> str:
    """A sentence where turns count, and a motion ends in another shape than they say there; empty where in that one.

    It ends at joints (m,), its frictionless tip at (3,) [m] (robot frame). Around a fold no turn tells them apart.
    """
    if scenario.start_turns != "absolute" or is_unique(scenario.robot, scenario.robot.drive.collars(joints)[1]):
        return ""
    there = standing(replace(scenario, start=joints, robot=scenario.robot.unguided))
    away_m = float(np.linalg.norm(there.robot.solve(*there.robot.drive.collars(joints)).tip_m - tip_m))
    if away_m <= max(SAME_SHAPE_M, mesh_allowance_m(scenario.robot, "search")) or other_start(there, joints):
        return ""  # or what begins there is refused
    return (
        f"The motion ends {away_m * MM_PER_M:.1f} mm from the stable shape where rotations straight from home end, "
        "around a fold: turns would no longer say which; end elsewhere, or by the way that led there"
    )


def _other_equilibria(scenario: Scenario, space: JointSpace, pieces: Sequence[Piece]) -> list[str]:
    lengths_mm = [float(space.lengths_mm(np.diff(piece.joints, axis=0)).sum()) for piece in pieces]
    result = other_equilibrium(scenario.robot, pieces, lengths_mm)
    return [result.sentence] if result else []


def _bounds(scenario: Scenario, samples: CertificateSamples, pieces: list[Piece]) -> StatedBounds:
    """Friction's by the file's robot, on the certificate mesh where it matters; what parameters add comes on top."""
    accuracies = [piece.accuracy for number, piece in enumerate(pieces) for _ in range(len(piece.l_b) - (number > 0))]
    added = samples.parameter_bound_m
    walked = samples.bound_m - added
    stated = stated_bounds(scenario.robot, samples.joints, walked, accuracies)
    if not added.any():
        return stated
    friction = np.minimum(stated.worst_m, walked + bound_allowance_m(scenario.robot, "search"))
    return StatedBounds(stated.goal_m + float(added[-1]), float((friction + added).max()))
