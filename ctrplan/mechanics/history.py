"""What the robot does along a joint path: equilibria whose friction follows the slip of every contact; the bound, step
by step.

The friction bound says how far a tip can be; a history says where it is, for the path by which it got there. Each
contact keeps a friction vector (phi, psi) in the unit disc, the circumferential and axial share of the Coulomb limit;
docs/model.md has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import PROGRESS, Choice, Made, checked
from ctrplan.base.arrays import Array, numbers, warn_of_degrees
from ctrplan.base.long_work import Progress
from ctrplan.base.package import of_this_process, shown
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.core_arrays import joint_row, joint_rows, shape_from_core, solved_bound
from ctrplan.mechanics.gradients import SAME_M, tip_gradient
from ctrplan.mechanics.shapes import Accuracy, Bound, Gradient, Shape, Status, input_errors
from ctrplan.mechanics.shapes import HistoryOptions as HistoryOptions

if TYPE_CHECKING:
    import ctrplan._model as _model

Start = Literal["released", "oscillated"] | Sequence[float] | Array

STICKING = 1e-6  # share of a pair's normal force below which contacts may stick where all slip
OSCILLATION_DEG = tuple(range(40, -1, -2))  # decreasing amplitude, turned one way and the other (Section V-A)


@shown
@dataclass(frozen=True, eq=False)
class PairFriction:
    """Friction state of a pair at its N contact points."""

    s_m: Array  # (N,)
    phi: Array  # (N,) circumferential share of the Coulomb limit; +1: the inner tube slipped counterclockwise
    psi: Array  # (N,) axial share; +1: the inner tube slipped forward
    force_N: Array  # (N,) normal force


@dataclass(frozen=True)
class Energy:
    """Balance of an advance by rotations: work = elastic + breakaway + loss. Loads and translations are left out."""

    work_J: float = 0.0  # of the actuators
    elastic_J: float = 0.0  # growth of elastic energy
    breakaway_J: float = 0.0  # growth of what contacts store before they slip
    loss_J: float = 0.0  # in contacts that slip
    smallest_loss_J: float = 0.0  # of any contact in any step: not below zero but for rounding


@shown
@dataclass(frozen=True, eq=False)
class HistoryStep:
    """Where a history stands after an advance."""

    theta_b: Array  # (n,) rad
    l_b: Array  # (n,) m
    shape: Shape
    friction: tuple[PairFriction, ...]  # per pair, outermost first
    frictionless: Shape  # the solution with clearance and without friction at the same joints
    energy: Energy
    steps: int  # that the advance took
    snaps: int  # of them without an equilibrium near by, where the robot slid to another one

    @property
    def phi(self) -> tuple[Array, ...]:
        """Circumferential friction state per pair and contact point."""
        return tuple(pair.phi for pair in self.friction)

    @property
    def tip_m(self) -> Array:
        """(3,) of the tip, in the robot's frame."""
        return self.shape.tip_m

    @property
    def deviation_m(self) -> float:
        """Distance [m] of the tip from that of the frictionless solution."""
        return float(np.linalg.norm(self.shape.tip_m - self.frictionless.tip_m))


@shown
@dataclass(frozen=True, eq=False)
class HistoryPath:
    """Tips along K waypoints."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    phi: Array  # (K, n - 1) circumferential friction state of each pair, averaged by normal force
    snaps: Array  # (K,) times the robot slid to another equilibrium on the way to each
    status: NDArray[np.int_]  # (K,) Status


@shown
@dataclass(frozen=True, eq=False)
class HistoryState:
    """A memory of a history, to go back to."""

    theta_b: Array
    l_b: Array
    core: _model.HistoryState

    __reduce__ = of_this_process("lead another History along the same path and save that")


@shown
class History:
    """A robot moved along a joint path, waypoint by waypoint. Memory does not grow with the path.

    It takes collars. It has one state, so that threads that share it move each other's robot: give each its own.
    """

    @checked(mechanics=Made("Mechanics"), accuracy=Choice("search", "certificate"), options=Made("HistoryOptions"))
    def __init__(
        self,
        mechanics: Mechanics,
        start: Start = "released",
        *,
        accuracy: Accuracy = "search",
        options: HistoryOptions | None = None,
    ) -> None:
        """`start` is the state at the first waypoint: "released" is free of friction, a sign per pair (or share in
        [-1, 1]) fully loaded in that corner, "oscillated" fully loaded and then released as in Section V-A.
        """
        self._mechanics, self._start = mechanics, start
        self._accuracy: Accuracy = accuracy
        self.options = options or HistoryOptions()
        self._phi = _start_phi(start, mechanics.n - 1)
        self._oscillates = isinstance(start, str) and start == "oscillated"
        self._core = mechanics.core_history(self.options, accuracy)
        self._at: tuple[Array, Array] | None = None

    __reduce__ = of_this_process("make another by Robot.history and lead it along the same path")

    def headline(self) -> str:
        """Where it started."""
        return f"of {self._mechanics.n} tubes, which started {self._start}"

    def advance(self, theta_b: ArrayLike, l_b: ArrayLike) -> HistoryStep:
        """Moves all joints to base rotations (n,) [rad] and translations (n,) [m]; the first call starts there.

        Raises SolverError where no equilibrium is found, with the history left where it got to. Ctrl-C on the way
        leaves it where it was, one after the way at its end.
        """
        warn_of_degrees("theta_b", theta_b)
        rows = joint_row(theta_b, self._mechanics.n), joint_row(l_b, self._mechanics.n)
        moved = self._begin(*rows) if self._at is None else self._move(*rows)
        self._at = rows
        return self._step(*rows, **moved)

    @checked(progress=PROGRESS)
    def follow(self, theta_b: ArrayLike, l_b: ArrayLike, *, progress: Progress | None = None) -> HistoryPath:
        """Moves along K waypoints (K, n) [rad], (K, n) [m] in one call into the core, with tips only.

        Rows after one that FAILED are NaN. `progress` is told the finished share, 0 to 1. Ctrl-C, and whatever
        `progress` raises, leave the history where it was.
        """
        warn_of_degrees("theta_b", theta_b)
        thetas, ls = joint_rows(theta_b, l_b, self._mechanics.n)
        if self._at is None and len(thetas):
            self._begin(thetas[0], ls[0])
        with input_errors():
            path = HistoryPath(**self._core.follow(thetas, ls, progress))
        reached = np.flatnonzero(path.status < Status.FAILED)
        if len(reached):
            self._at = (thetas[reached[-1]].copy(), ls[reached[-1]].copy())
        return path

    def shape(self) -> Shape:
        """The robot where the history stands; InputError before the first advance."""
        if self._at is None:
            raise InputError("a history has no state before its first advance", key="history")
        return shape_from_core(self._core.shape())

    def tip_beside(self, phi: ArrayLike) -> Array:
        """Tip (3,) [m] with the contacts of each pair at phi (n - 1,), on the branch that the history is on.

        The history stays where it is. NaN where the branch ends before friction is there; InputError before the first
        advance. Other solvers choose their branch afresh at every configuration.
        """
        if self._at is None:
            raise InputError("a history has no state before its first advance", key="history")
        return np.asarray(self._core.beside(_friction_state(phi, "phi", self._mechanics.n - 1)))

    def gradient(self, parameters: Sequence[str] = ()) -> Gradient:
        """How the tip (3,) [m] changes where the history stands, by the collars of its last waypoint and by parameters.

        Smooth, and the tip that of a corner of friction, where every pair slips at its limit: then the way there does
        not count. NaN where a pair sticks or turns round, and where it is on another branch than `Robot.bound`. By
        translations a history differs from it by its mesh, which moves along. Raises InputError before the first
        advance and for parameters that there are not.
        """
        if self._at is None:
            raise InputError("a history has no state before its first advance", key="history")
        pairs = [PairFriction(**pair) for pair in self._core.friction()]
        phi = np.array([float(pair.force_N @ pair.phi) / max(float(pair.force_N.sum()), 1e-300) for pair in pairs])
        tip = tip_gradient(self._mechanics, *self._at, np.clip(np.round(phi), -1, 1), parameters, self._accuracy)
        slips = bool(np.all(np.abs(phi) > 1 - STICKING)) and np.linalg.norm(tip.value - self.shape().tip_m) < SAME_M
        return tip if slips else tip.lost()

    def save(self) -> HistoryState:
        """A memory of the present state; InputError before the first advance."""
        if self._at is None:
            raise InputError("a history has no state before its first advance", key="history")
        return HistoryState(*self._at, self._core.save())

    def restore(self, state: HistoryState) -> None:
        """Goes back to a saved state of this robot at this accuracy; InputError if it is of another."""
        if not isinstance(state, HistoryState):
            raise InputError("must be what History.save returned", key="state", value=state)
        with input_errors():
            self._core.restore(state.core)
        self._at = (state.theta_b, state.l_b)

    def _begin(self, theta_b: Array, l_b: Array) -> dict[str, Any]:
        with input_errors():
            status = self._core.start(theta_b, l_b, self._phi)
        if status == Status.FAILED:
            raise SolverError("no equilibrium was found at the start of the history")
        moved = {"steps": 0, "snaps": 0, "energy": Energy()}
        if self._oscillates:
            weights = np.arange(self._mechanics.n)  # every pair turns by the amplitude
            for k, amplitude in enumerate(np.radians(OSCILLATION_DEG)):
                self._move(theta_b + (-1) ** k * amplitude * weights, l_b)
            moved = self._move(theta_b, l_b)
        self._at = (theta_b, l_b)  # begun, once it is there
        return moved

    def _move(self, theta_b: Array, l_b: Array) -> dict[str, Any]:
        with input_errors():
            moved = self._core.advance(theta_b, l_b)
        if moved["status"] == Status.FAILED:
            raise SolverError("no equilibrium was found along the path")
        return {"steps": moved["steps"], "snaps": moved["snaps"], "energy": Energy(**moved["energy"])}

    def _step(self, theta_b: Array, l_b: Array, steps: int, snaps: int, energy: Energy) -> HistoryStep:
        return HistoryStep(
            theta_b=theta_b,
            l_b=l_b,
            shape=shape_from_core(self._core.shape()),
            friction=tuple(PairFriction(**pair) for pair in self._core.friction()),
            frictionless=self._mechanics.solve(theta_b, l_b, 0.0, accuracy=self._accuracy),
            energy=energy,
            steps=steps,
            snaps=snaps,
        )


def _start_phi(start: Start, pairs: int) -> Array:
    if isinstance(start, str):
        if start not in ("released", "oscillated"):
            raise InputError('must be "released", "oscillated" or one sign per pair', key="start", value=start)
        return np.full(pairs, 0.0 if start == "released" else 1.0)
    return _friction_state(start, "start", pairs)


def _friction_state(values: ArrayLike, key: str, pairs: int) -> Array:
    phi = numbers(values, key)
    if phi.shape != (pairs,) or not np.all(np.abs(phi) <= 1):
        raise InputError(f"must be {pairs} values in [-1, 1], one per pair", key=key)
    return phi


@shown
@dataclass(frozen=True, eq=False)
class BoundStep:
    """The bound where a walker stands. NaN where a solve FAILED."""

    position_m: float  # of the tip
    tangent_rad: float
    stability: float
    max_strain: float
    residual: float  # largest of all shapes
    status: Status  # never MULTIPLE: other solutions are not looked for
    tip_m: Array  # (3,) frictionless
    tip_tangent: Array  # (3,)
    started_cold: bool  # not from the last solution: the branch is that of continuation from no precurvature
    solves: int  # configurations on the way, this one among them


class Walker:
    """A robot that stands somewhere and is moved on. Made by `Robot.walker`; it takes collars.

    Warm steps stay on the branch that the path is on, which need not be that of `Robot.bound`. One thread at a time.
    """

    def __init__(self, core: _model.Walker, n: int) -> None:
        """core: what `Mechanics.core_walker` made, of n tubes."""
        self._core, self._n = core, n

    __reduce__ = of_this_process("make another by Robot.walker and lead it to where this one stands")

    def bound(self, theta_b: ArrayLike, l_b: ArrayLike) -> BoundStep:
        """The bound at collars (n,) [rad], (n,) [m], from where the walker stands, in steps of 0.1 rad or 3 mm at most.

        Ctrl-C on the way leaves it nowhere: the next step starts cold. Raises InputError.
        """
        warn_of_degrees("theta_b", theta_b)
        with input_errors():
            result = self._core.step(joint_row(theta_b, self._n), joint_row(l_b, self._n))
        position_m, tangent_rad, stability, max_strain, residual, status, tip, tangent, cold, solves = result
        return BoundStep(
            position_m=position_m,
            tangent_rad=tangent_rad,
            stability=stability,
            max_strain=max_strain,
            residual=residual,
            status=Status(status),
            tip_m=np.array(tip),
            tip_tangent=np.array(tangent),
            started_cold=cold,
            solves=solves,
        )

    def shapes(self) -> Bound:
        """The shapes of the last step. Raises InputError before the first one."""
        with input_errors():
            return solved_bound(self._core.shapes())
