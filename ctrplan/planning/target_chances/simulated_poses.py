"""Where histories of drawn robots leave the tip: the motion simulated on each, from one of the states it may start in.

A robot with other parameters ends in another friction state than the file's robot. How far that leaves its tip from
where a solve in all corners of friction has it is what the linearised model can't know.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.cores import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.history import History
from ctrplan.planning.certificate.prediction import predict, rows_to_simulate, start_states
from ctrplan.robot.observer.state import ObservedHistory
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.tip_slopes import held_collars

if TYPE_CHECKING:
    from ctrplan.mechanics.history import Start
    from ctrplan.planning.scenario import Scenario
    from ctrplan.robot.robot import Robot

BATCH, MOST = 16, 32  # robots; more until the mean of what they are off by is known to MEAN_M
MEAN_M = 0.01e-3  # standard error, a hundredth of usual tolerances
START_SEED = 24


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
        """Of draws with parameters offsets (M, P) away from their values.

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
            return _driven(robot, starts[start[k]], *held_collars(parameters, robot, *commanded), rows)

        beyond = np.empty((0, len(rows), 6))
        with ThreadPoolExecutor(cores()) as pool:
            while parameters.count and len(beyond) < min(MOST, len(solved)) and not _is_known(beyond):
                more = np.arange(len(beyond), min(len(beyond) + BATCH, len(solved)))
                found = np.array(list(pool.map(driven, more.tolist())))
                beyond = np.concatenate([beyond, found - nominal[start[more]] - solved[more]])
        return cls(nominal, start, beyond)

    def middle(self, w: int) -> Array:
        """(6,) at a place."""
        found: Array = self.nominal[:, w].mean(axis=0)
        return found

    def started(self, w: int, count: int) -> Array:
        """(count, 6) of the file's robot from the start states of the first draws."""
        found: Array = self.nominal[self.start[:count], w]
        return found


def _is_known(beyond: Array) -> bool:
    """Whether the mean of (R, W, 6) is, for every tip that was found."""
    tips = beyond[~np.isnan(beyond).any(axis=(1, 2)), :, :3]
    if len(tips) < 2:
        return False
    error = np.linalg.norm(tips.std(axis=0, ddof=1), axis=1) / np.sqrt(len(tips))
    return bool(error.max() <= MEAN_M)


def _starts(scenario: Scenario) -> tuple[list[Start | ObservedHistory], Array]:
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


def _driven(robot: Robot, begun: Start | ObservedHistory, theta_b: Array, l_b: Array, rows: NDArray[np.int_]) -> Array:
    """(W, 6) poses at rows of collars (N, n)."""
    # an observed state is of the file's robot: others begin with its friction, even along each contact
    start = np.clip(begun.phi, -1, 1) if isinstance(begun, ObservedHistory) else begun
    try:
        found = History(robot.mechanics, start).follow(theta_b, l_b)
    except SolverError:
        return np.full((len(rows), 6), np.nan)
    return np.concatenate([found.position_m, found.tangent], axis=1)[rows]
