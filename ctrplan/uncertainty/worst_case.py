"""The farthest that parameters and base may displace a point, its causes ranked, and the chance of it in draws.

A displacement is a + J dp + t + w x r. The offsets dp lie in a box, its sides the 95 % intervals; where errors are
correlated, in a box along the principal axes of their distribution, 1.96 standard deviations wide. The shift t and the
rotation w lie in balls. The set of displacements is convex, so that its farthest point from the origin is where a
direction u agrees with its own support: u -> a + (what is farthest along u), ascending until it stays. The ascent
starts from many directions; a set with several farthest points far apart could still hide one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import CHI95, CI95, MM_PER_M, Array
from ctrplan.base.package import shown
from ctrplan.uncertainty.parameters import UncertainParameters

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Registration

STARTS, STEPS = 40, 30
COVER = 400  # directions of a half sphere that cover it


@dataclass(frozen=True, eq=False)
class OffsetBox:
    """Offsets of P parameters from their values: middle + axes s, every s in [-1, 1]."""

    middle: Array  # (P,)
    axes: Array  # (P, A)

    @classmethod
    def of(cls, parameters: UncertainParameters) -> OffsetBox:
        """The stated intervals; along principal axes where errors are correlated."""
        half, middle = parameters.half_width, (parameters.low + parameters.high) / 2 - parameters.value
        axes, rows = np.diag(half), np.flatnonzero(parameters.is_correlated)
        if len(rows):
            values, vectors = np.linalg.eigh(parameters.correlation[np.ix_(rows, rows)])
            axes[np.ix_(rows, rows)] = half[rows, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        return cls(middle, axes[:, axes.any(axis=0)])

    def displaced(self, by: Array) -> IntervalSides:
        """Displacements of points with slopes (B, 3, P)."""
        return IntervalSides(by @ self.middle, by @ self.axes)


@dataclass(frozen=True, eq=False)
class IntervalSides:
    """Displacements of B points: middle + sides s, every s in [-1, 1]."""

    middle: Array  # (B, 3)
    sides: Array  # (B, 3, A)


@dataclass(frozen=True)
class BaseBall:
    """Radii of the balls that hold the base's shift [m] and its rotation [rad], 95 % each."""

    shift_m: float = 0.0
    rotation_rad: float = 0.0

    @classmethod
    def of(cls, position_sigma_m: float, rotation_sigma_rad: float) -> BaseBall:
        """The ball of standard deviations of coordinates, and of small rotations about each axis."""
        return cls(CHI95 * position_sigma_m, CHI95 * rotation_sigma_rad)


KNOWN_BASE = BaseBall()


@dataclass(frozen=True, eq=False)
class Farthest:
    """The farthest displacement of each of B points."""

    length_m: Array  # (B,)
    direction: Array  # (B, 3)
    signs: Array  # (B, A) of the box's axes there


def farthest(a: Array, moved: IntervalSides, base: BaseBall = KNOWN_BASE, lever_m: Array | None = None) -> Farthest:
    """The farthest ends of B displacements, (B, 3) [m] without errors; levers (B, 3) from the base's origin to the
    points.
    """
    middle, sides = a + moved.middle, moved.sides
    arms = np.zeros_like(a) if lever_m is None else lever_m
    starts = np.concatenate([_sphere(STARTS), -_sphere(STARTS)])
    own = np.concatenate([middle[:, None], sides.transpose(0, 2, 1), -sides.transpose(0, 2, 1)], axis=1)
    u = np.concatenate([np.broadcast_to(starts, (len(a), *starts.shape)), _unit(own)], axis=1)
    for _ in range(STEPS):
        risen = _unit(_support_point(u, middle, sides, base, arms))
        if np.allclose(risen, u, rtol=0, atol=1e-12):
            break
        u = risen
    length = np.einsum("bsc,bsc->bs", u, _support_point(u, middle, sides, base, arms))
    rows, best = np.arange(len(a)), np.argmax(length, axis=1)
    direction = u[rows, best]
    signs = np.sign(np.einsum("bc,bca->ba", direction, sides))
    return Farthest(np.maximum(length[rows, best], 0.0), direction, signs)


def reach_m(moved: IntervalSides, base: BaseBall = KNOWN_BASE, lever_m: Array | None = None) -> Array:
    """(B,) [m] no point is displaced farther: the support along directions that cover a sphere, over the gaps' cosine.

    Levers (B, 3). At most 1 % above `farthest` where the middle is zero, without a search; grows with every interval.
    """
    directions = _sphere(COVER)
    columns = np.concatenate([moved.sides, moved.middle[..., None]], axis=2)  # to either side of the value: safe
    along: Array = np.abs(directions @ columns).sum(axis=2)  # (B, U)
    if lever_m is not None and base.rotation_rad:
        along = along + base.rotation_rad * np.linalg.norm(np.cross(lever_m[:, None], directions[None]), axis=2)
    result: Array = along.max(axis=1) / np.cos(_gap(COVER)) + base.shift_m
    return result


def rough_reach_m(moved: IntervalSides, base: BaseBall, lever_m: Array) -> Array:
    """(B,) [m] never less than `reach_m` but for the gaps' cosine: everything added up. Levers (B, 3)."""
    sides = np.linalg.norm(moved.sides, axis=1).sum(axis=1) + np.linalg.norm(moved.middle, axis=1)
    result: Array = sides + base.shift_m + base.rotation_rad * np.linalg.norm(lever_m, axis=1)
    result /= np.cos(_gap(COVER))
    return result


def _support_point(u: Array, middle: Array, sides: Array, base: BaseBall, arms: Array) -> Array:
    """(B, U, 3) what is farthest along directions u (B, U, 3)."""
    signs = np.sign(np.einsum("buc,bca->bua", u, sides))
    point: Array = middle[:, None] + np.einsum("bca,bua->buc", sides, signs) + base.shift_m * u
    if base.rotation_rad:
        point = point + base.rotation_rad * np.cross(_unit(np.cross(arms[:, None], u)), arms[:, None])
    return point


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit


def _sphere(count: int) -> Array:
    """(count, 3) directions spread evenly over a half sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def _gap(count: int) -> float:
    """No direction or its opposite is farther [rad] from one of `_sphere`: 2.05 over the root for 10^5 directions."""
    return float(2.1 / np.sqrt(count))


FRICTION, REGISTRATION, PLAY = "friction", "registration", "play of the drive"
UNEXPLAINED, SECOND_ORDER = "what calibration left unexplained", "beyond first order"
OFF = "distance without friction and errors"
OFF_DIRECTION = "angle without friction and errors"
SHOWN_M, SHOWN_RAD = 0.05e-3, math.radians(0.05)  # smaller shares are not in the sentence


@shown
@dataclass(frozen=True)
class Contributor:
    """One cause of a worst case."""

    name: str
    share_m: float  # of the worst case; shares add up to it, some may be negative
    saved_m: float  # by how much the worst case would be smaller, were this known exactly


@dataclass(frozen=True)
class TurnContributor:
    """One cause of a worst-case angle, as `Contributor` is one of a distance."""

    name: str
    share_rad: float
    saved_rad: float


def shares(
    parameters: UncertainParameters,
    direction: Array,
    by: Array,
    offset: Array,
    base: BaseBall,
    lever: Array,
    unexplained_m: float,
) -> dict[str, float]:
    """Shares [m] of a displacement along direction (3,), by (3, P) at offset (P,), with a lever (3,) from the base."""
    results: dict[str, float] = {}
    for title, share in zip(parameters.title, (direction @ by * offset).tolist(), strict=True):
        results[title] = results.get(title, 0.0) + share
    turned = base.rotation_rad * float(np.linalg.norm(np.cross(lever, direction)))
    rest = {REGISTRATION: base.shift_m + turned, UNEXPLAINED: unexplained_m}
    return results | {name: share for name, share in rest.items() if share}


def ranked(given: Mapping[str, float], saved: Mapping[str, float]) -> tuple[Contributor, ...]:
    """The largest share first."""
    return tuple(Contributor(*row) for row in _ranked(given, saved))


def ranked_turns(given: Mapping[str, float], saved: Mapping[str, float]) -> tuple[TurnContributor, ...]:
    """The largest share first."""
    return tuple(TurnContributor(*row) for row in _ranked(given, saved))


def sentence(worst_m: float, contributors: tuple[Contributor, ...]) -> str:
    """The causes in words: "3.1 mm, of which friction 1.9, registration 0.8; measuring the registration would take
    0.6 off".
    """
    causes = [(c.name, c.share_m, c.saved_m) for c in contributors]
    return _told(f"{_digits(worst_m)} mm", [(n, _digits(a), _digits(b), a, b) for n, a, b in causes], SHOWN_M)


def turn_sentence(worst_rad: float, contributors: tuple[TurnContributor, ...]) -> str:
    """The causes in words: "3.1 deg, of which friction 1.9, registration 0.8; measuring the registration would take
    0.6 off".
    """
    causes = [(c.name, c.share_rad, c.saved_rad) for c in contributors]
    rows = [(n, f"{math.degrees(a):.1f}", f"{math.degrees(b):.1f}", a, b) for n, a, b in causes]
    return _told(f"{math.degrees(worst_rad):.1f} deg", rows, SHOWN_RAD)


def _ranked(given: Mapping[str, float], saved: Mapping[str, float]) -> list[tuple[str, float, float]]:
    rows = sorted(given.items(), key=lambda item: -item[1])
    return [(name, share, max(saved.get(name, 0.0), 0.0)) for name, share in rows]


def _told(whole: str, causes: Iterable[tuple[str, str, str, float, float]], shown: float) -> str:
    """Causes are name, share and saving in digits, and as numbers."""
    known = list(causes)
    parts = [f"{name} {digits}" for name, digits, _, share, _ in known if share >= shown]
    text = whole + (f", of which {', '.join(parts)}" if parts else "")
    best = max(known, key=lambda cause: cause[4], default=None)
    if best is None or best[4] < shown:
        return text
    return f"{text}; measuring {best[0]} would take {best[2]} off"


def _digits(length_m: float) -> str:
    return f"{length_m * MM_PER_M:.1f}" if length_m < 0.1 else f"{length_m * MM_PER_M:.0f}"


DRAWS, SOLVED, SEED = 10_000, 200, 23
DISTRIBUTION = (
    "parameters normal with the stated 95 % intervals, truncated where physics ends them, correlated as stated; "
    "registration normal in every direction; model_error_mm the 95th percentile of the length of a normal vector, "
    "another one at each target"
)


@shown
@dataclass(frozen=True)
class Chance:
    """How likely something is: the share of draws of the linearised model, with a 95 % interval of that share."""

    share: float
    low: float
    high: float
    solved_share: float  # of the draws that were solved
    solved_low: float
    solved_high: float

    @property
    def is_confirmed(self) -> bool:
        """Whether the solves allow the share of the linearised model."""
        return self.solved_low <= self.share <= self.solved_high

    @property
    def stated(self) -> float:
        """The share; that of the solves where they contradict it and are worse."""
        return self.solved_share if self.solved_low > self.share else self.share


def chance(linear: NDArray[np.bool_], solved: NDArray[np.bool_]) -> Chance:
    """The chance of events (M,) by the linearised model, and (R,) solved for the first of them."""
    return Chance(float(linear.mean()), *wilson(linear), float(solved.mean()), *wilson(solved))


def wilson(events: NDArray[np.bool_]) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    count, share, z2 = len(events), float(events.mean()), CI95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = CI95 / (1 + z2 / count) * float(np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)))
    # rounding must not shut out the ends
    return (0.0 if share == 0 else max(middle - half, 0.0)), (1.0 if share == 1 else min(middle + half, 1.0))


@dataclass(frozen=True, eq=False)
class Draws:
    """M robots, bases and unexplained errors drawn from the stated distribution; SI, robot frame."""

    offset: Array  # (M, P) of the parameters
    shift_m: Array  # (M, 3) of the base
    turn_rad: Array  # (M, 3) small rotation of the base
    unexplained_m: Array  # (M, 3)
    model_error_m: float  # 95th percentile of its length

    @classmethod
    def of(
        cls,
        parameters: UncertainParameters,
        registration: Registration,
        model_error_m: float,
        count: int = DRAWS,
        seed: int = SEED,
    ) -> Draws:
        """Draws from the stated distribution, the same ones every time."""
        rng = np.random.default_rng(seed)
        offset = parameters.drawn(rng, count)
        scales = registration.position_sigma_m, registration.rotation_sigma_rad, model_error_m / CHI95
        shift, turn, unexplained = (scale * rng.standard_normal((count, 3)) for scale in scales)
        return cls(offset, shift, turn, unexplained, model_error_m)

    def elsewhere(self, number: int, seed: int = SEED) -> Draws:
        """The drawn robots and bases at another pose, where the unexplained error is drawn anew."""
        rng = np.random.default_rng((seed, number))
        error = self.model_error_m / CHI95 * rng.standard_normal(self.unexplained_m.shape)
        return replace(self, unexplained_m=error)

    def rigid(self, point_m: Array) -> Array:
        """(M, 3) how base and unexplained errors displace a point (3,) [m]."""
        moved: Array = self.shift_m + np.cross(self.turn_rad, point_m) + self.unexplained_m
        return moved

    def turned(self, tangent: Array) -> Array:
        """(M, 3) how the base turns a direction (3,)."""
        moved: Array = np.cross(self.turn_rad, tangent)
        return moved
