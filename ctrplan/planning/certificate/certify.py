"""The certificate: finished legs rechecked densely with the full model and exact distances to the anatomy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.progress import Progress
from ctrplan.base.units import MM_PER_M
from ctrplan.drive.legs import distance_from_polyline, merge_legs
from ctrplan.mechanics.core import Accuracy, PathLimits
from ctrplan.planning.certificate.prediction import Prediction, predict, rows_to_simulate
from ctrplan.planning.certificate.start_branches import other_start
from ctrplan.planning.certificate.walked_piece import (
    DISCRETISATION_M,
    SAME_BRANCH_M,
    SPACING_M,
    Piece,
    in_every_friction_state,
    walk_pieces,
)
from ctrplan.planning.certified import Certificate, CertificateSamples, TargetReached
from ctrplan.planning.goals.goal_state import target_in_robot_frame
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import breach, path_limits, released_error
from ctrplan.planning.path_cost import path_cost_mm
from ctrplan.robot.friction_calibration import friction_law

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario
    from ctrplan.robot.robot import Robot

BRANCH_TOLERANCE_M = 0.2e-3  # between tips of a shape at the ends of neighbouring pieces, reached on two ways
BEYOND_BOUND_M = 0.3e-3  # of a prediction: histories and bounds may be of different meshes
LEAP_M = 2 * SPACING_M  # a shape that moves farther between samples was not followed


class Arrival(Protocol):
    """Says in sentences why the end of a certified path does not meet the goal; none if it does."""

    def __call__(self, scenario: Scenario, samples: CertificateSamples, prediction: Prediction) -> list[str]:
        """samples: of the whole path; prediction: tips from several friction states."""
        ...


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

    Clearances are of every friction state, not of the corners alone (`friction_cube.py`): exact distances of body
    points, less the outer radius, half the motion to the samples on both sides, the discretisation error, an allowance
    for friction that differs along a contact, and what play of the drive may move the robot by. Nothing of the search's
    field is used. Pieces that only the coarse mesh's allowance for its error would refuse are walked on the fine mesh.

    What the motion's own simulation contradicts is refused: snaps, leaps of a shape, tips beyond the bound, shapes that
    depend on the way there.

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
    pieces: list[Piece]
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
    space, limits = JointSpace.of(scenario), path_limits(scenario)
    pieces = walk_pieces(scenario, space, corners, accuracy, progress)
    samples = _join(scenario.robot, space, corners, pieces)
    problems = _problems(scenario, space, corners, pieces, samples, limits)
    if not problems:  # what the solved shapes refuse needs no look at the states between them
        pieces = in_every_friction_state(scenario, space, pieces)
        samples = _join(scenario.robot, space, corners, pieces)
        problems = _problems(scenario, space, corners, pieces, samples, limits)
    light = [replace(piece, samples=replace(piece.samples, bodies=())) for piece in pieces]
    return WalkedLegs(scenario, corners, accuracy, light, samples, problems)


def finished(walk: WalkedLegs, arrival: Arrival = frictionless_arrives) -> Certificate:
    """The certificate of walked legs, histories simulated."""
    scenario = walk.scenario
    prediction, samples = _predicted(scenario, walk.pieces, walk.samples, walk.accuracy)
    problems = walk.problems + arrival(scenario, samples, prediction) + _contradictions(prediction, samples)
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


def _contradictions(prediction: Prediction, samples: CertificateSamples) -> list[str]:
    """Sentences where the simulated histories leave what the walk promises."""
    if not np.all(np.isfinite(prediction.tip_m)):
        return ["A simulated robot finds no equilibrium to go on to."]
    found = []
    if prediction.snaps:
        times = f"{prediction.snaps} times" if prediction.snaps > 1 else "once"
        found.append(f"Simulated robots snap to another equilibrium {times}.")
    beyond = samples.predicted_m - samples.bound_m
    worst = int(np.argmax(beyond))
    if beyond[worst] > BEYOND_BOUND_M:
        where = f"On leg {samples.leg[worst] + 1}"
        found.append(f"{where}: a simulated robot is {beyond[worst] * MM_PER_M:.2f} mm beyond the worst-case error.")
    return found


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


def _join(robot: Robot, space: JointSpace, corners: Array, pieces: list[Piece]) -> CertificateSamples:
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
    scenario: Scenario, pieces: list[Piece], samples: CertificateSamples, accuracy: Accuracy
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


def _problems(
    scenario: Scenario,
    space: JointSpace,
    corners: Array,
    pieces: list[Piece],
    samples: CertificateSamples,
    limits: PathLimits,
) -> list[str]:
    """Sentences about everything that keeps the path from being certified."""
    found = []
    if other := other_start(scenario.robot, corners[0]):
        found.append(f"{other}.")
    if not space.allowed(corners):
        found.append("A waypoint breaks a joint limit or the nesting of the tubes.")
    for before, piece in zip([None, *pieces[:-1]], pieces, strict=True):
        where = f"leg {piece.leg + 1}"
        if piece.samples.fraction[-1] < 1 and len(pieces) > 1 or breach(piece.samples, PathLimits()):
            found.append(f"On {where}: {breach(piece.samples, PathLimits()) or 'the walk did not reach its end'}.")
        elif before is not None and _apart(before, piece) > BRANCH_TOLERANCE_M:
            found.append(f"On {where}: the shape depends on the way there, several equilibria exist.")
        if piece.branches.max() > SAME_BRANCH_M:
            found.append(f"On {where}: another equilibrium exists for the same joints and friction.")
        if (leap := float(piece.samples.motion_m.max())) > LEAP_M:
            found.append(
                f"On {where}: a shape leaps by {leap * MM_PER_M:.1f} mm, its friction state loses its equilibrium."
            )
    checks = [
        (samples.stability < limits.stability, "stability falls to {:.3g}, below the margin", samples.stability.min()),
        (samples.max_strain > limits.max_strain, "strain reaches {:.4g}, above the limit", samples.max_strain.max()),
        (
            samples.clearance_m < limits.clearance_m,
            "a shape that friction allows comes {:.2f} mm too close to the anatomy",
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


def _apart(before: Piece, after: Piece) -> float:
    """Largest distance [m] of tips of one shape, frictionless or corner, where two pieces meet.

    Less what their meshes may differ by.
    """
    ends = [np.vstack([s.tip_m[k], *s.corner_tip_m[k][:, None]]) for s, k in ((before.samples, -1), (after.samples, 0))]
    gap = float(np.linalg.norm(ends[0] - ends[1], axis=1).max())
    return gap if before.accuracy == after.accuracy else gap - DISCRETISATION_M["search"]


def _goal_miss(scenario: Scenario, tip: Array) -> float:
    if scenario.goal.tip_m is None:
        return 0.0
    return float(np.linalg.norm(tip - target_in_robot_frame(scenario)))
