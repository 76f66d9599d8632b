"""Arrival: where the tip ends after one motion, driven from any friction state that the robot may start in.

The friction bound says how far friction could push the tip if nobody knew how the robot got where it is. A plan knows.
Each pair of tubes forgets its past by its own slip, so that the set of friction states, carried along the motion by
simulated histories, shrinks to one where every pair slips. What is left is an offset that is known beforehand and can
be compensated, and what else is stated to be uncertain: coefficients of friction, execution, play, parameters,
registration. The arrival error adds these up. It is simulated and first order in parameters, not proven, and it holds
on the branch of equilibria that the certificate names.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.base.package import shown
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.errors import CtrplanError
from ctrplan.mechanics.history import HistoryState
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import (
    TIP_TOLERANCE_M,
    FrictionStart,
    PathPrediction,
    are_same,
    ball_centre,
    predict,
    rows_to_simulate,
)
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.target import TargetPose
from ctrplan.uncertainty.tip_slopes import tip_slopes
from ctrplan.uncertainty.worst_case import BaseBall, OffsetBox, farthest

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Goal, Scenario

FORGOTTEN = 0.01  # share of all friction states below which a pair has forgotten its past
MOST_RESTARTS = 3  # waypoints that are tried, a budget
COMPARED_EVERY = 5  # rows after which a detour is compared with the prediction
LAST_LEGS = 2  # whose inexact execution is simulated: those before leave next to nothing, a budget
MATTERS = 0.05  # share of the largest cause below which another is not worth a word
MOST_CORNERS = 16  # robots at ends of their friction intervals, a budget


def _cause(words: str) -> float:
    """A share of the arrival error, 0 unless there is one, and what it is called."""
    return field(default=0.0, metadata={"words": words})


@shown
@dataclass(frozen=True)
class ArrivalCauses:
    """The arrival error [m] by cause; the shares add up to it."""

    offset_m: float = _cause("what is left of the known offset")
    past_m: float = _cause("friction states before the motion")
    coefficients_m: float = _cause("coefficients of friction")
    memory_m: float = _cause("what contacts keep after slip")
    execution_m: float = _cause("inexact execution")
    play_m: float = _cause("play of the drive")
    parameters_m: float = _cause("uncertain parameters")
    registration_m: float = _cause("registration")
    unexplained_m: float = _cause("the model's own error")
    mesh_m: float = _cause("steps and meshes of the simulation")

    @property
    def ranked(self) -> list[tuple[str, float]]:
        """Words and share of each cause that has one, the largest first."""
        named = [(entry.metadata["words"], float(getattr(self, entry.name))) for entry in fields(self)]
        return sorted(((words, share) for words, share in named if not share <= 0), key=lambda pair: -pair[1])

    @property
    def main(self) -> list[tuple[str, float]]:
        """The largest of them: those that matter beside the first."""
        ranked = self.ranked
        return [(words, share) for words, share in ranked if share >= MATTERS * ranked[0][1]]

    @property
    def total_m(self) -> float:
        """Sum of all causes [m]."""
        return float(sum(getattr(self, entry.name) for entry in fields(self)))


@dataclass(frozen=True)
class ErasedPair:
    """How the motion erases the friction states that a pair of tubes had before it."""

    leg: int | None  # index of the leg on which the pair forgets them; None where it does not, or knows none
    turned_rad: float  # turn of the inner tube against the outer one since that leg began
    slid_m: float  # slide likewise
    kept: float  # share of all friction states that is possible at the end, 0 to 1


@shown
@dataclass(frozen=True, eq=False)
class Arrival:
    """Where the tip ends after a motion, from any friction state before it on the branch that is certified."""

    error_m: float  # worst distance from the target; of a goal in joint values, from the frictionless tip
    error_rad: float  # worst angle from the target's direction by friction and registration; 0 without one
    spread_m: float  # how far friction before the motion may take the tip from the middle
    middle_m: Array  # (3,) of the tips at the end, over friction states and coefficients; robot frame
    by_cause: ArrivalCauses
    erased: tuple[ErasedPair, ...]  # per pair, outermost first
    restart: int | None = None  # waypoint from which an interrupted run begins again; None: from a start as stated

    def keeps(self, goal: Goal) -> bool:
        """Whether the tip arrives within the goal's tolerances whatever friction was before; verdicts are amber else.

        Of a goal in joint values alone, which states none for the tip: True.
        """
        is_near = goal.tip_m is None or self.error_m <= goal.tolerance_m
        most_rad = goal.direction_tolerance_rad
        return bool(is_near and (most_rad is None or self.error_rad <= most_rad))

    def after(self, before: Arrival | None, legs: int) -> Arrival:
        """This arrival in a tour, whose stage begins after `legs` legs with the friction states that `before` left."""
        restart = None if self.restart is None else self.restart + legs
        if restart is None and before is not None:
            restart = before.restart
        erased = [pair if pair.leg is None else replace(pair, leg=pair.leg + legs) for pair in self.erased]
        for k, pair in enumerate(erased):
            if before and pair.leg is None and not pair.kept:  # forgotten before the stage
                erased[k] = before.erased[k]
        return replace(self, restart=restart, erased=tuple(erased))


@shown
@dataclass(frozen=True)
class TargetReached:
    """A target of a plan, and how well it is reached there."""

    name: str
    leg: int  # index of the leg that ends at it
    path_mm: float  # weighted joint length travelled until then
    bound_m: float
    bound_rad: float
    released_m: float  # the bound less what the friction law says translations released
    unknown_m: float  # what friction leaves there that no compensation knows, by the friction law; in the cost
    predicted_m: float  # by simulated history
    tip_error_m: float  # frictionless tip to the target; 0 for joint goals
    play_m: float = 0.0  # how far play of the drive may move the tip
    line_error_m: float | None = (
        None  # largest distance of the frictionless tip from the line on the way, if it has one
    )
    arrival: Arrival | None = None  # None where a history found no equilibrium


def arrival(
    scenario: Scenario,
    joints: Array,
    leg: NDArray[np.int_],
    prediction: PathPrediction,
    starts: Sequence[FrictionStart],
    *,
    goal_bound_m: float,
    play_m: float,
) -> Arrival:
    """The arrival of a motion through joints (K, m) [rad, m] on legs (K,), simulated from `starts`.

    `prediction` has to hold the states of the first start at the ends of legs, see `rows_to_keep`. What the steps of
    histories add is left to `with_steps`.
    """
    robot, ends = scenario.robot, scenario.robot.drive.collars(joints[-1:])
    without = robot.mechanics.tips_with_friction(*ends, np.zeros((1, robot.n - 1)))
    target = TargetPose.of(scenario, scenario.goal, without.position_m[0])
    variants = [*_coefficients(scenario, joints, prediction, starts)]
    tips = np.concatenate([prediction.tip_m, *(variant.tip_m for variant in variants)])
    centre, spread = ball_centre(tips[:, -1]), prediction.end_spread_m
    off = np.max([_off_m(target, row) for row in tips]) if len(tips) else 0.0
    offset = min(float(np.linalg.norm(centre - target.tip_m)), off) if target.line_m is None else max(off - spread, 0.0)
    shift, turn = _registration(scenario, centre)
    by_cause = ArrivalCauses(
        offset_m=offset,
        past_m=min(spread, off - offset),
        coefficients_m=max(off - offset - spread, 0.0) + _beyond_hull(variants),
        memory_m=robot.friction_memory * goal_bound_m,
        execution_m=_execution(robot, joints, leg, prediction),
        play_m=play_m,
        parameters_m=_parameters(robot, joints[-1]),
        registration_m=shift,
        unexplained_m=robot.model_error_m,
        mesh_m=_mesh(robot, joints[-1], prediction),
    )
    tangents = np.concatenate([prediction.tangent[:, -1], *(variant.tangent[:, -1] for variant in variants)])
    return Arrival(
        error_m=by_cause.total_m,
        error_rad=float(target.turned_rad(tangents).max()) + turn if target.direction is not None else 0.0,
        spread_m=spread,
        middle_m=centre,
        by_cause=by_cause,
        erased=_erased(robot, joints, leg, prediction),
    )


def with_steps(before: Arrival, steps_m: float) -> Arrival:
    """An arrival whose histories may be off by so much [m], by the steps that they were followed in."""
    by_cause = replace(before.by_cause, mesh_m=before.by_cause.mesh_m + steps_m)
    return replace(before, error_m=by_cause.total_m, by_cause=by_cause)


def rows_to_keep(leg: NDArray[np.int_]) -> list[int]:
    """Rows (K,) after which states are kept: the last one and the last but one of every leg."""
    last = np.flatnonzero(np.diff(leg, append=leg[-1] + 1) > 0)
    return sorted({max(int(row) - before, 0) for row in last for before in (0, 1)})


def _off_m(target: TargetPose, tips: Array) -> float:
    """[m] of a history's tips (K, 3) from the target at the end, and from its line on the way."""
    on_way = target.off_m(tips, is_end=False).max() if target.line_m is not None else 0.0
    return float(max(on_way, target.off_m(tips[-1:], is_end=True)[0]))


def _erased(robot: Robot, joints: Array, leg: NDArray[np.int_], prediction: PathPrediction) -> tuple[ErasedPair, ...]:
    """For each pair, when its set of friction states has shrunk to one for good."""
    theta, slide = (np.diff(part, axis=1) for part in robot.drive.collars(joints))
    spread, results = prediction.friction_spread, []
    for pair in range(robot.n - 1):
        known = spread[:, pair] < FORGOTTEN
        row = len(known) - int(np.argmin(known[::-1])) if not known.all() else 0
        if row >= len(known) or row == 0:
            results.append(ErasedPair(None, 0.0, 0.0, float(spread[-1, pair])))
            continue
        begin = max(int(np.argmax(leg == leg[row])) - 1, 0)
        turned, slid = (float(abs(part[row, pair] - part[begin, pair])) for part in (theta, slide))
        results.append(ErasedPair(int(leg[row]), turned, slid, float(spread[-1, pair])))
    return tuple(results)


def restart_waypoint(
    scenario: Scenario, joints: Array, leg: NDArray[np.int_], end_m: Array, starts: Sequence[FrictionStart]
) -> int | None:
    """The last waypoint of a motion from which its legs erase every friction state; the first where no other does.

    joints (K, m) on legs (K,), rows as simulated; end_m (3,) where the tip ends. Corners of friction are simulated from
    the waypoint on. None where the friction that the motion begins with is known and no later waypoint does: the claim
    needs that start.
    """
    robot = scenario.robot
    is_known = scenario.start_friction != "unknown" or any(isinstance(start, HistoryState) for start in starts)
    law, tried = friction_law(robot), 0
    begins = np.flatnonzero(np.diff(leg, prepend=leg[0]) > 0) - 1  # last rows of the legs before
    ends = np.flatnonzero(np.diff(leg, append=leg[-1] + 1) > 0).tolist()
    for waypoint, row in reversed(list(zip(leg[begins + 1].tolist(), begins.tolist(), strict=True))):
        onward = robot.drive.collars(joints[[row, *(end for end in ends if end > row)]])
        if not np.all(law.unknown_after(np.ones(robot.n - 1), *onward) < FORGOTTEN):
            continue  # the friction law sees no use in a simulation
        if all(_all_end_at(robot, joints[row:], end_m, some) for some in opposite_first(robot.n - 1)):
            return int(waypoint)
        tried += 1
        if tried == MOST_RESTARTS:
            break
    return None if is_known else 0


def opposite_first(pairs: int) -> tuple[list[FrictionStart], list[FrictionStart]]:
    """Two opposite corners of friction, which are likeliest to tell whether it is forgotten; and all other states."""
    corners: list[FrictionStart] = list(itertools.product((1.0, -1.0), repeat=pairs))
    return [corners[0], corners[-1]], ["released", *corners[1:-1]]


def _all_end_at(robot: Robot, joints: Array, end_m: Array, starts: Sequence[FrictionStart]) -> bool:
    """Whether histories along joints (K, m) end at a tip (3,), within what they are simulated to."""
    try:
        tips = predict(robot, joints, starts).tip_m[:, -1]
    except CtrplanError:
        return False
    return bool(np.linalg.norm(tips - end_m, axis=1).max() <= TIP_TOLERANCE_M)


def beside_nominal(scenario: Scenario, corners: Array, starts: Sequence[FrictionStart]) -> Array:
    """(3,) [m] from the middle of the nominal robot's tips after a motion through corners (K, m) to that of all."""
    nominal = predict(scenario.robot, corners, starts)
    tips = [nominal.tip_m, *(variant.tip_m for variant in _coefficients(scenario, corners, nominal, starts))]
    shift: Array = ball_centre(np.concatenate(tips)[:, -1]) - nominal.end_middle_m
    return shift


def _coefficients(
    scenario: Scenario, joints: Array, prediction: PathPrediction, starts: Sequence[FrictionStart]
) -> Iterator[PathPrediction]:
    """Histories of robots at all ends of their friction intervals, and last of the one in their middle.

    Two opposite corners and no friction stand for all start states where the nominal robot forgets them.
    """
    robots = friction_variants(scenario.robot)
    if not robots:
        return
    chosen, others = opposite_first(scenario.robot.n - 1)
    if prediction.friction_spread[-1].max(initial=0.0) >= FORGOTTEN:
        chosen = chosen + others
    if len(starts) == 1 and isinstance(starts[0], str):
        chosen = list(starts)
    for robot in robots:
        yield predict(robot, joints, chosen)


def friction_variants(robot: Robot) -> list[Robot]:
    """Robots at every corner of the intervals of friction coefficients, the one in the middle last; none without any.

    Intervals are those of contacts, of [uncertainty], and of effects that set friction.
    """
    parameters = uncertain_parameters(robot)
    known = [j for j, title in enumerate(parameters.title) if title == "friction"]
    contacts = np.flatnonzero(robot.friction[:, 0] < robot.friction[:, 1])
    axes = len(known) + len(contacts)
    if axes == 0:
        return []
    corners = list(itertools.product((0.0, 1.0), repeat=axes))
    if len(corners) > MOST_CORNERS:  # all together, and each by itself
        single = np.eye(axes)
        corners = [tuple(row) for row in np.vstack([np.zeros(axes), np.ones(axes), single, 1 - single]).tolist()]
    return [_at_shares(robot, parameters, known, contacts, shares) for shares in [*corners, (0.5,) * axes]]


def _at_shares(
    robot: Robot, parameters: UncertainParameters, known: list[int], contacts: NDArray[np.intp], shares: Sequence[float]
) -> Robot:
    """The robot with its friction coefficients at shares of their intervals, 0 their lower ends."""
    offset = np.zeros(parameters.count)
    for j, share in zip(known, shares, strict=False):
        offset[j] = parameters.low[j] + share * (parameters.high[j] - parameters.low[j]) - parameters.value[j]
    moved = parameters.robot_at(offset) if known else robot
    changed = list(moved.contacts)
    for k, share in zip(contacts.tolist(), shares[len(known) :], strict=True):
        low, high = robot.friction[k]
        value = float(low + share * (high - low))
        changed[k] = replace(changed[k], friction_coefficient=(value, value))
    return replace(moved, contacts=tuple(changed))


def _beyond_hull(variants: Sequence[PathPrediction]) -> float:
    """[m] by which the robot in the middle ends off the mean of those at the ends: what corners may miss."""
    if len(variants) < 2:
        return 0.0
    *ends, middle = (variant.end_middle_m for variant in variants)
    return float(np.linalg.norm(middle - np.mean(ends, axis=0)))


def _execution(robot: Robot, joints: Array, leg: NDArray[np.int_], prediction: PathPrediction) -> float:
    """[m] by which inexact execution of the last legs may move the tip at the end: their effects added up.

    Joints go beyond the end of a leg by the drive's tolerance and come back; where several move, the first or the last
    of them is late by it. What is left of that after the rest of the motion is simulated, as far as there is something.
    """
    drive, kept = robot.drive, dict(prediction.states)
    space = JointSpace.of_robot(robot)
    most = np.where(drive.is_rotation, drive.execution.rotation_rad, drive.execution.translation_m)
    last = np.flatnonzero(np.diff(leg, append=leg[-1] + 1) > 0)
    runs: list[tuple[HistoryState, Array, int]] = []
    for row in last[-LAST_LEGS:].tolist():
        begin = max(int(np.argmax(leg == leg[row])) - 1, 0)
        moved = joints[row] - joints[begin]
        way = np.where(np.abs(moved) > JOINT_ROUNDING, np.sign(moved) * most, 0.0)
        moving = np.flatnonzero(way)
        beyond = np.clip(joints[row] + way, drive.lower, drive.upper)
        if row in kept and way.any() and space.allowed(beyond):  # else the drive is exact, or at a stop
            runs.append((kept[row], np.array([beyond, joints[row]]), row))
        for joint in {int(moving[0]), int(moving[-1])} if len(moving) > 1 and row - 1 in kept else ():
            late = joints[row] - np.where(np.arange(len(way)) == joint, way, 0.0)
            if space.allowed(late):
                runs.append((kept[row - 1], np.array([late, joints[row]]), row))
    with ThreadPoolExecutor(cores()) as pool:
        tips = list(pool.map(lambda run: _end_of(robot, joints, prediction, *run), runs))
    away = np.linalg.norm(np.array(tips).reshape(-1, 3) - prediction.tip_m[0, -1], axis=1)
    return float(np.nan_to_num(away, nan=np.inf).sum())


def _end_of(
    robot: Robot, joints: Array, prediction: PathPrediction, state: HistoryState, detour: Array, row: int
) -> Array:
    """(3,) tip after a detour (D, m) from a state to a row of joints (K, m), and the rest of them.

    That of the prediction as soon as the detour is forgotten; NaN where no equilibrium is found.
    """
    history = robot.history(accuracy=prediction.accuracy)
    try:
        history.restore(state)
        path, begin = history.follow(*robot.drive.collars(detour)), row + 1
        while begin < len(joints):
            path = history.follow(*robot.drive.collars(joints[begin : begin + COMPARED_EVERY]))
            begin += len(path.position_m)
            pose = np.concatenate([path.position_m[-1], path.tangent[-1], path.phi[-1]])
            known = (part[0, begin - 1] for part in (prediction.tip_m, prediction.tangent, prediction.phi))
            if are_same(pose, np.concatenate([*known])[None])[0]:
                return np.asarray(prediction.tip_m[0, -1])
    except CtrplanError:
        return np.full(3, np.nan)
    return np.asarray(path.position_m[-1])


def _parameters(robot: Robot, joints: Array) -> float:
    """[m] by which uncertain parameters but those of friction may move the tip at joints (m,), in any friction state.

    First order.
    """
    parameters = uncertain_parameters(robot)
    friction = np.array([title == "friction" for title in parameters.title], dtype=bool)
    if not parameters.count or friction.all():
        return 0.0
    rest = parameters.measured(friction) if friction.any() else parameters
    slopes = tip_slopes(rest, *robot.drive.commanded(joints[None]))
    by = slopes.by[0]
    by = by[np.isfinite(by).all(axis=(1, 2))]
    result = farthest(np.zeros((len(by), 3)), OffsetBox.of(rest).displaced(by))
    return float(result.length_m.max(initial=0.0)) if len(by) else np.inf


def _registration(scenario: Scenario, tip_m: Array) -> tuple[float, float]:
    """[m], [rad] by which the base's stated errors move and turn a tip (3,) of the robot's frame, in 95 % of cases."""
    stated = scenario.registration
    ball = BaseBall.of(stated.position_sigma_m, stated.rotation_sigma_rad)
    return ball.shift_m + ball.rotation_rad * float(np.linalg.norm(tip_m)), ball.rotation_rad


def _mesh(robot: Robot, joints: Array, prediction: PathPrediction) -> float:
    """[m] a simulated tip may be off by its mesh: the finer mesh's tip in the same friction state is so far."""
    collars, phi = robot.drive.collars(joints[None]), np.clip(prediction.phi[:1, -1], -1, 1)
    solve = partial(robot.mechanics.tips_with_friction, *collars, phi)
    coarse, fine = (solve(accuracy=mesh).position_m[0] for mesh in ("search", "certificate"))
    return float(np.linalg.norm(fine - coarse))


def simulated_rows(scenario: Scenario, joints: Array, leg: NDArray[np.int_]) -> tuple[NDArray[np.int_], list[int]]:
    """Rows of samples (K, m) on legs (K,) that histories are followed through, and those whose states are kept."""
    rows = rows_to_simulate(scenario.robot, joints, leg)
    return rows, rows_to_keep(leg[rows])
