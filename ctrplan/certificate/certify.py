"""The certificate: finished legs rechecked densely with the full model and exact distances to the anatomy."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.arrival import (
    Arrival,
    TargetReached,
    arrival,
    restart_waypoint,
    simulated_rows,
    with_steps,
)
from ctrplan.certificate.certificate import Certificate, CertificateSamples
from ctrplan.certificate.closest import ClosestPlaces, closest_places
from ctrplan.certificate.friction_states import BEYOND_BOUND_M
from ctrplan.certificate.problems import frictionless_miss, goal_miss_m, line_error_m
from ctrplan.certificate.walked_legs import WalkedLegs, walk_legs
from ctrplan.mechanics.shapes import Accuracy, Shape
from ctrplan.scenario.prediction import FrictionStart, PathPrediction, predict_end, start_states, step_error
from ctrplan.scenario.tip_solver import angle_to, target_in_robot_frame

if TYPE_CHECKING:
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.mechanics.history import HistoryState
    from ctrplan.scenario.scenario import Scenario


@dataclass(eq=False)
class SimulatedBodies:
    """Is shown shapes, from several threads, and keeps the least clearance."""

    distance: AnatomyDistance
    clearances_m: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, scenario: Scenario) -> SimulatedBodies | None:
        """None in free space."""
        distance = AnatomyDistance.of(scenario)
        return None if distance is None else cls(distance.as_registered)

    def __call__(self, shape: Shape) -> None:
        """Looks at the stations of the innermost tube, with the radius of what is around it."""
        ahead = shape.s_m >= 0
        if ahead.any():
            owner = np.zeros(int(ahead.sum()), dtype=np.intp)
            result = self.distance.least(shape.centreline_m[ahead], shape.radius_m[ahead], owner, 1)
            self.clearances_m.append(float(result[0]))

    @property
    def sentence(self) -> str:
        """For the problems of a certificate; empty where all bodies keep clear, but for what meshes differ by."""
        deep = -min(self.clearances_m, default=np.inf) - BEYOND_BOUND_M
        if not deep > 0:
            return ""
        return f"A simulated robot comes {(deep + BEYOND_BOUND_M) * MM_PER_M:.2f} mm too close to the anatomy."


class GoalTest(Protocol):
    """Says in sentences why the end of a certified path does not meet the goal; none if it does."""

    def __call__(
        self,
        scenario: Scenario,
        samples: CertificateSamples,
        prediction: PathPrediction,
        arrival: Arrival | None,
    ) -> list[str]:
        """samples: of the whole path; prediction: tips from several friction states; arrival: None where one failed."""
        ...


def frictionless_arrives(
    scenario: Scenario, samples: CertificateSamples, prediction: PathPrediction, arrival: Arrival | None
) -> list[str]:
    """Sentences if the frictionless tip misses the goal."""
    return frictionless_miss(scenario, samples.tip_m)


def predicted_arrives(
    scenario: Scenario, samples: CertificateSamples, prediction: PathPrediction, arrival: Arrival | None
) -> list[str]:
    """Sentences if the middle of the arrivals misses the goal, or the target is outside the worst-case envelope.

    How far arrivals are from the middle, and what else is uncertain, is the arrival's to say.
    """
    goal, result = scenario.goal, []
    allowed = f"{goal.tolerance_m * MM_PER_M:g} mm"
    off = arrival.by_cause.offset_m if arrival else np.inf
    if not off <= goal.tolerance_m:
        result.append(f"The predicted tip ends {off * MM_PER_M:.2f} mm from the target, tolerance {allowed}.")
    if goal.direction is not None and goal.direction_tolerance_rad is not None:
        tangent = prediction.tangent[:, -1].mean(axis=0)
        angle = float(angle_to(tangent[None], scenario.base_R.T @ goal.direction)[0])
        if not angle <= goal.direction_tolerance_rad:
            most = f"{np.degrees(goal.direction_tolerance_rad):g} deg"
            result.append(f"The predicted tip's direction is {np.degrees(angle):.1f} deg off, tolerance {most}.")
    shift = float(np.linalg.norm(samples.tip_m[-1] - target_in_robot_frame(scenario)))
    bound = float(samples.bound_m[-1])
    if not shift <= bound + goal.tolerance_m:
        shown = (
            f"{shift * MM_PER_M:.2f} mm from the frictionless tip, the worst-case error is {bound * MM_PER_M:.2f} mm"
        )
        result.append(f"The target lies outside the worst-case envelope: {shown}.")
    return result


def either_arrives(
    scenario: Scenario, samples: CertificateSamples, prediction: PathPrediction, arrival: Arrival | None
) -> list[str]:
    """Sentences if the goal is missed both by the frictionless tip and by the middle of the arrivals."""
    missed = frictionless_arrives(scenario, samples, prediction, arrival)
    return missed if missed and predicted_arrives(scenario, samples, prediction, arrival) else []


def certify(
    scenario: Scenario,
    corners: Array,
    *,
    accuracy: Accuracy = "search",
    goal_test: GoalTest = frictionless_arrives,
    starts: Sequence[FrictionStart] | None = None,
    restart: bool = True,
    spare_m: float = np.inf,
    timing: Trajectory | None = None,
    progress: Progress | None = None,
) -> Certificate:
    """Walks the polyline `corners` (K, m) of actuated joints so that no body point moves more than 0.5 mm a sample.

    Clearances are of every friction state, not of the corners alone (`friction_cube.py`): exact distances of body
    points, less the outer radius, half the motion to the samples on both sides, the discretisation error, and an
    allowance for friction that differs along a contact; of every robot within its intervals, its play and its
    registration (`variants.py`). Late drives are followed in time, by the motion that ctrplan makes of the legs, or by
    `timing`. Nothing of the search's field is used.

    What the motion's own simulation contradicts is refused: snaps, leaps of a shape, tips beyond the bound, shapes that
    depend on the way there.

    Friction errors are the bound, whatever the history; the same less what the friction law says translations released,
    which the cost counts as the search does; and the prediction by simulated histories, from `starts` where a motion
    before this one left the robot in these friction states. `goal_test` says what misses the goal. From where an
    interrupted run begins again is simulated too, unless it is not wanted. Of clearance beyond `spare_m` more than what
    the scenario asks for it is only known that it is more, and no place of closest approach is sought: that takes less
    time.
    """
    walk = walk_legs(scenario, corners, accuracy=accuracy, spare_m=spare_m, timing=timing, progress=progress)
    result = finished(walk, goal_test, starts)
    return with_restart(walk.scenario, result, starts, accuracy) if restart else result


def finished(
    walk: WalkedLegs,
    goal_test: GoalTest = frictionless_arrives,
    starts: Sequence[FrictionStart] | None = None,
) -> Certificate:
    """The certificate of walked legs, histories simulated; of as much clearance as the walk asked for."""
    scenario, start_friction = walk.scenario, start_states(walk.scenario) if starts is None else starts
    bodies = SimulatedBodies.of(scenario)
    with ThreadPoolExecutor(1) as beside:  # of few histories one ends last
        places = beside.submit(_places, walk)
        history = _simulated(walk, start_friction, bodies)
        closest = places.result()
    prediction, samples = history.prediction, history.samples
    problems = (
        walk.problems + goal_test(scenario, samples, prediction, history.arrival) + _contradictions(prediction, samples)
    )
    problems += [bodies.sentence] if bodies and bodies.sentence else []
    return Certificate(
        samples=samples,
        valid=not problems,
        problems=tuple(problems),
        worst_bound_m=walk.bounds.worst_m,
        goal_bound_m=walk.bounds.goal_m,
        goal_bound_rad=float(samples.bound_rad[-1]),
        goal_tip_error_m=goal_miss_m(scenario, samples.tip_m[-1]),
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
        arrival=history.arrival,
        targets=(_target(walk, samples, history.arrival),),
        start_friction=scenario.start_friction,
        nominal=closest.nominal,
        closest=closest.friction,
        narrowest=closest.certified,
        end_states=tuple(history.end_states),
        spare_m=walk.spare_m,
        walk_again=partial(_walked_again, walk, goal_test),
    )


def _places(walk: WalkedLegs) -> ClosestPlaces:
    """Where walked legs come closest; none where not all of their clearance is known."""
    return closest_places(walk.scenario, walk.pieces, walk.samples) if np.isinf(walk.spare_m) else ClosestPlaces()


def _walked_again(
    walk: WalkedLegs,
    goal_test: GoalTest,
    accuracy: Accuracy | None,
    starts: Sequence[FrictionStart] | None = None,
) -> Certificate:
    mesh, timing = accuracy or walk.accuracy, walk.timing
    return certify(walk.scenario, walk.corners, accuracy=mesh, goal_test=goal_test, starts=starts, timing=timing)


def with_restart(
    scenario: Scenario,
    certificate: Certificate,
    starts: Sequence[FrictionStart] | None = None,
    accuracy: Accuracy = "search",
) -> Certificate:
    """The certificate of one path, its arrival knowing from where an interrupted run begins again, and its own steps.

    Asked for of what is driven in the end: it takes as long as the histories do, once or twice.
    """
    samples = certificate.samples
    if certificate.arrival is None or not certificate.valid:
        return certificate
    rows, _ = simulated_rows(scenario, samples.joints, samples.leg)
    start_friction = start_states(scenario) if starts is None else starts
    path = samples.joints[rows], samples.leg[rows], certificate.goal_predicted_tip_m
    steps_m = step_error(scenario.robot, path[0], certificate.end_states, start_friction, accuracy)
    arrival = replace(
        with_steps(certificate.arrival, steps_m), restart=restart_waypoint(scenario, *path, start_friction)
    )
    *before, last = certificate.targets
    return replace(certificate, arrival=arrival, targets=(*before, replace(last, arrival=arrival)))


def _contradictions(prediction: PathPrediction, samples: CertificateSamples) -> list[str]:
    """Sentences where the simulated histories leave what the walk promises."""
    if not np.all(np.isfinite(prediction.tip_m)):
        return ["A simulated robot finds no equilibrium to go on to."]
    results = []
    if prediction.snaps:
        times = f"{prediction.snaps} times" if prediction.snaps > 1 else "once"
        results.append(f"Simulated robots snap to another equilibrium {times}.")
    beyond = samples.predicted_m - (samples.bound_m - samples.parameter_bound_m)  # of the file's robot
    worst = int(np.argmax(beyond))
    if beyond[worst] > BEYOND_BOUND_M:
        where = f"On leg {samples.leg[worst] + 1}"
        results.append(f"{where}: a simulated robot is {beyond[worst] * MM_PER_M:.2f} mm beyond the worst-case error.")
    return results


def _target(walk: WalkedLegs, samples: CertificateSamples, arrival: Arrival | None) -> TargetReached:
    scenario = walk.scenario
    return TargetReached(
        name=scenario.goal.name,
        leg=int(samples.leg[-1]),
        path_mm=float(samples.path_mm[-1]),
        bound_m=walk.bounds.goal_m,
        bound_rad=float(samples.bound_rad[-1]),
        released_m=float(samples.released_m[-1]),
        unknown_m=walk.unknown_m,
        predicted_m=float(samples.predicted_m[-1]),
        tip_error_m=goal_miss_m(scenario, samples.tip_m[-1]),
        play_m=float(samples.play_m[-1]),
        line_error_m=line_error_m(scenario, samples.tip_m),
        arrival=arrival,
    )


@dataclass(frozen=True, eq=False)
class _Simulated:
    """What the histories along walked legs say."""

    prediction: PathPrediction
    samples: CertificateSamples  # with their errors and the size of the set of friction states
    arrival: Arrival | None  # None where a history found no equilibrium
    end_states: list[HistoryState]


def _simulated(walk: WalkedLegs, starts: Sequence[FrictionStart], bodies: SimulatedBodies | None) -> _Simulated:
    """Histories along the samples from `starts`; the bound where a simulation failed."""
    scenario, robot, samples, accuracy = walk.scenario, walk.scenario.robot, walk.samples, walk.accuracy
    rows, keep = simulated_rows(scenario, samples.joints, samples.leg)
    joints, leg = samples.joints[rows], samples.leg[rows]
    prediction, end_states = predict_end(robot, joints, starts, accuracy, bodies, keep)
    frictionless = samples.tip_m[rows]
    finer = np.concatenate(
        [np.full(len(p.samples.fraction) - (k > 0), p.accuracy != accuracy) for k, p in enumerate(walk.pieces)]
    )[rows]
    if finer.any():  # compared on the mesh of the simulation, the other one would pass for friction
        collars = robot.drive.collars(joints[finer])
        without = np.zeros((int(finer.sum()), robot.n - 1))
        frictionless[finer] = robot.mechanics.tips_with_friction(*collars, without, accuracy=accuracy).position_m
    errors = prediction.errors(frictionless)
    errors = np.where(np.isnan(errors), samples.bound_m[rows], errors)
    every = np.arange(len(samples.leg))
    samples = replace(
        samples,
        predicted_m=np.interp(every, rows, errors),
        spread_m=np.interp(every, rows, prediction.spread_m),
        friction_spread=np.array([np.interp(every, rows, column) for column in prediction.friction_spread.T]).T.reshape(
            len(every), robot.n - 1
        ),
    )
    if not np.all(np.isfinite(prediction.tip_m)):
        return _Simulated(prediction, samples, None, [])
    bound_m, play_m = float(walk.samples.bound_m[-1]), float(samples.play_m[-1])
    at_end = arrival(scenario, joints, leg, prediction, starts, goal_bound_m=bound_m, play_m=play_m)
    return _Simulated(prediction, samples, at_end, end_states)
