"""Where the tip is along a path, by full simulation of its history from every friction state it may start in."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, read_only
from ctrplan.base.long_work import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.history import OSCILLATION_DEG, History, HistoryState, Start
from ctrplan.mechanics.shapes import LONG_STEPS, HistoryOptions, Status
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.robot.observer import ObservedHistory
from ctrplan.robot.observer_histories import SAME_M, SAME_PHI

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Accuracy, Shape
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario

STEP_RAD, STEP_M = 0.05, 1e-3  # between configurations at which the simulated tips are looked at
BLOCK = 20  # of these steps after which histories are compared
LOOK_EVERY = 5  # configurations after which a body is looked at
# Differences of tips, tangents and friction below which histories have become one: a fiftieth of what they are
# simulated to, so that what grows in passing stays below that.
SAME_RAD = 1e-5  # of tangents; tips and friction as where an observer joins histories
TIP_TOLERANCE_M = 0.05e-3  # of simulated tips (`history numerics` of benchmarks/run.py)
_STEPS = HistoryOptions()
HALF_STEPS = replace(
    _STEPS,
    rotation_rad=_STEPS.rotation_rad / 2,
    translation_m=_STEPS.translation_m / 2,
    state_change=_STEPS.state_change / 2,
)
SCATTER_M = 0.01e-3  # by which tips still differ whatever the steps (`arrival steps` of benchmarks/run.py: 0.007 mm)

Look = Callable[["Shape"], None]
FrictionStart = Start | ObservedHistory | HistoryState  # the last one is where the first configuration is
MOST_REMEMBERED = 100  # ends of paths
MOST_STARTS = 4  # lists of start states whose paths are remembered
_ENDS: WeakKeyDictionary[Robot, dict[tuple[FrictionStart, ...], dict[bytes, _PathEnd]]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class _PathEnd:
    """Where the histories along a path end."""

    tip_m: Array  # (S, 3); NaN where one failed
    states: list[HistoryState]  # one for each start, to go on from; empty where one failed


@dataclass(frozen=True, eq=False)
class PathPrediction:
    """Simulated tips at K configurations from each of S start states, released and every corner."""

    tip_m: Array  # (S, K, 3) robot frame; NaN after no equilibrium was found
    tangent: Array  # (S, K, 3) of the tip, likewise
    phi: Array  # (S, K, P) circumferential friction of each pair, averaged by normal force, likewise
    snaps: int  # times any of the simulated robots slid to another equilibrium
    states: tuple[tuple[int, HistoryState], ...] = ()  # of the first start at rows that were to be kept
    accuracy: Accuracy = "search"  # mesh of the histories

    def errors(self, frictionless_m: Array) -> Array:
        """(K,) [m] largest distance of a simulated tip from the frictionless one (K, 3); NaN where any failed."""
        largest: Array = np.linalg.norm(self.tip_m - frictionless_m, axis=2).max(axis=0)
        return largest

    @cached_property
    def end_middle_m(self) -> Array:
        """(3,) centre of the smallest ball around the tips at the last configuration."""
        return ball_centre(self.tip_m[:, -1])

    @property
    def end_spread_m(self) -> float:
        """How far [m] the start state may take the last tip from that centre: what no correction can know."""
        return float(np.linalg.norm(self.tip_m[:, -1] - self.end_middle_m, axis=1).max())

    @property
    def spread_m(self) -> Array:
        """(K,) [m] half the largest distance of two tips: the size of the set of friction states, at the tip."""
        apart = np.linalg.norm(self.tip_m[:, None] - self.tip_m[None], axis=3)
        return np.asarray(apart.max(axis=(0, 1)) / 2)

    @property
    def friction_spread(self) -> Array:
        """(K, P) half the largest difference of each pair's friction: 1 where nothing is known, 0 where all is."""
        return np.asarray((self.phi.max(axis=0) - self.phi.min(axis=0)) / 2)


BALL_STEPS = 300  # of the ascent to the centre, which ends within 1/BALL_STEPS of the radius


def ball_centre(points: Array) -> Array:
    """(3,) centre of the smallest ball around points (S, 3): again and again a step to the farthest one."""
    centre: Array = (points.min(axis=0) + points.max(axis=0)) / 2
    if np.ptp(points, axis=0).max() == 0 or not np.all(np.isfinite(points)):
        return centre
    for step in range(2, BALL_STEPS):
        centre = centre + (points[np.argmax(np.linalg.norm(points - centre, axis=1))] - centre) / step
    return centre


def start_states(scenario: Scenario) -> list[FrictionStart]:
    """What the robot's friction may be like before a path: released or fully loaded in any corner, if unknown.

    Of a robot that was followed, the histories that agree with what was measured.
    """
    if scenario.start_state is not None:
        return list(scenario.start_state.histories)
    if scenario.start_friction in ("released", "oscillated"):
        return [scenario.start_friction]
    pairs = scenario.robot.n - 1
    corners: list[FrictionStart] = list(itertools.product((1.0, -1.0), repeat=pairs)) if pairs else []
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
    starts: Sequence[FrictionStart],
    accuracy: Accuracy = "search",
    look: Look | None = None,
) -> PathPrediction:
    """The histories along configurations (K, m) of actuated joints, from start states.

    `look` is shown the shape of each simulated robot every LOOK_EVERY configurations, from several threads.
    """
    return predict_end(robot, joints, starts, accuracy, look)[0]


def predict_end(
    robot: Robot,
    joints: Array,
    starts: Sequence[FrictionStart],
    accuracy: Accuracy = "search",
    look: Look | None = None,
    keep: Sequence[int] = (),
) -> tuple[PathPrediction, list[HistoryState]]:
    """Predicts as `predict`, and returns the states at the end too, to go on from; none where one failed.

    States of the first start after rows `keep` are in the prediction.
    """
    histories = begun_histories(robot, starts, accuracy)
    prediction = replace(_follow(robot, histories, joints, look, keep), accuracy=accuracy)
    return prediction, _saved(histories) if np.all(np.isfinite(prediction.tip_m[:, -1])) else []


def predict_from(robot: Robot, states: Sequence[HistoryState], joints: Array) -> PathPrediction:
    """Predicts as `predict`, from states at the first row of joints (K, m), one for each start."""
    return _follow(robot, begun_histories(robot, states), joints)


def goal_error(robot: Robot, joints: Array, starts: Sequence[FrictionStart]) -> float:
    """Largest distance [m] of a simulated tip from the frictionless one after the path (K, m); inf if any failed."""
    off = end_tips(robot, joints, starts) - frictionless_tips(robot, joints[-1:])[0]
    error = float(np.linalg.norm(off, axis=1).max())
    return error if np.isfinite(error) else np.inf


def end_tips(robot: Robot, joints: Array, starts: Sequence[FrictionStart]) -> Array:
    """(S, 3) [m] simulated tips after the path (K, m); NaN where one failed.

    For a search, by LONG_STEPS. Paths that begin alike share that part of their histories; a robot's last few are
    remembered.
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
    return known[joints.tobytes()].tip_m


def offset_m(scenario: Scenario, corners: Array, beside: Array | None = None) -> Array:
    """(3,) [m] from the frictionless tip at a path's end (K, m) to `end_middle_m`, in the robot's frame."""
    return np.asarray(end_middle_m(scenario, corners, beside) - frictionless_tips(scenario.robot, corners[-1:])[0][0])


def end_middle_m(scenario: Scenario, corners: Array, beside: Array | None = None) -> Array:
    """(3,) [m] the middle of where the tip with friction ends on a path (K, m), over all that the start allows.

    In the robot's frame, simulated once; NaN where a history failed. With `beside`, a path near by, all starts are
    simulated there, and but one here: what they differ by at the end hardly changes.
    """
    if beside is None or np.array_equal(beside, corners):
        return np.asarray(_ends(scenario, corners)[0])
    middle, first = _ends(scenario, beside)
    return np.asarray(middle - first + end_tips(scenario.robot, corners, start_states(scenario)[:1])[0])


def _ends(scenario: Scenario, corners: Array) -> Array:
    """(2, 3) [m] the middle of the ends, and that of the first start."""
    known, key = _MIDDLES.setdefault(scenario, {}), corners.tobytes()
    if key not in known:
        tips = end_tips(scenario.robot, corners, start_states(scenario))
        known[key] = read_only(np.array([ball_centre(tips), tips[0]]))
    return known[key]


_MIDDLES: WeakKeyDictionary[Scenario, dict[bytes, Array]] = WeakKeyDictionary()  # by the corners of paths


def frictionless_tips(robot: Robot, joints: Array) -> tuple[Array, Array]:
    """Frictionless tips (K, 3) [m] and tangents (K, 3) at joints (K, m), robot's frame."""
    tips = robot.mechanics.tips_with_friction(*robot.drive.collars(joints), np.zeros((len(joints), robot.n - 1)))
    return tips.position_m, tips.tangent


def step_error(
    robot: Robot,
    joints: Array,
    end_states: Sequence[HistoryState],
    starts: Sequence[FrictionStart],
    accuracy: Accuracy = "search",
) -> float:
    """[m] how far off the last tips of histories along joints (K, m) may be by their steps; a state for each start.

    Histories of half the steps are followed beside it, one for each of the different ends. Their tips are nearer to
    those of endless refinement: the difference, divided by 1 - sqrt(1/2), covers an error that falls with at least the
    square root of the step (it falls linearly).
    """
    coarse = _follow(robot, begun_histories(robot, end_states, accuracy), joints[-1:])
    ends = np.concatenate([part[:, -1] for part in (coarse.tip_m, coarse.tangent, coarse.phi)], axis=1)
    different = list[int]()
    for k in range(len(ends)):
        if not are_same(ends[k], ends[different]).any():
            different.append(k)
    begun = begun_histories(robot, [starts[k] for k in different], accuracy, HALF_STEPS)
    finer = _follow(robot, begun, joints)
    off = np.linalg.norm(finer.tip_m[:, -1] - coarse.tip_m[different, -1], axis=1)
    return float(np.nan_to_num(off / (1 - np.sqrt(0.5)), nan=np.inf).max()) + SCATTER_M


def begun_histories(
    robot: Robot,
    starts: Sequence[FrictionStart],
    accuracy: Accuracy = "search",
    options: HistoryOptions | None = None,
) -> list[History]:
    """A history for each start; one and the same for several that are one saved state."""
    histories = {id(start): _begun(robot, start, accuracy, options) for start in {id(s): s for s in starts}.values()}
    return [histories[id(start)] for start in starts]


def _begun(robot: Robot, start: FrictionStart, accuracy: Accuracy, options: HistoryOptions | None) -> History:
    if isinstance(start, ObservedHistory):
        return start.history(robot.mechanics, accuracy, options)
    if isinstance(start, HistoryState):
        history = robot.history(accuracy=accuracy, options=options)
        history.restore(start)
        return history
    return robot.history(start, accuracy=accuracy, options=options)


def _end_after(robot: Robot, q: Array, before: _PathEnd | None, starts: Sequence[FrictionStart]) -> _PathEnd:
    """Where histories are after moving on to q (m,) from where others ended, or at a start there."""
    if before is not None and not before.states:
        return before
    histories = begun_histories(robot, before.states if before else starts, options=LONG_STEPS)
    tips = _follow(robot, histories, q[None]).tip_m[:, -1]
    return _PathEnd(tips, _saved(histories) if np.all(np.isfinite(tips)) else [])


def _saved(histories: Sequence[History]) -> list[HistoryState]:
    """A state for each history, one and the same where a history stands for several."""
    states = {history: history.save() for history in histories}
    return [states[history] for history in histories]


def rows_to_simulate(robot: Robot, joints: Array, leg: NDArray[np.int_]) -> NDArray[np.int_]:
    """Indices of configurations (K, m) no farther apart than the steps, the ends of legs (K,) among them."""
    step = np.floor(_steps_until(*robot.drive.collars(joints)))
    is_kept = np.concatenate([[True], np.diff(step) > 0])
    is_kept[:-1] |= np.diff(leg) > 0
    is_kept[-1] = True
    return np.flatnonzero(is_kept)


def _steps_until(theta_b: Array, l_b: Array) -> Array:
    """(K,) steps that collars (K, n) [rad], (K, n) [m] have moved by since the first row."""
    turned, slid = (np.abs(np.diff(part, axis=0)).max(axis=1) for part in (theta_b, l_b))
    return np.append(0.0, np.cumsum(np.maximum(turned / STEP_RAD, slid / STEP_M)))


def _follow(
    robot: Robot, histories: list[History], joints: Array, look: Look | None = None, keep: Sequence[int] = ()
) -> PathPrediction:
    """Tips of the histories along joints (K, m).

    Slip wipes out where they came from: those that have become the same are followed once from there on, and stand for
    each other in `histories`. States of the first are kept after rows `keep`.
    """
    theta_b, l_b = robot.drive.collars(joints)
    count, size = len(joints), 6 + robot.n - 1
    poses, snaps, states = np.full((len(histories), count, size), np.nan), 0, list[tuple[int, HistoryState]]()
    compared = np.flatnonzero(np.diff(_steps_until(theta_b, l_b) // BLOCK)) + 2
    ends = sorted({*compared.tolist(), *(row + 1 for row in keep), count})
    with ThreadPoolExecutor(cores()) as pool:
        for begin, end in itertools.pairwise([0, *ends]):
            rows, apart = slice(begin, end), list(dict.fromkeys(histories))
            follow = partial(_block, theta_b[rows], l_b[rows], look, size)
            different, seen = list[History](), np.full((len(apart), size), np.nan)
            for history, (result, slid) in zip(apart, pool.map(follow, apart), strict=True):
                alike = [k for k, other in enumerate(histories) if other is history]
                poses[alike, rows], snaps = result, snaps + slid * len(alike)
                same = np.flatnonzero(are_same(result[-1], seen[: len(different)]))
                if not len(same):
                    seen[len(different)] = result[-1]
                    different.append(history)
                for k in alike if len(same) else ():
                    histories[k] = different[same[0]]
            if end - 1 in keep and np.isfinite(poses[0, end - 1, 0]):
                states.append((end - 1, histories[0].save()))
    return PathPrediction(poses[..., :3], poses[..., 3:6], poses[..., 6:], snaps, tuple(states))


def are_same(a: Array, others: Array) -> NDArray[np.bool_]:
    """(O,) whether histories are one with another from there on: tips, tangents and friction of pairs, (6 + P,) and
    (O, 6 + P), are alike.
    """
    most = np.concatenate([[SAME_M] * 3, [SAME_RAD] * 3, np.full(len(a) - 6, SAME_PHI)])
    same: NDArray[np.bool_] = np.all(np.abs(others - a) < most, axis=1)
    return same


def _block(theta_b: Array, l_b: Array, look: Look | None, size: int, history: History) -> tuple[Array, int]:
    """Tips, tangents and friction of pairs (K, 6 + P), and snaps."""
    poses, snaps, step = np.full((len(theta_b), size), np.nan), 0, LOOK_EVERY if look else len(theta_b)
    for begin in range(0, len(theta_b), step):
        rows = slice(begin, begin + step)
        try:
            path = history.follow(theta_b[rows], l_b[rows])
        except SolverError:
            return np.full(poses.shape, np.nan), 0
        poses[rows] = np.concatenate([path.position_m, path.tangent, path.phi], axis=1)
        snaps += int(np.nansum(path.snaps))
        if look and path.status[-1] < Status.FAILED:
            look(history.shape())
    return poses, snaps
