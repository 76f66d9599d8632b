"""Obstacles and lumens as one signed-distance field: the clearance available to a point, on a grid.

The core samples the field at every point of every shape; the certificate uses `exact_clearance` instead. What the parts
mean together stands in `ctrplan.anatomy.parts`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.anatomy.distance_field import SignedDistanceField
from ctrplan.anatomy.grid_distance import COARSEST, grid_distance
from ctrplan.anatomy.parts import AnatomyPart, combined_clearance
from ctrplan.anatomy.shape import Shape
from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress, part_of
from ctrplan.errors import InputError
from ctrplan.storage import cache as field_cache

FORMAT = b"ctrplan distance field 2"  # part of the cache key: change it with anything that changes the values
SPACINGS_M = (1e-6, 1.0)
DEFAULT_NODES, MAX_DEFAULT_NODES, MAX_NODES = 2e6, 8e6, 5e8


def field_bounds(
    parts: Sequence[AnatomyPart],
    reach_m: float,
    base_position_m: ArrayLike = (0.0, 0.0, 0.0),
    base_R: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    side_m: float | None = None,
) -> tuple[Array, Array]:
    """Lower and upper corner (3,), (3,) [m] of a grid that holds all clear points the robot can reach.

    The robot leaves its base along the base's z axis and stays within reach_m of it, in front of it, and, where given,
    within side_m of that axis [m]. Lumens bound it further: outside their box nothing is clear.
    """
    if not 0 < reach_m < np.inf:
        raise InputError("must be a finite number above zero", key="reach_m", value=reach_m, unit="m")
    base, R = np.asarray(base_position_m, dtype=np.float64), np.asarray(base_R, dtype=np.float64)
    side = reach_m if side_m is None else min(side_m, reach_m)
    # Extent along each axis of the anatomy's frame of the box side x side x [0, reach] turned by R, within the ball.
    across, along = np.linalg.norm(R[:, :2], axis=1) * side, R[:, 2] * reach_m
    upper = base + np.minimum(across + np.maximum(along, 0), reach_m)
    lower = base - np.minimum(across + np.maximum(-along, 0), reach_m)
    boxes = [part.shape.box() for part in parts if part.role == "inside"]
    if boxes:
        inside_lower, inside_upper = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
        lower, upper = np.clip(inside_lower, lower, upper), np.clip(inside_upper, lower, upper)
    return lower, upper


def default_spacing_m(lower_m: ArrayLike, upper_m: ArrayLike) -> float:
    """Spacing [m] between 0.5 and 1 mm that gives some 2 million nodes; above 1 mm only beyond 8 million nodes."""
    extent = np.maximum(np.asarray(upper_m, dtype=np.float64) - np.asarray(lower_m, dtype=np.float64), 1e-3)
    volume = float(extent.prod())
    spacing = float(np.clip(np.cbrt(volume / DEFAULT_NODES), 0.5e-3, 1e-3))
    return max(spacing, float(np.cbrt(volume / MAX_DEFAULT_NODES)))


def build_field(
    parts: Sequence[AnatomyPart],
    lower_m: ArrayLike,
    upper_m: ArrayLike,
    spacing_m: float,
    progress: Progress | None = None,
    cache: bool = True,
) -> SignedDistanceField | None:
    """Clearance on a grid over the box lower_m (3,) to upper_m (3,) [m], or None when there are no parts.

    The grid starts at lower_m and ends up to 4 nodes beyond upper_m. progress: called with the fraction done, 0 to 1.
    cache: keep the grid on disk and take it from there (see `ctrplan.storage.cache`).
    Values are exact within some 11 grid steps of a surface and coarser further away, see
    `ctrplan.anatomy.grid_distance`.
    Raises InputError for a box or spacing that makes no grid.
    """
    if not parts:
        return None
    origin, spacing, shape = _grid(lower_m, upper_m, spacing_m)
    key = content_key(parts, origin, spacing, shape)
    values = field_cache.load(key, shape) if cache else None
    if values is None:
        steps = iter(range(len(parts)))
        values = combined_clearance(
            parts, lambda part: grid_distance(part, origin, spacing, shape, part_of(progress, next(steps), len(parts)))
        ).astype(np.float32, copy=False)
        if cache:
            field_cache.store(key, values)
    if progress:
        progress(1.0)
    return SignedDistanceField(origin, spacing, values, tuple(parts))


def _grid(lower_m: ArrayLike, upper_m: ArrayLike, spacing_m: float) -> tuple[Array, float, tuple[int, int, int]]:
    lower, upper = np.array(lower_m, dtype=np.float64), np.array(upper_m, dtype=np.float64)
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise InputError("must be a finite number above zero", key="spacing_m", value=spacing_m, unit="m")
    if not SPACINGS_M[0] <= spacing_m <= SPACINGS_M[1]:
        rule = f"must be from {SPACINGS_M[0]:g} to {SPACINGS_M[1]:g} m"
        raise InputError(rule, key="spacing_m", value=spacing_m, unit="m")
    if lower.shape != (3,) or upper.shape != (3,) or not (np.isfinite(lower) & (lower <= upper)).all():
        raise InputError("must not exceed upper_m", key="lower_m", value=lower.tolist(), unit="m")
    cells = np.ceil(np.maximum((upper - lower) / (COARSEST * spacing_m) - 1e-9, 1.0)) * COARSEST
    if (cells + 1).prod() > MAX_NODES:
        rule = f"gives {(cells + 1).prod():.3g} grid nodes: must give at most {MAX_NODES:.0e}"
        raise InputError(rule, key="spacing_m", value=spacing_m, unit="m")
    nx, ny, nz = (int(c) + 1 for c in cells)
    return lower, float(spacing_m), (nx, ny, nz)


def content_key(parts: Sequence[AnatomyPart], *grid: ArrayLike) -> str:
    """SHA-256 of everything that determines the values: numbers of anatomy and grid, the files that make distances."""
    content = hashlib.sha256(FORMAT)
    _add_numbers(content, grid)
    sources = {kind: _source(kind) for kind in {type(part.shape) for part in parts}}
    for part in parts:
        content.update(f"{part.shape.kind} {part.role};".encode() + sources[type(part.shape)])
        _add_numbers(content, [part.margin_m, *part.shape.content()])
    return content.hexdigest()


def _add_numbers(content: hashlib._Hash, numbers: Sequence[ArrayLike]) -> None:
    for number in numbers:
        array = np.ascontiguousarray(number, dtype="<f8")
        content.update(f"{np.shape(number)};".encode() + array.tobytes())


def _source(shape: type[Shape]) -> bytes:
    """Hash of the file that defines a kind: who writes one changes its distances now and then."""
    file = getattr(sys.modules.get(shape.__module__), "__file__", None)
    return hashlib.sha256(Path(file).read_bytes() if file else b"").digest()
