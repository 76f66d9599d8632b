"""Walkers: warm bounds are those of cold solves, on the branch of the path, and say when they started cold."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROBOTS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Status

SAME_M = 1e-8
START = np.array([0.0, 0.4, -0.9]), np.array([0.0, -0.017, -0.0628])


def test_warm_bounds_are_those_of_cold_solves() -> None:
    robot, random = ctrplan.load_robot(ROBOTS / "three_tube.toml"), np.random.default_rng(4)
    walker = robot.walker()
    theta, l = (array.copy() for array in START)  # noqa: E741
    for k in range(60):
        theta += random.uniform(-1, 1, 3) * np.radians(1 if k % 7 else 12)
        l[2] += random.uniform(-1, 1) * 0.5e-3
        step, cold = walker.bound(theta, l), robot.bound(theta, l)
        assert step.started_cold == (k == 0) and step.status is Status.CONVERGED
        assert step.position_m == pytest.approx(cold.position_m, abs=SAME_M)
        assert step.tangent_rad == pytest.approx(cold.tangent_rad, abs=1e-6)
        np.testing.assert_allclose(step.tip_m, cold.frictionless.tip_m, rtol=0, atol=SAME_M)
        if k % 20 == 0:
            for mine, afresh in zip(walker.shapes().corners, cold.corners, strict=True):
                np.testing.assert_allclose(mine.centreline_m[-1], afresh.tip_m, rtol=0, atol=SAME_M)


def test_a_long_way_is_the_branch_of_its_steps_and_the_same_twice() -> None:
    """Which solution is found depends on the way, not on the length of the calls."""
    robot = ctrplan.load_robot(ROBOTS / "table_1_pair.toml")
    l = np.array([0.0, -0.017])  # noqa: E741
    ends = []
    for count in (1, 1, 30):
        walker = robot.walker()
        walker.bound([0.0, 0.0], l)
        for angle in np.linspace(0, 2.9, count + 1)[1:]:
            step = walker.bound([0.0, angle], l)
        ends.append((step.position_m, *step.tip_m))
        assert not step.started_cold and step.solves == (29 if count == 1 else 1)
    assert ends[0] == ends[1]
    np.testing.assert_allclose(ends[0], ends[2], rtol=0, atol=SAME_M)


def test_a_walker_starts_cold_after_a_way_that_is_too_long_and_stands_nowhere_at_first() -> None:
    walker = ctrplan.load_robot(ROBOTS / "three_tube.toml").walker()
    with pytest.raises(InputError, match="^a walker stands nowhere before its first step"):
        walker.shapes()
    assert walker.bound(*START).started_cold
    assert not walker.bound(START[0] + [0, 0.01, 0], START[1]).started_cold
    assert walker.bound(START[0] + [0, 300.0, 0], START[1]).started_cold


def test_a_walk_that_goes_on_is_that_from_scratch() -> None:
    """Also from where the way before began, which was not taken."""
    mechanics, random = ctrplan.load_robot(ROBOTS / "three_tube.toml").mechanics, np.random.default_rng(6)
    walker, (theta, l) = mechanics.core_walker("search"), START  # noqa: E741
    for k in range(21):
        to = theta + random.uniform(-0.1, 0.1, 3), l + [0, 0, random.uniform(-1, 1) * 1e-3]
        way = np.array([theta, to[0]]), np.array([l, to[1]])
        warm, cold = (mechanics.check_path(*way, bodies=True, walker=own) for own in (walker, None))
        assert len(warm.segment) == len(cold.segment) == 2
        for name in ("tip_m", "corner_tip_m", "position_m", "motion_m", "clearance_m", "max_strain"):
            np.testing.assert_allclose(getattr(warm, name), getattr(cold, name), rtol=1e-6, atol=SAME_M)
        np.testing.assert_allclose(warm.shape_stability, cold.shape_stability, rtol=1e-3)  # by the last step's factors
        for mine, afresh in zip(warm.bodies, cold.bodies, strict=True):
            np.testing.assert_allclose(mine, afresh, rtol=0, atol=SAME_M)
        theta, l = (theta, l) if k % 3 == 1 else to  # noqa: E741


@pytest.mark.parametrize(
    "effect", ["", "effects.nonlinear_elasticity={strain_percent = 0.5, stiffness_fraction = 0.4}"]
)
def test_a_walk_is_strained_as_its_shapes_are(effect: str) -> None:
    """Once walks, and all certificates, looked between the places where elements are strained most: 5 % too little."""
    robot = ctrplan.load_robot(ROBOTS / "three_tube.toml", [effect] if effect else [])
    rng = np.random.default_rng(8)
    for theta, l_3 in zip(rng.uniform(-1, 1, (8, 3)), rng.uniform(-0.1, -0.04, 8), strict=True):
        collars = np.array([theta]), np.array([[0, -0.017, l_3]])
        walked = robot.mechanics.check_path(*collars, None)
        bound = robot.bound(theta, collars[1][0], accuracy="search")
        most = max(shape.max_strain for shape in (bound.frictionless, *bound.corners))
        assert walked.max_strain[-1] == pytest.approx(most, rel=1e-4)
