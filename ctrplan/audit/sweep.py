"""The whole way under everything that a scenario allows: a sweep that looks closer where a body may be nearest, and
descents from the worst places.

At a row, friction states of the file's robot are solved, and the frictionless robot at either end of every axis (play,
parameters, delays). A point of a body comes nearer by what each axis takes off its distance; the sum over axes predicts
the worst vertex, which is solved. No distance changes by more than the point moves. So between two rows
the clearance is at least the mean of theirs less half the motion between them: the interval where that is least is
halved next, until none can break the claim. What is looked at depends on the plan alone.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.audit.allowed_robots import nearest_base
from ctrplan.audit.audited_plan import AuditedPlan
from ctrplan.base.arrays import CHI95, Array
from ctrplan.errors import CtrplanError

FIRST_ROWS, ROWS_OF_A_ROUND = 33, 16  # places of the way to begin with, and between two descents: budgets of the hunt
SPACING_M = 2e-3  # between the points of a body in a sweep
CLOSEST_M = 0.1e-3  # of motion between rows, below which the interval is not halved
MOST_GRID = 3  # pairs of tubes whose friction states are a grid of -1, 0 and 1; of more, corners and middle
SAME_PLACE = 0.004  # by which descents begin apart
HALVINGS = 9  # of the steps of a descent
CLOSE_M = 0.3e-3  # more than is claimed, within which the judge's mesh descends too: what meshes differ by
SOLVE = 6  # work of a configuration, in that of a friction state in it


@dataclass(frozen=True, eq=False)
class Row:
    """A place, and what is predicted there of F friction states."""

    place: float
    point_m: Array  # (F, N, 3) bodies of the file's robot, at even shares of their length
    alone_m: Array  # (F,) clearance of the file's robot
    least_m: Array  # (F,) predicted at the worst vertex of the axes
    vertex: Array  # (F, A) which that is
    low_m: float  # clearance at the lowest of these vertices, solved; sums over axes predict too little where they bend


@dataclass(frozen=True, eq=False)
class Suspect:
    """A place, a friction state (P,) and axes (A,) of the allowed robots there."""

    place: float
    phi: Array
    axes: Array


class MotionSweep:
    """Rounds of rows and a descent each; `is_done` once no interval is left in which the claim could be broken."""

    def __init__(self, case: AuditedPlan) -> None:
        """case: what is judged."""
        self.case = case
        pairs = case.pairs
        signs = (0.0, 1.0, -1.0) if pairs <= MOST_GRID else (1.0, -1.0)
        grid = [row for row in itertools.product(signs, repeat=pairs) if any(row)]
        self.phi = np.array([(0.0,) * pairs, *grid]).reshape(1 + len(grid), pairs)
        self.count = 2 + int(max(tube.length_m for tube in case.robot.tubes) / SPACING_M)
        self.rows: dict[float, Row] = {}
        self.intervals: list[tuple[float, float, float]] = []
        first = np.unique(np.append(np.linspace(0, 1, FIRST_ROWS), case.sample_place[[0, -1]]))
        self.first = [*case.way.bent(first), *first.tolist()]
        self.descended: list[tuple[bool, float]] = []
        self.is_done = False

    def round(self) -> Iterator[None]:
        """Looks at some places, and goes downhill from the worst ones. Yields where it may be stopped."""
        for _ in range(ROWS_OF_A_ROUND):
            if self.first:
                self._look(self.first.pop(0))
            elif not self._halved():
                break
            yield
        if self.first:
            return
        before = len(self.descended)
        for of_all in (True, False):
            if (begin := self._next(of_all)) is not None:
                yield from self._descent(begin)
        self.is_done = len(self.descended) == before and not self.intervals

    def _halved(self) -> bool:
        """Looks at the middle of the interval that may hide most; False where none may break the claim."""
        while self.intervals:
            _, low, high = heapq.heappop(self.intervals)
            middle = (low + high) / 2
            if self._look(middle):
                return True
        return False

    def _look(self, place: float) -> bool:
        row = self._row(place)
        if row is None:
            return False
        self.rows[place] = row
        known = sorted(self.rows)
        at = known.index(place)
        for low, high in itertools.pairwise(known[max(at - 1, 0) : at + 2]):
            self._keep(self.rows[low], self.rows[high])
        return True

    def _keep(self, a: Row, b: Row) -> None:
        """Notes the interval between two rows, if the claim could be broken in it."""
        moved = float(np.linalg.norm(a.point_m - b.point_m, axis=2).max())
        bound = (a.low_m + b.low_m - moved) / 2
        if moved > CLOSEST_M and bound < self.case.stated("clearance", a.place):
            heapq.heappush(self.intervals, (bound, a.place, b.place))

    def _row(self, place: float) -> Row | None:
        case = self.case
        own = self._bodies(place, self.phi, case.middle)
        if own is None:
            return None
        points, radius, solved = own
        base = self._base_m(points)
        others: list[tuple[int, float, Array, Array]] = []
        for axis, side in case.robots.ends:
            other = self._bodies(place, self.phi[:1], side * np.eye(case.robots.count)[axis])
            if other is not None and other[2][0]:
                others.append((axis, side, other[0][0], other[1]))
        middle = self._rooms(points[:1], radius)[0]
        moved = np.linalg.norm(points - points[0], axis=2)
        moved[np.logical_not(solved)] = 0.0
        shifts = np.zeros((case.robots.count, points.shape[1]))
        for axis, _, body, _ in others:
            shifts[axis] = np.maximum(shifts[axis], np.linalg.norm(body - points[0], axis=1))
        # points that can't be nearest, whatever is moved, are not looked at: they keep the bound
        near = middle - moved.max(axis=0) - shifts.sum(axis=0) - base.max(axis=0) <= (middle - base[0]).min()
        rooms = middle - moved
        rooms[:, near] = self._rooms(points[:, near], radius[near])
        rooms[np.logical_not(solved)] = np.inf
        nearer, sides = shifts.copy(), np.zeros(shifts.shape)
        nearer[:, near] = 0.0
        for axis, side, body, filled in others:
            taken = np.where(near, -np.inf, 0.0)
            taken[near] = rooms[0, near] - self._rooms(body[None, near], filled[near])[0]
            more = near & (taken > nearer[axis])
            nearer[axis, more], sides[axis, more] = taken[more], side
        predicted = rooms - nearer.sum(axis=0) - base
        k = np.argmin(predicted, axis=1)
        least = predicted[np.arange(len(predicted)), k]
        row = Row(place, points, rooms.min(axis=1), least, sides.T[k], least.min())
        if not others:
            return row
        f = int(np.argmin(least))
        return replace(
            row, low_m=min(self._score(Suspect(place, self.phi[f], row.vertex[f])), float(row.alone_m.min()))
        )

    def _base_m(self, points: Array) -> Array:
        """(F, N) [m] more than which the registration takes off no point."""
        registration, base = self.case.plan.scenario.registration, self.case.plan.scenario.base_position_m
        lever: Array = np.linalg.norm(points - base, axis=2)
        return CHI95 * (registration.position_sigma_m + registration.rotation_sigma_rad * lever)

    def _bodies(self, place: float, phi: Array, axes: Array) -> tuple[Array, Array, Array] | None:
        """(S, N, 3) of the anatomy's frame, radii (N,), and which are solved (S,); None where none is."""
        case = self.case
        case.work += SOLVE + len(phi)
        try:
            collars, robot = case.collars(place, axes), case.robot_at(axes)
            bodies = robot.mechanics.friction_bodies(*collars, phi, spacing_m=SPACING_M)
        except CtrplanError:
            return None
        if not bodies.solved[0]:
            return None
        given = bodies.point_m.shape[1]
        at = np.linspace(0, given - 1, self.count)
        k = np.minimum(at.astype(np.intp), max(given - 2, 0))
        share, after = (at - k)[:, None], np.minimum(k + 1, given - 1)
        points = bodies.point_m[:, k] * (1 - share) + bodies.point_m[:, after] * share
        radius = np.maximum(bodies.radius_m[k], bodies.radius_m[after])
        stands = [
            (case.located(turned.reshape(-1, 3)).reshape(turned.shape), radius - margin_m)
            for turned, margin_m in case.stands(points, place, axes)
        ]
        if stands[1:]:
            stands.sort(key=lambda stand: float(self._rooms(stand[0][:1], stand[1]).min()))
        return *stands[0], np.asarray(bodies.solved)

    def _rooms(self, points: Array, radius: Array) -> Array:
        """(S, N) clearances of bodies (S, N, 3) with radii (N,)."""
        self.case.count_points(points.shape[0] * points.shape[1])
        return self.case.anatomy.along(points) - radius

    def _next(self, of_all: bool) -> Suspect | None:
        """The lowest place along the way that no descent began near: of all that is allowed, or of friction alone."""
        known = [self.rows[place] for place in sorted(self.rows)]
        if not known or (of_all and not self.case.robots.count):
            return None
        low = np.array([row.low_m if of_all else float(row.alone_m.min()) for row in known])
        before, after = np.append(np.inf, low[:-1]), np.append(low[1:], np.inf)
        for k in np.argsort(np.where((low <= before) & (low <= after), low, np.inf)):
            row = known[k]
            if not (low[k] <= before[k] and low[k] <= after[k] and np.isfinite(low[k])):
                return None
            if any(kind == of_all and abs(row.place - place) < SAME_PLACE for kind, place in self.descended):
                continue
            self.descended.append((of_all, row.place))
            f = int(np.argmin(row.least_m if of_all else row.alone_m))
            return Suspect(row.place, self.phi[f], row.vertex[f] if of_all else self.case.middle)
        return None

    def _score(self, at: Suspect) -> float:
        """Clearance on the coarse mesh, the base where its registration brings the body nearest; inf where unsolved."""
        case = self.case
        body = self._bodies(at.place, at.phi[None], at.axes)
        if body is None or not body[2].all():
            return np.inf
        points, radius, _ = body
        scenario = case.plan.scenario
        if scenario.registration.is_exact:
            least, looked = case.anatomy.least(points, radius)
            case.count_points(looked)
            return float(least[0])
        rooms = self._rooms(points, radius)[0]
        move = nearest_base(scenario.registration, case.anatomy, points[0], rooms, scenario.base_position_m)
        return float((case.anatomy.room(move.of(points[0], scenario.base_position_m)) - radius).min())

    def _descent(self, begin: Suspect) -> Iterator[None]:
        """Compass search over place, friction state and vertex on the coarse mesh; its end on the judge's mesh."""
        known = sorted(self.rows)
        at = known.index(begin.place)
        step = max(1 / FIRST_ROWS, *np.diff(known[max(at - 1, 0) : at + 2])) / 2
        best, least, size = begin, self._score(begin), 0.5
        for _ in range(HALVINGS):
            for other in self._around(best, step, size):
                if (score := self._score(other)) < least:
                    best, least = other, score
            yield
            step, size = step / 2, size / 2
        yield from self._confirmed(best, 4 * step)

    def _around(self, at: Suspect, step: float, size: float) -> Iterator[Suspect]:
        """States one step away along the way and in friction, and vertices with one axis at another end."""
        for side in (1, -1):
            if (place := float(np.clip(at.place + side * step, 0, 1))) != at.place:
                yield replace(at, place=place)
        for row in np.eye(len(at.phi)):
            for side in (1, -1):
                if np.any((phi := np.clip(at.phi + side * size * row, -1, 1)) != at.phi):
                    yield replace(at, phi=phi)
        if np.any(at.axes):
            for axis, end in self.case.robots.ends:
                if at.axes[axis] != end:
                    yield replace(at, axes=np.where(np.arange(len(at.axes)) == axis, end, at.axes))

    def _confirmed(self, at: Suspect, step: float) -> Iterator[None]:
        """The state on the judge's mesh; from what is nearly broken it goes downhill by what that mesh says."""
        least = self._judged(at)
        yield
        if least - self.case.stated("clearance", at.place) > CLOSE_M:
            return
        for size in (0.1, 0.05):
            for other in self._around(at, step, size):
                if (score := self._judged(other)) < least:
                    at, least = other, score
                yield

    def _judged(self, at: Suspect) -> float:
        result = self.case.solved(at.place, tuple(at.phi), at.axes)
        self.case.note(result)
        return min((f.value for f in result if f.claim == "clearance"), default=np.inf)
