"""Typed face of the mechanics core: shapes, friction states, bounds, also for whoever moves a robot step by step.

Models and conventions: docs/model.md. Joint arrays are outermost tube first; SI units; the world frame stands at the
front plate, z along insertion, s = 0 at the plate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arguments import EXECUTOR, PROGRESS, Choice, Flag, Made, Number, Texts, Whole, checked
from ctrplan.base.arrays import Array, numbers
from ctrplan.base.long_work import MOST_THREADS, Progress, core_threads, part_of
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.mechanics.core_arrays import (
    Near,
    core_density,
    core_grid,
    core_limits,
    core_model,
    joint_row,
    joint_rows,
    promised,
    require_tubes,
    solved_bound,
    solved_shape,
    sound,
    worst,
)
from ctrplan.mechanics.friction import SPACING, Branched, FrictionStates, corner_signs
from ctrplan.mechanics.gradients import bound_gradients, directions, with_gradient
from ctrplan.mechanics.loaded_shape import LoadedRobot, is_beyond_standard
from ctrplan.mechanics.shapes import Accuracy, Bound, Bounds, FrictionBodies, Shape, Status, Tips, input_errors
from ctrplan.mechanics.tube import Loads, nests
from ctrplan.mechanics.walk import (
    Field,
    PathDensity,
    PathLimits,
    PathSamples,
    bounds_in_chunks,
    bounds_on_executor,
    chunks,
    rows_in_a_chunk,
    scattered,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ctrplan.mechanics.guide import Guide
    from ctrplan.mechanics.shapes import HistoryOptions
    from ctrplan.mechanics.tube import Tube

TIPS_AT_ONCE = 1 << 16  # whose copies in the core take little memory, and no time to give up
MOST_TUBES_OF_ALL_CORNERS = 8  # 128 corners, a second or so; beyond, the extreme ones unless all are asked for
ACCURACY, FIRST_ORDER = Choice(*get_args(Accuracy)), Choice("search", "certificate")
THREADS = Whole(0, MOST_THREADS, " (0: every core)")


@shown
class Mechanics:
    """A robot's compiled model. Thread-safe: concurrent calls use separate workspaces; the GIL is released."""

    def __init__(
        self,
        tubes: Sequence[Tube],
        clearance_m: ArrayLike,
        friction: ArrayLike,
        loads: Loads | None = None,
        guide: Guide | None = None,
    ) -> None:
        """`clearance_m` (n - 1,) radial [m]; `friction` (n - 1,) Coulomb coefficients. Raises InputError.

        guide: shapes that whatever is solved begins from, those of a branch; by default a robot without precurvature.
        """
        self.n = len(tubes)
        if not tubes:
            raise InputError("must be at least one tube", key="tubes")
        gaps, coefficients = self._pairs(clearance_m, "clearance_m"), self._pairs(friction, "friction")
        loads = loads or Loads()
        self._given = (tuple(tubes), gaps.copy(), coefficients.copy(), loads, guide)
        require_tubes(tubes)
        with input_errors():
            self._model = core_model(tubes, gaps, coefficients, loads, guide)

    def headline(self) -> str:
        """How many tubes."""
        return f"{self.n} tubes, {len(self._given[0][-1].sections)} sections of the innermost"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as the numbers it was made of, and compiled again where it is read."""
        return type(self), self._given

    @property
    def numbers(self) -> tuple[tuple[Tube, ...], list[str]]:
        """What `gradients.directions` has to know: the tubes, and what the core calls its numbers."""
        return self._given[0], self._model.number_names()

    @cached_property
    def _loaded(self) -> LoadedRobot | None:
        """What solves the zero-clearance model with terms that the core leaves out of it; None without such terms."""
        tubes, _, _, loads, _ = self._given
        return LoadedRobot(tubes, loads) if is_beyond_standard(tubes, loads) else None

    @checked(loads=Flag())
    def zero_clearance(self, theta_b: ArrayLike, l_b: ArrayLike, *, loads: bool = True) -> Shape:
        """The standard model (2)-(3) at base rotations (n,) [rad] and translations (n,) [m].

        With the robot's loads, weight, ovality and softening, unless `loads` is False. `status` is then that of the
        equilibrium without them, from which the loads grow; FAILED where no equilibrium is reached on the way.
        """
        with input_errors():
            shape = solved_shape(self._model.zero_clearance(*self._collars(theta_b, l_b)))
        if self._loaded is None or not loads or shape.status == Status.FAILED:
            return shape
        return self._loaded.shape(*self._collars(theta_b, l_b), shape)

    @checked(accuracy=ACCURACY, refinement=Number(0.25, 16))
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
        state = numbers(phi, "phi")
        if state.ndim == 0:
            state = np.full(self.n - 1, state)
        state = self._pairs(state, "phi")
        if not np.all(np.abs(state) <= 1):
            raise InputError("must lie in [-1, 1]", key="phi", value=worst(state))
        with input_errors():
            return solved_shape(
                self._model.solve(*self._collars(theta_b, l_b), np.ascontiguousarray(state), accuracy, refinement)
            )

    @checked(
        accuracy=ACCURACY, corners=Choice("all", "extreme"), progress=PROGRESS, gradient=Flag(), parameters=Texts()
    )
    def bound(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        corners: Literal["all", "extreme"] | None = None,
        progress: Progress | None = None,
        gradient: bool = False,
        parameters: Sequence[str] = (),
    ) -> Bound:
        """Frictionless solution, corners phi in {-1, 1}^(n-1), and the largest deviations between them.

        corners: "all" 2^(n-1) of them, for at most 10 tubes, or those "extreme" ones that a search finds to move the
        tip farthest by some n^2 solves: benchmarks/bound_sizes.py says what they miss. By default all of at most
        MOST_TUBES_OF_ALL_CORNERS tubes. A corner without an equilibrium in reach leaves no bound: the others
        that are hard to reach are FAILED then too. `progress` is told the finished share, 0 to 1. With `gradient`, the
        bound has one (`ctrplan.mechanics.gradients`), of the corners visited, by collars and by `parameters`.
        """
        which = corners or ("all" if self.n <= MOST_TUBES_OF_ALL_CORNERS else "extreme")
        collars = self._collars(theta_b, l_b)
        with input_errors():
            bound = solved_bound(self._model.bound(*collars, accuracy, which == "extreme", progress))
        return with_gradient(self, bound, *collars, parameters, accuracy) if gradient else bound

    @checked(accuracy=ACCURACY, threads=THREADS, progress=PROGRESS, executor=EXECUTOR)
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
        (thetas, ls), cores = joint_rows(theta_b, l_b, self.n), core_threads(threads)
        rows = rows_in_a_chunk(self.n, accuracy)
        if executor is not None or len(thetas) > rows:  # nothing is solved before all is known to be well-formed
            self._refuse(thetas, ls)
        if executor is not None:
            return bounds_on_executor(executor, self, thetas, ls, accuracy, threads, progress)

        def solve(theta_b: Array, l_b: Array) -> Bounds:
            with input_errors():
                return promised(Bounds(**self._model.bound_many(theta_b, l_b, accuracy, cores)))

        return bounds_in_chunks(solve, thetas, ls, rows, progress)

    @checked(
        accuracy=ACCURACY,
        threads=THREADS,
        progress=PROGRESS,
        executor=EXECUTOR,
        gradient=Flag(),
        parameters=Texts(),
    )
    def bounds(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        threads: int = 0,
        progress: Progress | None = None,
        executor: Executor | None = None,
        gradient: bool = False,
        parameters: Sequence[str] = (),
    ) -> Bounds:
        """`bound_many` with a status for every row: REFUSED and NaN where `bound` of the row raises InputError."""
        thetas, ls = joint_rows(theta_b, l_b, self.n)
        refused = np.zeros(len(thetas), dtype=bool)
        refused[[k for k, _ in self._refused(thetas, ls)]] = True
        solved = self.bound_many(
            thetas[~refused], ls[~refused], accuracy=accuracy, threads=threads, progress=progress, executor=executor
        )
        result = scattered(solved, refused) if refused.any() else solved
        if not gradient:
            return result
        kept, signs = ~refused, corner_signs(self.n - 1)
        by = bound_gradients(self, thetas[kept], ls[kept], signs, parameters, accuracy=accuracy, threads=threads)
        return replace(result, gradient=by.each(lambda of: of.scattered(kept)))

    def first_refused(self, theta_b: ArrayLike, l_b: ArrayLike) -> tuple[int, str] | None:
        """The first of K configurations (K, n), (K, n) that is malformed or does not nest, and why; None if none is."""
        return next(self._refused(*joint_rows(theta_b, l_b, self.n)), None)

    def _refused(self, thetas: Array, ls: Array) -> Iterator[tuple[int, str]]:
        with np.errstate(invalid="ignore"):  # rows that are no numbers
            nested = nests(self._given[0], ls) & np.all(np.abs(thetas) < 1e5, axis=1) & np.all(np.isfinite(ls), axis=1)
        for k in np.flatnonzero(~nested).tolist():  # the core has the last word
            try:
                self._model.zero_clearance(thetas[k], ls[k])
            except _model.InvalidInput as refusal:
                yield k, str(refusal)

    @checked(threads=THREADS, progress=PROGRESS, loads=Flag())
    def tips(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        threads: int = 0,
        progress: Progress | None = None,
        loads: bool = True,
    ) -> tuple[Array, Array, NDArray[np.int_]]:
        """Zero-clearance tips (K, 3) [m], tangents (K, 3) and status (K,) of K configurations.

        Loads and the other terms that `zero_clearance` names are included; they take milliseconds a tip instead of
        15 us, so searches, whose tips are hints, leave them out by `loads=False`. `progress` is told the finished
        share, 0 to 1.
        """
        thetas, ls = joint_rows(theta_b, l_b, self.n)
        parts = chunks(len(thetas), TIPS_AT_ONCE)
        if len(parts) > 1:  # nothing is solved before all is known to be well-formed
            self._refuse(thetas, ls)
        results = []
        for k, rows in enumerate(parts):
            with input_errors():
                results.append(
                    self._model.tips(thetas[rows], ls[rows], core_threads(threads), part_of(progress, k, len(parts)))
                )
        position_m, tangent, status = map(np.concatenate, zip(*results, strict=True))
        status = sound(status, position_m, tangent)
        if self._loaded is None or not loads or not len(thetas):
            return position_m, tangent, status
        return self._loaded.tips(thetas, ls, status, partial(self.zero_clearance, loads=False))

    @checked(field=Made("Field"), spacing_m=SPACING, threads=THREADS)
    def zero_clearance_rooms(
        self, theta_b: ArrayLike, l_b: ArrayLike, field: Field, *, spacing_m: float = 4e-3, threads: int = 0
    ) -> tuple[Array, Array]:
        """Clearances (K,) [m] of zero-clearance shapes at points `spacing_m` apart, and tips (K, 3) [m].

        The outer radius of what is there is taken off; -inf without a stable solution. A hint, some 30 times cheaper
        than a bound: loads, friction and clearance between tubes move a shape by millimetres. Raises InputError.
        """
        with input_errors():
            return self._model.clearances(
                *joint_rows(theta_b, l_b, self.n), core_grid(field), spacing_m, core_threads(threads)
            )

    @checked(parameters=Texts(), threads=THREADS, accuracy=FIRST_ORDER, progress=PROGRESS)
    def tips_with_friction(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        phi: ArrayLike,
        *,
        parameters: Sequence[str] = (),
        threads: int = 0,
        accuracy: Accuracy = "search",
        progress: Progress | None = None,
        near: Near | None = None,
    ) -> Tips:
        """Tips of K friction states, theta_b, l_b (K, n), phi (K, n - 1), and their derivatives by P parameters.

        Named as in `ctrplan.mechanics.gradients`. Rows of one configuration in turn or near known solutions are faster.
        Derivatives of the discretised equations; NaN where a solve FAILED, by what would pass another, by compliance
        of a rigid shaft, where a load's own change does not settle. What coincides is taken to move together.
        """
        thetas, ls = joint_rows(theta_b, l_b, self.n)
        states = np.ascontiguousarray(numbers(phi, "phi"))
        if states.shape != (len(thetas), self.n - 1):
            raise InputError(f"must have shape ({len(thetas)}, {self.n - 1}), not {states.shape}", key="phi")
        if not np.all(np.abs(states) <= 1):
            raise InputError("must lie in [-1, 1]", key="phi", value=worst(states))
        given = directions(parameters, *self.numbers)
        with input_errors():
            result = self._model.tips_with_friction(
                thetas, ls, states, given, accuracy, core_threads(threads), progress, *(near or (None, []))
            )
        return promised(Tips(**result))

    def core_body(
        self, theta_b: Array, l_b: Array, phi: Array, names: Sequence[str], accuracy: Accuracy, spacing_m: float
    ) -> tuple[Array, Array, float, Array]:
        """Points and radii (N, 4) [m] of a body, derivatives (N, 3, P), stability and its (P,), NaN with friction."""
        given = directions(names, *self.numbers)
        with input_errors():
            return self._model.body_derivatives(theta_b, l_b, phi, given, accuracy, spacing_m)

    @checked(accuracy=ACCURACY)
    def core_walker(self, accuracy: Accuracy) -> _model.Walker:
        """The compiled part of `ctrplan.mechanics.history.Walker`."""
        with input_errors():
            return _model.Walker(self._model, accuracy)

    def core_history(self, options: HistoryOptions, accuracy: Accuracy) -> _model.History:
        """The compiled simulation that `ctrplan.mechanics.history.History` drives."""
        given = (options.breakaway_m, options.rotation_rad, options.translation_m, options.state_change)
        return self._model.history(accuracy, *given)

    @checked(
        field=Made("Field"), density=Made("PathDensity"), limits=Made("PathLimits"), accuracy=ACCURACY, bodies=Flag()
    )
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
        walker: _model.Walker | None = None,
    ) -> PathSamples:
        """Walks the straight lines between configurations (K, n), (K, n), each solve starting from the one before.

        Stops after the first sample that breaks a limit, fails, or is UNSTABLE, which a snap on the way is too. With
        `bodies`, points, stability and strain of every shape are kept. A walker, of `core_walker` with its accuracy,
        goes on from where it stands or stood before its last step, if that is the first configuration.
        """
        until = core_density(density or PathDensity()), core_limits(limits or PathLimits())
        with input_errors():
            theta, length = joint_rows(theta_b, l_b, self.n)
            given = (theta, length, core_grid(field), *until)
            walked = walker.check_path(*given, bodies) if walker else self._model.check_path(*given, accuracy, bodies)
        return promised(PathSamples(**walked))

    @checked(accuracy=ACCURACY)
    def body(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> tuple[Array, Array]:
        """Outermost centreline in front of the plate: points (1 + corners, N, 3) [m], outer radii (N,) [m]."""
        with input_errors():
            return self._model.body(*self._collars(theta_b, l_b), accuracy)

    @checked(accuracy=ACCURACY)
    def friction_states(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> FrictionStates:
        """A configuration solved without friction: where its friction states part, to ask for them again."""
        with input_errors():
            core = _model.FrictionStates(self._model, *self._collars(theta_b, l_b), accuracy)
        return FrictionStates(core, self.n)

    def friction_bodies(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        phi: ArrayLike,
        *,
        spacing_m: float = 1e-3,
        accuracy: Accuracy = "search",
    ) -> FrictionBodies:
        """Bodies in friction states phi of one configuration, asked for once: see `FrictionStates.bodies`."""
        return self.friction_states(theta_b, l_b, accuracy=accuracy).bodies(phi, spacing_m=spacing_m)

    def core_solve_from(
        self, theta_b: Array, l_b: Array, phi: Array, s_m: Array, angles: Array, accuracy: Accuracy
    ) -> Branched:
        """S rotations theta_b (S, n) and friction states phi (S, n - 1) at one l_b (n,), each from a given shape.

        angles (S, n, K) [rad] of every tube at arc lengths s_m (K,) that ascend, beyond its ends as there.
        """
        turned, states, places, shapes = (np.ascontiguousarray(values) for values in (theta_b, phi, s_m, angles))
        with input_errors():
            return Branched(*self._model.solve_from(turned, joint_row(l_b, self.n), states, places, shapes, accuracy))

    @checked(accuracy=ACCURACY)
    def corners_apart(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> Array:
        """(C,) [m] how far another stable equilibrium of each sign corner lies from its own, at the configuration.

        Each corner is solved from the shapes of all others too; 0 where the same equilibrium is found, inf where a
        corner has none. Order of corners as `Bound.corners`.
        """
        with input_errors():
            return np.asarray(self._model.corners_apart(*self._collars(theta_b, l_b), accuracy))

    def _collars(self, theta_b: ArrayLike, l_b: ArrayLike) -> tuple[Array, Array]:
        """Base rotations and translations (n,) in the layout of the core. Raises InputError."""
        rows = joint_row(theta_b, self.n, "theta_b"), joint_row(l_b, self.n, "l_b")
        longest = max(tube.length_m for tube in self._given[0])
        if 20 * longest < np.abs(rows[1]).max() < 5000 * longest:  # where no tube can be, and in mm each of them
            raise InputError(
                "is many lengths of the robot: are these millimetres?", key="l_b", value=worst(rows[1]), unit="m"
            )
        return rows

    def _refuse(self, theta_b: Array, l_b: Array) -> None:
        if refused := self.first_refused(theta_b, l_b):
            raise InputError("row {}: {}".format(*refused))

    def _pairs(self, values: ArrayLike, key: str) -> Array:
        pairs = np.atleast_1d(numbers(values, key))
        if pairs.shape == (self.n - 1,):
            return pairs
        raise InputError(f"must have shape ({self.n - 1},), one value per pair, not {pairs.shape}", key=key)


def kernel_name() -> str:
    """Instruction set of the kernel in use: "avx2" or "baseline"."""
    return str(_model.kernel_name())
