"""Room that the anatomy leaves: whether for what a scenario requires, said in words before any search begins; and what
it lets a search expect of states that are not solved.

Friction and the clearance between tubes move shapes by millimetres, so that less clearance is left than the room around
zero-clearance shapes. How much less changes slowly over joint space: it is a Gaussian process there, which every solved
state teaches. And how motions of the joints change it, for who leads a tip past walls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtr

from ctrplan.anatomy.parts import AnatomyPart, surface_distance
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.motion.checker import MotionChecker
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import anatomy_grid

if TYPE_CHECKING:
    from ctrplan.anatomy.clearance_grid import SignedDistanceField
    from ctrplan.mechanics.walk import PathSamples
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.scenario.tip_solver import TipSolver


def refuse_blocked_target(checker: MotionChecker) -> None:
    """Raises NoAnswerError for a tip target in a structure, outside the lumen, or nearer to a wall than allowed."""
    scenario = checker.scenario
    target, tolerance = scenario.goal.tip_m, scenario.goal.tolerance_m
    if target is None:
        return
    needed = scenario.robot.tubes[-1].outer_diameter_m / 2 + scenario.robot.model_error_m
    sentence = blocked(scenario, target, needed, tolerance)
    if sentence:
        raise NoAnswerError(f"{scenario.path or scenario.name}: {scenario.goal.place}: {sentence}.")


def blocked(scenario: Scenario, point: Array, needed_m: float, tolerance_m: float) -> str:
    """Why a body of radius `needed_m` can't come within `tolerance_m` of a point (3,); empty if it can."""
    for k, part in enumerate(scenario.anatomy):
        if part.role == "avoid":
            outside = float(surface_distance(part, point[None])[0])
            if outside - part.margin_m - needed_m < -tolerance_m:
                return _inside(scenario, k, outside) if outside < 0 else _too_near(scenario, k, outside, needed_m)
    lumens = [k for k, part in enumerate(scenario.anatomy) if part.role == "inside"]
    if lumens:
        room = {k: -float(surface_distance(scenario.anatomy[k], point[None])[0]) for k in lumens}
        k = max(room, key=lambda k: room[k] - scenario.anatomy[k].margin_m)
        if room[k] - scenario.anatomy[k].margin_m - needed_m < -tolerance_m:
            return _outside(scenario, k, -room[k]) if room[k] < 0 else _too_near(scenario, k, room[k], needed_m)
    return ""


def start_room(checker: MotionChecker) -> float:
    """Clearance [m] that a scenario's start leaves beyond the margins and the play, whatever the checker's reserve."""
    _, samples = checker.probe(checker.scenario.start)
    if samples is None:
        return 0.0
    return float(samples.clearance_m[-1]) - (checker.limits.clearance_m - checker.reserve_m)


def start_trouble(checker: MotionChecker) -> str:
    """Where the start leaves the lumen or enters a structure, in words; empty where neither is the trouble."""
    scenario = checker.scenario
    if not scenario.anatomy or not checker.space.allowed(scenario.start):
        return ""
    located, radius = _body(checker, scenario.start)
    lumens = [(k, part) for k, part in enumerate(scenario.anatomy) if part.role == "inside"]
    if lumens:
        depth = np.max([-surface_distance(part, located) for _, part in lumens], axis=0)
        worst = int(np.argmin(depth - radius))
        if depth[worst] < radius[worst]:
            out_mm, where = (radius - depth)[worst] * MM_PER_M, _at(located[worst])
            return f"the robot leaves {_lumens(scenario, lumens)} by {out_mm:.2f} mm at {where}"
    for k, part in enumerate(scenario.anatomy):
        outside = surface_distance(part, located) - radius
        worst = int(np.argmin(outside))
        if part.role == "avoid" and outside[worst] < 0:
            deep_mm, where = -outside[worst] * MM_PER_M, _at(located[worst])
            return f"the robot cuts {deep_mm:.2f} mm into {called(scenario, k)} at {where}"
    return _margin_trouble(scenario, located, radius)


def tightest_place(checker: MotionChecker, joints: Array) -> str:
    """Where the frictionless body of joints (m,) has least room beyond the margins, in words; empty in free space."""
    if not checker.scenario.anatomy:
        return ""
    located, radius = _body(checker, joints)
    k, worst, _, _ = _tightest(checker.scenario, located, radius)
    return f"{called(checker.scenario, k)} at {_at(located[worst])}"


def _body(checker: MotionChecker, joints: Array) -> tuple[Array, Array]:
    """Points (N, 3) [m] of the frictionless centreline in the anatomy's frame, radii (N,)."""
    points, radius = checker.mechanics.body(*checker.space.drive.collars(joints))
    return checker.scenario.located(points[0]), radius


def _margin_trouble(scenario: Scenario, located: Array, radius: Array) -> str:
    """The margin that the body, points (N, 3) in the anatomy's frame and radii (N,), breaks most."""
    k, worst, room, beyond = _tightest(scenario, located, radius)
    if beyond >= scenario.robot.model_error_m:
        return ""
    margin_mm, where = scenario.anatomy[k].margin_m * MM_PER_M, _at(located[worst])
    near = f"the robot is {room * MM_PER_M:.2f} mm from {called(scenario, k)} at {where}"
    return f"{near}, less than margin_mm = {margin_mm:g}"


def _tightest(scenario: Scenario, located: Array, radius: Array) -> tuple[int, int, float, float]:
    """The part and the point of a body with least room beyond margins; room [m] there, and beyond the margin."""
    sides = np.array([1.0 if part.role == "avoid" else -1.0 for part in scenario.anatomy])
    margins = np.array([part.margin_m for part in scenario.anatomy])
    rooms = sides[:, None] * [surface_distance(part, located) for part in scenario.anatomy] - radius
    beyond = rooms - margins[:, None]
    lumens = sides < 0
    if lumens.any():  # one of them is enough, at each point another
        best = np.argmax(np.where(lumens[:, None], beyond, -np.inf), axis=0)
        beyond[lumens[:, None] & (np.arange(len(sides))[:, None] != best)] = np.inf
    k, worst = np.unravel_index(np.argmin(beyond), beyond.shape)
    return int(k), int(worst), float(rooms[k, worst]), float(beyond[k, worst])


def refuse_impossible_margins(scenario: Scenario) -> None:
    """Raises InputError where margins leave no room for even the innermost tube anywhere."""
    grid = anatomy_grid(scenario)
    if grid is None:
        return
    needed = scenario.robot.tubes[-1].outer_diameter_m / 2 + scenario.robot.model_error_m
    most = float(grid.values_m.max()) + grid.spacing_m  # a grid may miss the very best place by less than a step
    if most < needed:
        rule = (
            f"leave no room for the innermost tube anywhere: it needs {needed * MM_PER_M:.2f} mm, beyond the margins "
            f"there are {max(most, 0.0) * MM_PER_M:.2f} mm at best"
        )
        margins = ", ".join(f"{part.margin_m * MM_PER_M:g}" for part in scenario.anatomy)
        raise InputError(rule, file=scenario.path, key=f"anatomy margin_mm = [{margins}]")


def called(scenario: Scenario, k: int) -> str:
    """Part k (from 0) as a reader of the scenario file knows it."""
    return f"anatomy.{k + 1} ({scenario.anatomy[k].shape.name})"


def _inside(scenario: Scenario, k: int, outside_m: float) -> str:
    return f"lies {-outside_m * MM_PER_M:.2f} mm inside {called(scenario, k)}, which is to be avoided"


def _outside(scenario: Scenario, k: int, outside_m: float) -> str:
    return f"lies {outside_m * MM_PER_M:.2f} mm outside {called(scenario, k)}, which the robot stays within"


def _too_near(scenario: Scenario, k: int, distance_m: float, needed_m: float) -> str:
    own, margin, robot = distance_m * MM_PER_M, scenario.anatomy[k].margin_m * MM_PER_M, needed_m * MM_PER_M
    return (
        f"is {own:.2f} mm from the surface of {called(scenario, k)}, nearer than its margin_mm = {margin:g} and the "
        f"robot's own {robot:.2f} mm allow"
    )


def _lumens(scenario: Scenario, lumens: list[tuple[int, AnatomyPart]]) -> str:
    return called(scenario, lumens[0][0]) if len(lumens) == 1 else "all lumens"


def _at(point_m: Array) -> str:
    return f"{[round(float(x), 1) for x in point_m * MM_PER_M]} mm"


def refuse_blocked_fixtures(scenario: Scenario) -> None:
    """Raises NoAnswerError where a fixture is nearer to the anatomy than margins allow."""
    if trouble := fixture_trouble(scenario):
        raise NoAnswerError(f"{scenario.path or scenario.name}: {trouble}.")


def fixture_trouble(scenario: Scenario) -> str:
    """The fixture that breaks its margins most, in words; empty where all keep them."""
    results = [
        (*fixture.clearance(scenario.anatomy, scenario.base_position_m, scenario.base_R), k, fixture.name)
        for k, fixture in enumerate(scenario.fixtures, 1)
    ]
    clearance, place, k, name = min(results, key=lambda entry: entry[0], default=(np.inf, np.zeros(3), 0, ""))
    if clearance >= 0:
        return ""
    at = [round(float(x), 1) for x in place * MM_PER_M]
    return (
        f"fixture.{k} ({name}): is {-clearance * MM_PER_M:.2f} mm nearer to the anatomy than margins allow, at {at} mm"
    )


# What is lost of the room [m] before any state near is solved, its standard deviation, how far neighbours differ at
# least, and the joint length [mm] over which it changes: of greatest marginal likelihood for 1,322 states that twelve
# searches of two scenarios solved.
LOSS_M, LOSS_SD_M, SCATTER_M, LOSS_MM = 1e-3, 2e-3, 0.2e-3, 30.0
LEAST_HOPE = 0.01  # however little is expected: the surrogate may be wrong


def expected_share(room_m: Array) -> Array:
    """Share of states that leave any clearance, by their rooms [m], before any near them is solved."""
    return _share_valid(room_m, np.full(len(room_m), LOSS_M), np.full(len(room_m), LOSS_SD_M**2))


class ClearanceSurrogate:
    """The probability that places in joint space leave any clearance, given what was solved.

    The covariance of what two places lose falls with the distance between them (Matern, of smoothness 3/2), rotations
    counted as chords, so that it is one for any number of turns. Each solved place is a row of the Cholesky factor of
    all covariances, continued to places that are not solved.
    """

    def __init__(self, space: JointSpace) -> None:
        """Nothing is solved yet."""
        self.space = space
        self.joints: Array = np.empty((0, len(space.weights_mm)))
        self.room_m: Array = np.empty(0)
        self.loss_m: Array = np.empty(0)  # expected
        self.variance: Array = np.empty(0)  # [m^2]
        self._at_mm = self._embedded(self.joints)
        self._solved: list[int] = []  # numbers of N places
        self._surprise: Array = np.empty(0)  # (N,) of what was solved, in deviations
        self._kept: Array = np.empty((0, 0))  # rows, and room for more, so that they are not copied each time
        self._factor: Array = np.empty((0, 0))  # the Cholesky factor (N, N) [m], and room for more

    def extend(self, joints: Array, room_m: Array) -> NDArray[np.int_]:
        """Adds places (K, m) with their rooms (K,) [m]; returns their numbers (K,)."""
        rows, first = self._continued(joints), len(self.room_m)
        loss_m, variance = self._expected(rows)
        self.joints, self.room_m = np.concatenate([self.joints, joints]), np.concatenate([self.room_m, room_m])
        self._at_mm = np.concatenate([self._at_mm, self._embedded(joints)])
        self.loss_m, self.variance = np.append(self.loss_m, loss_m), np.append(self.variance, variance)
        self._kept = _with_room(self._kept, len(self._solved), len(self.room_m))
        self._rows[:, first:] = rows
        return np.arange(first, len(self.room_m))

    def learn(self, place: int, clearance_m: float) -> None:
        """Takes in what a solved place leaves; nothing of one where that is not known."""
        if not np.isfinite(self.room_m[place] - clearance_m) or place in self._solved:
            return
        deviation_m = np.sqrt(self.variance[place] + SCATTER_M**2)
        surprise = (self.room_m[place] - clearance_m - self.loss_m[place]) / deviation_m
        row = (_covariance(self._at_mm[[place]], self._at_mm)[0] - self._rows[:, place] @ self._rows) / deviation_m
        self.loss_m, self.variance = self.loss_m + surprise * row, self.variance - row**2
        self._surprise = np.append(self._surprise, surprise)
        self._factor = _with_room(self._factor, len(self._solved) + 1, len(self._solved) + 1)
        self._factor[len(self._solved), : len(self._solved)] = self._rows[:, place]
        self._factor[len(self._solved), len(self._solved)] = deviation_m
        self._solved.append(place)
        self._kept = _with_room(self._kept, len(self._solved), len(self.room_m))
        self._rows[-1] = row

    @property
    def _rows(self) -> Array:
        """(N, M) [m] of solved places, to all."""
        return self._kept[: len(self._solved), : len(self.room_m)]

    def share_valid(self) -> Array:
        """(M,) probability that a place leaves any clearance."""
        return _share_valid(self.room_m, self.loss_m, self.variance)

    def share_valid_at(self, joints: Array, room_m: Array) -> Array:
        """(K,) that of other places (K, m) with their rooms (K,) [m]."""
        return _share_valid(room_m, *self._expected(self._continued(joints)))

    def _continued(self, joints: Array) -> Array:
        """(N, K) [m] rows to other places (K, m)."""
        if not self._solved:
            return np.empty((0, len(joints)))
        count = len(self._solved)
        across = _covariance(self._at_mm[self._solved], self._embedded(joints))
        return np.asarray(solve_triangular(self._factor[:count, :count], across, lower=True, check_finite=False))

    def _expected(self, rows: Array) -> tuple[Array, Array]:
        """What places with rows (N, K) lose (K,) [m], and its variance (K,) [m^2]."""
        return LOSS_M + self._surprise @ rows, LOSS_SD_M**2 - (rows**2).sum(axis=0)

    def _embedded(self, joints: Array) -> Array:
        """(K, E) [mm] coordinates in which distances are those of joint values (K, m), rotations as chords."""
        turns, scaled = self.space.drive.is_rotation, joints * self.space.weights_mm
        radius_mm = self.space.weights_mm[turns]
        angles = joints[:, turns]
        return np.concatenate([radius_mm * np.cos(angles), radius_mm * np.sin(angles), scaled[:, ~turns]], axis=1)


def _with_room(kept: Array, rows: int, columns: int) -> Array:
    """The array, twice as large where it has not so many rows or columns: zeros are new."""
    size = kept.shape
    if rows <= size[0] and columns <= size[1]:
        return kept
    larger = np.zeros([max(n, 2 * s) if n > s else s for n, s in zip((rows, columns), size, strict=True)])
    larger[: size[0], : size[1]] = kept
    return larger


def _covariance(a_mm: Array, b_mm: Array) -> Array:
    """(A, B) [m^2] of what embedded places (A, E) and (B, E) lose."""
    scaled = np.sqrt(3) / LOSS_MM * np.linalg.norm(a_mm[:, None] - b_mm, axis=2)
    return np.asarray(LOSS_SD_M**2 * (1 + scaled) * np.exp(-scaled))


def _share_valid(room_m: Array, loss_m: Array, variance: Array) -> Array:
    return np.asarray(ndtr((room_m - loss_m) / np.sqrt(np.maximum(variance, 0.0) + SCATTER_M**2)))


HOLD_OFF_M = 0.1e-3  # room beyond the margins for what a straight motion leaves out: 1 mm along a wall of 5 mm radius
STRETCHES = 24  # of the body, each with the point that has least room


def closer_by_joints(
    checker: MotionChecker, solver: TipSolver, q: Array, samples: PathSamples, most: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """(R, m) how joints at q (m,) bring the body closer to the anatomy [m per rad or m], room (R,) [m], stretches (R,).

    samples: a walk with bodies that ends at q. Of all points that motions up to `most` (m,) may bring too close, the
    one with least room on each stretch. All shapes are taken to move as the zero-clearance one.
    """
    grid = anatomy_grid(checker.scenario)
    if grid is None:
        return np.zeros((0, len(q))), np.zeros(0), np.zeros(0, dtype=int)
    points, share, room = _points_and_rooms(checker, grid, samples)
    motion = _body_by_joints(solver, q, share)
    near = np.flatnonzero(room < np.tile(np.linalg.norm(motion, axis=1) @ most, len(room) // len(share)))
    stretch = _stretch(share)[near % len(share)]
    order = np.lexsort((room[near], stretch))
    stretch, first = np.unique(stretch[order], return_index=True)
    near = near[order[first]]
    shifts = grid.spacing_m / 2 * np.vstack([np.eye(3), -np.eye(3)])
    beside = checker.scenario.located((points[near] + shifts[:, None]).reshape(-1, 3))
    up, down = grid.sample(beside).reshape(2, 3, -1)
    closer = -np.einsum("ir,rij->rj", (up - down) / grid.spacing_m, motion[near % len(share)])
    return closer, room[near], stretch


def rooms_on_stretches(checker: MotionChecker, samples: PathSamples) -> Array:
    """(STRETCHES,) [m] least room of all shapes at the end of a walk with bodies on each stretch, plate to tip.

    Beyond the limit of clearance and HOLD_OFF_M; inf in free space.
    """
    result, grid = np.full(STRETCHES, np.inf), anatomy_grid(checker.scenario)
    if grid is not None:
        _, share, room = _points_and_rooms(checker, grid, samples)
        np.minimum.at(result, np.tile(_stretch(share), len(room) // len(share)), room)
    return result


def _stretch(share: Array) -> NDArray[np.intp]:
    return np.asarray(np.minimum((share * STRETCHES).astype(int), STRETCHES - 1))


def _points_and_rooms(
    checker: MotionChecker, grid: SignedDistanceField, samples: PathSamples
) -> tuple[Array, Array, Array]:
    """(B, 3) points of all shapes at the end of a walk, shares (N,) of the body's length of each one's, rooms (B,)."""
    body = samples.bodies[-1]
    own = body[: len(body) // (len(samples.corner_tip_m[-1]) + 1), :3]
    along = np.cumsum(np.linalg.norm(np.diff(own, axis=0, prepend=own[:1]), axis=1))
    room = grid.sample(checker.scenario.located(body[:, :3])) - body[:, 3] - checker.limits.clearance_m - HOLD_OFF_M
    return body[:, :3], along / max(float(along[-1]), 1e-9), room


def _body_by_joints(solver: TipSolver, q: Array, share: Array) -> Array:
    """(N, 3, m) derivatives by joints at q (m,) of points at shares (N,) of the zero-clearance body, plate to tip."""
    drive, common = solver.space.drive, solver.common_rotation

    def line(joints: Array) -> Array:
        tube = solver.mechanics.zero_clearance(*drive.collars(joints), loads=False).tubes[-1]
        s, points = tube.s_m / tube.s_m[-1], tube.centreline_m
        return np.stack([np.interp(share, s, points[:, k]) for k in range(3)], axis=1)

    here, result = line(q), np.zeros((len(share), 3, len(q)))
    spared = None if common is None or drive.terms else int(np.argmax(np.abs(common)))
    for j in range(len(q)):
        moved = q.copy()
        moved[j] = solver.beside(q[None], j)[0]
        if j != spared and moved[j] != q[j]:
            result[:, :, j] = (line(moved) - here) / (moved[j] - q[j])
    if spared is not None and common is not None:
        about_z = np.cross([0.0, 0.0, 1.0], here)
        result[:, :, spared] = (about_z - result @ common) / common[spared]
    return result
