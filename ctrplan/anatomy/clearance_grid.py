"""Obstacles and lumens as one signed-distance field: the clearance available to a point, on a grid.

Exact queries cost microseconds, and most nodes of a grid lie far from the surface. Distances are therefore exact on a
grid COARSEST times coarser; each halving of the step interpolates and then replaces by exact values all nodes within
FAR coarse steps S. What stays interpolated is at least (FAR - sqrt(3) / 2) S from the surface, since distance is
1-Lipschitz and each node within sqrt(3) / 2 S of what it is interpolated from. On either side of the surface distance
is a minimum of cones |x - p| with second derivatives of at most 1 / |x - p|, so that interpolation exceeds the unsigned
distance by at most 3 S^2 / (8 d): below 2 % of d. It can fall short by sqrt(3) / 2 S, on the medial axis.

The core samples the field at every point of every shape; the certificate uses `exact_clearance` instead. What the parts
mean together stands in `ctrplan.anatomy.parts`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.anatomy.parts import CHUNK_POINTS, AnatomyPart, combined_clearance, surface_distance
from ctrplan.anatomy.shape import PartShape
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import Progress, part_of
from ctrplan.errors import InputError
from ctrplan.storage import cache as field_cache

Grid = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SignedDistanceField:
    """Clearance on a regular grid: node (i, j, k) stands at origin_m + spacing_m * (i, j, k).

    origin_m (3,) [m]; values_m (nx, ny, nz) float32, C order [m], see `exact_clearance` for the quantity;
    parts: what it was built from, for measuring its error.
    """

    origin_m: Array
    spacing_m: float
    values_m: Grid
    parts: tuple[AnatomyPart, ...] = field(default=(), repr=False)

    @property
    def upper_m(self) -> Array:
        """The corner (3,) opposite to origin_m [m]."""
        return np.asarray(self.origin_m + self.spacing_m * (np.array(self.values_m.shape) - 1))

    def sample(self, points_m: ArrayLike) -> Array:
        """Trilinear clearance (K,) [m] at points (K, 3) [m].

        Outside the grid: the value at the nearest point of the grid's box minus the distance to it, a lower bound since
        clearance is 1-Lipschitz.
        """
        points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
        origin = np.ascontiguousarray(self.origin_m, dtype=np.float64)
        grid = _model.Grid(
            values=self.values_m, origin=origin, spacing=self.spacing_m, R_AB=np.eye(3), p_AB=np.zeros(3)
        )
        return np.asarray(grid.sample(points))


COARSEST = 4  # grid steps of the coarsest level, a power of two; node counts are a multiple of it plus one
FAR = 6.0


def grid_distance(
    part: AnatomyPart, origin_m: Array, spacing_m: float, shape: tuple[int, int, int], report: Progress
) -> Grid:
    """Distance (nx, ny, nz) to the part's surface at the nodes origin_m + spacing_m (i, j, k) [m], negative within it.

    report: called with the fraction done.
    """
    step = COARSEST
    values = np.empty(tuple((n - 1) // step + 1 for n in shape), dtype=np.float32)
    _fill(values, np.inf, part, origin_m, spacing_m * step, None)
    while step > 1:
        limit, step = FAR * spacing_m * step, step // 2
        values = _halved(values)
        _fill(values, limit, part, origin_m, spacing_m * step, report if step == 1 else None)
    return values


def _fill(values: Grid, limit: float, part: AnatomyPart, origin: Array, step: float, report: Progress | None) -> None:
    """Replace by exact distances: all values, or with a finite `limit` [m] those within it that are interpolated."""
    planes = max(1, CHUNK_POINTS // values[0].size)
    for first in range(0, len(values), planes):
        block = values[first : first + planes]
        if np.isfinite(limit):
            wanted = np.abs(block) <= limit
            wanted[first % 2 :: 2, ::2, ::2] = False  # nodes of the coarse level are exact already
            node = np.argwhere(wanted)
        else:
            node = np.indices(block.shape).reshape(3, -1).T
        if len(node):
            points = origin + step * (node + (first, 0, 0))
            block[tuple(node.T)] = surface_distance(part, np.ascontiguousarray(points))
        if report:
            report(min(1.0, (first + planes) / len(values)))


def _halved(coarse: Grid) -> Grid:
    """Trilinear interpolation to half the grid step: (n, ...) nodes become (2 n - 1, ...)."""
    fine = np.empty(tuple(2 * n - 1 for n in coarse.shape), dtype=np.float32)
    fine[::2, ::2, ::2] = coarse
    fine[1::2, ::2, ::2] = (coarse[:-1] + coarse[1:]) / 2
    fine[:, 1::2, ::2] = (fine[:, :-1:2, ::2] + fine[:, 2::2, ::2]) / 2
    fine[:, :, 1::2] = (fine[:, :, :-1:2] + fine[:, :, 2::2]) / 2
    return fine


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
    `ctrplan.anatomy.clearance_grid`.
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


def _source(shape: type[PartShape]) -> bytes:
    """Hash of the file that defines a kind: who writes one changes its distances now and then."""
    file = getattr(sys.modules.get(shape.__module__), "__file__", None)
    return hashlib.sha256(Path(file).read_bytes() if file else b"").digest()
