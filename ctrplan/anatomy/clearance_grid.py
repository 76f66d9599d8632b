"""Obstacles and lumens as one signed-distance field: the clearance available to a point, on a grid, or in bricks of one
lattice that belong to the anatomy: any base pose, any robot.

Exact queries cost microseconds, and most nodes of a grid lie far from the surface. Distances are therefore exact on a
grid COARSEST times coarser; each halving of the step interpolates and then replaces by exact values all nodes within
FAR coarse steps S. What stays interpolated is at least (FAR - sqrt(3) / 2) S from the surface, since distance is
1-Lipschitz and each node within sqrt(3) / 2 S of what it is interpolated from. On either side of the surface distance
is a minimum of cones |x - p| with second derivatives of at most 1 / |x - p|, so that interpolation exceeds the unsigned
distance by at most 3 S^2 / (8 d): below 2 % of d. It can fall short by sqrt(3) / 2 S, on the medial axis.

The lattice stands in the anatomy's frame, at the lower corner of the lumens' box, else at its origin. Bricks are kept
on disk one by one, and a field is put together of those it needs. Where two bricks meet they hold the same nodes.
Bricks beyond reach are neither built nor needed.

The core samples the field at every point of every shape; the certificate uses `exact_clearance` instead. What the parts
mean together stands in `ctrplan.anatomy.parts`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.anatomy.parts import (
    CHUNK_POINTS,
    FEW,
    AnatomyPart,
    combined_clearance,
    lumens_box,
    nearby,
    surface_distance,
)
from ctrplan.anatomy.shape import PartShape
from ctrplan.base.arrays import Array, read_only
from ctrplan.base.long_work import Progress, cores
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
DEFAULT_NODES, MAX_DEFAULT_NODES = 2e6, 8e6


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
    if (box := lumens_box(parts)) is not None:
        lower, upper = np.clip(box[0], lower, upper), np.clip(box[1], lower, upper)
    return lower, upper


def default_spacing_m(lower_m: ArrayLike, upper_m: ArrayLike) -> float:
    """Spacing [m] between 0.5 and 1 mm that gives some 2 million nodes; above 1 mm only beyond 8 million nodes."""
    extent = np.maximum(np.asarray(upper_m, dtype=np.float64) - np.asarray(lower_m, dtype=np.float64), 1e-3)
    volume = float(extent.prod())
    spacing = float(np.clip(np.cbrt(volume / DEFAULT_NODES), 0.5e-3, 1e-3))
    return max(spacing, float(np.cbrt(volume / MAX_DEFAULT_NODES)))


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


BRICK = 48  # cells along an edge: 0.5 MB
BLOCK = 12  # cells along an edge of what is asked for the same few of many parts, a multiple of COARSEST
RUNGS = 3  # spacings to a factor of two, so that robots of much the same reach share them
FINEST_M = 0.5e-3
ROUNDING = 1e-9  # of a cell
AT_ONCE = 64  # bricks held in memory, and kept together

Index = tuple[int, int, int]


def shared_spacing_m(parts: Sequence[AnatomyPart], reach_m: float) -> float:
    """Spacing [m] for an anatomy and robots of about that reach, whatever their base; see `default_spacing_m`."""
    extents = [np.array([2 * reach_m, 2 * reach_m, reach_m])]
    if (box := lumens_box(parts)) is not None:
        extents.append(box[1] - box[0])
    spacing = min(default_spacing_m(np.zeros(3), extent) for extent in extents)
    return float(FINEST_M * 2 ** (round(RUNGS * np.log2(spacing / FINEST_M)) / RUNGS))


def anatomy_field(
    parts: Sequence[AnatomyPart],
    lower_m: ArrayLike,
    upper_m: ArrayLike,
    spacing_m: float,
    *,
    base_position_m: ArrayLike,
    reach_m: float,
    progress: Progress | None = None,
) -> SignedDistanceField:
    """Clearance on the lattice's nodes around the box lower_m (3,) to upper_m (3,) [m], which `field_bounds` gives.

    Beyond reach_m [m] of base_position_m (3,) [m], anatomy's frame, it may say -reach_m: no robot gets there.
    progress: called with the fraction done, 0 to 1. Accuracy: `ctrplan.anatomy.clearance_grid`.
    """
    lattice = Lattice.of(parts, spacing_m)
    first, last = lattice.nodes_around(np.asarray(lower_m, np.float64), np.asarray(upper_m, np.float64))
    values: Grid = np.full(last - first + 1, -reach_m, dtype=np.float32)
    base = np.asarray(base_position_m, dtype=np.float64)
    needed = [index for index in lattice.bricks(first, last) if lattice.distance_m(index, base) <= reach_m]
    for index, brick in _bricks(parts, lattice, needed, progress):
        start = np.array(index) * BRICK
        low, high = np.maximum(start, first), np.minimum(start + brick.shape - 1, last)
        values[_box(low - first, high - first)] = brick[_box(low - start, high - start)]
    return SignedDistanceField(lattice.node_m(first), spacing_m, values, tuple(parts))


@dataclass(frozen=True, eq=False)
class Lattice:
    """Nodes origin_m + spacing_m (i, j, k) [m]; brick (a, b, c) begins at node BRICK (a, b, c)."""

    origin_m: Array  # (3,)
    spacing_m: float
    lowest: Array  # (3,) first node and
    highest: Array  # (3,) last node that may matter: those of the lumens' box, else infinite

    @classmethod
    def of(cls, parts: Sequence[AnatomyPart], spacing_m: float) -> Lattice:
        """The lattice of an anatomy."""
        box = lumens_box(parts)
        if box is None:
            return cls(np.zeros(3), spacing_m, np.full(3, -np.inf), np.full(3, np.inf))
        cells = np.ceil(np.maximum((box[1] - box[0]) / (COARSEST * spacing_m) - ROUNDING, 1.0)) * COARSEST
        return cls(box[0], spacing_m, np.zeros(3), cells)

    def node_m(self, node: NDArray[np.int_]) -> Array:
        """Where a node (3,) stands [m]."""
        return np.asarray(self.origin_m + self.spacing_m * node)

    def nodes_around(self, lower_m: Array, upper_m: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """The first and the last node (3,), (3,) of the cells that hold a box [m], at least one along each axis."""
        first = np.floor((lower_m - self.origin_m) / self.spacing_m + ROUNDING)
        first = np.clip(first, self.lowest, self.highest - 1)
        last = np.ceil((upper_m - self.origin_m) / self.spacing_m - ROUNDING)
        last = np.maximum(np.minimum(last, self.highest), first + 1)
        return first.astype(np.int64), last.astype(np.int64)

    def bricks(self, first: NDArray[np.int_], last: NDArray[np.int_]) -> Iterator[Index]:
        """Bricks that hold the cells between two nodes."""
        ranges = [range(a // BRICK, (b - 1) // BRICK + 1) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
        return product(*ranges)  # type: ignore[return-value]  # of three ranges

    def shape(self, index: Index) -> Index:
        """Nodes of a brick along each axis; fewer where the lumens' box ends."""
        nx, ny, nz = np.minimum(BRICK, self.highest - np.array(index) * BRICK).astype(int) + 1
        return int(nx), int(ny), int(nz)

    def distance_m(self, index: Index, point_m: Array) -> float:
        """From a brick to a point (3,) [m]; 0 within it."""
        lower = self.node_m(np.array(index) * BRICK)
        upper = lower + self.spacing_m * (np.array(self.shape(index)) - 1)
        return float(np.linalg.norm(point_m - np.clip(point_m, lower, upper)))


def _bricks(
    parts: Sequence[AnatomyPart], lattice: Lattice, needed: list[Index], progress: Progress | None
) -> Iterator[tuple[Index, Grid]]:
    """Each brick needed, from disk or built and then kept."""
    anatomy = content_key(parts, lattice.origin_m, lattice.spacing_m)

    def brick(index: Index) -> tuple[str, Grid, bool]:
        key = hashlib.sha256(f"{anatomy} {BRICK} {index}".encode()).hexdigest()
        kept = field_cache.load(key, lattice.shape(index))
        return (key, _build(parts, lattice, index), True) if kept is None else (key, kept, False)

    with ThreadPoolExecutor(cores()) as pool:
        for first in range(0, len(needed), AT_ONCE):
            some, built = needed[first : first + AT_ONCE], dict[str, Grid]()
            for done, (index, (key, values, is_new)) in enumerate(
                zip(some, pool.map(brick, some), strict=True), first + 1
            ):
                if is_new:
                    built[key] = values
                if progress:
                    progress(done / len(needed))
                yield index, values
            field_cache.store_all(built)


def _build(parts: Sequence[AnatomyPart], lattice: Lattice, index: Index) -> Grid:
    start, shape = np.array(index) * BRICK, lattice.shape(index)
    centre, radius = _ball(lattice, start, shape)
    (parts,) = nearby(parts, centre[None], radius)
    if len(parts) <= FEW:
        return _clearance(parts, lattice, start, shape)
    values: Grid = np.empty(shape, dtype=np.float32)
    blocks = list(product(*(range(0, size - 1, BLOCK) for size in shape)))
    shapes = [(np.minimum(np.array(shape) - 1 - block, BLOCK) + 1).astype(int) for block in blocks]
    balls = [_ball(lattice, start + np.array(block), size) for block, size in zip(blocks, shapes, strict=True)]
    matter = nearby(parts, np.array([middle for middle, _ in balls]), max(radius for _, radius in balls))
    for block, size, few in zip(blocks, shapes, matter, strict=True):
        nx, ny, nz = size.tolist()
        values[_box(np.array(block), np.array(block) + size - 1)] = _clearance(
            few, lattice, start + np.array(block), (nx, ny, nz)
        )
    return values


def _clearance(parts: Sequence[AnatomyPart], lattice: Lattice, start: NDArray[np.int_], shape: Index) -> Grid:
    """At the nodes from `start` on."""
    origin = lattice.node_m(start)

    def distance(part: AnatomyPart) -> NDArray[np.floating]:
        if part.shape.is_formula:
            return surface_distance(part, origin + _nodes_m(lattice.spacing_m, shape)).reshape(shape)
        return grid_distance(part, origin, lattice.spacing_m, shape, lambda _: None)

    return combined_clearance(parts, distance).astype(np.float32, copy=False)


@lru_cache(maxsize=2)
def _nodes_m(spacing_m: float, shape: Index) -> Array:
    """(K, 3) [m] nodes of a brick as they lie from its first one; most bricks have the same."""
    return read_only(spacing_m * np.indices(shape).reshape(3, -1).T)


def _ball(lattice: Lattice, start: NDArray[np.int_], shape: ArrayLike) -> tuple[Array, float]:
    """Centre (3,) and radius [m] around so many nodes, those that coarse levels ask for included."""
    half = lattice.spacing_m * (np.asarray(shape) - 1) / 2
    return lattice.node_m(start) + half, float(np.linalg.norm(half)) * (1 + 1e-9)


def _box(first: NDArray[np.int_], last: NDArray[np.int_]) -> tuple[slice, slice, slice]:
    """Nodes from first (3,) to last (3,), both included."""
    i, j, k = (slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))
    return i, j, k
