"""Walks of a path and many bounds at once: how densely, until what, in chunks with progress between them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import Flag, Number, checked, require
from ctrplan.base.arrays import Array, numbers
from ctrplan.base.long_work import Progress
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Status

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Accuracy, Bounds

SHORTEST_STEP, LONGEST_STEP = 1e-6, 100.0  # rad or m; with shorter ones a walk would not end
ANY = Number(-np.inf, np.inf)


def no_shapes() -> Array:
    """(0, 0) of a walk that keeps no shapes."""
    return np.empty((0, 0))


@shown
@dataclass(frozen=True, eq=False)
class PathSamples:
    """What `Mechanics.check_path` found at each of the K configurations it reached."""

    segment: NDArray[np.int_]  # (K,) leg the sample lies on
    fraction: Array  # (K,) of that leg
    position_m: Array  # (K,) bound of the tip
    tangent_rad: Array  # (K,)
    stability: Array  # (K,)
    max_strain: Array  # (K,)
    clearance_m: Array  # (K,) smallest over the shapes looked up, outer radius taken off; 1e9 in free space
    motion_m: Array  # (K,) largest displacement of a body point of any of these shapes since the sample before
    status: NDArray[np.int_]  # (K,) values of Status
    tip_m: Array  # (K, 3) frictionless
    tip_tangent: Array  # (K, 3)
    solves: NDArray[np.int_]  # (K,) configurations solved since the sample before, those not accepted among them
    corner_tip_m: Array  # (K, C, 3) of the corner shapes in the order of Bound.corners; C = 0 when looked up
    # Friction states (K, P) whose shape, interpolated, is nearer than those solved, if asked for; NaN where none is
    nearest_phi: Array = field(default_factory=no_shapes)
    # Of every shape, frictionless first, if asked for:
    shape_stability: Array = field(default_factory=no_shapes)  # (K, 1 + C) friction included
    shape_max_strain: Array = field(default_factory=no_shapes)  # (K, 1 + C)
    bodies: tuple[Array, ...] = ()  # per sample: (N, 4) points of all shapes and their outer radius [m]

    def at_end(self) -> PathSamples:
        """The last sample alone, without bodies."""
        return replace(self.at_rows([-1]), bodies=())

    def at_rows(self, rows: Sequence[int] | NDArray[np.intp]) -> PathSamples:
        """Some of the samples; their motion is still that since the sample before."""
        kept = {entry.name: getattr(self, entry.name)[rows] for entry in fields(self) if entry.name != "bodies"}
        return PathSamples(**kept, bodies=tuple(self.bodies[row] for row in rows) if self.bodies else ())

    def at_given(self, count: int) -> PathSamples | None:
        """The samples at the `count` configurations that were walked through, motion in between summed up.

        None where the walk ended before the last of them, or there.
        """
        place = self.segment + self.fraction
        rows = np.flatnonzero(place == np.round(place))
        if len(rows) < count or self.status[-1] >= Status.UNSTABLE:
            return None
        motion = np.add.reduceat(self.motion_m, np.append(0, rows[:-1] + 1))
        return replace(self.at_rows(rows), motion_m=motion)


@checked(
    rotation_rad=Number(SHORTEST_STEP, LONGEST_STEP, "rad"),
    translation_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    motion_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    near_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    point_spacing_m=Number(SHORTEST_STEP, LONGEST_STEP, "m"),
    between_corners=Flag(),
)
@dataclass(frozen=True)
class PathDensity:
    """How densely a path is walked: longest joint steps, largest motion of a body point between samples.

    Where `near_m` is below `motion_m`, a step may move a body point no farther than the clearance it starts with, or
    `near_m`: clearances are 1-Lipschitz, so that an obstacle is noticed before it is passed. Shapes between the corners
    of friction are interpolated, multilinearly with a parabola that takes the corners' mean to the frictionless shape:
    a body that friction moves past an obstacle from one corner to another touches it in neither.
    """

    rotation_rad: float = 0.18
    translation_m: float = 5e-3
    motion_m: float = 20e-3
    near_m: float = 2e-3
    point_spacing_m: float = 1.5e-3  # between the points of a shape that are looked up in the field
    between_corners: bool = False  # whether shapes in friction states between the corners are looked up, too


SAME_TIP_M = 1e-5  # between solutions of one equilibrium, which agree to 1e-7; others are 0.1 mm away and more


class KnownLegs:
    """Walks of polylines in which no leg is walked twice: paths of a local search have most of theirs in common.

    The core's steps depend on a leg alone, so that samples are those of a walk of the whole. A leg walked by itself
    begins from a shape solved afresh; where that is another equilibrium than the one that the leg before leads to, the
    path is walked as a whole. For one thread at a time.
    """

    def __init__(self, walk: Callable[[Array], PathSamples], is_broken: Callable[[PathSamples], bool]) -> None:
        """`walk` stops where a limit is broken, which `is_broken` tells from its last sample."""
        self._walk, self._is_broken = walk, is_broken
        self._legs: dict[tuple[bytes, bytes], PathSamples] = {}

    def along(self, corners: Array) -> PathSamples:
        """Samples along a polyline (K, m), up to the first that breaks a limit."""
        ends = [row.tobytes() for row in corners]
        legs = list(pairwise(ends))
        unknown = [k for k, leg in enumerate(legs) if leg not in self._legs]
        while unknown:
            first = last = unknown[0]
            while last + 1 in unknown:
                last += 1
            samples = self._walk(corners[first : last + 2])
            is_broken = self._is_broken(samples)
            for k in range(int(samples.segment[-1]) + 1 - is_broken):
                self._legs[legs[first + k]] = _leg(samples, k)
            if is_broken:
                before = [self._legs[leg] for leg in legs[:first]]
                return (_joined([*before, samples]) if len(samples.segment) > 1 else None) or self._walk(corners)
            unknown = [k for k in unknown if k > last]
        return (_joined([self._legs[leg] for leg in legs]) if legs else None) or self._walk(corners)


def _leg(samples: PathSamples, k: int) -> PathSamples:
    """The samples of leg k, from its beginning to its end, as those of a walk of it alone."""
    on_leg = np.flatnonzero(samples.segment == k)
    rows = on_leg if k == 0 else np.concatenate([on_leg[:1] - 1, on_leg])
    leg = samples.at_rows(rows)
    fraction = np.where(np.arange(len(rows)) > 0, leg.fraction, 0.0)
    return replace(leg, segment=np.zeros_like(leg.segment), fraction=fraction)


def _joined(parts: Sequence[PathSamples]) -> PathSamples | None:
    """Walks that go on from one another as one; None where the equilibria at their ends differ."""
    kept, legs = [parts[0]], int(parts[0].segment[-1]) + 1
    for part in parts[1:]:
        a, b = (np.vstack([x.tip_m[[row]], x.corner_tip_m[row]]) for x, row in ((kept[-1], -1), (part, 0)))
        if not np.linalg.norm(a - b, axis=1).max() < SAME_TIP_M:
            return None
        kept.append(replace(part.at_rows(np.arange(1, len(part.segment))), segment=part.segment[1:] + legs))
        legs += int(part.segment[-1]) + 1
    names = [entry.name for entry in fields(PathSamples) if entry.name != "bodies"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in kept]) for name in names}
    return PathSamples(**columns)


@checked(stability=ANY, max_strain=ANY, clearance_m=ANY)
@dataclass(frozen=True)
class PathLimits:
    """A walk ends at the first sample that breaks one of these."""

    stability: float = -np.inf
    max_strain: float = np.inf
    clearance_m: float = -np.inf


@shown
@dataclass(frozen=True, eq=False)
class Field:
    """A grid of clearances [m] in the anatomy's frame A, and where the robot's base B stands in it."""

    values_m: NDArray[np.float32]  # (nx, ny, nz)
    origin_m: Array  # (3,)
    spacing_m: float
    R_AB: Array  # (3, 3)
    p_AB: Array  # (3,)

    def __post_init__(self) -> None:
        """Takes what can be read as such arrays. Raises InputError for other shapes, or numbers that say nothing."""
        for key, shape, kind in (
            ("values_m", (None,) * 3, np.float32),
            ("origin_m", (3,), np.float64),
            ("R_AB", (3, 3), np.float64),
            ("p_AB", (3,), np.float64),
        ):
            values = getattr(self, key)
            if not isinstance(values, np.ndarray) or values.dtype != kind:  # large grids are not copied
                values = numbers(values, f"field.{key}").astype(kind)
            values = np.ascontiguousarray(values)
            fits = values.ndim == len(shape) and all(b in (None, a) for a, b in zip(values.shape, shape, strict=True))
            if not fits or values.size == 0:
                wanted = "(nx, ny, nz)" if shape[0] is None else str(shape)
                raise InputError(f"must have shape {wanted}, not {values.shape}", key=f"field.{key}")
            if kind is np.float64 and not np.all(np.isfinite(values)):
                raise InputError("must be finite", key=f"field.{key}")
            object.__setattr__(self, key, values)
        require("field.spacing_m", self.spacing_m, Number(0, 1e3, "m", above=True))


CHUNK = 256  # configurations of three tubes per call into the core, which spreads them over threads: half a second
FEWEST = 16  # which still keep every thread busy
TASK = 64  # configurations per task of an executor: long against sending it, short enough to share out evenly


class ManyBounds(Protocol):
    """What `Mechanics` answers for many configurations."""

    def bound_many(self, theta_b: Array, l_b: Array, *, accuracy: Accuracy, threads: int) -> Bounds:
        """Bounds of (K, n) base rotations [rad] and translations [m]."""


def rows_in_a_chunk(n: int, accuracy: Accuracy) -> int:
    """Configurations of n tubes between two reports of progress, at which Ctrl-C is noticed as well."""
    corners = max(1.0, 2.0 ** (n - 3) * n / 3)  # four at a time; a node has 5 n - 4 unknowns
    finer = {"search": 1, "certificate": 4, "exact": 16}[accuracy]
    return max(FEWEST, int(CHUNK / (corners * finer)))


def bounds_in_chunks(
    solve: Callable[[Array, Array], Bounds], theta_b: Array, l_b: Array, rows: int, progress: Progress | None
) -> Bounds:
    """`solve` for (K, n), (K, n), `rows` after `rows` in the calling thread."""
    parts = []
    for chunk in chunks(len(theta_b), rows):
        parts.append(solve(theta_b[chunk], l_b[chunk]))
        if progress:
            progress(min(1.0, chunk.stop / max(len(theta_b), 1)))
    return join(parts)


def bounds_on_executor(
    executor: Executor,
    mechanics: ManyBounds,
    theta_b: Array,
    l_b: Array,
    accuracy: Accuracy,
    threads: int,
    progress: Progress | None,
) -> Bounds:
    """`mechanics.bound_many` for (K, n), (K, n) as tasks on an executor, each on `threads` threads (0: one)."""
    content = pickle.dumps(mechanics)
    tasks = [(content, theta_b[chunk], l_b[chunk], accuracy, max(threads, 1)) for chunk in chunks(len(theta_b), TASK)]
    return join(run(executor, _solve_chunk, tasks, progress))


def run(
    executor: Executor, work: Callable[..., Bounds], tasks: Sequence[Sequence[Any]], progress: Progress | None
) -> list[Bounds]:
    """work(*task) of every task, in order. Uses nothing but `submit`, `result` and `cancel`, which all executors have.

    What is not done yet is called off when a task or `progress` raises, Ctrl-C included. Raises InputError where the
    executor takes no tasks, because it was shut down or its workers died.
    """
    futures: list[Any] = []
    results: list[Bounds] = []
    try:
        for task in tasks:
            futures.append(_submitted(executor, work, task))
        for done, future in enumerate(futures, start=1):
            results.append(future.result())
            if progress:
                progress(done / len(futures))
    finally:
        for future in futures[len(results) :]:
            future.cancel()
    return results


def _submitted(executor: Executor, work: Callable[..., Bounds], task: Sequence[Any]) -> Any:
    try:
        return executor.submit(work, *task)
    except RuntimeError as error:  # of all executors of concurrent.futures
        raise InputError(f"takes no tasks ({error})", key="executor", value=executor) from error


def join(parts: Sequence[Bounds]) -> Bounds:
    """One table of all rows."""
    if len(parts) == 1:
        return parts[0]
    columns: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in columns_of(parts[0])}
    return type(parts[0])(**columns)


def scattered(solved: Bounds, refused: NDArray[np.bool_]) -> Bounds:
    """Bounds of the rows that are not refused, and between them those (K,) that are, NaN and REFUSED."""

    def column(values: Any) -> Any:
        empty = Status.REFUSED if values.dtype.kind == "i" else np.nan
        result = np.full((len(refused), *values.shape[1:]), empty, dtype=values.dtype)
        result[~refused] = values
        return result

    return type(solved)(**{name: column(getattr(solved, name)) for name in columns_of(solved)})


def columns_of(bounds: Bounds) -> list[str]:
    """What a table has K of: all but its gradient, which is made of the whole."""
    return [each.name for each in fields(bounds) if each.name != "gradient"]


def chunks(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` rows; at least one, which is empty if there are none."""
    return [slice(first, min(first + size, count)) for first in range(0, max(count, 1), size)]


def _solve_chunk(content: bytes, theta_b: Array, l_b: Array, accuracy: Accuracy, threads: int) -> Bounds:
    return _rebuilt(content).bound_many(theta_b, l_b, accuracy=accuracy, threads=threads)


@lru_cache(maxsize=4)
def _rebuilt(content: bytes) -> ManyBounds:
    """The model in this process, built once from the numbers it was given: the workspaces of its solvers are reused."""
    mechanics: ManyBounds = pickle.loads(content)
    return mechanics
