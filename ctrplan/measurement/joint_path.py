"""Commanded joint paths: waypoints in the order visited, unwrapped; several files as one experiment."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements, is_streamed


@shown
@dataclass(frozen=True, eq=False)
class JointPath:
    """K waypoints of n tubes in the order visited; between them all joints move together linearly."""

    theta_commanded: Array  # (K, n) base rotations, rad, not wrapped
    l_commanded: Array  # (K, n) base translations, m
    sequence: NDArray[np.int_]  # (K,) runs, each approached afresh
    time_s: Array | None = None  # (K,)
    file: str | None = None
    more: Mapping[str, Array] = field(default_factory=dict)  # other columns (K,), NaN where blank
    notes: tuple[str, ...] = ()  # how the file was read, a sentence each
    of_collars: bool = False  # whether joints are those of the collars, so that the drive's effects are in them

    @property
    def runs(self) -> list[slice]:
        """Rows of each run."""
        starts = [*np.flatnonzero(np.diff(self.sequence, prepend=np.nan) != 0).tolist(), len(self.sequence)]
        return [slice(a, b) for a, b in zip(starts, starts[1:], strict=False)]


TURN = 2 * np.pi
NEAR_A_TURN = 0.26 * TURN  # steps that are nearer to one turn may be a wrapped angle's: of the usual 90 deg, too
SMALL_STEP = 1.0  # rad; those of a log, but for a few
FEW = 0.01  # of the steps of a log
STEPS_PER_JUMP = 20  # of a log, at least
EXACT = 1e-6  # rad


def looks_wrapped(theta: Array, sequence: NDArray[np.int_]) -> bool | None:
    """Whether a rotation (R,) [rad] in runs (R,) was kept within one turn. None where it can't be known.

    A log of small steps that now and then jumps by nearly a turn was. Waypoints that are far apart may be meant as they
    are; a step of exactly one turn is.
    """
    step = np.abs(np.diff(theta))[np.diff(sequence) == 0]
    far = _is_near_a_turn(step)
    if not far.any():
        return False
    others = step[~far]
    is_log = len(others) >= STEPS_PER_JUMP * far.sum() and np.mean(others > SMALL_STEP) <= FEW
    if is_log:
        return True
    return False if np.all(np.abs(step[far] - TURN) < EXACT) else None


def jumps(theta: Array, sequence: NDArray[np.int_]) -> NDArray[np.int_]:
    """Rows (from 0) that a rotation (R,) reaches by a step near a full turn."""
    near = _is_near_a_turn(np.abs(np.diff(theta))) & (np.diff(sequence) == 0)
    result: NDArray[np.int_] = np.flatnonzero(near) + 1
    return result


def unwrapped(theta: Array, sequence: NDArray[np.int_]) -> Array:
    """Rotations (R,) [rad] that go on where they jump by nearly a turn."""
    rows, turns = jumps(theta, sequence), np.zeros(len(theta))
    turns[rows] = -np.round((theta[rows] - theta[rows - 1]) / TURN)
    whole: Array = theta + TURN * np.cumsum(turns)
    return whole


def _is_near_a_turn(step: Array) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.abs(step - TURN) < NEAR_A_TURN
    return near


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


def _positions(parts: Sequence[Measurements]) -> Array | None:
    """(K, 3) of tips, None where markers stand between them."""
    return None if any(part.has_markers for part in parts) else np.concatenate([part.position_m for part in parts])


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
        is_stream=is_streamed(sequence, rows, np.hstack([theta, l]), _positions(parts)),
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
