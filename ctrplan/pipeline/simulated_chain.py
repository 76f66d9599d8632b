"""A joint path through a robot's drive, clock and sensor: where collars really go, what a tracker says of the tips.

The mechanics in between are a simulated history (`simulation.py`); effects are those of the robot file.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Collars
from ctrplan.experiment.friction_states import last_directions
from ctrplan.experiment.joint_path import JointPath
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.robot_effects import effects_of
from ctrplan.robot.robot import Robot
from ctrplan.sensor.poses import Poses, frames_along


def collars_of(robot: Robot, path: JointPath, place: Array, theta_b: Array, l_b: Array) -> Collars:
    """Where the drive puts the collars at commanded samples (S, n) of one run, `place` (S,) in waypoints."""
    collars = Collars(theta_b, l_b)
    terms = [(effect, values) for effect, values in effects_of(robot) if effect.stage == "drive"]
    if not terms:
        return collars
    directions = last_directions(_samples(path, place, theta_b, l_b))
    for effect, values in terms:
        collars = effect.drive(values, collars, directions)
    return collars


def measured_poses(
    robot: Robot, path: JointPath, place: Array, collars: Collars, phi: Array, position_m: Array, tangent: Array
) -> Poses | None:
    """What a tracker reports of tips (S, 3); None where nothing stands between tip and report."""
    terms = [(effect, values) for effect, values in effects_of(robot) if effect.stage in ("clock", "sensor")]
    if not terms or any(effect.missing_columns(path.time_s, path.more) for effect, _ in terms):
        return None
    across = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    if any(effect.turns_with_tip for effect, _ in terms):  # for others any direction across the tangent will do
        rows = zip(collars.theta, collars.l, np.nan_to_num(phi), strict=True)
        across = np.array([robot.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows])
    numbers = np.hstack([position_m, tangent, across])
    if delay_s := sum(effect.delay_s(values) for effect, values in terms):
        numbers = _earlier(path, place, numbers, delay_s)
    poses = Poses(numbers[:, :3], frames_along(_unit(numbers[:, 3:6]), numbers[:, 6:]))
    samples = _samples(path, place, collars.theta, collars.l)
    for effect, values in terms:
        poses = effect.sensor(values, poses, samples)
    return poses


def chain_warnings(robot: Robot, path: JointPath) -> Iterator[str]:
    """One sentence per effect of the robot that the path says too little for."""
    for effect, _ in effects_of(robot):
        if missing := effect.missing_columns(path.time_s, path.more):
            lacking = f"without a column {', '.join(missing)}"
            yield f"{path.file}: {lacking} nothing is said of what would be measured: {effect.name}."


def _samples(path: JointPath, place: Array, theta_b: Array, l_b: Array) -> Measurements:
    """Samples as waypoints that are all measured, in the words of the effects."""
    blank = np.zeros((len(place), 3))
    waypoints = np.arange(len(path.sequence))
    time_s = None if path.time_s is None else np.interp(place, waypoints, path.time_s)
    more = {name: np.interp(place, waypoints, values) for name, values in path.more.items()}
    sequence = path.sequence[np.ceil(place).astype(int)]
    return Measurements(sequence, theta_b, l_b, np.arange(len(place)), blank, blank, time_s, more=more)


def _earlier(path: JointPath, place: Array, numbers: Array, delay_s: float) -> Array:
    """Rows of `numbers` (S, ...) at the samples' times minus `delay_s`, inside each run."""
    samples = _samples(path, place, numbers, numbers)
    assert samples.time_s is not None
    found = numbers.copy()
    for run in np.unique(samples.sequence):
        rows = np.flatnonzero(samples.sequence == run)
        wanted = samples.time_s[rows] - delay_s
        found[rows] = np.column_stack([np.interp(wanted, samples.time_s[rows], c) for c in numbers[rows].T])
    return found


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
