"""A trajectory -> files in the formats there are, and back from CSV."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import ctrplan.files.trajectory_formats
from ctrplan.base.arrays import Array
from ctrplan.base.extensions import import_modules
from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError
from ctrplan.files.trajectory_format import CATALOGUE, TrajectoryFormat
from ctrplan.storage.atomic_write import write_atomically

import_modules(ctrplan.files.trajectory_formats, CATALOGUE)


def trajectory_formats(names: Sequence[str]) -> list[TrajectoryFormat]:
    """The formats of these names, each once. Raises InputError for one that there is not."""
    for name in names:
        if name not in CATALOGUE:
            raise InputError(f"must be of {CATALOGUE.names}", key="--formats", value=name)
    return [CATALOGUE[name] for name in dict.fromkeys(names)]


def left_over(folder: Path, formats: Sequence[TrajectoryFormat]) -> list[str]:
    """Names of trajectories in a folder that are in none of these formats: an earlier plan left them there."""
    others = [other.file_name for other in CATALOGUE.values() if other not in formats]
    return [name for name in others if (folder / name).exists()]


def write_trajectory(folder: Path, trajectory: Trajectory, formats: Sequence[TrajectoryFormat]) -> None:
    """Writes a file per format into a folder. Raises InputError for joints that a format can't tell apart."""
    for chosen in formats:
        write_atomically(folder / chosen.file_name, chosen.text(trajectory))


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


def _numbers(row: list[str], file: str, number: int) -> list[float]:
    try:
        return [float(value) for value in row]
    except ValueError as error:
        raise InputError("must hold numbers only", file=file, key=f"row {number}", value=",".join(row)) from error
