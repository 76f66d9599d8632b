"""Two results figure by figure: where one says something else than the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline, merge_legs

SAME, SHARE = 1e-5, 1e-3  # in a figure's own unit (0.01 mm of a length), and of its value: processors round differently
OFF_PATH = 1e-9  # rad or m by which legs and trajectory may leave the certified path


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out again."""

    figure: str  # its name, "samples.bound_m" for the worst sample of a column
    stated: float | str
    found: float | str

    @property
    def sentence(self) -> str:
        """Figure and both values, without a full stop."""
        stated, found = (x if isinstance(x, str) else f"{x:.6g}" for x in (self.stated, self.found))
        return f"{self.figure} is stated as {stated} and found to be {found}"


def differences(stated: Any, found: Any, *, of: str = "", skip: tuple[str, ...] = ()) -> tuple[Difference, ...]:
    """Of two dataclasses of one kind, fields in `skip` left out; figures are named `of` and the field.

    Of sequences of unlike lengths the lengths are compared, of texts whether they are alike.
    """
    names = (entry.name for entry in fields(stated) if entry.name not in skip)
    return tuple(d for name in names for d in _compared(of + name, getattr(stated, name), getattr(found, name)))


def path_differences(waypoints: Array, trajectory: Array, certified: Array) -> tuple[Difference, ...]:
    """Of legs through waypoints (K, m) and a trajectory (T, m) [rad, m] from the path certified, (L, m)."""
    driven, path = merge_legs(waypoints), merge_legs(certified)
    line = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    apart = {
        "legs": np.abs(driven - path).max() if driven.shape == path.shape else np.inf,
        "ends of the trajectory": np.abs(trajectory[[0, -1]] - line[[0, -1]]).max(),
        "trajectory": distance_from_polyline(trajectory, line).max(),
    }
    return tuple(
        Difference(f"distance of the {what} from the certified path", 0.0, float(distance))
        for what, distance in apart.items()
        if distance > OFF_PATH
    )


def _compared(figure: str, stated: Any, found: Any) -> Iterator[Difference]:
    if (stated is None) != (found is None) and (is_dataclass(stated) or is_dataclass(found)):
        yield Difference(figure, np.nan, np.nan)
    elif is_dataclass(stated):
        yield from differences(stated, found, of=f"{figure}.")
    elif isinstance(stated, str):
        if stated != found:
            yield Difference(figure, stated, str(found))
    elif isinstance(stated, tuple):
        if len(stated) != len(found):
            yield Difference(figure, len(stated), len(found))
        for number, (a, b) in enumerate(zip(stated, found, strict=False), start=1):
            yield from _compared(f"{figure}.{number}", a, b)
    else:
        yield from _numbers_compared(figure, stated, found)


def _numbers_compared(figure: str, stated: Any, found: Any) -> Iterator[Difference]:
    """The largest difference of numbers or arrays beyond what rounding may do; None counts as not a number."""
    a, b = (np.asarray(np.nan if value is None else value, dtype=np.float64).ravel() for value in (stated, found))
    if a.shape != b.shape:
        yield Difference(f"number of {figure}", len(a), len(b))
        return
    off = ~np.isclose(a, b, rtol=SHARE, atol=SAME, equal_nan=True)
    if off.any():
        gap = np.nan_to_num(np.abs(a - b), nan=np.inf)
        k = int(np.argmax(np.where(off, gap, -1.0)))
        yield Difference(figure, float(a[k]), float(b[k]))
