"""Tracking as laws: limits and clearance hold at every step, tips are reached, and what is known of friction helps."""

from __future__ import annotations

import numpy as np
import pytest
from places import SCENARIOS
from scipy.optimize import minimize

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import path_limits
from ctrplan.planning.inverse_kinematics import TipTracker, TrackedStep
from ctrplan.planning.room import closer_by_joints, rooms_on_stretches
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.tip_solver import DAMPING, TipSolver, least_squares_within

BEGIN = np.array([0.3, -0.4, 0.9, -0.04])
STEP_S = 0.05


@pytest.fixture(scope="module")
def robot() -> Robot:
    return ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml")


@pytest.fixture(scope="module")
def vessel() -> Scenario:
    """Where a lumen is narrow: the robot stands in its branch."""
    scenario = ctrplan.load_scenario(SCENARIOS / "vessel.toml")
    found = ctrplan.inverse_kinematics(scenario, scenario.goal.tip_m, tolerance_m=1e-3, starts=60)
    return scenario.with_(start=found.valid[0].joints)


def tip(robot: Robot, q: Array) -> Array:
    """Frictionless, robot's frame."""
    state = np.zeros((1, robot.n - 1))
    return robot.mechanics.tips_with_friction(*robot.drive.collars(q[None]), state).position_m[0]


def line(robot: Robot, count: int = 16, along_mm: tuple[float, float, float] = (5, -4, 3)) -> Array:
    return tip(robot, BEGIN) + np.linspace(0, 1, count)[:, None] * np.array(along_mm) * 1e-3


def test_a_line_is_followed_to_the_tolerance(robot: Robot) -> None:
    tracker = TipTracker(robot, BEGIN)
    for point in line(robot):
        step = tracker.step(point)
        assert step.status == "reached" and not step.reason
        np.testing.assert_array_equal(step.joints, tracker.joints)
        bound = robot.bound(*robot.drive.collars(step.joints))
        np.testing.assert_allclose(step.tip_m, bound.frictionless.tip_m, atol=2e-6)
        assert np.linalg.norm(bound.frictionless.tip_m - point) <= tracker.tolerance_m + 2e-6
        assert step.bound_m == pytest.approx(bound.position_m, abs=5e-6)


@pytest.mark.parametrize("friction", [None, "released"])
def test_limits_nesting_and_speeds_hold_at_every_step(robot: Robot, friction: str | None) -> None:
    """Points far apart and out of reach push joints to all of their limits."""
    tracker, space, rng = (
        TipTracker(robot, BEGIN, friction=friction),
        JointSpace.of_robot(robot),
        np.random.default_rng(4),
    )
    statuses = set()
    for point in np.repeat(rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.3], (5, 3)), 6, axis=0):
        before = tracker.joints
        step = tracker.step(point, dt_s=STEP_S)
        statuses.add(step.status)
        assert space.allowed(step.joints)
        assert np.all(np.abs(step.joints - before) <= robot.drive.max_velocity * STEP_S + 1e-9)
        assert step.stability >= path_limits(tracker.scenario).stability
    assert "limited" in statuses


def test_a_slower_step_goes_less_far(robot: Robot) -> None:
    far = tip(robot, BEGIN) + np.array([0.02, 0.02, 0])
    moved = []
    for dt_s in (0.05, 0.2):
        tracker = TipTracker(robot, BEGIN)
        moved.append(tracker.step(far, dt_s=dt_s).tip_error_m)
    assert moved[1] < moved[0] < np.linalg.norm(far - tip(robot, BEGIN))


@pytest.mark.parametrize("friction", [None, "released"])
def test_what_limits_hold_is_not_walked_again(
    robot: Robot, friction: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A point far ahead is as far from a second place as from the first one, which speeds allow."""
    tracker, walks = TipTracker(robot, BEGIN, friction=friction), list[int]()
    walk = TipTracker._walk
    monkeypatch.setattr(TipTracker, "_walk", lambda self, corners: walks.append(len(corners)) or walk(self, corners))
    steps = [tracker.step(tip(robot, BEGIN) + np.array([0.02, 0.02, 0]), dt_s=0.05) for _ in range(5)]
    assert {step.status for step in steps} == {"limited"}
    assert len(walks) == len(steps)


def into_the_wall(tracker: TipTracker, steps: int) -> list[TrackedStep]:
    at = tracker.scenario.located(tip(tracker.scenario.robot, tracker.joints))
    return [tracker.step(at + share * np.array([0, 12e-3, 0])) for share in np.linspace(0, 1, steps)]


@pytest.mark.parametrize("friction", [None, (1.0, -1.0)])
def test_clearance_holds_at_every_step_into_a_wall(vessel: Scenario, friction: tuple[float, float] | None) -> None:
    checker = MotionChecker(vessel)
    checker.limits = path_limits(vessel)
    steps = into_the_wall(TipTracker(vessel, vessel.start, friction=friction), 30)
    for step in steps:
        state = checker.state(step.joints)
        assert state.valid, state.reason
        assert step.clearance_m >= checker.limits.clearance_m
    assert steps[-1].status in ("limited", "shortened", "stopped") and steps[-1].tip_error_m > 1e-3
    assert min(step.clearance_m for step in steps) - checker.limits.clearance_m < 0.5e-3  # it did go to the wall


def test_a_robot_that_was_stopped_finds_a_way_along_the_wall(vessel: Scenario) -> None:
    """What a refused step taught is kept where the robot stands."""
    tracker = TipTracker(vessel, vessel.start)
    steps = into_the_wall(tracker, 30)
    point = vessel.located(tip(vessel.robot, vessel.start)) + np.array([0, 12e-3, 0])
    later = [tracker.step(point) for _ in range(50)]
    assert steps[-1].status == "stopped" and later[-1].tip_error_m < steps[-1].tip_error_m - 0.1e-3


def test_a_robot_that_knows_its_friction_is_nearer_than_one_that_does_not(robot: Robot) -> None:
    """A simulated robot, whose contacts are loaded at the start."""
    points, loaded = line(robot, 30, (4, -3, 1)), (1.0, -1.0)
    left = {}
    for friction in (None, loaded):
        tracker, truth = TipTracker(robot, BEGIN, friction=friction), robot.history(loaded)
        truth.advance(*robot.drive.collars(BEGIN))
        off = []
        for point in points:
            step = tracker.step(point)
            path = truth.follow(*robot.drive.collars(step.joints[None]))
            off.append(float(np.linalg.norm(path.position_m[-1] - point)))
            if friction is loaded:
                np.testing.assert_allclose(step.tip_m, path.position_m[-1], atol=0.05e-3)
            else:
                assert off[-1] <= step.tip_error_m + step.bound_m
        left[friction] = off
    assert left[loaded][-1] < 0.2e-3 and left[loaded][-1] < 0.2 * left[None][-1]


def test_friction_may_be_told_later_by_a_history_or_an_observer(robot: Robot) -> None:
    collars = robot.drive.collars(BEGIN)
    history = robot.history((1.0, 1.0))
    history.advance(*collars)
    tracker = TipTracker(robot, BEGIN)
    tracker.know(history.save())
    step = tracker.step(tip(robot, BEGIN) + 5e-3, dt_s=1e-4)
    assert np.linalg.norm(step.tip_m - history.shape().tip_m) < 0.1e-3
    observer = robot.observer(0.1e-3, members=2)
    observer.observe(*collars, history.shape().tip_m)
    state = observer.state()
    tracker = TipTracker(robot, BEGIN, friction=state)
    np.testing.assert_allclose(tracker.step(tip(robot, BEGIN), dt_s=1e-4).joints, BEGIN, atol=2e-4)
    with pytest.raises(InputError, match="^friction: stands at other joints"):
        TipTracker(robot, BEGIN + 0.01, friction=state)


def test_a_direction_is_turned_to_within_its_tolerance() -> None:
    """Five joints leave two to spare for a point."""
    robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube_insertion.toml")
    begin = JointSpace.of_robot(robot).sample(np.random.default_rng(5), 1)[0]
    tracker, shape = TipTracker(robot, begin), robot.solve(*robot.drive.collars(begin))
    turned = shape.tip_tangent + 0.12 * np.array([1.0, 0.5, 0.0])
    steps = [tracker.step(shape.tip_m, turned, direction_tolerance_rad=0.03) for _ in range(25)]
    assert steps[0].turned_rad > 0.05
    assert steps[-1].status == "reached" and steps[-1].turned_rad <= 0.03


@pytest.mark.parametrize("seed", range(5))
def test_least_squares_within_is_the_constrained_minimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope, aim, rows, room = (
        rng.normal(size=(3, 5)),
        rng.normal(size=3),
        rng.normal(size=(9, 5)),
        rng.uniform(0, 0.3, 9),
    )

    def cost(x: Array) -> float:
        return float(np.sum((slope @ x - aim) ** 2) + DAMPING * x @ x)

    x = least_squares_within(slope, aim, rows, room)
    assert np.all(rows @ x <= room + 1e-9)
    other = minimize(cost, np.zeros(5), constraints={"type": "ineq", "fun": lambda y: room - rows @ y}, tol=1e-12)
    assert cost(x) <= cost(other.x) + 1e-7


def test_what_brings_a_body_closer_agrees_with_differences(vessel: Scenario) -> None:
    """Shapes with clearance and friction move to a good part as the one without, which all are taken to do."""
    checker = MotionChecker(vessel)
    checker.limits = path_limits(vessel)
    solver = TipSolver(checker.space, checker.mechanics)

    def walked(q: Array) -> object:
        collars = vessel.robot.drive.collars(q[None])
        return vessel.robot.mechanics.check_path(*collars, checker.field, bodies=True)

    q, most = vessel.start, np.array([0.1, 0.1, 0.1, 2e-3])
    at = walked(q)
    closer, room, near = closer_by_joints(checker, solver, q, at, most)  # type: ignore[arg-type]
    np.testing.assert_allclose(rooms_on_stretches(checker, at)[near], room)  # type: ignore[arg-type]
    assert len(near) >= 3
    for j, step in enumerate(0.1 * most):
        moved = q.copy()
        moved[j] += step
        change = rooms_on_stretches(checker, walked(moved))[near] - room  # type: ignore[arg-type]
        off = change + closer[:, j] * step
        assert np.abs(off).max() <= 0.05e-3 + 0.5 * np.abs(change).max(), j


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([0, 0, 0], "must be 4 finite numbers"),
        ([0, 0, 0, np.nan], "must be 4 finite numbers"),
        ([0, 0, 0, 0.5], "translate inner = 500 mm: must be within"),
    ],
)
def test_where_it_cannot_stand_is_refused(robot: Robot, joints: list[float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        TipTracker(robot, joints)


def test_joints_against_the_wall_are_refused(vessel: Scenario) -> None:
    with pytest.raises(InputError, match="too close to the anatomy"):
        TipTracker(vessel, BEGIN + np.array([2.5, 0, 0, 0.02]))


def test_a_point_in_millimetres_is_refused_as_by_inverse_kinematics(robot: Robot) -> None:
    tracker = TipTracker(robot, BEGIN)
    with pytest.raises(InputError, match="tip_m .*are these in millimetres"):
        tracker.step(1e3 * tip(robot, BEGIN) / 5)
    np.testing.assert_array_equal(tracker.joints, BEGIN)


@pytest.mark.parametrize("friction", ["slack", (2.0, 3.0), [0.1], float("nan"), {"a": 1}])
def test_friction_that_is_none_is_refused_by_its_own_name(friction: object) -> None:
    robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml")
    with pytest.raises(InputError, match=r"^friction( = 'slack')?: must be"):
        TipTracker(robot, [0.3, -0.4, 0.9, -0.04], friction=friction)  # type: ignore[arg-type]
