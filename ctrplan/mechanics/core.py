"""Typed face of the mechanics core: shapes, friction states, bounds. The only importer of the compiled module.

Models and conventions: docs/model.md. Joint arrays are outermost tube first; SI units; the world frame stands at the
front plate, z along insertion, s = 0 at the plate.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

import ctrplan._model as _model
from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.errors import InputError
from ctrplan.mechanics.batch import bounds_in_chunks, bounds_on_executor, check_helpers, rows_in_a_chunk
from ctrplan.mechanics.core_arrays import (
    bounds_from_core,
    joint_row,
    joint_rows,
    joint_table,
    numbers,
    path_samples,
    shape_from_core,
    tube_numbers,
    walk_arguments,
    worst,
)
from ctrplan.mechanics.derivative_names import directions
from ctrplan.mechanics.loads import Loads
from ctrplan.mechanics.nesting import nests
from ctrplan.mechanics.shapes import Bound, Bounds, Shape, Status, Tips, TubeShape
from ctrplan.mechanics.walk import SHORTEST_STEP, Field, PathDensity, PathLimits, PathSamples

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ctrplan.mechanics.history import HistoryOptions
    from ctrplan.mechanics.tube import Tube

__all__ = [
    "Accuracy",
    "Array",
    "Bound",
    "Bounds",
    "Field",
    "Mechanics",
    "PathDensity",
    "PathLimits",
    "PathSamples",
    "Shape",
    "Status",
    "Tips",
    "TubeShape",
    "kernel_name",
]

Accuracy = Literal["search", "certificate", "exact"]
"""Mesh error of a tip on the Table III grid: 0.3, 0.05 mm; "exact" also drops the first order in the clearance."""
MOST_THREADS = 1024
_LEVELS: tuple[Accuracy, ...] = get_args(Accuracy)


class Mechanics:
    """A robot's compiled model. Thread-safe: concurrent calls use separate workspaces; the GIL is released."""

    def __init__(
        self, tubes: Sequence[Tube], clearance_m: ArrayLike, friction: ArrayLike, loads: Loads | None = None
    ) -> None:
        """`clearance_m` (n - 1,) radial [m]; `friction` (n - 1,) Coulomb coefficients. Raises InputError."""
        self.n = len(tubes)
        if not tubes:
            raise InputError("must be at least one tube", key="tubes")
        gaps, coefficients = self._pairs(clearance_m, "clearance_m"), self._pairs(friction, "friction")
        loads = loads or Loads()
        self._given = (tuple(tubes), gaps.copy(), coefficients.copy(), loads)
        for i, tube in enumerate(tubes, start=1):
            if not tube.poisson_ratio > -1:
                raise InputError("must be above -1", key=f"tube.{i}.poisson_ratio", value=tube.poisson_ratio)
            if not 0 <= tube.inner_diameter_m < tube.outer_diameter_m:
                rule = f"must be from 0 to below the outer diameter of {tube.outer_diameter_m:g} m"
                raise InputError(rule, key=f"tube.{i}.inner_diameter_m", value=tube.inner_diameter_m, unit="m")
        with input_errors():
            self._model = _model.Model(
                [tube_numbers(tube) for tube in tubes],
                [
                    [[s.length_m, s.curvature_x_per_m, s.curvature_y_per_m, s.gradient] for s in tube.sections]
                    for tube in tubes
                ],
                [
                    [gap, mu, outer.inner_diameter_m / 2, inner.outer_diameter_m / 2]
                    for gap, mu, outer, inner in zip(
                        gaps.tolist(), coefficients.tolist(), tubes[:-1], tubes[1:], strict=True
                    )
                ],
                [list(loads.tip_force_N), list(loads.tip_moment_Nm), list(loads.gravity_m_s2)],
            )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the numbers it was made of, and compiled again where it is read."""
        return type(self), self._given

    def zero_clearance(self, theta_b: ArrayLike, l_b: ArrayLike) -> Shape:
        """The standard model (2)-(3) at base rotations (n,) [rad] and translations (n,) [m]."""
        with input_errors():
            return shape_from_core(self._model.zero_clearance(self._row(theta_b), self._row(l_b)))

    def solve(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        phi: ArrayLike = 0.0,
        *,
        accuracy: Accuracy = "search",
        refinement: float = 1.0,
    ) -> Shape:
        """Equilibrium (37) with clearance (14) and friction (38), (41), phi taking the place of eta.

        phi: scalar or (n - 1,), in [-1, 1], share of the Coulomb limit; +1: inner tube last rotated counterclockwise.
        refinement: elements and contact spacings are so many times shorter than `accuracy` makes them, 0.25 to 16.
        """
        if not 0.25 <= refinement <= 16:
            raise InputError("must lie in [0.25, 16]", key="refinement", value=refinement)
        state = numbers(phi, "phi")
        if state.ndim == 0:
            state = np.full(self.n - 1, state)
        state = self._pairs(state, "phi")
        if not np.all(np.abs(state) <= 1):
            raise InputError("must lie in [-1, 1]", key="phi", value=worst(state))
        with input_errors():
            return shape_from_core(
                self._model.solve(
                    self._row(theta_b), self._row(l_b), np.ascontiguousarray(state), _level(accuracy), refinement
                )
            )

    def bound(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> Bound:
        """Frictionless solution, every corner phi in {-1, 1}^(n-1), and the largest deviations between them."""
        with input_errors():
            raw = self._model.bound(self._row(theta_b), self._row(l_b), _level(accuracy))
        return Bound(
            position_m=raw["position"],
            tangent_rad=raw["tangent"],
            frictionless=shape_from_core(raw["frictionless"]),
            corners=tuple(shape_from_core(corner) for corner in raw["corners"]),
            envelope_m=raw["envelope"],
            worst_corner=raw["worst_corner"],
        )

    def bound_many(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        threads: int = 0,
        progress: Progress | None = None,
        executor: Executor | None = None,
    ) -> Bounds:
        """Bounds of K configurations, theta_b (K, n), l_b (K, n); threads = 0 uses every core.

        `progress` is told the finished share between chunks of half a second or so. With an `executor`, any that has
        the interface of concurrent.futures, chunks are its tasks, by default on one thread each. Results are the same.
        """
        (thetas, ls), level, cores = self._configurations(theta_b, l_b), _level(accuracy), _checked(threads)
        check_helpers(progress, executor)
        rows = rows_in_a_chunk(self.n, accuracy)
        if executor is not None or len(thetas) > rows:  # nothing is solved before all is known to be well-formed
            self._refuse(thetas, ls)
        if executor is not None:
            return bounds_on_executor(executor, self, thetas, ls, accuracy, threads, progress)

        def solve(theta_b: Array, l_b: Array) -> Bounds:
            with input_errors():
                return bounds_from_core(np.asarray(self._model.bound_many(theta_b, l_b, level, cores)))

        return bounds_in_chunks(solve, thetas, ls, rows, progress)

    def first_refused(self, theta_b: ArrayLike, l_b: ArrayLike) -> tuple[int, str] | None:
        """The first of K configurations (K, n), (K, n) that is malformed or does not nest, and why; None if none is."""
        thetas, ls = self._configurations(theta_b, l_b)
        sound = nests(self._given[0], ls) & np.all(np.abs(thetas) < 1e5, axis=1) & np.all(np.isfinite(ls), axis=1)
        for k in np.flatnonzero(~sound).tolist():  # the core has the last word
            try:
                self._model.zero_clearance(thetas[k], ls[k])
            except _model.InvalidInput as refusal:
                return k, str(refusal)
        return None

    def tips(self, theta_b: ArrayLike, l_b: ArrayLike, *, threads: int = 0) -> tuple[Array, Array, NDArray[np.int_]]:
        """Zero-clearance tips (K, 3) [m], tangents (K, 3) and status (K,) of K configurations."""
        with input_errors():
            table: Array = np.asarray(self._model.tips(self._rows(theta_b), self._rows(l_b), _checked(threads)))
        return table[:, :3], table[:, 3:6], table[:, 6].astype(int)

    def zero_clearance_rooms(
        self, theta_b: ArrayLike, l_b: ArrayLike, field: Field, *, spacing_m: float = 4e-3, threads: int = 0
    ) -> tuple[Array, Array]:
        """Clearances (K,) [m] of zero-clearance shapes at points `spacing_m` apart, and tips (K, 3) [m].

        The outer radius of what is there is taken off; -inf without a stable solution. A hint, some 30 times cheaper
        than a bound: friction and clearance between tubes move a shape by millimetres. Raises InputError.
        """
        if not spacing_m >= SHORTEST_STEP:
            raise InputError(f"must be at least {SHORTEST_STEP:g} m", key="spacing_m", value=spacing_m, unit="m")
        grid = walk_arguments(field, PathDensity(), PathLimits())[:5]
        with input_errors():
            table: Array = np.asarray(
                self._model.rooms(self._rows(theta_b), self._rows(l_b), *grid, spacing_m, _checked(threads))
            )
        return table[:, 0], table[:, 1:]

    def tips_with_friction(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        phi: ArrayLike,
        *,
        parameters: Sequence[str] = (),
        threads: int = 0,
        accuracy: Accuracy = "search",
    ) -> Tips:
        """Tips of K friction states, theta_b, l_b (K, n), phi (K, n - 1), and their derivatives by P parameters.

        Parameters are named as in `ctrplan.mechanics.derivative_names`. Rows of one configuration are solved
        faster when they follow each other. Derivatives are those of the discretised equations; NaN where a
        solve FAILED, where a collar, joint or tip would pass another one, by the compliance of a shaft that is
        rigid, and where a load is so large that its own change does not settle. Collars, joints and tips that
        coincide are taken to move together.
        """
        thetas, ls = self._configurations(theta_b, l_b)
        states = np.ascontiguousarray(numbers(phi, "phi"))
        if states.shape != (len(thetas), self.n - 1):
            raise InputError(f"must have shape ({len(thetas)}, {self.n - 1}), not {states.shape}", key="phi")
        if not np.all(np.abs(states) <= 1):
            raise InputError("must lie in [-1, 1]", key="phi", value=worst(states))
        given = directions(parameters, self._given[0], self._model.number_names())
        with input_errors():
            table: Array = np.asarray(
                self._model.tips_with_friction(thetas, ls, states, given, _first_order(accuracy), _checked(threads))
            )
        slopes = table[:, 9:].reshape(len(thetas), len(given), 2, 3)
        return Tips(
            position_m=table[:, :3],
            tangent=table[:, 3:6],
            status=table[:, 6].astype(int),
            residual=table[:, 7],
            max_strain=table[:, 8],
            position_by=np.moveaxis(slopes[:, :, 0], 1, 2),
            tangent_by=np.moveaxis(slopes[:, :, 1], 1, 2),
        )

    def core_lookup(
        self, axes: Sequence[tuple[int, bool, float, float, int]], values: NDArray[np.float32], margin_m: float
    ) -> _model.FieldLookup:
        """The compiled lookup that `ctrplan.mechanics.bound_lookup.FieldLookup` asks."""
        with input_errors():
            return self._model.field_lookup(list(axes), np.ascontiguousarray(values), margin_m)

    def core_history(self, options: HistoryOptions, accuracy: Accuracy) -> _model.History:
        """The compiled simulation that `ctrplan.mechanics.history.History` drives."""
        given = (options.breakaway_m, options.rotation_rad, options.translation_m, options.state_change)
        if not all(0 < value < np.inf for value in given):
            raise InputError("steps and breakaway length of a history must be positive")
        return self._model.history(_first_order(accuracy), *given)

    def check_path(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        field: Field | None = None,
        *,
        density: PathDensity | None = None,
        limits: PathLimits | None = None,
        accuracy: Accuracy = "search",
        bodies: bool = False,
    ) -> PathSamples:
        """Walks the straight lines between configurations (K, n), (K, n), each solve starting from the one before.

        Stops after the first sample that breaks a limit, fails, or is UNSTABLE, which a snap on the way is too.
        """
        given = walk_arguments(field, density or PathDensity(), limits or PathLimits())
        with input_errors():
            theta, length = joint_rows(theta_b, l_b, self.n)
            table, points = self._model.check_path(theta, length, *given, _level(accuracy), bodies)
        return path_samples(np.asarray(table), points)

    def field_entries(self, theta_b: ArrayLike, l_b: ArrayLike, *, threads: int = 0) -> Array:
        """(K, FieldLookup.NUMBERS) what a grid of bounds stores of K configurations, (K, n), (K, n)."""
        thetas, ls = self._configurations(theta_b, l_b)
        with input_errors():
            return np.asarray(self._model.field_entries(thetas, ls, _checked(threads)))

    def body(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> tuple[Array, Array]:
        """Outermost centreline in front of the plate: points (1 + corners, N, 3) [m], outer radii (N,) [m]."""
        with input_errors():
            table: Array = np.asarray(self._model.body(self._row(theta_b), self._row(l_b), _level(accuracy)))
        return table[:, :, :3], table[0, :, 3]

    def _configurations(self, theta_b: ArrayLike, l_b: ArrayLike) -> tuple[Array, Array]:
        return joint_rows(theta_b, l_b, self.n)

    def _refuse(self, theta_b: Array, l_b: Array) -> None:
        if refused := self.first_refused(theta_b, l_b):
            raise InputError("row {}: {}".format(*refused))

    def _pairs(self, values: ArrayLike, key: str) -> Array:
        pairs = np.atleast_1d(numbers(values, key))
        if pairs.shape != (self.n - 1,):
            raise InputError(f"must have shape ({self.n - 1},), one value per pair, not {pairs.shape}", key=key)
        return pairs

    def _row(self, values: ArrayLike) -> Array:
        return joint_row(values, self.n)

    def _rows(self, values: ArrayLike) -> Array:
        return joint_table(values, self.n)


class input_errors:
    """Turns the core's refusals into InputError."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, _model.InvalidInput):
            raise InputError(str(error)) from None


def kernel_name() -> str:
    """Instruction set of the kernel in use: "avx2" or "baseline"."""
    return str(_model.kernel_name())


def _checked(threads: int) -> int:
    try:
        count = operator.index(threads)
    except TypeError:
        count = -1
    if not 0 <= count <= MOST_THREADS:
        raise InputError(f"must be a whole number from 0 (every core) to {MOST_THREADS}", key="threads", value=threads)
    return count


def _level(accuracy: Accuracy) -> int:
    if accuracy not in _LEVELS:
        raise InputError('must be "search", "certificate" or "exact"', key="accuracy", value=accuracy)
    return _LEVELS.index(accuracy)


def _first_order(accuracy: Accuracy) -> int:
    if accuracy == "exact":
        raise InputError('must be "search" or "certificate" here', key="accuracy", value=accuracy)
    return _level(accuracy)
