"""Where the tip is along a path, by full simulation of its history from every friction state it may start in."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.history import OSCILLATION_DEG, History
from ctrplan.mechanics.shapes import Status
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.robot.observer import ObservedHistory

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.history import HistoryState, Start
    from ctrplan.mechanics.shapes import Shape
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

STEP_RAD, STEP_M = 0.05, 1e-3  # between configurations at which the simulated tips are looked at
BLOCK = 20  # configurations after which histories are compared
LOOK_EVERY = 5  # configurations after which a body is looked at
SAME = 1e-3  # difference of friction, of 0.01 mm and of 1 mrad at the tip, below which they have become one
TIP_TOLERANCE_M = 0.05e-3  # of simulated tips (benchmarks/history.py)


Look = Callable[["Shape"], None]
MOST_REMEMBERED = 100  # ends of paths
MOST_STARTS = 4  # lists of start states whose paths are remembered
_ENDS: WeakKeyDictionary[Robot, dict[tuple[Start | ObservedHistory, ...], dict[bytes, _End]]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class _End:
    """Where the histories along a path end."""

    tip_m: Array  # (S, 3); NaN where one failed
    states: list[HistoryState]  # one for each start, to go on from; empty where one failed


@dataclass(frozen=True, eq=False)
class PathPrediction:
    """Simulated tips at K configurations from each of S start states, released and every corner."""

    tip_m: Array  # (S, K, 3); NaN after no equilibrium was found
    tangent: Array  # (S, K, 3) of the tip, likewise
    snaps: int  # times any of the simulated robots slid to another equilibrium

    def errors(self, frictionless_m: Array) -> Array:
        """(K,) [m] largest distance of a simulated tip from the frictionless one (K, 3); NaN where any failed."""
        largest: Array = np.linalg.norm(self.tip_m - frictionless_m, axis=2).max(axis=0)
        return largest

    @property
    def end_middle_m(self) -> Array:
        """(3,) mean of the tips at the last configuration."""
        middle: Array = self.tip_m[:, -1].mean(axis=0)
        return middle

    @property
    def end_spread_m(self) -> float:
        """How far [m] the start state may take the last tip from that mean: what no correction can know."""
        return float(np.linalg.norm(self.tip_m[:, -1] - self.end_middle_m, axis=1).max())


def start_states(scenario: Scenario) -> list[Start | ObservedHistory]:
    """What the robot's friction may be like before a path: released or fully loaded in any corner, if unknown.

    Of a robot that was followed, the histories that agree with what was measured.
    """
    if scenario.start_state is not None:
        return list(scenario.start_state.histories)
    if scenario.start_friction in ("released", "oscillated"):
        return [scenario.start_friction]
    pairs = scenario.robot.n - 1
    corners: list[Start | ObservedHistory] = list(itertools.product((1.0, -1.0), repeat=pairs)) if pairs else []
    return ["released", *corners]


def start_load(scenario: Scenario) -> Array:
    """(P,) largest |phi| of each pair that the friction law reckons with before a path."""
    if scenario.start_friction == "released":
        return np.zeros(scenario.robot.n - 1)
    if scenario.start_friction == "oscillated":  # the last turn but none
        last = np.radians(OSCILLATION_DEG[-2]) / friction_law(scenario.robot).loading_rad
        return np.asarray(np.minimum(last, 1.0))
    return np.ones(scenario.robot.n - 1)


def predict(
    robot: Robot,
    joints: Array,
    starts: Sequence[Start | ObservedHistory],
    accuracy: Accuracy = "search",
    look: Look | None = None,
) -> PathPrediction:
    """The histories along configurations (K, m) of actuated joints, from start states.

    `look` is shown the shape of each simulated robot every LOOK_EVERY configurations, from several threads.
    """
    histories = [_begun(robot, start, accuracy) for start in starts]
    return _follow(robot, histories, joints, look)


def predict_end(
    robot: Robot, joints: Array, starts: Sequence[Start | ObservedHistory]
) -> tuple[PathPrediction, list[HistoryState]]:
    """Predicts as `predict`, and returns the states at the end too, to go on from."""
    histories = [_begun(robot, start) for start in starts]
    prediction = _follow(robot, histories, joints)
    return prediction, _saved(histories)


def predict_from(robot: Robot, states: Sequence[HistoryState], joints: Array) -> PathPrediction:
    """Predicts as `predict`, from states at the first row of joints (K, m), one for each start."""
    return _follow(robot, _restored(robot, states), joints)


def goal_error(robot: Robot, joints: Array, starts: Sequence[Start | ObservedHistory]) -> float:
    """Largest distance [m] of a simulated tip from the frictionless one after the path (K, m); inf if any failed.

    Paths that begin alike share that part of their histories; a robot's last few are remembered.
    """
    of_starts = _ENDS.setdefault(robot, {})
    while len(of_starts) >= MOST_STARTS and tuple(starts) not in of_starts:  # every observer's state is another
        of_starts.pop(next(iter(of_starts)))
    known = of_starts.setdefault(tuple(starts), {})
    shared = next((k for k in range(len(joints), 0, -1) if joints[:k].tobytes() in known), 0)
    for k in range(shared, len(joints)):
        before = known[joints[:k].tobytes()] if k else None
        while len(known) >= MOST_REMEMBERED:
            known.pop(next(iter(known)))
        known[joints[: k + 1].tobytes()] = _end_after(robot, joints[k], before, starts)
    theta_b, l_b = robot.drive.collars(joints[-1:])
    frictionless = robot.mechanics.tips_with_friction(theta_b, l_b, np.zeros((1, robot.n - 1))).position_m
    error = float(np.linalg.norm(known[joints.tobytes()].tip_m - frictionless, axis=1).max())
    return error if np.isfinite(error) else np.inf


def _begun(robot: Robot, start: Start | ObservedHistory, accuracy: Accuracy = "search") -> History:
    if isinstance(start, ObservedHistory):
        return start.history(robot.mechanics, accuracy)
    return robot.history(start, accuracy=accuracy)


def _end_after(robot: Robot, q: Array, before: _End | None, starts: Sequence[Start | ObservedHistory]) -> _End:
    """Where histories are after moving on to q (m,) from where others ended, or at a start there."""
    if before is not None and not before.states:
        return before
    histories = _restored(robot, before.states) if before else [_begun(robot, start) for start in starts]
    tips = _follow(robot, histories, q[None]).tip_m[:, -1]
    return _End(tips, _saved(histories) if np.all(np.isfinite(tips)) else [])


def _saved(histories: Sequence[History]) -> list[HistoryState]:
    """A state for each history, one and the same where a history stands for several."""
    states = {history: history.save() for history in histories}
    return [states[history] for history in histories]


def _restored(robot: Robot, states: Sequence[HistoryState]) -> list[History]:
    """A history for each state, one and the same where a state stands for several."""
    histories = {id(state): robot.history() for state in states}
    for state in states:
        histories[id(state)].restore(state)
    return [histories[id(state)] for state in states]


def rows_to_simulate(robot: Robot, joints: Array, leg: NDArray[np.int_]) -> NDArray[np.int_]:
    """Indices of configurations (K, m) no farther apart than the steps, the ends of legs (K,) among them."""
    theta_b, l_b = robot.drive.collars(joints)
    moved = np.maximum(
        np.abs(np.diff(theta_b, axis=0)).max(axis=1) / STEP_RAD, np.abs(np.diff(l_b, axis=0)).max(axis=1) / STEP_M
    )
    step = np.floor(np.concatenate([[0.0], np.cumsum(moved)]))
    wanted = np.concatenate([[True], np.diff(step) > 0])
    wanted[:-1] |= np.diff(leg) > 0
    wanted[-1] = True
    return np.flatnonzero(wanted)


def _follow(robot: Robot, histories: list[History], joints: Array, look: Look | None = None) -> PathPrediction:
    """Tips of the histories along joints (K, m).

    Rotation wipes out where they came from: those that have become the same are followed once from there on, and stand
    for each other in `histories`.
    """
    theta_b, l_b = robot.drive.collars(joints)
    poses, snaps = np.full((len(histories), len(joints), 6), np.nan), 0
    with ThreadPoolExecutor(cores()) as pool:
        for begin in range(0, len(joints), BLOCK):
            rows = slice(begin, begin + BLOCK)
            apart = list(dict.fromkeys(histories))
            ends: list[Array] = []
            for history, (result, count, end) in zip(
                apart, pool.map(partial(_block, theta_b[rows], l_b[rows], look), apart), strict=True
            ):
                alike = [k for k, other in enumerate(histories) if other is history]
                poses[alike, rows], snaps = result, snaps + count * len(alike)
                same = [k for k, other in enumerate(ends) if np.all(np.abs(end - other) < SAME)]
                ends.append(end)
                for k in alike if same else ():
                    histories[k] = apart[same[0]]
    return PathPrediction(poses[..., :3], poses[..., 3:], snaps)


def _block(theta_b: Array, l_b: Array, look: Look | None, history: History) -> tuple[Array, int, Array]:
    """Tips and tangents (K, 6), snaps, and what tells the end state from others: tip [0.01 mm], friction of pairs."""
    poses, snaps, step = np.full((len(theta_b), 6), np.nan), 0, LOOK_EVERY if look else len(theta_b)
    for begin in range(0, len(theta_b), step):
        rows = slice(begin, begin + step)
        try:
            path = history.follow(theta_b[rows], l_b[rows])
        except SolverError:
            return np.full((len(theta_b), 6), np.nan), 0, np.array([np.nan])
        poses[rows] = np.concatenate([path.position_m, path.tangent], axis=1)
        snaps += int(np.nansum(path.snaps))
        if look and path.status[-1] < Status.FAILED:
            look(history.shape())
    end = np.concatenate([path.position_m[-1] / 1e-5, path.tangent[-1] / 1e-3, path.phi[-1]])
    return poses, snaps, end
