"""measurements.csv -> Measurements. Every fault is one sentence with file, row, column, value and rule."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.experiment.joint_path import JointPath
from ctrplan.experiment.measurements import Measurements, is_streamed
from ctrplan.files.joint_path_file import joint_path
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.file_bytes import file_name

POSE = ("x_m", "y_m", "z_m", "tx", "ty", "tz")
TANGENT_TOLERANCE = 0.01  # of its length: files are rounded
FURTHEST = 2.0  # tip from the base, in lengths of the longest tube
STILL_RAD, STILL_M = 1e-6, 1e-8


def load_measurements(path: str | os.PathLike[str], robot: Robot) -> Measurements:
    """The waypoints and poses of a CSV file that goes with `robot`.

    Raises InputError, one sentence with file, row, column, value and rule, for anything malformed or contradictory.
    """
    table = CsvTable(file_name(path, "a CSV file"), "file of measurements")
    joints = joint_path(table, robot, needed=("sequence", *POSE))
    pose, rows = _poses(table)
    theta_b, l_b = joints.theta_commanded, joints.l_commanded
    if np.ptp(theta_b, axis=0).max() < STILL_RAD and np.ptp(l_b, axis=0).max() < STILL_M:
        raise table.fault("all joints are constant: one configuration says nothing about a model")
    _check_poses(table, pose, rows, robot)
    return Measurements(
        sequence=joints.sequence,
        theta_commanded=theta_b,
        l_commanded=l_b,
        rows=rows,
        position_m=pose[:, :3],
        tangent=pose[:, 3:] / np.linalg.norm(pose[:, 3:], axis=1, keepdims=True),
        time_s=joints.time_s,
        is_stream=is_streamed(joints.sequence, rows, np.hstack([theta_b, l_b])),
        more=joints.more,
        file=table.file,
        sha256=table.sha256,
        warnings=(*_still_joints(theta_b[rows], l_b[rows], table.file), *_left_out(robot, joints)),
    )


def _poses(table: CsvTable) -> tuple[Array, Any]:
    pose = np.column_stack([table.numbers(name, blanks=True) for name in POSE])
    given = np.isfinite(pose)
    for row in np.flatnonzero(given.any(axis=1) & ~given.all(axis=1)).tolist():
        rule = "is empty, a pose needs all of x_m, y_m, z_m, tx, ty, tz"
        raise table.fault(rule, row, POSE[int(given[row].argmin())])
    rows = np.flatnonzero(given.all(axis=1))
    if not len(rows):
        raise table.fault("holds no pose: x_m, y_m, z_m, tx, ty, tz are empty in every row")
    return pose[rows], rows


def _check_poses(table: CsvTable, pose: Array, rows: Sequence[int], robot: Robot) -> None:
    with np.errstate(over="ignore"):  # what is beyond all numbers is too far
        far, length = (np.linalg.norm(vectors, axis=1) for vectors in (pose[:, :3], pose[:, 3:]))
    limit = FURTHEST * max(tube.length_m for tube in robot.tubes)
    for k in np.flatnonzero(far > limit).tolist():
        unit = ", are these millimetres?" if np.median(far) > 100 * limit else ""
        rule = f"tip is {far[k]:g} m from the base, beyond the reach of {limit:.3g} m{unit}"
        raise table.fault(rule, int(rows[k]), "x_m", pose[k, 0])
    if np.median(far) < limit / 2000:
        raise table.fault(f"tips are {np.median(far):.2g} m from the base, are these metres?", column="x_m")
    for k in np.flatnonzero(np.abs(length - 1) > TANGENT_TOLERANCE).tolist():
        rule = f"tangent has length {length[k]:.4g}, must be a unit vector"
        raise table.fault(rule, int(rows[k]), "tx", pose[k, 3])


def _still_joints(theta_b: Array, l_b: Array, file: str) -> list[str]:
    """One sentence per pair of tubes that never turned and per tube that never moved inside the others."""
    still = []
    for i in range(1, theta_b.shape[1]):
        if np.ptp(theta_b[:, i] - theta_b[:, i - 1]) < STILL_RAD:
            still.append(f"{file}: tubes {i} and {i + 1} never turn against each other: their pair is not testable.")
    if np.ptp(l_b, axis=0).max() < STILL_M:
        still.append(f"{file}: no tube is ever moved along: lengths and translations are not testable.")
    return still


def _left_out(robot: Robot, joints: JointPath) -> list[str]:
    """One sentence per effect of the robot file that these data say too little for."""
    lacking = (
        (given.effect.name, given.effect.missing_columns(joints.time_s, joints.more))
        for given in Chain.of(robot).acting
    )
    return [
        f"{joints.file}: without a column {', '.join(missing)} the robot's {name} is left out."
        for name, missing in lacking
        if missing
    ]
