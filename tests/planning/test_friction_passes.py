"""Bodies that friction moves past an obstacle on the way from one sign corner to another."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.core_arrays import core_grid
from ctrplan.mechanics.friction import corner_signs, tip_deviations
from ctrplan.mechanics.walk import PathDensity, PathLimits
from ctrplan.motion.checker import MotionChecker, robot_field
from ctrplan.motion.limits import clearance_between
from ctrplan.scenario.scenario import Scenario

BETWEEN = np.array([-1.0, 0.5])  # a friction state on an edge of the square of states
ROOM_M = 1.5e-3  # of the passed place from the bodies in the sign corners, and from the frictionless one


def passed_place(scenario: Scenario, q: Array) -> tuple[Array, float]:
    """The point (3,) of the body in the state between that is farthest [m] from all solved ones; anatomy's frame."""
    states = scenario.robot.mechanics.friction_states(*scenario.robot.drive.collars(q))
    bodies = states.bodies(np.vstack([BETWEEN, np.zeros(2), corner_signs(2)])).point_m
    apart = np.linalg.norm(bodies[0][:, None, None] - bodies[None, 1:], axis=3).min(axis=(1, 2))
    k = int(np.argmax(apart))
    return scenario.located(bodies[0][[k]])[0], float(apart[k])


@pytest.fixture(scope="module")
def passing() -> tuple[Scenario, Array]:
    """Three tubes and a ball that only friction states between the corners touch; and the configuration."""
    base = replace(load_scenario(SCENARIOS / "ribs.toml"), anatomy=())
    rng, space = np.random.default_rng(5), MotionChecker(base).space
    for q in space.sample(rng, 200):
        place, apart_m = passed_place(base, q)
        if apart_m > ROOM_M + 2e-3 and MotionChecker(base).state(q).valid:
            ball = AnatomyPart(Sphere(place, 0.3e-3), "avoid", 0.0)
            return replace(base, anatomy=(ball,)), q
    raise AssertionError("friction moves no body that far")


def test_a_walk_looks_up_shapes_interpolated_between_the_corners(passing: tuple[Scenario, Array]) -> None:
    """The core's clearance against the formula of friction states of tips, for every point of the bodies."""
    scenario, q = passing
    field, (theta_b, l_b) = robot_field(scenario), scenario.robot.drive.collars(q[None])
    walk, density = scenario.robot.mechanics.check_path, PathDensity()
    corners = walk(theta_b, l_b, field, density=density, bodies=True)
    between = walk(theta_b, l_b, field, density=replace(density, between_corners=True))
    shapes = corners.bodies[0].reshape(5, -1, 4)
    phi = np.array(list(itertools.product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=2)))
    bodies = np.array(
        [own + tip_deviations(np.tile(of, (len(phi), 1, 1)), np.tile(own, (len(phi), 1)), phi)
         for own, of in zip(shapes[0, :, :3], shapes[1:, :, :3].transpose(1, 0, 2), strict=True)]
    )  # fmt: skip
    grid = core_grid(field)
    assert grid is not None
    rooms = np.asarray(grid.sample(bodies.reshape(-1, 3))).reshape(bodies.shape[:2]) - shapes[0, :, 3:]
    assert between.clearance_m[0] == pytest.approx(rooms.min(), abs=1e-12)
    np.testing.assert_array_equal(between.nearest_phi[0], phi[np.argmin(rooms.min(axis=0))])
    assert between.clearance_m[0] < corners.clearance_m[0] - 0.5e-3


def test_looking_between_the_corners_changes_no_solution(passing: tuple[Scenario, Array]) -> None:
    """Only clearance can fall, and where a shape between is nearer, its friction state is told."""
    base, q = passing
    for scenario in (base, load_scenario(SCENARIOS / "vessel.toml")):
        collars = scenario.robot.drive.collars((q if scenario is base else scenario.start)[None])
        walk, field = scenario.robot.mechanics.check_path, robot_field(scenario)
        plain, between = walk(*collars, field), walk(*collars, field, density=PathDensity(between_corners=True))
        np.testing.assert_array_equal(between.corner_tip_m, plain.corner_tip_m)
        assert np.all(np.isnan(plain.nearest_phi))
        is_nearer = between.clearance_m < plain.clearance_m
        np.testing.assert_array_equal(np.isfinite(between.nearest_phi).all(axis=1), is_nearer)


def test_clearance_between_corners_is_that_of_the_bodies_there(passing: tuple[Scenario, Array]) -> None:
    """It touches the ball, which no solved corner does, and is inf for another equilibrium's tip."""
    scenario, q = passing
    field, collars, mechanics = robot_field(scenario), scenario.robot.drive.collars(q), scenario.robot.mechanics
    assert field is not None
    tip_m = mechanics.bound(*collars).frictionless.tip_m
    least = clearance_between(scenario, field, q, BETWEEN, tip_m, 1e-3)[0]
    bodies = mechanics.friction_bodies(*collars, BETWEEN)
    ball = scenario.anatomy[0].shape
    assert isinstance(ball, Sphere)
    away = np.linalg.norm(scenario.located(bodies.point_m[0]) - ball.center_m, axis=1)
    touching_m = float((away - ball.radius_m - bodies.radius_m).min())
    assert least <= touching_m + 1e-9 < 0
    assert least < float(mechanics.check_path(*(x[None] for x in collars), field).clearance_m[0]) - ROOM_M
    assert clearance_between(scenario, field, q, BETWEEN, tip_m + 1e-3, 1e-3)[0] == np.inf


def test_a_motion_whose_states_between_touch_is_refused(passing: tuple[Scenario, Array]) -> None:
    """It was called valid: friction moves the body past the ball from one corner to another."""
    scenario, q = passing
    way = np.array([q, q + np.radians(0.5) * scenario.robot.drive.is_rotation])
    refusing, blind, free = (
        MotionChecker(scenario),
        MotionChecker(scenario),
        MotionChecker(replace(scenario, anatomy=())),
    )
    blind.density = replace(blind.density, between_corners=False)
    assert free.along(way).valid and blind.along(way).valid
    assert not refusing.along(way).valid
    assert refusing.along(way).reason.startswith("a shape that friction allows comes")


def test_solved_states_refuse_what_interpolated_ones_leave(
    passing: tuple[Scenario, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interpolated shape says where to look; solved ones beside it say what is left there."""
    scenario, q = passing
    checker = MotionChecker(scenario)
    way = np.array([q, q + np.radians(0.5) * scenario.robot.drive.is_rotation])
    walked = checker.walk(way, checker.density, PathLimits())
    enough = replace(walked, clearance_m=np.full_like(walked.clearance_m, checker.limits.clearance_m))
    with monkeypatch.context() as patch:
        patch.setattr(checker, "walk", lambda *_: enough)
        assert "friction allows" in checker.along(way).reason
    samples = checker.walk(q[None], checker.density, PathLimits())
    sample = replace(samples.at_end(), clearance_m=np.array([checker.limits.clearance_m]))  # interpolated: just enough
    assert "friction allows" in checker._too_close_between(q, sample)
    far = replace(sample, clearance_m=checker.limits.clearance_m + 1.01 * sample.position_m)
    assert not checker._too_close_between(q, far)
    assert not checker._too_close_between(q, replace(sample, nearest_phi=np.full_like(sample.nearest_phi, np.nan)))
