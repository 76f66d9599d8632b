"""What a robot does along a joint path, beside what it would do without friction and the bound on the difference.

The chain of `pipeline/chain.py` with a simulated history as its mechanics. The clock comes last here: what is reported
is of the instant that the tracker saw, and the history has that instant too.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, PROGRESS, Choice, Made, checked
from ctrplan.base.arrays import ROUNDING_M, Array
from ctrplan.drive.legs import Collars
from ctrplan.errors import InputError
from ctrplan.measurement.approach import last_directions
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import Measurements, Poses, frames_along, joint_columns
from ctrplan.mechanics.history import History, Start
from ctrplan.mechanics.shapes import Accuracy, Bounds, Status
from ctrplan.mechanics.tube import moved_to_nest
from ctrplan.pipeline.chain import Chain, at_instants, range_notes
from ctrplan.pipeline.followed_runs import walked
from ctrplan.robot.data_rules import require_path
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.storage.csv_table import csv_text

SAMPLE_RAD, SAMPLE_M = np.radians(10.0), 3e-3  # between two looks at the tip on a leg


@dataclass(frozen=True, eq=False)
class Simulation:
    """S samples along a joint path, waypoints among them, as far as it was walked."""

    robot: Robot
    path: JointPath
    place: Array  # (S,) in waypoints: 2.5 is halfway from waypoint 2 to 3, counted from 0
    theta_commanded: Array  # (S, n) commanded, rad
    l_commanded: Array  # (S, n) commanded, m
    collars: Collars  # where the drive puts them: as commanded but for effects of the robot's drive
    position_m: Array  # (S, 3)
    tangent: Array  # (S, 3)
    phi: Array  # (S, n - 1) circumferential friction state of each pair, averaged by normal force
    snaps: NDArray[np.int_]  # (S,) times the robot slid to another equilibrium on the way from the sample before
    status: NDArray[np.int_]  # (S,) Status; the last may be FAILED
    bounds: Bounds  # (S,) with the frictionless tips
    measured: Poses | None  # (S,) what a tracker reports, if effects of clock or sensor stand in between
    marker_m: Array  # (S, M, 3) markers on the body
    measured_marker_m: Array | None  # (S, M, 3) what a tracker reports of them, as `measured`
    warnings: tuple[str, ...] = ()

    @property
    def deviation_m(self) -> Array:
        """(S,) distance of the tip from that of the frictionless solution."""
        distance: Array = np.linalg.norm(self.position_m - self.bounds.tip_m, axis=1)
        return distance

    @property
    def waypoints(self) -> NDArray[np.intp]:
        """Samples that are waypoints of the path, in order."""
        return np.flatnonzero(self.place == np.round(self.place))

    @property
    def failed_waypoint(self) -> int | None:
        """The waypoint (from 0) on whose way no equilibrium was found."""
        failed = len(self.status) > 0 and self.status[-1] == Status.FAILED
        return int(np.ceil(self.place[-1])) if failed else None

    @property
    def is_complete(self) -> bool:
        """Whether the whole path was walked."""
        return (
            len(self.place) > 0
            and self.place[-1] == len(self.path.theta_commanded) - 1
            and self.failed_waypoint is None
        )


@checked(
    robot=Made("Robot"),
    path=Made("JointPath"),
    accuracy=Choice("search", "certificate"),
    progress=PROGRESS,
    interrupted=EVENT,
)
def simulate(
    robot: Robot,
    path: JointPath,
    start: Start = "released",
    *,
    accuracy: Accuracy = "search",
    progress: Callable[[str, float], None] | None = None,
    interrupted: threading.Event | None = None,
) -> Simulation:
    """The history of `robot` along `path`; every run of the path starts anew in the state `start`.

    `progress` is told what is being done and its finished share. Raises InputError for what no file may command, and
    SolverError where a run has no start.
    """
    require_path(robot, path)
    report, stop = progress or (lambda *_: None), interrupted or threading.Event()
    rows: list[Array] = []
    count, chain = len(path.theta_commanded), Chain.of(robot).on(path.time_s, path.more, of_collars=path.of_collars)
    for run in path.runs:
        history = History(robot.mechanics, start, accuracy=accuracy)
        for place, *commanded, theta, l in _driven_legs(robot, chain, path, run):  # noqa: E741 (as in the equations)
            result, markers = walked(robot, history, theta, l)
            tip = (
                result.position_m,
                result.tangent,
                markers.reshape(len(place), -1),
                result.phi,
                result.snaps,
                result.status,
            )
            rows.append(np.column_stack((place, *commanded, theta, l, *tip)))
            report("simulating", (place[-1] + 1) / count)
            if stop.is_set() or result.status[-1] == Status.FAILED:
                return _simulation(robot, path, np.vstack(rows), accuracy, report)
    return _simulation(robot, path, np.vstack(rows), accuracy, report)


def poses_csv(result: Simulation) -> str:
    """The waypoints as the content of a CSV file, joints and poses in the columns of a measurement."""
    rotations, translations = joint_columns(result.robot.n)
    chosen = [k for k in result.waypoints.tolist() if result.status[k] != Status.FAILED]
    snaps = [int(result.snaps[a + 1 : b + 1].sum()) for a, b in pairwise([-1, *chosen])]
    place = result.place[chosen].astype(int)
    columns: dict[str, Array | list[int] | list[str]] = {"sequence": result.path.sequence[place].tolist()}
    if result.path.time_s is not None:
        columns["time_s"] = result.path.time_s[place]
    for names, values in (
        (rotations, result.theta_commanded),
        (translations, result.l_commanded),
        (("x_m", "y_m", "z_m"), result.position_m),
        (("tx", "ty", "tz"), result.tangent),
        (("frictionless_x_m", "frictionless_y_m", "frictionless_z_m"), result.bounds.tip_m),
    ):
        columns |= {name: values[chosen, i] for i, name in enumerate(names)}
    if result.measured is not None:
        seen = np.hstack([result.measured.position, result.measured.frame[:, :, 2]])[chosen]
        columns |= {f"measured_{name}": seen[:, i] for i, name in enumerate(("x_m", "y_m", "z_m", "tx", "ty", "tz"))}
    for prefix, points in (("", result.marker_m), ("measured_", result.measured_marker_m)):
        if points is not None:
            for k, marker in enumerate(result.robot.markers):
                columns |= {f"{prefix}{name}": points[chosen, k, i] for i, name in enumerate(marker.columns)}
    columns["deviation_mm"] = result.deviation_m[chosen] * 1e3
    columns["bound_mm"] = result.bounds.position_m[chosen] * 1e3
    columns |= {f"phi_{i + 1}": result.phi[chosen, i] for i in range(result.robot.n - 1)}
    columns["snaps"] = snaps
    columns["status"] = [Status(status).name for status in result.status[chosen].tolist()]
    lists = (values.tolist() if isinstance(values, np.ndarray) else values for values in columns.values())
    return csv_text(columns, zip(*lists, strict=True))


def _legs(path: JointPath, run: slice) -> Iterator[tuple[Array, Array, Array]]:
    """Places, rotations and translations: the start of a run, then each of its legs in samples without its first."""
    yield np.array([float(run.start)]), path.theta_commanded[run][:1], path.l_commanded[run][:1]
    for k in range(run.start, run.stop - 1):
        theta, l = path.theta_commanded[k : k + 2], path.l_commanded[k : k + 2]  # noqa: E741
        longest = max(np.abs(np.diff(theta, axis=0)).max() / SAMPLE_RAD, np.abs(np.diff(l, axis=0)).max() / SAMPLE_M)
        part = np.linspace(0, 1, max(1, int(np.ceil(longest - 1e-9))) + 1)[1:, None]
        yield (
            np.asarray(k + part[:, 0], dtype=np.float64),
            theta[:1] + part * np.diff(theta, axis=0),
            l[:1] + part * np.diff(l, axis=0),
        )


def _driven_legs(robot: Robot, chain: Chain, path: JointPath, run: slice) -> Iterator[tuple[Array, ...]]:
    """Places, commanded rotations and translations, and those that the drive makes of them, leg by leg."""
    legs = list(_legs(path, run))
    place, theta, l = (np.concatenate(parts) for parts in zip(*legs, strict=True))  # noqa: E741
    samples = _samples(path, place, Collars(theta, l))
    late, directions = chain.late(samples), last_directions(samples)
    collars = chain.drive(late, directions)
    if chain.of_stage("drive"):
        _check_collars(robot, path, place, chain.drive(late, np.zeros_like(directions)))  # in the middle of all play
        collars = Collars(collars.theta, _stopped(robot, collars.l))
    ends = np.cumsum([len(leg[0]) for leg in legs])[:-1]
    yield from zip(*(np.split(part, ends) for part in (place, theta, l, collars.theta, collars.l)), strict=True)


def _samples(path: JointPath, place: Array, commanded: Collars) -> Measurements:
    """Samples at `place` (S,) as waypoints that are all measured, in the words of the effects."""
    blank = np.zeros((len(place), 3))
    waypoints = np.arange(len(path.sequence))
    time_s = None if path.time_s is None else np.interp(place, waypoints, path.time_s)
    more = {name: np.interp(place, waypoints, values) for name, values in path.more.items()}
    sequence = path.sequence[np.ceil(place).astype(int)]
    every = np.arange(len(place))
    return Measurements(sequence, commanded.theta, commanded.l, every, blank, blank, time_s, more=more)


def _is_seen_as_it_is(chain: Chain, collars: Collars) -> bool:
    """Whether nothing stands between the robot and what a tracker reports."""
    return not chain.of_stage("clock") and not chain.of_stage("sensor") and chain.plate_turn(collars) is None


def _measured_markers(chain: Chain, samples: Measurements, collars: Collars, markers: Array) -> Array | None:
    """(S, M, 3) what a tracker reports of markers (S, M, 6); None as `_measured`."""
    if _is_seen_as_it_is(chain, collars):
        return None
    result = np.empty((*markers.shape[:2], 3))
    for k in range(markers.shape[1]):
        seen = at_instants(samples, markers[:, k], chain.delay_s)
        tangent = np.nan_to_num(seen[:, 3:]) + np.isnan(seen[:, 3:]) * [0.0, 0.0, 1.0]
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        frames = frames_along(tangent, np.eye(3)[np.argmin(np.abs(tangent), axis=1)])
        of_marker = replace(samples, marker=np.full(samples.count, k + 1))
        result[:, k] = chain.seen(Poses(seen[:, :3], frames), collars, of_marker).position
    return result


def _measured(chain: Chain, samples: Measurements, collars: Collars, phi: Array, tips: Array) -> Poses | None:
    """What a tracker reports of tips and tangents (S, 6); None where nothing stands between tip and report."""
    if _is_seen_as_it_is(chain, collars):
        return None
    across = across_tips(chain, collars, phi, tips[:, 3:])
    seen = at_instants(samples, np.hstack([tips, across]), chain.delay_s)
    tangent = seen[:, 3:6] / np.linalg.norm(seen[:, 3:6], axis=1, keepdims=True)
    return chain.seen(Poses(seen[:, :3], frames_along(tangent, seen[:, 6:])), collars, samples)


def across_tips(chain: Chain, collars: Collars, phi: Array, tangent: Array) -> Array:
    """(S, 3) a direction across each tangent (S, 3), that of the innermost tube where a sensor turns with it."""
    if not chain.turns_with_tip:  # any direction across the tangent will do
        axes: Array = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
        return axes
    rows = zip(collars.theta, collars.l, np.nan_to_num(phi), strict=True)
    return np.array([chain.mechanics.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows])


def _left_out(chain: Chain, path: JointPath) -> Iterator[str]:
    """One sentence per effect of the robot that the path says too little for."""
    for given in chain.acting:
        if missing := given.effect.missing_columns(path.time_s, path.more):
            lacking = f"without a column {', '.join(missing)}"
            yield f"{path.file}: {lacking} the robot's {given.effect.name} is left out."
        elif given.effect.overrides("friction_share") or given.effect.overrides("changing"):
            yield f"{path.file}: a simulated history has no {given.effect.name}: it acts in fits alone."


def _ranges_left(robot: Robot, path: JointPath, theta: Array, l: Array, position_m: Array) -> Iterator[str]:  # noqa: E741
    """Where built terms are asked outside their data, at (S, n) [rad], (S, n) [m] and tips (S, 3)."""
    solved = np.isfinite(position_m).all(axis=1)
    upright = np.broadcast_to(np.eye(3), (int(solved.sum()), 3, 3))
    tips = Poses(position_m[solved], upright)
    yield from (f"{path.file}: {note}" for note in range_notes(robot, theta[solved], l[solved], tips))


def _stopped(robot: Robot, l: Array) -> Array:  # noqa: E741
    """Base translations (S, n) [m] where play may put them: tubes that would not nest stop one another."""
    nested = moved_to_nest(robot.tubes, l)
    apart: Array = np.where(np.abs(nested - l).max(axis=1, keepdims=True) > ROUNDING_M, nested, l)
    return apart


def _check_collars(robot: Robot, path: JointPath, place: Array, collars: Collars) -> None:
    for k in range(len(place)):
        if sentence := nesting_violation(robot, collars.theta[k], collars.l[k]):
            key = f"row {place[k] + 1:.4g}"
            raise InputError(f"with the effects of the drive, {sentence}", file=path.file, key=key)


def _simulation(
    robot: Robot, path: JointPath, table: Array, accuracy: Accuracy, report: Callable[[str, float], None]
) -> Simulation:
    n = robot.n
    failed = np.flatnonzero(table[:, -1] == Status.FAILED)
    table = table[: failed[0] + 1] if len(failed) else table
    widths = [1, n, n, n, n, 3, 3, 6 * len(robot.markers), n - 1, 1]
    place, theta_commanded, l_commanded, theta, l, position_m, tangent, markers, phi, snaps, status = map(  # noqa: E741
        np.ascontiguousarray, np.split(table, np.cumsum(widths), axis=1)
    )
    markers = markers.reshape(len(table), -1, 6) if robot.markers else np.zeros((len(table), 0, 6))
    collars = Collars(theta, l)
    bounds = robot.bound_many(theta, l, accuracy=accuracy, progress=lambda share: report("bounds", share))
    every = Chain.of(robot)
    chain, samples = (
        every.on(path.time_s, path.more, of_collars=path.of_collars),
        _samples(path, place[:, 0], Collars(theta_commanded, l_commanded)),
    )
    return Simulation(
        robot=robot,
        path=path,
        place=place[:, 0],
        theta_commanded=theta_commanded,
        l_commanded=l_commanded,
        collars=collars,
        position_m=position_m,
        tangent=tangent,
        phi=phi,
        snaps=np.nan_to_num(snaps[:, 0]).astype(int),
        status=status[:, 0].astype(int),
        bounds=bounds,
        measured=_measured(chain, samples, collars, phi, np.hstack([position_m, tangent])),
        marker_m=markers[:, :, :3],
        measured_marker_m=_measured_markers(chain, samples, collars, markers),
        warnings=(
            *path.notes,
            *_left_out(every, path),
            *_ranges_left(robot, path, theta_commanded, l_commanded, position_m),
        ),
    )
