"""Poses in a tracker's frame that nobody registered, moved to where the robot's own tips are.

The rigid motion that brings measured positions nearest to the zero-clearance tips and markers of the robot file (Kabsch
1976), far ones left out. It takes the place of a registration, not of a fit: base_misalignment or frame_shift beside it
take up what a better model moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.tip_table import markers_on, on_body
from ctrplan.robot.robot import Robot

LEAST_POSES = 4
SPREAD_M = 1e-3  # of positions across their line, below which they say nothing about a rotation about it
KEPT = 0.9  # of the poses, the nearest ones
ROUNDS = 3


def registered(robot: Robot, data: Measurements, frames: Mapping[int, str]) -> Measurements:
    """The poses of some frames, number -> name, in the robot's frame, with a note each. Raises InputError."""
    position, tangent, notes = data.position_m.copy(), data.tangent.copy(), []
    for number, name in frames.items():
        poses = data.frames[data.rows] == number
        model = _believed_m(robot, data.subset(poses))
        good = np.isfinite(model).all(axis=1)
        if good.sum() < LEAST_POSES:
            raise InputError(f"has {good.sum()} poses, too few to find its place: at least {LEAST_POSES}", key=name)
        turn, shift, rms_m = _motion(position[poses][good], model[good], name, data.file)
        position[poses] = turn.apply(position[poses]) + shift
        tangent[poses] = turn.apply(tangent[poses])
        notes.append(
            f"{data.file}: the frame of {name} is not known: its poses were moved to where the robot file has the "
            f"tips, {rms_m * 1e3:.2f} mm off (rms). A fit needs base_misalignment or frame_shift besides."
        )
    return replace(data, position_m=position, tangent=tangent, warnings=(*data.warnings, *notes)) if notes else data


def _believed_m(robot: Robot, data: Measurements) -> Array:
    """(K, 3) [m] where the robot file has the measured points without clearance and friction; NaN where it has none."""
    theta_b, l_b = _collars(robot, data)
    found, _, _ = robot.mechanics.tips(theta_b, l_b)
    for k in np.flatnonzero(on_body(robot, data)).tolist():
        shape = robot.zero_clearance(theta_b[k], l_b[k])
        found[k] = markers_on(robot, shape, l_b[k])[0][data.seen_marker[k] - 1]
    return found


def _collars(robot: Robot, data: Measurements) -> tuple[Array, Array]:
    commanded = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    return commanded if data.of_collars else robot.collars(*commanded)


def _motion(measured: Array, model: Array, name: str, file: str | None) -> tuple[Rotation, Array, float]:
    """Turn and shift [m] that bring measured positions (K, 3) to those of the model, and the rms [m] that is left."""
    kept = np.arange(len(measured))
    for _ in range(ROUNDS):
        middle, aim = measured[kept].mean(axis=0), model[kept].mean(axis=0)
        if np.linalg.svd(model[kept] - aim, compute_uv=False)[1] < SPREAD_M * np.sqrt(len(kept)):
            raise InputError("has its tips on one line, which says nothing about its rotation", file=file, key=name)
        turn = Rotation.align_vectors(model[kept] - aim, measured[kept] - middle)[0]
        shift = aim - turn.apply(middle)
        off = np.linalg.norm(turn.apply(measured) + shift - model, axis=1)
        kept = np.argsort(off)[: max(LEAST_POSES, int(KEPT * len(off)))]
    return turn, shift, float(np.sqrt(np.mean(off**2)))
