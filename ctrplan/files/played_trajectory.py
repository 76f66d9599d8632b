"""trajectory.csv -> what the drive plays, and where on the plan's legs each sample lies."""

from __future__ import annotations

import os

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.file_bytes import file_name

LEAVES = 1e-5  # rad or m by which a sample may lie beside its leg: digits that somebody rounded
SHORTEST = 1e-4  # rad or m of a leg that no sample may leave out


def played_samples(path: str | os.PathLike[str], drive: Drive) -> tuple[Array, Array]:
    """Times (T,) [s] and joint values (T, m) of a trajectory.csv; other columns are not needed.

    Raises InputError, one sentence with row and column, for what is missing, no finite number, or out of order.
    """
    table = CsvTable(file_name(path, "a trajectory.csv"), "trajectory")
    joints = zip(drive.names, drive.is_rotation.tolist(), strict=True)
    columns = [f"{'_'.join(name.split())}_position_{'rad' if rotates else 'm'}" for name, rotates in joints]
    for name in ("time_s", *columns):
        if name not in table.header:
            raise table.fault("is missing", column=name)
    time_s = table.numbers("time_s")
    for row in (np.flatnonzero(np.diff(time_s) <= 0) + 1).tolist():
        raise table.fault(f"must be later than the row before, {time_s[row - 1]:.9g} s", row, "time_s", time_s[row])
    return time_s, np.column_stack([table.numbers(name) for name in columns])


def places_on_legs(rows: Array, waypoints: Array, file: str | None, what: str) -> Array:
    """(T,) leg number plus share of it where joints (T, m) lie on the legs through waypoints (L + 1, m).

    Raises InputError for rows that leave the legs, go back, leave a leg out, or do not go from start to end.
    """
    places, leg, share = np.empty(len(rows)), 0, 0.0
    for k, row in enumerate(rows):
        leg, share = _next_place(row, waypoints, leg, share, file, f"{what}, sample {k + 1}")
        places[k] = leg + share
    for k, end, name in ((0, 0, "start"), (len(rows) - 1, len(waypoints) - 1, "end")):
        if np.abs(rows[k] - waypoints[end]).max() > LEAVES:
            raise InputError(f"must be at the {name} of the plan's legs", file=file, key=f"{what}, sample {k + 1}")
    return places


def _next_place(row: Array, waypoints: Array, leg: int, share: float, file: str | None, key: str) -> tuple[int, float]:
    """The first place at or after (leg, share) where the row lies on the legs."""
    for k in range(leg, len(waypoints) - 1):
        chord = waypoints[k + 1] - waypoints[k]
        length = float(np.linalg.norm(chord))
        along = float((row - waypoints[k]) @ chord) / length**2 if length > 0 else 0.0
        at = min(max(along, share if k == leg else 0.0), 1.0)
        if np.abs(row - waypoints[k] - at * chord).max() <= LEAVES:
            return k, at
        if k > leg and length > SHORTEST:
            break
    if _apart(row, waypoints) > LEAVES:
        raise InputError(f"leaves the plan's legs by {_apart(row, waypoints):.3g} rad or m", file=file, key=key)
    raise InputError("is out of order: the legs do not pass here after the sample before", file=file, key=key)


def _apart(row: Array, waypoints: Array) -> float:
    """Distance [rad or m, the largest joint's] of a row (m,) from the legs."""
    chords = np.diff(waypoints, axis=0)
    squares = np.sum(chords**2, axis=1)
    along = np.sum((row - waypoints[:-1]) * chords, axis=1) / np.where(squares > 0, squares, 1.0)
    feet = waypoints[:-1] + np.clip(along, 0.0, 1.0)[:, None] * chords
    return float(np.abs(row - feet).max(axis=1).min())
