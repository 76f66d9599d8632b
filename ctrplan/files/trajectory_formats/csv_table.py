"""A header and a row per sample."""

from __future__ import annotations

import numpy as np

from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError
from ctrplan.files.trajectory_file import register
from ctrplan.storage.csv_table import csv_text


@register("csv", suffix=".csv")
def trajectory_as_csv(trajectory: Trajectory) -> str:
    """time_s and, joint by joint, position, velocity and acceleration (SI), so that reading returns every bit.

    The trajectory's marks are whole-number columns after these.
    """
    columns = [trajectory.position, trajectory.velocity, trajectory.acceleration]
    by_joint = np.stack(columns, axis=2).reshape(len(trajectory.time_s), -1)
    table = np.column_stack([trajectory.time_s, by_joint]).tolist()
    marks = np.array(list(trajectory.marks.values())).T.tolist() or [[]] * len(table)
    rows = ([*row, *marked] for row, marked in zip(table, marks, strict=True))
    return csv_text([*trajectory_columns(trajectory), *trajectory.marks], rows)


def trajectory_columns(trajectory: Trajectory) -> list[str]:
    """Header of trajectory.csv, for example time_s, rotate_inner_position_rad, rotate_inner_velocity_rad_s, ..."""
    columns = ["time_s"]
    for name, is_rotation in zip(trajectory.names, trajectory.is_rotation, strict=True):
        joint, unit = "_".join(name.split()), "rad" if is_rotation else "m"
        columns += [f"{joint}_position_{unit}", f"{joint}_velocity_{unit}_s", f"{joint}_acceleration_{unit}_s2"]
    if len(set(columns)) < len(columns):
        rule = "two joints have the same name once spaces are written as underscores"
        raise InputError(rule, key="joint names", value=list(trajectory.names))
    return columns
