"""Several files as one experiment: runs one after another, each approached afresh."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import Measurements, is_streamed

PAUSE_S = 1.0  # between files whose clocks begin anew: nobody knows it


def joined_paths(parts: Sequence[JointPath]) -> JointPath:
    """The waypoints of all; one path is itself. Raises InputError where some have a clock and some none."""
    if len(parts) == 1:
        return parts[0]
    time_s, notes = _clock(parts)
    return JointPath(
        np.concatenate([part.theta_commanded for part in parts]),
        np.concatenate([part.l_commanded for part in parts]),
        _runs(parts),
        time_s,
        parts[0].file,
        _more(parts),
        (*(note for part in parts for note in part.notes), *notes),
        parts[0].of_collars,
    )


def joined_measurements(parts: Sequence[Measurements], trackers: Sequence[str], homings: Sequence[str]) -> Measurements:
    """All of them; parts of one tracker share a frame, parts of one homing the zeros of the joints.

    One part is itself. Raises InputError as `joined_paths`.
    """
    if len(parts) == 1:
        return parts[0]
    time_s, notes = _clock(parts)
    first = list(accumulate((len(part.sequence) for part in parts), initial=0))
    rows = np.concatenate([part.rows + start for part, start in zip(parts, first, strict=False)])
    theta, l = (np.concatenate([getattr(p, f"{k}_commanded") for p in parts]) for k in ("theta", "l"))  # noqa: E741
    sequence = _runs(parts)
    return replace(
        parts[0],
        sequence=sequence,
        theta_commanded=theta,
        l_commanded=l,
        rows=rows,
        position_m=np.concatenate([part.position_m for part in parts]),
        tangent=np.concatenate([part.tangent for part in parts]),
        time_s=time_s,
        is_stream=is_streamed(sequence, rows, np.hstack([theta, l])),
        more=_more(parts),
        sha256=hashlib.sha256("".join(part.sha256 for part in parts).encode()).hexdigest(),
        warnings=(*dict.fromkeys(warning for part in parts for warning in part.warnings), *notes),
        frame=_numbered(parts, trackers),
        homing=_numbered(parts, homings),
        marker=_of_poses(parts, "marker", 0),
        noise_ratio=_of_poses(parts, "noise_ratio", 1.0),
        file=_all_files(parts),
    )


def _all_files(parts: Sequence[Measurements]) -> str | None:
    """The first and how many more, in words."""
    files = list(dict.fromkeys(part.file for part in parts if part.file))
    more = len(files) - 1
    if more < 1:
        return parts[0].file
    return f"{files[0]} and {more} other file{'s' if more > 1 else ''}"


def _numbered(parts: Sequence[Measurements], names: Sequence[str]) -> NDArray[np.int_] | None:
    """(R,) number, from 1, of the name that each part has; None where there is one name."""
    known = list(dict.fromkeys(names))
    numbers = [np.full(len(part.sequence), known.index(name) + 1) for part, name in zip(parts, names, strict=True)]
    return np.concatenate(numbers) if len(known) > 1 else None


def _of_poses(parts: Sequence[Measurements], name: str, usual: float) -> NDArray[Any] | None:
    """(K,) of all parts, the usual value where one has none; None where none has any."""
    if all(getattr(part, name) is None for part in parts):
        return None
    given = (getattr(part, name) for part in parts)
    filled = (np.full(p.count, usual) if of is None else of for p, of in zip(parts, given, strict=True))
    return np.concatenate(list(filled))


def _runs(parts: Sequence[JointPath] | Sequence[Measurements]) -> NDArray[np.int_]:
    """(R,) runs counted from 0 over all files."""
    numbers, first = [], 0
    for part in parts:
        changes = np.cumsum(np.diff(part.sequence, prepend=part.sequence[0]) != 0)
        numbers.append(changes + first)
        first += int(changes[-1]) + 1
    return np.concatenate(numbers)


def _clock(parts: Sequence[JointPath] | Sequence[Measurements]) -> tuple[Array | None, list[str]]:
    """(R,) times [s] that do not run backwards, and a note where clocks had to be put one after another."""
    times = [part.time_s for part in parts]
    for part in parts:
        if (part.time_s is None) != (times[0] is None):
            lacking = part if part.time_s is None else parts[0]
            raise InputError("is missing, other files have it", file=lacking.file, key="time_s")
    given = [time_s for time_s in times if time_s is not None]
    if not given:
        return None, []
    if all(later[0] >= earlier[-1] for earlier, later in zip(given, given[1:], strict=False)):
        return np.concatenate(given), []
    shifted, end = [], 0.0
    for time_s in given:
        shifted.append(time_s - time_s[0] + end)
        end = float(shifted[-1][-1]) + PAUSE_S
    note = f"{parts[0].file}: clocks of {len(parts)} files overlap and were put one after another, which hides drifts."
    return np.concatenate(shifted), [note]


def _more(parts: Sequence[JointPath] | Sequence[Measurements]) -> Mapping[str, Array]:
    """Other columns of all files, NaN where a file has none of the name."""
    names = dict.fromkeys(name for part in parts for name in part.more)
    return {
        name: np.concatenate([part.more.get(name, np.full(len(part.sequence), np.nan)) for part in parts])
        for name in names
    }
