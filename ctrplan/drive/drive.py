"""The drive: actuated joints -> base rotation and base translation of every tube's collar."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Choice, Number, read_plain_fields, require, rows_of
from ctrplan.base.arrays import Array, numbers, read_only, vector, warn_of_degrees
from ctrplan.base.package import shown
from ctrplan.errors import InputError

Kind = Literal["rotation", "translation"]


class DriveTerm(Protocol):
    """What effects of a drive make of collars (K, n) [rad], (K, n) [m] that are `off` (2 G n,) by play."""

    def __call__(self, theta: Array, l: Array, off: Array | None) -> tuple[Array, Array]:  # noqa: E741
        """Where they stand."""
        ...

    def bends(self, theta: Array, l: Array, off: Array | None) -> Iterator[tuple[Array, Array]]:  # noqa: E741
        """Inputs (K,), each with values (B,) between which the effects are smooth in it."""
        ...


ANGLE_STEP, LENGTH_STEP = 1e-4, 1e-6  # rad, m: of differences, exact to about their square

STEP_RAD, STEP_M = np.radians(1.0), 0.25e-3  # of a joint, between rows of a way in time, where it is taken as straight
JOINT_ROUNDING = 1e-9  # rad or m by which rounding may change a joint value or a collar
SAME_JOINTS = 1e-6  # rad or m by which joint values differ that somebody wrote with few digits: a tolerance

# Unit in files and on screens, and its value in SI.
UNITS: dict[Kind, tuple[str, float]] = {"rotation": ("deg", math.pi / 180), "translation": ("mm", 1e-3)}


# Largest velocity, acceleration and jerk where a joint gives none, in deg or mm and s. A surgical drive moves slowly
# enough to be watched; it is at speed after a quarter (rotation) or a fifth of a second (translation), and its
# acceleration rises within a tenth of a second, so that slender tubes are not made to ring.
DEFAULT_MOTION: dict[Kind, tuple[float, float, float]] = {
    "rotation": (60.0, 240.0, 2400.0),
    "translation": (10.0, 50.0, 500.0),
}

RATES = ("max_velocity", "max_acceleration", "max_jerk")


@shown
@dataclass(frozen=True, eq=False)
class Joint:
    """One actuator; its value in rad or m, zero at home. Raises InputError for what is no joint.

    Rates that are None become those of a drive for surgery, DEFAULT_MOTION.
    """

    name: str
    kind: Kind
    moves: Array  # (n,) rotation [rad/rad] or translation [m/m] of each tube's collar per unit of the joint
    lower: float = -math.inf  # -inf when unlimited
    upper: float = math.inf
    max_velocity: float = None  # type: ignore[assignment]  # per s
    max_acceleration: float = None  # type: ignore[assignment]  # per s^2
    max_jerk: float = None  # type: ignore[assignment]  # per s^3

    def __post_init__(self) -> None:
        """Reads its numbers."""
        require("kind", self.kind, Choice(*UNITS))
        object.__setattr__(self, "moves", vector("moves", self.moves))
        for name, default in zip(RATES, DEFAULT_MOTION[self.kind], strict=True):
            if getattr(self, name) is None:
                object.__setattr__(self, name, default * self.si_per_unit)
        read_plain_fields(self)
        for name in ("lower", "upper"):  # rates are looked at where something moves by them
            require(name, getattr(self, name), Number(-math.inf, math.inf))

    @property
    def is_unlimited(self) -> bool:
        """A rotation without limits."""
        return math.isinf(self.lower)

    @property
    def unit(self) -> str:
        """Unit in files and on screens: deg or mm."""
        return UNITS[self.kind][0]

    @property
    def si_per_unit(self) -> float:
        """rad per deg, or m per mm."""
        return UNITS[self.kind][1]


@dataclass(frozen=True)
class ExecutionTolerance:
    """How far a joint may go beyond the end of a leg before it comes back, or be behind the others on the way.

    The default is what positioning stages of such drives resolve and settle within.
    """

    rotation_rad: float = math.radians(0.2)
    translation_m: float = 0.05e-3

    def __post_init__(self) -> None:
        """Raises InputError for what is no number."""
        read_plain_fields(self)


@shown
@dataclass(frozen=True, eq=False)
class Drive:
    """m actuators moving the collars of n tubes: commanded = home + sum over joints of moves * joint value.

    Collars stand where they are commanded, but for effects of the drive.

    Arrays over joints are (m,), in rad or m as the joint has it, and read-only.
    """

    joints: tuple[Joint, ...]
    home_theta_rad: Array  # (n,)
    home_l_m: Array  # (n,)
    terms: tuple[DriveTerm, ...] = ()  # of [effects.*]: what it makes of collars (K, n), (K, n), off by play
    counted: frozenset[int] = frozenset()  # tubes, from 1, on whose rotations terms depend beyond whole turns
    play: Array | None = None  # (G, 2 n) [rad], [m]: how far collars may be off either way at G places, likewise
    execution: ExecutionTolerance = ExecutionTolerance()
    late_s: tuple[Array, Array] | None = None  # (n,), (n,): how much later collars turn and slide, likewise

    def __post_init__(self) -> None:
        """Reads its numbers. Raises InputError unless every joint moves as many tubes as have a home."""
        object.__setattr__(self, "joints", rows_of("joints", self.joints, Joint))
        if not self.joints:
            raise InputError("must hold one joint at least", key="joints")
        n = len(vector("home_theta_rad", self.home_theta_rad))
        for name in ("home_theta_rad", "home_l_m"):
            object.__setattr__(self, name, vector(name, getattr(self, name), n))
        for joint in self.joints:
            vector(f"moves of {joint.name}", joint.moves, n)

    def collars(self, q: ArrayLike) -> tuple[Array, Array]:
        """theta_b [rad] and l_b [m], each (n,) or (K, n), for joint values `q` (m,) or (K, m).

        Raises InputError when `q` has another shape.
        """
        return self.reached(*self.commanded(q))

    def commanded(self, q: ArrayLike) -> tuple[Array, Array]:
        """What an ideal drive would make of joint values `q` (m,) or (K, m): [rad] and [m], each (n,) or (K, n)."""
        values = numbers(q, "joint values")
        if values.ndim not in (1, 2) or values.shape[-1] != len(self.joints):
            rule = f"must have shape (m,) or (K, m), m = {len(self.joints)} joints, not {values.shape}"
            raise InputError(rule, key="joint values")
        return self.home_theta_rad + values @ self.matrix_theta.T, self.home_l_m + values @ self.matrix_l.T

    def warn_of_degrees(self, key: str, q: ArrayLike) -> None:
        """Warns the caller of the package where joint values (m,) or (K, m) most likely have rotations in degrees."""
        if np.ndim(q) and np.shape(q)[-1] == len(self.joints):
            warn_of_degrees(f"rotations of {key}", np.asarray(q)[..., self.is_rotation])

    def named(self, q: Array) -> dict[str, float]:
        """Joint values (m,) by the joints' names, in deg or mm, as scenario files have them."""
        return {joint.name: float(value) / joint.si_per_unit for joint, value in zip(self.joints, q, strict=True)}

    def reached(self, theta: ArrayLike, l: ArrayLike, off: Array | None = None) -> tuple[Array, Array]:  # noqa: E741
        """theta_b [rad] and l_b [m] where theta, l, each (n,) or (K, n), are commanded: with the drive's effects.

        They are `off` (2 G n,) [rad], [m] by play at its G places in the drive; without it in its middle.
        """
        theta_b, l_b = numbers(theta, "theta_commanded"), numbers(l, "l_commanded")
        if not self.terms:
            n = len(self.home_l_m)
            return (theta_b, l_b) if off is None else (theta_b + off[:n], l_b + off[n:])
        rows = np.atleast_2d(theta_b), np.atleast_2d(l_b)
        for term in self.terms:
            rows = term(*rows, off)
        return rows[0].reshape(theta_b.shape), rows[1].reshape(l_b.shape)

    def bends(self, q: Array, off: Array | None = None) -> list[tuple[Array, Array]]:
        """Inputs (K,) of the drive's effects at joint values (K, m), each with values (B,) between which the effects
        are smooth in it.
        """
        (theta, l), results = self.commanded(q), list[tuple[Array, Array]]()  # noqa: E741 (as in the equations)
        for term in self.terms:
            results += term.bends(theta, l, off)
            theta, l = term(theta, l, off)  # noqa: E741 (as in the equations)
        return results

    def collars_by_joints(self, q: ArrayLike) -> Array:
        """(K, 2 n, m) derivatives of theta_b, then of l_b, by joint values `q` (K, m).

        Of an ideal drive those are its gears; effects of the drive are arithmetic, and differenced.
        """
        commanded = np.hstack(self.commanded(np.atleast_2d(q)))
        gears = np.vstack([self.matrix_theta, self.matrix_l])
        if not self.terms:
            return np.tile(gears, (len(commanded), 1, 1))
        count, n = commanded.shape[1], len(self.home_l_m)
        by = np.empty((len(commanded), count, count))
        for j, step in enumerate(np.repeat([ANGLE_STEP, LENGTH_STEP], n)):
            ends = (commanded + side * step * np.eye(count)[j] for side in (1, -1))
            up, down = (np.hstack(self.reached(end[:, :n], end[:, n:])) for end in ends)
            by[:, :, j] = (up - down) / (2 * step)
        slopes: Array = by @ gears
        return slopes

    @cached_property
    def travel_m(self) -> tuple[Array, Array]:
        """(n,), (n,) [m] least and greatest base translations within the limits, those without limits at home."""
        slope = self.matrix_l[:, ~self.is_rotation]
        ends = np.stack([self.lower, self.upper])[:, ~self.is_rotation]
        ends = np.where(np.isfinite(ends), ends, 0.0)
        both = slope * ends[0], slope * ends[1]
        home = np.asarray(self.home_l_m)
        return home + np.minimum(*both).sum(axis=1), home + np.maximum(*both).sum(axis=1)

    @cached_property
    def joint_late_s(self) -> Array:
        """(m,) how much later than commanded each joint follows: the latest of the collars that it moves."""
        if self.late_s is None:
            return read_only(np.zeros(len(self.joints)))
        moves = np.vstack([self.matrix_theta, self.matrix_l]) != 0
        return read_only(np.where(moves, np.concatenate(self.late_s)[:, None], 0.0).max(axis=0))

    @property
    def is_late(self) -> bool:
        """Whether joints leave straight legs, because some follow later than others."""
        return bool(np.ptp(self.joint_late_s) > 0)

    @cached_property
    def matrix_theta(self) -> Array:
        """(n, m) collar rotation per unit of each joint."""
        return self._matrix("rotation")

    @cached_property
    def matrix_l(self) -> Array:
        """(n, m) collar translation per unit of each joint."""
        return self._matrix("translation")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the drive."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def is_rotation(self) -> NDArray[np.bool_]:
        """Whether each joint rotates; else it translates."""
        return self._each(lambda joint: joint.kind == "rotation")

    @cached_property
    def is_unlimited(self) -> NDArray[np.bool_]:
        """Whether each joint is a rotation without limits."""
        return self._each(lambda joint: joint.is_unlimited)

    @cached_property
    def wraps(self) -> NDArray[np.bool_]:
        """Whether q and q + 2 pi of each joint are one place: of unlimited rotations that no effect or gear scales."""
        joints, collars = len(self.joints), len(self.home_l_m)
        here = np.hstack(self.collars(np.zeros((1, joints))))
        moved = np.hstack(self.collars(2 * math.pi * np.eye(joints))) - here
        off = np.abs(moved)
        off[:, :collars] = np.abs(moved[:, :collars] - 2 * math.pi * np.round(moved[:, :collars] / (2 * math.pi)))
        counts = np.any(self.matrix_theta[[tube - 1 for tube in sorted(self.counted)]] != 0, axis=0)
        return read_only(self.is_unlimited & np.all(off < JOINT_ROUNDING, axis=1) & ~counts)

    @cached_property
    def lower(self) -> Array:
        """Lower limits, -inf when unlimited."""
        return self._each(lambda joint: joint.lower)

    @cached_property
    def upper(self) -> Array:
        """Upper limits, inf when unlimited."""
        return self._each(lambda joint: joint.upper)

    @cached_property
    def max_velocity(self) -> Array:
        """Largest speeds, per s."""
        return self._each(lambda joint: joint.max_velocity)

    @cached_property
    def max_acceleration(self) -> Array:
        """Largest accelerations, per s^2."""
        return self._each(lambda joint: joint.max_acceleration)

    @cached_property
    def max_jerk(self) -> Array:
        """Largest jerks, per s^3."""
        return self._each(lambda joint: joint.max_jerk)

    def _each(self, value: Callable[[Joint], float]) -> NDArray[Any]:
        return read_only([value(joint) for joint in self.joints])

    def _matrix(self, kind: Kind) -> Array:
        columns = [joint.moves if joint.kind == kind else np.zeros_like(joint.moves) for joint in self.joints]
        return read_only(np.stack(columns, axis=1))
