"""The certificate: finished legs rechecked densely with the full model and exact distances to the anatomy."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.clearance_grid import exact_clearance
from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.base.units import MM_PER_M
from ctrplan.drive.legs import distance_from_polyline, merge_legs
from ctrplan.mechanics.core import Accuracy, PathDensity, PathLimits, PathSamples
from ctrplan.planning.certificate.prediction import Prediction, predict, rows_to_simulate
from ctrplan.planning.certified import Certificate, CertificateSamples, TargetReached
from ctrplan.planning.goals.goal_state import target_in_robot_frame
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import anatomy_grid, breach, path_limits, released_error
from ctrplan.planning.path_cost import path_cost_mm
from ctrplan.planning.play import play_shift
from ctrplan.robot.friction_calibration import friction_law

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario
    from ctrplan.robot.robot import Robot

SPACING_M = 0.5e-3  # largest motion of a body point of any shape between samples, but for leaps of a corner
POINT_SPACING_M = 1e-3  # between the points of a shape
# More than the largest error of a tip seen on 2,500 random configurations, 0.60 mm, 98 % of them below 0.3 mm
# (`benchmarks/mechanics.py meshes --count 2500`); 0.14 mm on the certificate mesh, to which its
# last barrier adds up to 0.02 mm. Allowances, no proven bounds.
DISCRETISATION_M = {"search": 1.0e-3, "certificate": 0.2e-3}
BRANCH_TOLERANCE_M = 0.2e-3  # between the ends of neighbouring pieces, the same state reached on two ways
GRID_SHARE = 0.03  # of a clearance by which the grid may be off far from surfaces (ctrplan.anatomy.grid_distance)
PIECE_MM = 40.0  # joint length of the pieces that run in parallel


class Arrival(Protocol):
    """Says in sentences why the end of a certified path does not meet the goal; none if it does."""

    def __call__(self, scenario: Scenario, samples: CertificateSamples, prediction: Prediction) -> list[str]:
        """samples: of the whole path; prediction: tips from several friction states."""
        ...


@dataclass(frozen=True, eq=False)
class _Piece:
    leg: int
    start: Array
    end: Array
    samples: PathSamples
    accuracy: Accuracy
    clearance_m: Array  # (K,) exact, less half the motion between samples, the discretisation error and the play
    play_m: float  # how far play of the drive may move the robot, the largest of both ends and the middle


def frictionless_arrives(scenario: Scenario, samples: CertificateSamples, prediction: Prediction) -> list[str]:
    """Sentences if the frictionless tip misses the goal."""
    return _frictionless_miss(scenario, samples)


def _frictionless_miss(scenario: Scenario, samples: CertificateSamples) -> list[str]:
    goal, miss = scenario.goal, _goal_miss(scenario, samples.tip_m[-1])
    if goal.tip_m is None or miss <= goal.tolerance_m:
        return []
    miss_mm, tolerance_mm = miss * MM_PER_M, goal.tolerance_m * MM_PER_M
    return [f"The frictionless tip ends {miss_mm:.2f} mm from the target, tolerance {tolerance_mm:g} mm."]


def certify(
    scenario: Scenario,
    corners: Array,
    *,
    accuracy: Accuracy = "search",
    arrival: Arrival = frictionless_arrives,
    progress: Progress | None = None,
) -> Certificate:
    """Walks the polyline `corners` (K, m) of actuated joints so that no body point moves more than 0.5 mm a sample.

    Clearances are exact distances of points of the frictionless and every corner shape, less the outer radius, half the
    motion between samples, the discretisation error and what play of the drive may move the robot by; nothing of the
    search's field is used. Pieces that only the coarse mesh's allowance for its error would refuse are walked again on
    the fine mesh.

    Friction errors are the bound, whatever the history; the same less what the friction law says translations released,
    which the cost counts as the search does; and the prediction by simulated histories. `arrival` says what misses the
    goal.
    """
    return finished(walk_legs(scenario, corners, accuracy=accuracy, progress=progress), arrival)


@dataclass(frozen=True, eq=False)
class WalkedLegs:
    """Legs walked for a certificate: what it rests on, before histories are simulated."""

    scenario: Scenario
    corners: Array  # (K, m)
    accuracy: Accuracy
    pieces: list[_Piece]
    samples: CertificateSamples
    problems: list[str]  # but whether the goal is met

    @property
    def failure(self) -> str:
        """The first reason not to certify the legs, or that the frictionless tip misses the goal; empty if none."""
        return next(iter(self.problems + _frictionless_miss(self.scenario, self.samples)), "")

    @property
    def length_mm(self) -> float:
        """Joint length."""
        return float(self.samples.path_mm[-1])

    @property
    def legs(self) -> int:
        """Pieces driven without a stop."""
        return len(merge_legs(self.corners)) - 1

    @property
    def cost_mm(self) -> float:
        """By the scenario's weights."""
        samples = self.samples
        return path_cost_mm(
            self.scenario.cost,
            length_mm=self.length_mm,
            legs=self.legs,
            integral_mm=self.integral_mm(samples.released_m),
            left_m=float(samples.bound_m[-1] + samples.released_m[-1]),
        )

    def integral_mm(self, error_m: Array) -> float:
        """Of an error [m] at every sample, (K,), along the path: 1 for 1 mm over 1 rad."""
        return float(np.trapezoid(error_m * MM_PER_M, self.samples.path_mm)) / self.scenario.cost.mm_per_rad


def walk_legs(
    scenario: Scenario, corners: Array, *, accuracy: Accuracy = "search", progress: Progress | None = None
) -> WalkedLegs:
    """What decides whether the polyline `corners` (K, m) is valid, see `certify`."""
    space = JointSpace.of(scenario)
    pieces = _walk(scenario, space, corners, accuracy, progress)
    samples = _join(scenario.robot, space, corners, pieces)
    problems = _problems(scenario, space, corners, pieces, samples, path_limits(scenario))
    return WalkedLegs(scenario, corners, accuracy, pieces, samples, problems)


def finished(walk: WalkedLegs, arrival: Arrival = frictionless_arrives) -> Certificate:
    """The certificate of walked legs, histories simulated."""
    scenario = walk.scenario
    prediction, samples = _predicted(scenario, walk.pieces, walk.samples, walk.accuracy)
    problems = walk.problems + arrival(scenario, samples, prediction)
    return Certificate(
        samples=samples,
        valid=not problems,
        problems=tuple(problems),
        worst_bound_m=float(samples.bound_m.max()),
        goal_bound_m=float(samples.bound_m[-1]),
        goal_bound_rad=float(samples.bound_rad[-1]),
        goal_tip_error_m=_goal_miss(scenario, samples.tip_m[-1]),
        error_integral_mm=walk.integral_mm(samples.bound_m),
        worst_predicted_m=float(samples.predicted_m.max()),
        goal_predicted_m=float(samples.predicted_m[-1]),
        released_integral_mm=walk.integral_mm(samples.released_m),
        predicted_integral_mm=walk.integral_mm(samples.predicted_m),
        goal_predicted_tip_m=prediction.end_middle_m,
        goal_predicted_spread_m=prediction.end_spread_m,
        snaps=prediction.snaps,
        min_clearance_m=float(samples.clearance_m.min()),
        min_stability=float(samples.stability.min()),
        max_strain=float(samples.max_strain.max()),
        length_mm=walk.length_mm,
        stops=max(walk.legs - 1, 0),
        cost_mm=walk.cost_mm,
        spacing_m=float(samples.motion_m.max()),
        worst_play_m=float(samples.play_m.max()),
        goal_play_m=float(samples.play_m[-1]),
        targets=(_target(scenario, samples),),
        walk_again=partial(_walked_again, scenario, walk.corners, walk.accuracy, arrival),
    )


def _walked_again(
    scenario: Scenario, corners: Array, first: Accuracy, arrival: Arrival, accuracy: Accuracy | None
) -> Certificate:
    return certify(scenario, corners, accuracy=accuracy or first, arrival=arrival)


def _target(scenario: Scenario, samples: CertificateSamples) -> TargetReached:
    return TargetReached(
        name=scenario.goal.name,
        leg=int(samples.leg[-1]),
        path_mm=float(samples.path_mm[-1]),
        bound_m=float(samples.bound_m[-1]),
        bound_rad=float(samples.bound_rad[-1]),
        released_m=float(samples.released_m[-1]),
        predicted_m=float(samples.predicted_m[-1]),
        tip_error_m=_goal_miss(scenario, samples.tip_m[-1]),
        play_m=float(samples.play_m[-1]),
        line_error_m=_line_error(scenario, samples.tip_m),
    )


def _walk(
    scenario: Scenario, space: JointSpace, corners: Array, accuracy: Accuracy, progress: Progress | None
) -> list[_Piece]:
    """The legs in pieces, in parallel; each starts from scratch, which `_problems` compares with the one before."""
    ends = []
    for leg, (a, b) in enumerate(zip(corners[:-1], corners[1:], strict=True)):
        count = max(1, int(np.ceil(space.length_mm(b - a) / PIECE_MM)))
        points = a + np.linspace(0, 1, count + 1)[:, None] * (b - a)
        ends += [(leg, points[k], points[k + 1]) for k in range(count)]
    if not ends:
        ends = [(0, corners[0], corners[0])]
    required = path_limits(scenario).clearance_m

    def walk(piece: tuple[int, Array, Array]) -> _Piece:
        found = _walked(scenario, space, *piece, accuracy)
        spare = DISCRETISATION_M[found.accuracy] - DISCRETISATION_M["certificate"]
        if found.clearance_m.min() < required <= found.clearance_m.min() + spare:
            found = _walked(scenario, space, *piece, "certificate")
        return found

    pieces: list[_Piece] = []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for piece in pool.map(walk, ends):
            pieces.append(piece)
            if progress:  # told by this thread alone, so that whoever listens needs no lock
                progress(len(pieces) / len(ends))
    return pieces


def _walked(scenario: Scenario, space: JointSpace, leg: int, start: Array, end: Array, accuracy: Accuracy) -> _Piece:
    density = PathDensity(motion_m=SPACING_M, near_m=SPACING_M, point_spacing_m=POINT_SPACING_M)
    theta_b, l_b = space.drive.collars(np.array([start, end]))
    samples = scenario.robot.mechanics.check_path(
        theta_b, l_b, density=density, accuracy=accuracy, bodies=bool(scenario.anatomy)
    )
    places = [start] if np.array_equal(start, end) else [start, (start + end) / 2, end]
    play = max(play_shift(scenario.robot, *space.drive.collars(q)) for q in places)
    clearance = _exact(scenario, samples) - samples.motion_m / 2 - DISCRETISATION_M[accuracy] - play
    return _Piece(leg, start, end, replace(samples, bodies=()), accuracy, clearance, play)


def _join(robot: Robot, space: JointSpace, corners: Array, pieces: list[_Piece]) -> CertificateSamples:
    """One table over all pieces; the first sample of every piece but the first repeats the last one before it."""
    starts = np.concatenate([[0.0], np.cumsum([space.length_mm(d) for d in np.diff(corners, axis=0)])])
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    load = np.ones(robot.n - 1)
    for number, piece in enumerate(pieces):
        s = piece.samples
        keep = slice(0 if number == 0 else 1, None)
        joints = piece.start + s.fraction[:, None] * (piece.end - piece.start)
        travelled = [space.length_mm(q - corners[piece.leg]) for q in joints]
        ends = space.drive.collars(np.array([piece.start, piece.end]))
        loads = friction_law(robot).load_left(load, *ends, s.fraction)
        load = loads[-1]
        rows: dict[str, NDArray[Any]] = {
            "leg": np.full(len(s.fraction), piece.leg),
            "joints": joints,
            "path_mm": starts[piece.leg] + np.array(travelled),
            "bound_m": s.position_m,
            "bound_rad": s.tangent_rad,
            "stability": s.stability,
            "max_strain": s.max_strain,
            "clearance_m": piece.clearance_m,
            "motion_m": s.motion_m,
            "tip_m": s.tip_m,
            "released_m": released_error(s, loads),
            "predicted_m": s.position_m,  # until it is simulated
            "play_m": np.full(len(s.fraction), piece.play_m),
        }
        for name, values in rows.items():
            columns[name].append(values[keep])
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()})


def _predicted(
    scenario: Scenario, pieces: list[_Piece], samples: CertificateSamples, accuracy: Accuracy
) -> tuple[Prediction, CertificateSamples]:
    """Simulated histories along the samples, and the samples with their errors; the bound where a simulation failed."""
    robot = scenario.robot
    rows = rows_to_simulate(robot, samples.joints, samples.leg)
    prediction = predict(robot, samples.joints[rows], accuracy)
    frictionless = samples.tip_m[rows]
    finer = np.concatenate(
        [np.full(len(p.samples.fraction) - (k > 0), p.accuracy != accuracy) for k, p in enumerate(pieces)]
    )[rows]
    if finer.any():  # compared on the mesh of the simulation, the other one would pass for friction
        collars = robot.drive.collars(samples.joints[rows][finer])
        without = np.zeros((int(finer.sum()), robot.n - 1))
        frictionless[finer] = robot.mechanics.tips_with_friction(*collars, without, accuracy=accuracy).position_m
    errors = prediction.errors(frictionless)
    errors = np.where(np.isnan(errors), samples.bound_m[rows], errors)
    along = np.interp(np.arange(len(samples.leg)), rows, errors)
    return prediction, replace(samples, predicted_m=along)


def _exact(scenario: Scenario, samples: PathSamples) -> Array:
    """(K,) smallest clearance of all shapes beyond the anatomy's margins [m]; inf in free space.

    Distances are exact; the grid only tells which points cannot be the closest ones: it is within GRID_SHARE of itself
    and half a cell's diagonal of the truth.
    """
    grid = anatomy_grid(scenario)
    if grid is None:
        return np.full(len(samples.fraction), np.inf)
    points = np.concatenate(samples.bodies)
    owner = np.repeat(np.arange(len(samples.bodies)), [len(body) for body in samples.bodies])
    located = points[:, :3] @ scenario.base_R.T + scenario.base_position_m
    rough = grid.sample(located)
    doubt = GRID_SHARE * np.abs(rough) + np.sqrt(3) / 2 * grid.spacing_m
    ceiling = np.full(len(samples.bodies), np.inf)
    np.minimum.at(ceiling, owner, rough + doubt - points[:, 3])
    near = rough - doubt - points[:, 3] <= ceiling[owner]
    least = np.full(len(samples.bodies), np.inf)
    np.minimum.at(least, owner[near], exact_clearance(scenario.anatomy, located[near]) - points[near, 3])
    return least


def _problems(
    scenario: Scenario,
    space: JointSpace,
    corners: Array,
    pieces: list[_Piece],
    samples: CertificateSamples,
    limits: PathLimits,
) -> list[str]:
    """Sentences about everything that keeps the path from being certified."""
    found = []
    if not space.allowed(corners):
        found.append("A waypoint breaks a joint limit or the nesting of the tubes.")
    for before, piece in zip([None, *pieces[:-1]], pieces, strict=True):
        where = f"leg {piece.leg + 1}"
        if piece.samples.fraction[-1] < 1 and len(pieces) > 1 or breach(piece.samples, PathLimits()):
            found.append(f"On {where}: {breach(piece.samples, PathLimits()) or 'the walk did not reach its end'}.")
        elif before is not None and _apart(before, piece) > BRANCH_TOLERANCE_M:
            found.append(f"On {where}: the shape depends on the way there, several equilibria exist.")
    checks = [
        (samples.stability < limits.stability, "stability falls to {:.3g}, below the margin", samples.stability.min()),
        (samples.max_strain > limits.max_strain, "strain reaches {:.4g}, above the limit", samples.max_strain.max()),
        (
            samples.clearance_m < limits.clearance_m,
            "a corner shape comes {:.2f} mm too close to the anatomy",
            (limits.clearance_m - samples.clearance_m.min()) * MM_PER_M,
        ),
    ]
    for broken, text, value in checks:
        if broken.any():
            found.append(f"On leg {samples.leg[np.argmax(broken)] + 1}: {text.format(value)}.")
    limit, on_line = scenario.cost.max_error_goal_m, _line_error(scenario, samples.tip_m)
    error = samples.bound_m[-1] if on_line is None else samples.bound_m.max()
    if limit is not None and not error <= limit:
        where, error_mm, limit_mm = (
            "at the goal" if on_line is None else "on the line",
            error * MM_PER_M,
            limit * MM_PER_M,
        )
        found.append(f"The worst-case error {where} is {error_mm:.2f} mm, above {limit_mm:g} mm.")
    if on_line is not None and not on_line <= scenario.goal.tolerance_m:
        off_mm, tolerance_mm = on_line * MM_PER_M, scenario.goal.tolerance_m * MM_PER_M
        found.append(f"The frictionless tip leaves the line by {off_mm:.2f} mm, tolerance {tolerance_mm:g} mm.")
    return found


def _line_error(scenario: Scenario, tip_m: Array) -> float | None:
    """Largest distance of tips (K, 3), robot's frame, from the goal's line; None without a line."""
    if scenario.goal.line_m is None:
        return None
    located = tip_m @ scenario.base_R.T + scenario.base_position_m
    return float(distance_from_polyline(located, scenario.goal.line_m).max())


def _apart(before: _Piece, after: _Piece) -> float:
    """Between the tips where two pieces meet, less what their meshes may differ by [m]."""
    gap = float(np.linalg.norm(before.samples.tip_m[-1] - after.samples.tip_m[0]))
    return gap if before.accuracy == after.accuracy else gap - DISCRETISATION_M["search"]


def _goal_miss(scenario: Scenario, tip: Array) -> float:
    if scenario.goal.tip_m is None:
        return 0.0
    return float(np.linalg.norm(tip - target_in_robot_frame(scenario)))
