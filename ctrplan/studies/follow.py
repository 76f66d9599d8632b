"""A measured log followed by an observer: one-step-ahead errors of the tip, with it and without.

Joints are moved through clock and drive of the chain, so that the observer is given collars; what sensor and plate do
to a tip is taken off measured tips, as it is at the tip of the history that nobody corrects.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, MEMBERS, PROGRESS, SEED, Made, checked
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import Progress
from ctrplan.drive.legs import Collars
from ctrplan.errors import NoAnswerError, SolverError
from ctrplan.measurement.approach import last_directions
from ctrplan.measurement.measurements import Measurements, Poses, SensorNoise, frames_along
from ctrplan.mechanics.history import HistoryPath
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.data_rules import require_measured
from ctrplan.robot.observer import Observed
from ctrplan.robot.robot import Robot
from ctrplan.robot.slow_states import SlowOffset, SlowParameter
from ctrplan.storage.csv_table import csv_text
from ctrplan.studies.simulate import across_tips

AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Following:
    """K measured tips of a log as an observer saw them, one after the other; runs are approached afresh."""

    robot: Robot
    data: Measurements  # the K poses that could be followed
    measured_m: Array  # (K, 3), what the sensor does to them taken off
    expected_m: Array  # (K, 3) one step ahead
    low_m: Array  # (K, 3) ends of its interval
    high_m: Array
    without_m: Array  # (K, 3) of a history that starts released, and that no tip corrects
    friction: Array  # (K, n - 1)
    histories: NDArray[np.int_]  # (K,) followed
    unexplained_m: Array  # (K,)
    set_aside: NDArray[np.bool_]  # (K,) tips that were not taken: farther off than noise and friction explain
    parameters: Mapping[str, Array]  # (K, 2) value and standard deviation of each slow parameter, SI

    @property
    def error_m(self) -> Array:
        """(K,) distance of measured tips from those expected one step ahead."""
        distance: Array = np.linalg.norm(self.measured_m - self.expected_m, axis=1)
        return distance

    @property
    def error_without_m(self) -> Array:
        """(K,) distance of measured tips from the history without an observer."""
        distance: Array = np.linalg.norm(self.measured_m - self.without_m, axis=1)
        return distance


@checked(
    robot=Made("Robot"),
    data=Made("Measurements"),
    noise=Made("SensorNoise"),
    offset=Made("SlowOffset"),
    members=MEMBERS,
    seed=SEED,
    progress=PROGRESS,
    interrupted=EVENT,
)
def follow(
    robot: Robot,
    data: Measurements,
    *,
    noise: SensorNoise | None = None,
    offset: SlowOffset | None = None,
    slow: Sequence[SlowParameter] = (),
    members: int = 9,
    seed: int = 0,
    progress: Progress | None = None,
    interrupted: threading.Event | None = None,
) -> Following:
    """Follows a log row by row, by `Robot.observer`; `noise`, `offset`, `slow`, `members` and `seed` are as there.

    A row where no friction state has an equilibrium is left out. Raises InputError, and NoAnswerError where no pose
    can be followed.
    """
    require_measured(robot, data)
    data = data.of_tips()
    chain = Chain.of(robot).on(data.time_s, data.more, of_collars=data.of_collars)
    built = replace(robot, drive=replace(robot.drive, terms=(), play=None))  # what it is given are collars
    collars = _collars(chain, data)
    without = _without(built, data, collars)
    seen = _seen_tips(chain, data, collars, without)
    pose = {row: k for k, row in enumerate(data.rows.tolist())}
    results: list[tuple[int, Observed]] = []
    observer = built.observer(noise, offset=offset, slow=slow, members=members, seed=seed)
    for row in range(len(data.sequence)):
        if interrupted is not None and interrupted.is_set():
            raise KeyboardInterrupt
        if row == 0 or data.sequence[row] != data.sequence[row - 1]:
            observer = built.observer(noise, offset=offset, slow=slow, members=members, seed=seed)
        tip = seen.position[pose[row]] if row in pose else None
        along = seen.frame[pose[row], :, 2] if row in pose and data.given[pose[row]].all() else None
        try:
            step = observer.observe(collars.theta[row], collars.l[row], tip, along)
        except SolverError:
            continue
        if row in pose:
            results.append((row, step))
        if progress is not None:
            progress((row + 1) / len(data.sequence))
    if not results:
        raise NoAnswerError(f"{data.file or 'measurements'}: no pose can be followed.")
    return _following(robot, data, seen, without, pose, results)


def followed_csv(result: Following) -> str:
    """The rows as the content of a CSV file: tips measured, expected with interval, and without an observer."""
    rows = result.data.rows
    columns: dict[str, list[float] | list[int]] = {"row": (rows + 1).tolist()}
    columns["sequence"] = result.data.sequence[rows].tolist()
    if result.data.time_s is not None:
        columns["time_s"] = result.data.time_s[rows].tolist()
    for name in ("measured", "expected", "low", "high", "without"):
        values = getattr(result, f"{name}_m")
        columns |= {f"{name}_{axis}_m": values[:, i].tolist() for i, axis in enumerate(AXES)}
    columns["error_mm"] = (result.error_m * 1e3).tolist()
    columns["error_without_mm"] = (result.error_without_m * 1e3).tolist()
    columns |= {f"phi_{i + 1}": result.friction[:, i].tolist() for i in range(result.robot.n - 1)}
    columns["histories"] = result.histories.tolist()
    columns["unexplained_mm"] = (result.unexplained_m * 1e3).tolist()
    columns["set_aside"] = result.set_aside.astype(int).tolist()
    for name, values in result.parameters.items():
        columns |= {name: values[:, 0].tolist(), f"{name}_sigma": values[:, 1].tolist()}
    return csv_text(columns, zip(*columns.values(), strict=True))


def _collars(chain: Chain, data: Measurements) -> Collars:
    """Where collars stand at every waypoint (R, n), measured or not."""
    every = np.arange(len(data.sequence))
    blank = np.zeros((len(every), 3))
    waypoints = replace(data, rows=every, position_m=blank, tangent=blank, marker=None, noise_ratio=None)
    return chain.collars(waypoints, last_directions(waypoints))


def _without(robot: Robot, data: Measurements, collars: Collars) -> HistoryPath:
    """Histories that start released, run by run, at the K poses; NaN after one failed."""
    count, n = len(data.sequence), robot.n
    table = {"position_m": np.full((count, 3), np.nan), "tangent": np.full((count, 3), np.nan)}
    phi, snaps, status = np.full((count, n - 1), np.nan), np.zeros(count), np.full(count, int(Status.FAILED))
    for run in np.unique(data.sequence).tolist():
        rows = np.flatnonzero(data.sequence == run)
        try:
            path = robot.history().follow(collars.theta[rows], collars.l[rows])
        except SolverError:
            continue
        table["position_m"][rows], table["tangent"][rows], phi[rows] = path.position_m, path.tangent, path.phi
        snaps[rows], status[rows] = path.snaps, path.status
    at = data.rows
    return HistoryPath(table["position_m"][at], table["tangent"][at], phi[at], snaps[at], status[at])


def _seen_tips(chain: Chain, data: Measurements, collars: Collars, tips: HistoryPath) -> Poses:
    """Measured poses (K), what sensor and plate do to them taken off."""
    at = Collars(collars.theta[data.rows], collars.l[data.rows])
    whole: NDArray[np.bool_] = np.all(data.given, axis=1)
    along = np.where(whole[:, None], np.nan_to_num(data.tangent), [0.0, 0.0, 1.0])
    sound: NDArray[np.bool_] = np.all(np.isfinite(tips.position_m), axis=1)
    if not (chain.of_stage("sensor") or chain.plate_turn(at) is not None) or not sound.any():
        return Poses(data.position_m, frames_along(along, np.eye(3)[np.argmin(np.abs(along), axis=1)]))
    tangent = np.where(sound[:, None], np.nan_to_num(tips.tangent), [0.0, 0.0, 1.0])
    position = np.where(sound[:, None], np.nan_to_num(tips.position_m), data.position_m)
    frame = frames_along(tangent, across_tips(chain, at, tips.phi, tangent))
    reported = chain.seen(Poses(position, frame), at, data)
    turned = along + tangent - reported.frame[:, :, 2]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    frames = frames_along(turned, np.eye(3)[np.argmin(np.abs(turned), axis=1)])
    return Poses(data.position_m + position - reported.position, frames)


def _following(
    robot: Robot,
    data: Measurements,
    seen: Poses,
    without: HistoryPath,
    pose: dict[int, int],
    results: list[tuple[int, Observed]],
) -> Following:
    kept = np.array([pose[row] for row, _ in results])
    steps = [step for _, step in results]
    return Following(
        robot=robot,
        data=data.subset(kept),
        measured_m=seen.position[kept],
        expected_m=np.array([step.expected.position_m for step in steps]),
        low_m=np.array([step.expected.low_m for step in steps]),
        high_m=np.array([step.expected.high_m for step in steps]),
        without_m=without.position_m[kept],
        friction=np.array([step.friction for step in steps]).reshape(len(steps), robot.n - 1),
        histories=np.array([step.histories for step in steps]),
        unexplained_m=np.array([step.unexplained_m for step in steps]),
        set_aside=np.array([step.set_aside for step in steps]),
        parameters={
            name: np.array([(step.parameters[name].value, step.parameters[name].sigma) for step in steps])
            for name in steps[0].parameters
        },
    )
