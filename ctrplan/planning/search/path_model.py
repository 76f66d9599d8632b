"""What small motions of a path's corners do: to its length and its error at the goal, to clearance, limits and tip.

A path of legs is a sequence of values for the rotations and one for the translations, each held until the next leg of
its kind: the levels. Motions of levels change the cost about quadratically and all else about linearly, so that the
best motion within limits is a quadratic programme.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.gradients import collar_names
from ctrplan.mechanics.walk import PathSamples
from ctrplan.motion.checker import ASTRAY_M, MotionChecker
from ctrplan.planning.goal_states import LEAST_MM, RANK
from ctrplan.planning.reach import BoundSlopes, bound_slopes
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.scenario.tip_solver import least_within

ALIKE_M = 0.15e-3  # of room between shapes of a place: those with more than the nearest have by so much are left out
SPARE_MM = 0.03  # of room kept, so that what is left out, second order and places between samples, does not refuse


@dataclass(frozen=True, eq=False)
class NearPlace:
    """A place of a path where a shape is near the anatomy."""

    leg: int
    fraction: float  # of that leg
    room_mm: float  # beyond what is required
    by_joints: Array  # (m,) of room, mm per mm of joint length

    def moved(self, delta: Array) -> NearPlace:
        """What is expected of it after motions (K, m) [mm] of the path's corners."""
        along = (1 - self.fraction) * delta[self.leg] + self.fraction * delta[self.leg + 1]
        return replace(self, room_mm=self.room_mm + float(self.by_joints @ along))


@dataclass(frozen=True, eq=False)
class Levels:
    """How corners of a path may move, by a number for each joint of each level."""

    spread: Array  # (K, m, X) of joints weighted to mm: 1 where a number moves them
    level: NDArray[np.int_]  # (X,) the level of each
    has_goal: bool  # whether the last level is the goal's

    def places(self) -> list[tuple[int, int, NDArray[np.bool_]]]:
        """The first corner, that after the last, and the joints (m,) of each level."""
        result = []
        for level in np.unique(self.level):
            moves = self.spread[:, :, self.level == level].sum(axis=2) > 0
            rows = np.flatnonzero(moves.sum(axis=1))
            result.append((int(rows[0]), int(rows[-1]) + 1, moves.sum(axis=0) > 0))
        return result


def levels_of(checker: MotionChecker, corners: Array, *, moves_goal: bool) -> Levels:
    """The levels of a path (K, m) that may move, in order: those of the goal are one, where joints are to spare."""
    is_rotation, goal = checker.space.drive.is_rotation, np.zeros(corners.shape, dtype=bool)
    masks = list[NDArray[np.bool_]]()
    for kind in (is_rotation, ~is_rotation):
        changes = 1 + np.flatnonzero(np.any(np.diff(corners[:, kind], axis=0) != 0, axis=1))
        for first, last in zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True):
            masks.append(np.zeros(corners.shape, dtype=bool))
            masks[-1][first:last, kind] = True
        if len(changes):
            goal[changes[-1] :, kind] = True
    has_spare = int(goal.any(axis=0).sum()) > 3  # joints: three of them hold the tip
    has_goal = has_spare and moves_goal and checker.scenario.goal.joints is None
    columns = [
        np.where(np.arange(corners.shape[1]) == joint, mask, False)
        for mask in [*masks, *([goal] if has_goal else [])]
        for joint in np.flatnonzero(mask.any(axis=0)).tolist()
    ]
    counts = [int(mask.any(axis=0).sum()) for mask in [*masks, *([goal] if has_goal else [])]]
    spread = np.stack(columns, axis=2).astype(float) if columns else np.zeros((*corners.shape, 0))
    return Levels(spread, np.repeat(np.arange(len(counts)), counts), has_goal)


class NearPlaces:
    """Solves places of paths with derivatives, and remembers them."""

    def __init__(self, checker: MotionChecker) -> None:
        """Nothing is solved yet."""
        self._checker, self._known = checker, dict[bytes, list[tuple[float, Array]]]()

    def along(self, corners: Array, samples: PathSamples) -> Iterator[NearPlace]:
        """Places where a walk of a path (K, m) has least room on its way, if that is less than ASTRAY_M."""
        if self._checker.field is None:
            return
        room_m, at = samples.clearance_m - self._checker.limits.clearance_m, _places(corners, samples)
        for row in self._rows(samples, room_m):
            near = self._at(at[row], samples.nearest_phi[row] if samples.nearest_phi.size else None)
            least = min((room_mm for room_mm, _ in near), default=0.0)
            off_mm = float(room_m[row]) * MM_PER_M - least  # of interpolated shapes
            leg, fraction = int(samples.segment[row]), float(samples.fraction[row])
            yield from (NearPlace(leg, fraction, room_mm + off_mm, by) for room_mm, by in near)

    def foreseen(self, corners: Array, walked: Array, samples: PathSamples) -> list[NearPlace] | None:
        """Places where a path (K, m) likely has least room, from a walk of another beside it with legs like its own.

        The zero-clearance shapes tell: where the walk had its samples, their room differs from that of the walk's
        shapes by about as much on either path. None where the path is too close by more than ASTRAY_M.
        """
        if self._checker.field is None:
            return []
        space, at, of_walk = self._checker.space, _places(corners, samples), _places(walked, samples)
        own_m = self._checker.state_rooms(np.concatenate([at, of_walk])).reshape(2, -1)
        room_m = samples.clearance_m - self._checker.limits.clearance_m + own_m[0] - own_m[1]
        if room_m.min() < -ASTRAY_M:
            return None
        rows = self._rows(samples, room_m)
        sides = np.eye(len(space.weights_mm)) * LEAST_MM / space.weights_mm
        beside = (at[rows][:, None, None] + np.stack([sides, -sides])).reshape(-1, len(sides))
        is_allowed = space.allowed_rows(beside)  # else the place itself is one side
        beside = np.where(is_allowed[:, None], beside, np.repeat(at[rows], 2 * len(sides), axis=0))
        up, down = self._checker.state_rooms(beside).reshape(len(rows), 2, len(sides)).swapaxes(0, 1)
        apart_mm = LEAST_MM * np.maximum(is_allowed.reshape(len(rows), 2, len(sides)).sum(axis=1), 1)
        slopes = (up - down) * MM_PER_M / apart_mm
        return [
            NearPlace(int(samples.segment[row]), float(samples.fraction[row]), float(room_m[row]) * MM_PER_M, slope)
            for row, slope in zip(rows, slopes, strict=True)
        ]

    def _rows(self, samples: PathSamples, room_m: Array) -> list[int]:
        """Samples with hardly any room (S,), and those with less than ASTRAY_M that have less than others of their leg.

        A body that is pushed along its own track is as near to what it passes all the time.
        """
        is_near = room_m < ALIKE_M
        for leg in np.unique(samples.segment).tolist():
            on_leg = np.flatnonzero(samples.segment == leg)
            valleys = on_leg[_valleys(room_m[on_leg])]
            is_near[valleys] |= room_m[valleys] < ASTRAY_M
        return np.flatnonzero(is_near).tolist()

    def _at(self, q: Array, phi: Array | None) -> list[tuple[float, Array]]:
        """Rooms [mm] of body points at q (m,) that have less than those beside them, and how joints (m,) change them.

        They are those of the corner shapes that are about as near as the nearest one, and of the interpolated one with
        friction state phi (P,), where there is one.
        """
        key = q.tobytes()
        if key not in self._known:
            self._known[key] = list(self._solved(q, phi))
        return self._known[key]

    def _solved(self, q: Array, phi: Array | None) -> Iterator[tuple[float, Array]]:
        checker, mechanics, scenario = self._checker, self._checker.mechanics, self._checker.scenario
        grid, spacing_m, needed_m = anatomy_grid(scenario), checker.density.point_spacing_m, checker.limits.clearance_m
        assert grid is not None, "there is a field"
        checker.watch.ask()
        pairs, (theta_b, l_b) = mechanics.n - 1, checker.space.drive.collars(q)
        states = np.vstack([np.zeros(pairs), corner_signs(pairs)])
        if phi is not None and np.isfinite(phi).all():
            states = np.vstack([states, phi])
        bodies = mechanics.friction_bodies(theta_b, l_b, states, spacing_m=spacing_m)
        if not bodies.solved.all():
            return
        rooms = grid.sample(scenario.located(bodies.point_m.reshape(-1, 3))).reshape(len(states), -1)
        least_m = (rooms - bodies.radius_m).min(axis=1)
        moves = checker.space.drive.collars_by_joints(q[None])[0]
        moved = np.flatnonzero(moves.any(axis=1))
        names, moves = [collar_names(mechanics.n)[k] for k in moved.tolist()], moves[moved]
        sides = grid.spacing_m / 2 * np.vstack([np.eye(3), -np.eye(3)])
        near = states[least_m < least_m.min() + ALIKE_M]
        checker.meter.add(checker.solved_ns * (1 + len(near)))  # derivatives of a shape take as long as all shapes
        for state in near:
            body, by, _, _ = mechanics.core_body(theta_b, l_b, state, names, "search", spacing_m)
            own = scenario.located(body[:, :3])
            room_m = grid.sample(own) - body[:, 3] - needed_m
            for k in _lowest(room_m).tolist():
                if room_m[k] < max(ASTRAY_M, room_m.min() + ALIKE_M):
                    up, down = grid.sample(own[k] + sides).reshape(2, 3)
                    slope = (up - down) / grid.spacing_m @ scenario.base_R @ np.nan_to_num(by[k]) @ moves
                    yield float(room_m[k]) * MM_PER_M, slope / checker.space.weights_mm * MM_PER_M


# Places of a leg, by Gauss's rule on [0, 1], at which the bound is differenced, and their weights
GAUSS = (np.polynomial.legendre.leggauss(3)[0] + 1) / 2, np.polynomial.legendre.leggauss(3)[1] / 2


def slope_along(checker: MotionChecker, corners: Array, levels: Levels, samples: PathSamples) -> Array:
    """(X,) how levels change what the error along a walked path (K, m) costs, the friction law's loads as they are."""
    space, cost, result = checker.space, checker.scenario.cost, np.zeros(levels.spread.shape[2])
    if not cost.error_along or not result.size:
        return result
    error_m = checker.errors(corners, samples)
    share = error_m / np.maximum(samples.position_m, 1e-12)
    price = cost.error_along * MM_PER_M / cost.mm_per_rad  # of m over mm
    fraction, weight = GAUSS
    for leg in np.unique(samples.segment).tolist():  # a walk that breaks a limit ends there
        on_leg = np.flatnonzero(samples.segment == leg)
        rows, at = np.append(max(on_leg[0] - 1, 0), on_leg), np.append(0.0, samples.fraction[on_leg])
        moved = (corners[leg + 1] - corners[leg]) * space.weights_mm
        length_mm = float(np.linalg.norm(moved))
        mean_m = float(np.trapezoid(error_m[rows], at))
        if price * mean_m * length_mm < LEAST_MM:
            continue
        spread = levels.spread[leg : leg + 2]
        result += price * mean_m * (moved / length_mm) @ (spread[1] - spread[0])
        q = corners[leg] + fraction[:, None] * (corners[leg + 1] - corners[leg])
        by = bound_slopes(checker, q).bound_by / space.weights_mm
        by *= (weight * np.interp(fraction, at, share[rows]))[:, None]
        for place, f in zip(by, fraction, strict=True):
            result += price * length_mm * place @ ((1 - f) * spread[0] + f * spread[1])
    return result


def _places(corners: Array, samples: PathSamples) -> Array:
    """(S, m) joint values on a path (K, m) where a walk of it, or of one with legs like its own, has its samples."""
    begins, ends = corners[samples.segment], corners[np.minimum(samples.segment + 1, len(corners) - 1)]
    return begins + samples.fraction[:, None] * (ends - begins)


def _valleys(values: Array) -> list[int]:
    """Where values (N,) are least between ridges that rise from there by ALIKE_M on either side."""
    result, least, ridge = list[int](), 0, np.inf
    for row, value in enumerate(values.tolist()):
        if np.isfinite(ridge):
            ridge = max(ridge, value)
            if value <= ridge - ALIKE_M:
                least, ridge = row, np.inf
        elif value < values[least]:
            least = row
        elif value >= values[least] + ALIKE_M:
            result.append(least)
            ridge = value
    return result if np.isfinite(ridge) else [*result, least]


def _lowest(values: Array) -> NDArray[np.intp]:
    """Rows of values (N,) that are less than those on either side; the first of equal ones."""
    before, after = np.append(np.inf, values[:-1]), np.append(values[1:], np.inf)
    return np.flatnonzero((values < before) & (values <= after))


class PathModel:
    """What motions x (X,) [mm] of a path's levels do: quadratic for its cost, linear for all that is limited."""

    def __init__(
        self,
        checker: MotionChecker,
        corners: Array,
        levels: Levels,
        places: list[NearPlace],
        along: Array | float = 0.0,
    ) -> None:
        """`corners` (K, m); places as they are there, and the slope (X,) of what the error along the way costs."""
        self._checker, self._space, self._cost = checker, checker.space, checker.scenario.cost
        self.corners, self.levels, self.size, self.places = corners, levels, levels.spread.shape[2], places
        limits = [self._of_places(places), self._of_nesting(), self._of_joints()]
        self.rows, self.room_mm = (np.concatenate(parts) for parts in zip(*limits, strict=True))
        kept = np.any(self.rows != 0, axis=1)  # no motion puts the others right
        self.rows, self.room_mm = self.rows[kept], self.room_mm[kept]
        self.along = np.zeros(self.size) + along
        self.curvature, self.slope = self._of_length()
        self.slope = self.slope + self.along
        if levels.has_goal:
            bound_by = self.slopes.bound_by[0] / self._space.weights_mm * MM_PER_M
            self.slope = self.slope + self._cost.error_goal * bound_by @ levels.spread[-1]

    @cached_property
    def slopes(self) -> BoundSlopes:
        """Derivatives of the bound and the tip at the goal."""
        return bound_slopes(self._checker, self.corners[-1:])

    def step(self, damping: float) -> Array | None:
        """The motion (X,) that lowers the cost most, less `damping` |x|^2 / 2; None where none is within limits."""
        return self._least(self.curvature + damping * np.eye(self.size), self.slope)

    def gain_mm(self, motion: Array) -> float:
        """By how much a motion (X,) lowers the cost."""
        return float(-self.slope @ motion - motion @ self.curvature @ motion / 2)

    def foreseen_mm(self, walked: PathModel) -> float:
        """What its path costs less stops and what is unknown, by the walked path's slope of the error along the way."""
        legs, spread = np.diff(self.corners, axis=0), self.levels.spread
        motion = np.einsum("km,kmx->x", (self.corners - walked.corners) * self._space.weights_mm, spread)
        motion /= np.maximum(spread.sum(axis=(0, 1)), 1.0)
        cost_mm = self._cost.path * float(self._space.lengths_mm(legs).sum()) + float(self.along @ motion)
        if not self.levels.has_goal:
            return cost_mm
        return cost_mm + self._cost.error_goal * MM_PER_M * float(self.slopes.bound_m[0])

    def nearest(self, motion: Array) -> Array | None:
        """The motion (X,) within limits that is nearest to another; to none, the least that mends broken limits."""
        return self._least(np.eye(self.size), -motion)

    def correction(self) -> Array | None:
        """The motion (X,) that mends broken limits and lowers the cost, without limits about as long as the least.

        None without any. The least alone may cost more than all that was gained.
        """
        least = self.nearest(np.zeros(self.size))
        size = 0.0 if least is None else float(np.linalg.norm(least))
        return self.step(float(np.linalg.norm(self.slope)) / size) if size > 0 else least

    def _least(self, curvature: Array, slope: Array) -> Array | None:
        """The least of a quadratic within limits, the tip where it is."""
        free = self._free
        if not free.shape[1]:
            return None
        y = least_within(free.T @ curvature @ free, free.T @ slope, self.rows @ free, self.room_mm)
        return None if y is None else np.asarray(free @ y)

    @cached_property
    def _free(self) -> Array:
        """(X, Y) orthonormal motions that leave the tip where it is."""
        if not self.levels.has_goal:
            return np.eye(self.size)
        by = self.slopes.tip_by[0] / self._space.weights_mm * MM_PER_M @ self.levels.spread[-1]
        _, values, turned = np.linalg.svd(by)
        return np.asarray(turned[int(np.sum(values > RANK * values[0])) :].T)

    def _of_places(self, places: list[NearPlace]) -> tuple[Array, Array]:
        """Rows (R, X) and room (R,) [mm] of clearance."""
        spread, rows = self.levels.spread, np.zeros((len(places), self.size))
        for row, place in zip(rows, places, strict=True):
            ends = (1 - place.fraction) * spread[place.leg] + place.fraction * spread[place.leg + 1]
            row[:] = -place.by_joints @ ends
        room_mm = np.array([place.room_mm for place in places])
        spared_mm = room_mm - SPARE_MM
        return rows, np.where(room_mm < 0, spared_mm, np.maximum(spared_mm, 0.0))

    def _of_nesting(self) -> tuple[Array, Array]:
        """Rows (R, X) and room (R,) [mm] of the tubes' nesting at every corner."""
        (slope, room), weights_mm = self._space.nesting_rules, self._space.weights_mm
        rows = MM_PER_M * np.einsum("rm,kmx->krx", slope / weights_mm, self.levels.spread)
        left_mm = MM_PER_M * (room - self.corners @ slope.T)
        return rows.reshape(left_mm.size, self.size), np.maximum(left_mm.reshape(-1), 0.0)

    def _of_joints(self) -> tuple[Array, Array]:
        """Rows (R, X) and room (R,) [mm] of the joints' limits at every corner."""
        drive, rows = self._space.drive, self.levels.spread.reshape(self.corners.size, self.size)
        left = np.stack([drive.upper - self.corners, self.corners - drive.lower]) * self._space.weights_mm
        room_mm = left.reshape(-1)
        is_limited = np.isfinite(room_mm)
        return np.concatenate([rows, -rows])[is_limited], np.maximum(room_mm[is_limited], 0.0)

    def _of_length(self) -> tuple[Array, Array]:
        """The length's curvature (X, X), which overestimates it, and its slope (X,), weighted as the cost does."""
        curvature, slope = np.zeros((self.size, self.size)), np.zeros(self.size)
        for kind in (self._space.drive.is_rotation, ~self._space.drive.is_rotation):
            legs = np.diff(self.corners * self._space.weights_mm, axis=0)[:, kind]
            spread = np.diff(self.levels.spread, axis=0)[:, kind]
            length = np.maximum(np.linalg.norm(legs, axis=1), LEAST_MM)
            curvature += np.einsum("kmx,kmy,k->xy", spread, spread, self._cost.path / length)
            slope += np.einsum("kmx,km,k->x", spread, legs, self._cost.path / length)
        return curvature, slope
