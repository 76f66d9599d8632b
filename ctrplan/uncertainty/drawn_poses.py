"""Poses of the tip of drawn robots in every friction state, and where simulated histories of them end.

The quadratic is fitted to the solves, with ridge, for parameters may be correlated. Where there are too many parameters
for all its terms, products of two are left out. What it does not explain is given to the draws in turn.

A robot with other parameters ends in another friction state than the file's robot. How far that leaves its tip from
where a solve in all corners of friction has it is what the linearised model can't know.

What the solves find beyond first order is in all draws: a mean of 0.03 mm of it made stated chances 4 points too small
(docs/log/planning.md, coverage of uncertain parameters).
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.history import History, HistoryState
from ctrplan.robot.observer import ObservedHistory
from ctrplan.scenario.prediction import FrictionStart, predict, rows_to_simulate, start_states
from ctrplan.uncertainty.parameters import UncertainParameters
from ctrplan.uncertainty.target import Misses, TargetPose
from ctrplan.uncertainty.tip_slopes import TipSlopes, clamped_collars, poses_at, tip_slopes
from ctrplan.uncertainty.worst_case import SEED, SOLVED, Draws

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

RIDGE = 1.0  # beside sums of squares of as many as there are solves
SHARE = 0.5  # of the solves, as many terms at most


@dataclass(frozen=True, eq=False)
class BeyondFirstOrder:
    """What R solves differ by from first order."""

    weight: Array  # (F, ...) of the quadratic's terms
    remainder: Array  # (R, ...) NaN where there was no equilibrium

    @classmethod
    def of(cls, deviations: Array, result: Array) -> BeyondFirstOrder:
        """Fits differences (R, ...) of draws, deviations (R, P) from their values in standard deviations."""
        flat, terms = result.reshape(len(result), -1), _terms(deviations, len(result))
        known = ~np.isnan(flat).any(axis=1)
        A, values = terms[known], flat[known]
        if len(A) * SHARE < A.shape[1]:
            return cls(np.zeros((A.shape[1], *result.shape[1:])), result)
        solved = np.linalg.solve(A.T @ A + RIDGE * np.eye(A.shape[1]), A.T @ values)
        weight = np.asarray(solved, dtype=np.float64).reshape(-1, *result.shape[1:])
        return cls(weight, result - np.tensordot(terms, weight, axes=1))

    def at(self, deviations: Array, place: int) -> Array:
        """(M, ...) of draws (M, P), the first R those solved, at one place of the first axis after the draws."""
        quadratic = np.tensordot(_terms(deviations, len(self.remainder)), self.weight[:, place], axes=1)
        result: Array = quadratic + repeated(self.remainder[:, place], len(deviations))
        return result


def repeated(values: Array, count: int) -> Array:
    """(count, ...) values (R, ...) over and over."""
    result: Array = np.take(values, np.arange(count), axis=0, mode="wrap")
    return result


def _terms(deviations: Array, solves: int) -> Array:
    """(M, F) one, linear terms, squares, and products of two unless they are too many."""
    count, P = deviations.shape
    columns = [np.ones((count, 1)), deviations, deviations**2]
    if SHARE * solves >= 1 + 2 * P + P * (P - 1) // 2:
        i, j = np.triu_indices(P, 1)
        columns.append(deviations[:, i] * deviations[:, j])
    return np.concatenate(columns, axis=1)


BATCH, MOST = 16, 32  # robots; more until the mean of what they are off by is known to MEAN_M
MEAN_M = 0.01e-3  # standard error, a hundredth of usual tolerances
START_SEED = SEED + 1  # other random numbers than those of the robots


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """A motion of which the poses at some samples are asked for."""

    joints: Array  # (K, m)
    leg: NDArray[np.int_]  # (K,)
    rows: NDArray[np.int_]  # (W,) rising


@dataclass(frozen=True, eq=False)
class SimulatedPoses:
    """At W places of a motion; NaN after a history that found no equilibrium."""

    nominal: Array  # (H, W, 6) of the file's robot from each of H start states
    start: NDArray[np.int_]  # (M,) of each draw
    beyond: Array  # (R, W, 6) how far the first R draws end from there, displaced as solves in all corners are

    @classmethod
    def of(
        cls, scenario: Scenario, parameters: UncertainParameters, path: DrivenPath, offsets: Array, solved: Array
    ) -> SimulatedPoses:
        """Histories of draws with parameters offsets (M, P) away from their values.

        Solves of the first (R, W, 6) move poses by `solved` on the mean over friction states.
        """
        starts, weight = _starts(scenario)
        start = np.random.default_rng(START_SEED).choice(len(starts), len(offsets), p=weight)
        joints, rows = _simulated_rows(scenario.robot, path)
        commanded = scenario.robot.drive.commanded(joints)
        own = predict(scenario.robot, joints, starts)
        nominal = np.concatenate([own.tip_m, own.tangent], axis=2)[:, rows]

        def driven(k: int) -> Array:
            robot = parameters.robot_at(offsets[k])
            return _driven(robot, starts[start[k]], *clamped_collars(parameters, robot, *commanded), rows)

        beyond = np.empty((0, len(rows), 6))
        with ThreadPoolExecutor(cores()) as pool:
            while parameters.count and len(beyond) < min(MOST, len(solved)) and not _is_known(beyond):
                more = np.arange(len(beyond), min(len(beyond) + BATCH, len(solved)))
                result = np.array(list(pool.map(driven, more.tolist())))
                beyond = np.concatenate([beyond, result - nominal[start[more]] - solved[more]])
        return cls(nominal, start, beyond)

    def middle(self, w: int) -> Array:
        """(6,) at a place."""
        result: Array = self.nominal[:, w].mean(axis=0)
        return result

    def started(self, w: int, count: int) -> Array:
        """(count, 6) of the file's robot from the start states of the first draws."""
        result: Array = self.nominal[self.start[:count], w]
        return result


def _is_known(beyond: Array) -> bool:
    """Whether the mean of (R, W, 6) is, for every tip that was found."""
    tips = beyond[~np.isnan(beyond).any(axis=(1, 2)), :, :3]
    if len(tips) < 2:
        return False
    error = np.linalg.norm(tips.std(axis=0, ddof=1), axis=1) / np.sqrt(len(tips))
    return bool(error.max() <= MEAN_M)


def _starts(scenario: Scenario) -> tuple[list[FrictionStart], Array]:
    """Start states, and their probabilities: those of an observer, else all alike."""
    starts = start_states(scenario)
    if scenario.start_state is None:
        return starts, np.full(len(starts), 1 / len(starts))
    return starts, scenario.start_state.weight / scenario.start_state.weight.sum()


def _simulated_rows(robot: Robot, path: DrivenPath) -> tuple[Array, NDArray[np.int_]]:
    """Joints (N, m) to drive through, and the places among them (W,)."""
    rows = np.union1d(rows_to_simulate(robot, path.joints, path.leg), path.rows)
    rows = rows[rows <= path.rows[-1]]
    return path.joints[rows], np.searchsorted(rows, path.rows)


def _driven(robot: Robot, first: FrictionStart, theta_b: Array, l_b: Array, rows: NDArray[np.int_]) -> Array:
    """(W, 6) poses at rows of collars (N, n)."""
    # an observed state is of the file's robot: others begin with its friction, even along each contact
    assert not isinstance(first, HistoryState)  # of no scenario
    start = np.clip(first.phi, -1, 1) if isinstance(first, ObservedHistory) else first
    try:
        result = History(robot.mechanics, start).follow(theta_b, l_b)
    except SolverError:
        return np.full((len(rows), 6), np.nan)
    return np.concatenate([result.position_m, result.tangent], axis=1)[rows]


@dataclass(frozen=True, eq=False)
class DrawnPoses:
    """Poses of M draws at W places, joint values at which the tip is evaluated, in S friction states."""

    parameters: UncertainParameters
    theta: Array  # (W, n) commanded
    l: Array  # (W, n)  # noqa: E741 (as in the equations)
    slopes: TipSlopes  # (W, S)
    draws: Draws
    beyond: BeyondFirstOrder  # (R, W, S, 6) of the first R draws

    @classmethod
    def of(cls, parameters: UncertainParameters, draws: Draws, theta: Array, l: Array) -> DrawnPoses:  # noqa: E741
        """At commanded collars theta, l (W, n)."""
        slopes, offsets = tip_slopes(parameters, theta, l), draws.offset[:SOLVED]
        linear = slopes.pose + np.einsum("wscp,mp->mwsc", slopes.pose_by, offsets)
        solved = np.stack([poses_at(parameters, offset, theta, l) for offset in offsets])
        beyond = BeyondFirstOrder.of(offsets / parameters.sigma, solved - linear)
        return cls(parameters, theta, l, slopes, draws, beyond)

    def any_friction(self, aim: TargetPose, places: NDArray[np.int_], draws: Draws) -> tuple[Misses, Misses]:
        """In the worst friction state of all places: of all draws, and of those that were solved.

        `places` are those of one target, its end last; `draws` has the same robots.
        """
        result, own = list[Misses](), list[Misses]()
        for w, is_end in _ends(places):
            at = self.slopes.pose[w]
            for into, moved in ((result, self._moved(w)), (own, self._solved(w))):
                states = [_judged(aim, at[s] + moved[:, s], at[s], draws, is_end) for s in range(len(at))]
                into.append(Misses.worst(states))
        return Misses.worst(result), Misses.worst(own)

    def by_history(
        self, aim: TargetPose, places: NDArray[np.int_], draws: Draws, simulated: SimulatedPoses
    ) -> tuple[Misses, Misses]:
        """With friction as simulated, likewise."""
        result, own = list[Misses](), list[Misses]()
        for w, is_end in _ends(places):
            for into, moved in ((result, self._moved(w)), (own, self._solved(w))):
                pose = simulated.started(w, len(moved)) + moved.mean(axis=1)
                pose += repeated(simulated.beyond[:, w], len(moved)) if len(simulated.beyond) else 0.0
                into.append(_judged(aim, pose, simulated.middle(w), draws, is_end))
        return Misses.worst(result), Misses.worst(own)

    @property
    def solved(self) -> Array:
        """(R, W, 6) how parameters move poses on the mean over friction states, of the draws that were solved."""
        result: Array = np.stack([self._solved(w).mean(axis=1) for w in range(len(self.theta))], axis=1)
        return result

    def _moved(self, w: int) -> Array:
        """(M, S, 6) by parameters."""
        return self._displaced(w, self.draws.offset)

    def _solved(self, w: int) -> Array:
        """(R, S, 6) the same, of the draws that were solved."""
        return self._displaced(w, self.draws.offset[: len(self.beyond.remainder)])

    def _displaced(self, w: int, offset: Array) -> Array:
        linear: Array = np.einsum("scp,mp->msc", self.slopes.pose_by[w], offset)
        return linear + self.beyond.at(offset / self.parameters.sigma, w)


def _ends(places: NDArray[np.int_]) -> Iterator[tuple[int, bool]]:
    for w in places.tolist():
        yield w, w == places[-1]


def _judged(aim: TargetPose, pose: Array, at: Array, draws: Draws, is_end: bool) -> Misses:
    """Poses (M, 6) of the first M draws before base and unexplained errors, which move the tip about a pose at (6,)."""
    count = len(pose)
    off = aim.off_m(pose[:, :3] + draws.rigid(at[:3])[:count], is_end)
    if aim.direction is None or not is_end:
        return Misses(off, np.zeros(count))
    return Misses(off, aim.turned_rad(pose[:, 3:] + draws.turned(at[3:])[:count]))
