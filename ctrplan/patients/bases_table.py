"""bases.csv: base poses of a case, best first; the plan begins with the first row, so that editing it chooses."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import LONGEST_MM, MM_PER_M
from ctrplan.planning.placing.base_pose import DIGITS, MM_DIGITS, BasePose, Pose, as_written
from ctrplan.storage.csv_table import CsvTable

POSITION, TURN = ("x_mm", "y_mm", "z_mm"), ("qw", "qx", "qy", "qz")
TOLD = ("targets_reached", "worst_error_mm", "clearance_mm", "note")
NORM_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Row:
    """A base pose of the table."""

    number: int  # from 1
    pose: Pose


def bases_text(poses: Sequence[BasePose]) -> str:
    """The file's content. Position and quaternion are read again, the rest is for whoever looks at it."""
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow([*POSITION, *TURN, *TOLD])
    for pose in poses:
        written = Pose(pose.position_m, pose.R)
        position = np.round(pose.position_m * MM_PER_M, MM_DIGITS) + 0.0
        turn = np.round(written.quaternion_wxyz, DIGITS) + 0.0
        table.writerow([*map(repr, position.tolist()), *map(repr, turn.tolist()), *_told(pose)])
    return stream.getvalue()


def read_bases(file: Path) -> list[Row]:
    """The poses in their order. Raises InputError for a table without the columns, and for what turns nothing."""
    table = CsvTable(str(file), "table of base poses")
    for name in (*POSITION, *TURN):
        if name not in table.header:
            raise table.fault("is missing in the header", column=name)
    position = np.column_stack([table.numbers(name) for name in POSITION])
    turn = np.column_stack([table.numbers(name) for name in TURN])
    for k in range(len(position)):
        if np.abs(position[k]).max() > LONGEST_MM:
            raise table.fault(f"must lie from {-LONGEST_MM:g} to {LONGEST_MM:g} mm", k, "x_mm, y_mm, z_mm")
        if not abs(np.linalg.norm(turn[k]) - 1) <= NORM_TOLERANCE:
            raise table.fault(f"must have norm 1 within {NORM_TOLERANCE}", k, "qw, qx, qy, qz")
    return [
        Row(k + 1, as_written(Pose(position[k] / MM_PER_M, Rotation.from_quat(np.roll(turn[k], -1)).as_matrix())))
        for k in range(len(position))
    ]


def _told(pose: BasePose) -> list[str]:
    worst = max((target.worst_m for target in pose.targets if target.best), default=math.inf)
    numbers = [f"{x * MM_PER_M:.3f}" if math.isfinite(x) else "" for x in (worst, pose.clearance_m)]
    note = pose.reason or ("the entry itself" if pose.is_own else "")
    return [f"{pose.reached} of {len(pose.targets)}", *numbers, note]
