"""Columns of markers on the body in a file of measurements: NAME_x_m, NAME_y_m, NAME_z_m of each [[marker]]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.robot.robot import Robot
from ctrplan.storage.csv_table import CsvTable

AXES = "xyz"


@dataclass(frozen=True, eq=False)
class SeenMarker:
    """A marker of the robot where a table has it."""

    number: int  # from 1
    columns: tuple[str, str, str]
    position_m: Array  # (N, 3); NaN for an axis along which it was seen
    rows: NDArray[np.int_]  # (N,)
    notes: tuple[str, ...]


def seen_markers(table: CsvTable, robot: Robot, *, is_registered: bool) -> list[SeenMarker]:
    """Those markers that the table has two or three columns of. Raises InputError for one column, and half a row."""
    found = []
    for number, marker in enumerate(robot.markers, start=1):
        there = [name in table.header for name in marker.columns]
        names = [name for name, given in zip(marker.columns, there, strict=True) if given]
        if not names:
            continue
        if len(names) == 1:
            raise table.fault("one coordinate of a marker says too little, give two or all three", column=names[0])
        if len(names) == 2 and not is_registered:
            raise table.fault("two coordinates of a marker say too little where the frame is unknown", column=names[0])
        position = np.full((len(table.rows), 3), np.nan)
        position[:, there] = np.column_stack([table.numbers(name, blanks=True) for name in names])
        given = np.isfinite(position[:, there])
        for row in np.flatnonzero(given.any(axis=1) & ~given.all(axis=1)).tolist():
            rule = f"is empty, a marker needs all of {', '.join(names)} or none"
            raise table.fault(rule, row, names[int(given[row].argmin())])
        rows = np.flatnonzero(given.all(axis=1))
        along = "" if all(there) else AXES[there.index(False)]
        notes = (f"{table.file}: there is no {marker.name}_{along}_m: it is taken for seen along {along}.",)
        found.append(SeenMarker(number, marker.columns, position[rows], rows, notes if along else ()))
    return found


def with_markers(
    position: Array, tangent: Array, rows: NDArray[np.int_], seen: Sequence[SeenMarker]
) -> tuple[Array, Array, NDArray[np.int_], NDArray[np.int_]]:
    """Positions (K, 3), tangents (K, 3), rows (K,) and marker numbers (K,): tips first, then marker after marker."""
    numbers = [np.zeros(len(rows), int), *(np.full(len(point.rows), point.number) for point in seen)]
    return (
        np.concatenate([position, *(point.position_m for point in seen)]),
        np.concatenate([tangent, *(np.full((len(point.rows), 3), np.nan) for point in seen)]),
        np.concatenate([rows, *(point.rows for point in seen)]),
        np.concatenate(numbers),
    )


def noise_ratio(robot: Robot, marker: NDArray[np.int_]) -> Array | None:
    """(K,) noise of each position over a tip's, by the numbers of their markers (K,), 0: the tip; None if alike."""
    stated = robot.measurement
    if stated is None or all(point.position_sigma_m is None for point in robot.markers):
        return None
    ratios = [1.0, *((m.position_sigma_m or stated.position_sigma_m) / stated.position_sigma_m for m in robot.markers)]
    found: Array = np.array(ratios)[marker]
    return found
