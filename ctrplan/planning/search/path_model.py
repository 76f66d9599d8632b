"""What small motions of a path's corners do: to its length and its error at the goal, to clearance, limits and tip.

A path of legs is a sequence of values for the rotations and one for the translations, each held until the next leg of
its kind: the levels. Motions of levels change the cost about quadratically and all else about linearly, so that the
best motion within limits is a quadratic programme.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class Levels:
    """How corners of a path may move, by a number for each joint of each level."""

    spread: Array  # (K, m, X) of joints weighted to mm: 1 where a number moves them
    level: NDArray[np.int_]  # (X,) the level of each
    has_goal: bool  # whether the last level is the goal's


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
        room_m = samples.clearance_m - self._checker.limits.clearance_m
        for leg in range(len(corners) - 1):
            on_leg = np.flatnonzero(samples.segment == leg)
            for row in on_leg[_lowest(room_m[on_leg])].tolist():
                if room_m[row] >= ASTRAY_M:
                    continue
                fraction = float(samples.fraction[row])
                q = corners[leg] + fraction * (corners[leg + 1] - corners[leg])
                near = self._at(q, samples.nearest_phi[row] if samples.nearest_phi.size else None)
                least = min((room_mm for room_mm, _ in near), default=0.0)
                off_mm = float(room_m[row]) * MM_PER_M - least  # of interpolated shapes
                yield from (NearPlace(leg, fraction, room_mm + off_mm, by) for room_mm, by in near)

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


def _lowest(values: Array) -> NDArray[np.intp]:
    """Rows of values (N,) that are less than those on either side; the first of equal ones."""
    before, after = np.append(np.inf, values[:-1]), np.append(values[1:], np.inf)
    return np.flatnonzero((values < before) & (values <= after))


class PathModel:
    """What motions x (X,) [mm] of a path's levels do: quadratic for its cost, linear for all that is limited."""

    def __init__(self, checker: MotionChecker, corners: Array, levels: Levels, places: list[NearPlace]) -> None:
        """`corners` (K, m); places as they are there."""
        self._checker, self._space, self._cost = checker, checker.space, checker.scenario.cost
        self.corners, self.levels, self.size = corners, levels, levels.spread.shape[2]
        limits = [self._of_places(places), self._of_nesting(), self._of_joints()]
        self.rows, self.room_mm = (np.concatenate(parts) for parts in zip(*limits, strict=True))
        kept = np.any(self.rows != 0, axis=1)  # no motion puts the others right
        self.rows, self.room_mm = self.rows[kept], self.room_mm[kept]
        self.curvature, self.slope = self._of_length()
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

    def nearest(self, motion: Array) -> Array | None:
        """The motion (X,) within limits that is nearest to another; to none, the least that mends broken limits."""
        return self._least(np.eye(self.size), -motion)

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
