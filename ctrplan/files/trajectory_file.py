"""A trajectory -> files, and back."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError
from ctrplan.storage.atomic_write import write_atomically


def write_trajectory_csv(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write time_s and, joint by joint, position, velocity and acceleration (SI), so that reading returns every bit."""
    columns = [trajectory.position, trajectory.velocity, trajectory.acceleration]
    by_joint = np.stack(columns, axis=2).reshape(len(trajectory.time_s), -1)
    table = np.column_stack([trajectory.time_s, by_joint])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(trajectory_columns(trajectory))
    writer.writerows(table.tolist())
    write_atomically(path, text.getvalue())


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


def read_trajectory_csv(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Columns of a trajectory.csv by their header, each (T,). Raises InputError with file, row and rule."""
    try:
        with open(path, encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError("must be a readable CSV file with a header", file=str(path)) from error
    for number, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise InputError(f"must have {len(header)} values", file=str(path), key=f"row {number}", value=len(row))
    table = np.array([_numbers(row, str(path), k) for k, row in enumerate(rows, start=1)]).reshape(-1, len(header))
    return dict(zip(header, table.T, strict=True))


def trajectory_as_ros2_yaml(trajectory: Trajectory) -> str:
    """The trajectory as a ROS 2 trajectory_msgs/JointTrajectory in YAML, rad and m, times from start."""
    lines = ["header:", "  stamp: {sec: 0, nanosec: 0}", '  frame_id: ""']
    lines += [f"joint_names: {json.dumps(list(trajectory.names), ensure_ascii=False)}", "points:"]
    for k, time_s in enumerate(trajectory.time_s.tolist()):
        sec, nanosec = divmod(round(time_s * 1e9), 10**9)
        lines.append(f"- positions: {_yaml_list(trajectory.position[k].tolist())}")
        lines.append(f"  velocities: {_yaml_list(trajectory.velocity[k].tolist())}")
        lines.append(f"  accelerations: {_yaml_list(trajectory.acceleration[k].tolist())}")
        lines.append(f"  effort: []\n  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
    return "\n".join(lines) + "\n"


def _numbers(row: list[str], file: str, number: int) -> list[float]:
    try:
        return [float(value) for value in row]
    except ValueError as error:
        raise InputError("must hold numbers only", file=file, key=f"row {number}", value=",".join(row)) from error


def _yaml_list(values: Iterable[float]) -> str:
    return f"[{', '.join(map(_yaml_float, values))}]"


def _yaml_float(value: float) -> str:
    """YAML 1.1, which ROS reads, takes 1e-05 for a string: it wants 1.0e-05."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
