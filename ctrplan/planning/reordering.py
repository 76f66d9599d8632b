"""Reordering: legs of any path merged and reordered so that least friction error is left, never at a higher cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import SearchEnd
from ctrplan.certificate.certificate import Certificate
from ctrplan.drive.legs import merge_legs
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.errors import InputError
from ctrplan.motion.checker import Motion, MotionChecker
from ctrplan.pipeline.chain import plan_range_notes
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import ComparedWay, Compensation, Leg, ReorderReport, follow_the_leader_m, leg_kind
from ctrplan.scenario.joint_space import MotionStyle
from ctrplan.scenario.prediction import TIP_TOLERANCE_M, goal_error, start_states
from ctrplan.scenario.scenario import path_cost_mm

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

DEFERRED_M = (2e-3, 5e-3, 10e-3)  # of a translation, driven after the last rotation
RELEASED_M = 10e-3  # of translation after which nothing more is gained (Section V-B)


def with_translation_last(checker: MotionChecker, corners: Array) -> list[Array]:
    """The path (K, m) with some translation moved behind its last rotation, so that the last leg releases friction.

    A translation before that rotation stops short or goes too far by a little; where there is none, the tubes retreat
    and come back. Empty where the path ends with a long translation anyway.
    """
    is_rotation = checker.space.drive.is_rotation
    steps = np.diff(corners, axis=0)
    rotations = np.flatnonzero(np.any(steps[:, is_rotation], axis=1))
    if not len(rotations) or np.abs(steps[rotations[-1] + 1 :, ~is_rotation]).sum() >= RELEASED_M:
        return []
    last = int(rotations[-1])
    ways = []
    for joint in np.flatnonzero(~is_rotation):
        for length in DEFERRED_M:
            for offset in (length, -length):
                shift = np.where(np.arange(len(is_rotation)) == joint, offset, 0.0)
                rest = corners[last + 2 :] if last + 2 < len(corners) else corners[-1:]
                way = [*corners[: last + 1], corners[last] + shift, corners[last + 1] + shift, *rest]
                if last > 0 and not np.any(steps[last - 1, is_rotation]):
                    del way[last]  # the translation before the rotation goes there at once
                ways.append(merge_legs(np.array(way)))
    return [way for way in ways if checker.space.allowed(way)]


def translations_first(checker: MotionChecker, corners: Array) -> Array:
    """(K, m) all translations of the path at once, then all its rotations."""
    a, b = corners[0], corners[-1]
    return merge_legs(np.array([a, np.where(checker.space.drive.is_rotation, a, b), b]))


def straight_line(corners: Array) -> Array:
    """(2, m) all joints of the path together."""
    return corners[[0, -1]]


def alternative(checker: MotionChecker, name: str, corners: Array) -> ComparedWay:
    """What a way (K, m) would leave at the goal, and why it must not be driven if so."""
    length = sum(checker.space.length_mm(step) for step in np.diff(corners, axis=0))
    scenario, is_allowed = checker.scenario, checker.space.allowed(corners)
    error = goal_error(scenario.robot, corners, start_states(scenario)) if is_allowed else np.inf
    motion = checker.along(corners)
    return ComparedWay(name, error, float(length), motion.reason, _by_name(scenario, motion))


def _by_name(scenario: Scenario, motion: Motion) -> dict[str, float]:
    """What the scenario's own terms cost on a motion; nothing where it is not valid."""
    return _by_terms(scenario, motion.terms_mm)


def _by_terms(scenario: Scenario, terms_mm: Sequence[float]) -> dict[str, float]:
    """Costs [mm] of the scenario's own terms, in their order, by their names."""
    return {term.name: cost for term, cost in zip(scenario.terms, terms_mm, strict=False)}


def changes(checker: MotionChecker, before: Array, after: Array) -> tuple[str, ...]:
    """Sentences about what reordering did to a path (K, m), now (L, m)."""
    if before.shape == after.shape and np.array_equal(before, after):
        return ("Nothing was reordered: no other order is valid and better.",)
    sentences = [f"{_kinds(checker, before)} became {_kinds(checker, after)}."]
    beyond = _excess(after, before)[~checker.space.drive.is_rotation]
    if beyond.max(initial=0.0) > 0:
        shown = f"{beyond.max() * MM_PER_M:.1f} mm"
        sentences.append(
            f"The tubes retreat by {shown} before the last rotation and come back, which releases friction."
        )
    return tuple(sentences)


def _kinds(checker: MotionChecker, corners: Array) -> str:
    kinds = [leg_kind(checker.space.drive, a, b) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    return f"{len(kinds)} leg{'' if len(kinds) == 1 else 's'} ({', '.join(kinds)})"


def _excess(after: Array, before: Array) -> Array:
    """(m,) joint travel that the path has gained, half of it out and half back."""
    travel: Array = (np.abs(np.diff(after, axis=0)).sum(axis=0) - np.abs(np.diff(before, axis=0)).sum(axis=0)) / 2
    return np.where(travel > 1e-9, travel, 0.0)


LONGEST_SKIP = 12  # waypoints that one L-shaped motion may replace
MOST_SIMULATED = 3  # of the ways that hold translation back
EXCESS = 0.01  # of the bound by which a prediction may be above it


@dataclass(frozen=True, eq=False)
class Reordered:
    """Corners before and after, and what both are worth along the way."""

    before: Array  # (K, m)
    after: Array  # (L, m)
    motion_before: Motion
    motion_after: Motion
    style: MotionStyle
    on_line: bool = False  # follows a line with the tip, which takes all joints together


def least_error_order(checker: MotionChecker, corners: Array) -> Reordered:
    """The order of a path (K, m) that leaves the smallest predicted friction error at the goal, by simulated history.

    Candidates are the path itself, rotations before translations (`rotations_first`), and both with some translation
    held back until after the last rotation; none may cost more than the path does. Among those within the accuracy of
    the simulation the cheapest is taken. Where the scenario gives the error at the goal no weight, it is not asked for.
    """
    given = rotations_first(checker, corners)
    before = given.motion_before
    if not before.valid or checker.scenario.cost.error_goal == 0:
        return given
    robot, ways, starts = checker.scenario.robot, [corners], start_states(checker.scenario)
    if not np.array_equal(given.after, corners):
        ways.append(given.after)
    others = [way for base in tuple(ways) for way in with_translation_last(checker, base)]
    motions = [checker.along(way, remembers=True) for way in others]
    ranked = [k for k in np.argsort([_way_cost(checker, motion) for motion in motions]) if motions[k].valid]
    ways += [others[k] for k in ranked[:MOST_SIMULATED]]
    motions = [before, *(checker.along(way, remembers=True) for way in ways[1:])]
    costs = np.array([_way_cost(checker, motion) for motion in motions])
    cheap = np.flatnonzero(costs <= costs[0] + 1e-9)  # of no other is the error asked for
    if len(cheap) == 1:
        return given
    errors = np.array([goal_error(robot, ways[k], starts) for k in cheap])
    if not np.isfinite(errors).any():
        return given
    close = errors <= errors.min() + TIP_TOLERANCE_M
    best = int(cheap[np.argmin(np.where(close, costs[cheap], np.inf))])
    return Reordered(corners, ways[best], before, motions[best], _style(checker, ways[best]))


def as_given(checker: MotionChecker, corners: Array) -> Reordered:
    """A path (K, m) left as it is."""
    motion = checker.along(corners, remembers=True)
    return Reordered(corners, corners, motion, motion, _style(checker, corners))


def rotations_first(checker: MotionChecker, corners: Array) -> Reordered:
    """The cheapest way through the corners (K, m), some of them skipped by L-shaped motions; ends are kept.

    A shortest path over the corners whose edges are the given legs and all L-shaped motions between corners at most
    LONGEST_SKIP apart: the given path is among the candidates, so that the cost cannot rise. Motions count their length
    and stops, which is never too dear, and are walked only where they may be on it.
    """
    before = checker.along(corners, remembers=True)
    given = Reordered(corners, corners, before, before, _style(checker, corners))
    steps = [
        _Step(i, j, piece, _lower_bound_mm(checker, piece))
        for j in range(1, len(corners))
        for i in range(max(0, j - LONGEST_SKIP), j)
        for piece in _pieces(checker, corners, i, j)
    ]
    while True:
        chosen = _cheapest(steps, len(corners))
        if not chosen:
            return given
        unknown = [step for step in chosen if not step.known]
        if not unknown:
            break
        for step in unknown:
            motion = checker.along(step.piece, remembers=True)
            step.cost_mm = checker.cost_mm(motion, ends_at_goal=False) if motion.valid else np.inf
            step.known = True
    after = merge_legs(np.concatenate([corners[:1], *(step.piece[1:] for step in chosen)]))
    motion = checker.along(after, remembers=True)
    if not motion.valid or _way_cost(checker, motion) > _way_cost(checker, before) + 1e-9:
        return given
    return Reordered(corners, after, before, motion, _style(checker, after))


@dataclass(eq=False)
class _Step:
    """A way from corner i to corner j."""

    i: int
    j: int
    piece: Array  # (2 or 3, m)
    cost_mm: float  # at least; what it costs once known
    known: bool = False


def _cheapest(steps: list[_Step], count: int) -> list[_Step]:
    """The steps, sorted by where they end, that lead from the first corner to the last; empty if none do."""
    cost, came = np.full(count, np.inf), dict[int, _Step]()
    cost[0] = 0.0
    for step in steps:
        total = cost[step.i] + step.cost_mm
        if total < cost[step.j] - 1e-9:
            cost[step.j], came[step.j] = total, step
    if not np.isfinite(cost[-1]):
        return []
    chosen, j = [], count - 1
    while j > 0:
        chosen.append(came[j])
        j = came[j].i
    return chosen[::-1]


def _lower_bound_mm(checker: MotionChecker, piece: Array) -> float:
    length = sum(checker.space.length_mm(delta) for delta in np.diff(piece, axis=0))
    return checker.scenario.cost.path * length + checker.scenario.cost.stop * (len(piece) - 1)


def joined_paths(stages: list[Reordered]) -> Reordered:
    """The corners of all stages one after the other."""
    simultaneous = any(stage.style == "simultaneous" for stage in stages if not stage.on_line)
    return Reordered(
        np.concatenate([stages[0].before[:1], *(stage.before[1:] for stage in stages)]),
        np.concatenate([stages[0].after[:1], *(stage.after[1:] for stage in stages)]),
        _summed([stage.motion_before for stage in stages]),
        _summed([stage.motion_after for stage in stages]),
        "simultaneous" if simultaneous else "rotations before translations",
    )


def _summed(motions: list[Motion]) -> Motion:
    """The motions as one, which pays for the error at the end of each."""
    return Motion(
        all(motion.valid for motion in motions),
        next((motion.reason for motion in motions if motion.reason), ""),
        sum(motion.length_mm for motion in motions),
        sum(motion.error_integral_mm for motion in motions),
        sum(motion.end_bound_m for motion in motions),
        lambda: sum(motion.end_error_m for motion in motions),
        sum(motion.legs for motion in motions),
        tuple(map(sum, zip(*(motion.terms_mm for motion in motions), strict=True))),
    )


def _style(checker: MotionChecker, corners: Array) -> MotionStyle:
    kinds = {leg_kind(checker.space.drive, a, b) for a, b in zip(corners[:-1], corners[1:], strict=True)}
    return "simultaneous" if "simultaneous" in kinds else "rotations before translations"


def _pieces(checker: MotionChecker, corners: Array, i: int, j: int) -> list[Array]:
    """Ways from corner i to corner j: the L-shaped motion with the path's own winding, and the leg itself."""
    a, b = corners[i], corners[j]
    turned = np.where(checker.space.drive.is_rotation, b, a)
    ways = (
        [np.array([a, turned, b])]
        if not (np.array_equal(turned, a) or np.array_equal(turned, b))
        else [np.array([a, b])]
    )
    if j == i + 1 and len(ways[0]) > 2:
        ways.append(np.array([a, b]))
    return ways


def _way_cost(checker: MotionChecker, motion: Motion) -> float:
    return checker.cost_mm(motion, ends_at_goal=True) if motion.valid else np.inf


def assemble(
    scenario: Scenario,
    stages: list[Reordered],
    certificate: Certificate,
    *,
    planner: str,
    seed: int,
    clock_s: float,
    work_s: float | None = None,
    first_found_s: float = 0.0,
    first_certified_s: float = 0.0,
    period_s: float = 0.01,
    notes: tuple[str, ...] = (),
    ends: list[Array] | None = None,
    compensation: Compensation | None = None,
    ended_by: SearchEnd = "completion",
) -> Plan:
    """The plan of reordered corners, stage by stage; the trajectory rests after each stage.

    `ends` are what endings and compensation made of the stages, (K, m) each. Where a target is reached already, its
    stage is one leg of no length, as certificates count it.
    """
    drive, result = scenario.robot.drive, joined_paths(stages)
    ways = [stage.after for stage in stages] if ends is None else ends
    ways = [way if len(way) > 1 else np.repeat(way, 2, axis=0) for way in ways]
    driven = np.concatenate([ways[0][:1], *(way[1:] for way in ways)])
    rests = np.cumsum([len(way) - 1 for way in ways])
    legs = tuple(Leg(a, b, leg_kind(drive, a, b)) for a, b in zip(driven[:-1], driven[1:], strict=True))

    def cost(motion: Motion) -> float:
        return sum(motion.terms_mm) + path_cost_mm(
            scenario.cost,
            length_mm=motion.length_mm,
            legs=motion.legs,
            integral_mm=motion.error_integral_mm,
            left_m=motion.end_bound_m + motion.end_error_m,
        )

    a, b = result.motion_before, result.motion_after
    report = ReorderReport(
        cost_before_mm=cost(a),
        cost_after_mm=cost(b),
        goal_bound_before_m=stages[-1].motion_before.end_bound_m,
        goal_bound_after_m=stages[-1].motion_after.end_bound_m,
        error_integral_before_mm=a.error_integral_mm,
        error_integral_after_mm=b.error_integral_mm,
        stops_before=max(a.legs - 1, 0),
        stops_after=max(b.legs - 1, 0),
        terms_before_mm=_by_name(scenario, a),
        terms_after_mm=_by_name(scenario, b),
        **_compared(scenario, stages[-1], ways[-1], certificate),
    )
    try:
        trajectory = time_parameterise(driven, drive, period_s, rests=rests.tolist(), joinable=True)
    except InputError as error:  # the drive is that of the robot file
        file = scenario.robot.path if (error.key or "").startswith("joint.") else None
        raise InputError(error.rule, file=file, key=error.key, value=error.value, unit=error.unit) from None
    return Plan(
        scenario=scenario,
        seed=seed,
        planner=planner,
        style=result.style,
        legs=legs,
        certificate=certificate,
        trajectory=trajectory,
        reorder=report,
        clock_s=clock_s,
        work_s=work_s,
        first_found_s=first_found_s,
        first_certified_s=first_certified_s,
        notes=(*notes, *plan_range_notes(scenario.robot, driven), *_remarks(certificate)),
        compensation=compensation,
        ended_by=ended_by,
        follow_the_leader_m=follow_the_leader_m(scenario.robot, trajectory),
    )


def _compared(scenario: Scenario, stage: Reordered, driven: Array, certificate: Certificate) -> dict[str, Any]:
    """What was reordered on the way to the goal, and how to compare it with other ways; nothing for a line.

    driven (K, m): what settling and compensation made of the reordered way. Of that the certificate says whether it is
    valid, not the search, which keeps more room.
    """
    if stage.on_line:
        return {}
    checker = MotionChecker(scenario.stage_from(stage.after[0]))
    return {
        "changes": changes(checker, stage.before, stage.after),
        "compare": partial(_other_ways, checker.scenario, stage.before, driven, certificate),
    }


def _other_ways(scenario: Scenario, before: Array, driven: Array, certificate: Certificate) -> tuple[ComparedWay, ...]:
    """What a way as it was given (K, m), as it is driven (L, m), and in other orders would leave at the goal."""
    checker = MotionChecker(scenario)
    as_driven = ComparedWay(
        "as driven",
        certificate.goal_predicted_m,
        float(checker.space.lengths_mm(np.diff(driven, axis=0)).sum()),
        next(iter(certificate.problems), ""),
        _by_terms(scenario, checker.terms_mm(driven)),
    )
    return (
        alternative(checker, "as given", before),
        as_driven,
        alternative(checker, "straight line", straight_line(driven)),
        alternative(checker, "translations first", translations_first(checker, driven)),
    )


def _remarks(certificate: Certificate) -> tuple[str, ...]:
    """What the simulated histories found beside their errors."""
    samples, result = certificate.samples, []
    excess = samples.predicted_m - samples.bound_m * (1 + EXCESS) - TIP_TOLERANCE_M
    if excess.max() > 0:
        k = int(np.argmax(excess))
        beyond, where = (samples.predicted_m - samples.bound_m)[k] * MM_PER_M, samples.leg[k] + 1
        result.append(f"On leg {where} a simulated history leads {beyond:.2f} mm beyond the worst-case error.")
    if certificate.snaps:
        result.append("A simulated history slides to another equilibrium on the way, for a moment out of balance.")
    return tuple(result)
