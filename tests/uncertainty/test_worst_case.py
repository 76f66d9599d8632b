"""How far uncertain parameters may move tips and bounds: laws of the worst case."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.robot.robot import Robot
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.tip_slopes import tip_slopes, tips_at
from ctrplan.uncertainty.worst_case import CHI95, BaseBall, IntervalSides, OffsetBox, farthest, reach_m

ROBOT = SCENARIOS / "robots" / "three_tube.toml"
INTERVALS = [
    "uncertainty.ci95.tube.3.section.2.curvature_per_m=[17.9, 18.5]",
    "uncertainty.ci95.tube.2.poisson_ratio=[0.25, 0.35]",
    "uncertainty.ci95.tube.2.bending_stiffness_Nm2=[0.0497, 0.0517]",
    "uncertainty.ci95.contact.1.clearance_mm=[0.040, 0.045]",
    "effects.friction.mu_1=0.2",
    "effects.friction.ci95.mu_1=[0.18, 0.22]",
    "effects.homing_offset.ci95.theta_2_deg=[-0.4, 0.4]",
    "effects.homing_offset.ci95.l_3_mm=[-0.3, 0.3]",
    "effects.joint_scale.ci95.theta_3=[-0.005, 0.005]",
    "effects.backlash.ci95.theta_3_deg=[0, 0.5]",
]
THETA = np.array([[0.0, 1.0, 2.0], [0.0, 0.4, -0.8]])
L = np.array([[0.0, -0.017, -0.08], [0.0, -0.017, -0.06]])


def robot(intervals: list[str] = INTERVALS) -> Robot:
    return load_robot(ROBOT, intervals)


@pytest.fixture(scope="module")
def parameters() -> UncertainParameters:
    return uncertain_parameters(robot())


def test_slopes_are_those_of_solves_to_second_order(parameters: UncertainParameters) -> None:
    """Halving an offset quarters what first order leaves of the change."""
    slopes = tip_slopes(parameters, THETA, L)
    for j in range(parameters.count):
        left = []
        for share in (1.0, 0.5, 0.25):
            offset = share * np.eye(parameters.count)[j] * (parameters.high - parameters.value)
            moved = tips_at(parameters, offset, THETA, L) - slopes.tip_m
            left.append(np.abs(moved - slopes.by @ offset).max())
            assert left[-1] <= 0.1 * np.abs(slopes.by @ offset).max() + 2e-6, parameters.names[j]
        order = np.log2(left[0] / left[2]) / 2
        assert order > 1.6 or left[0] < 3e-6, (parameters.names[j], left)  # the solver's own tolerance


def test_without_intervals_the_bound_is_that_of_friction() -> None:
    plain = load_robot(ROBOT)
    found = ctrplan.bound_with_parameters(plain, THETA, L)
    np.testing.assert_array_equal(found.position_m, found.friction_m)
    np.testing.assert_allclose(found.friction_m, plain.bound_many(*plain.collars(THETA, L)).position_m, rtol=1e-4)


def test_the_bound_grows_with_every_interval(parameters: UncertainParameters) -> None:
    slopes = tip_slopes(parameters, THETA, L)
    away, by = (slopes.tip_m - slopes.tip_m[:, :1]).reshape(-1, 3), slopes.by.reshape(-1, 3, parameters.count)

    def worst(factor: np.ndarray) -> np.ndarray:
        return farthest(away, OffsetBox.of(parameters.widened(factor)).displaced(by)).length_m

    plain = np.ones(parameters.count)
    before = worst(plain)
    assert np.all(before >= np.linalg.norm(away, axis=1))
    for j in range(parameters.count):
        wider, narrower = plain.copy(), plain.copy()
        wider[j], narrower[j] = 1.5, 0.0
        assert np.all(worst(wider) >= before * (1 - 1e-12)) and np.all(worst(narrower) <= before * (1 + 1e-12))


def test_no_robot_within_the_intervals_is_beyond_the_bound(parameters: UncertainParameters) -> None:
    found = ctrplan.bound_with_parameters(parameters.robot, THETA, L)
    here = tip_slopes(parameters, THETA, L).tip_m[:, :1]
    rng = np.random.default_rng(4)
    for signs in (*np.sign(rng.standard_normal((15, parameters.count))), *rng.uniform(-1, 1, (5, parameters.count))):
        offset = np.where(signs > 0, parameters.high - parameters.value, parameters.value - parameters.low) * signs
        away = np.linalg.norm(tips_at(parameters, offset, THETA, L) - here, axis=2).max(axis=1)
        assert np.all(away <= found.position_m + 0.02e-3)
    assert np.all(found.beyond_first_order_m < 0.1 * (found.position_m - found.friction_m))


def test_one_configuration_may_be_asked_for_alone_and_nonsense_is_refused() -> None:
    both, one = ctrplan.bound_with_parameters(robot(), THETA, L), ctrplan.bound_with_parameters(robot(), THETA[0], L[0])
    np.testing.assert_allclose(one.position_m, both.position_m[:1], rtol=1e-6)
    with pytest.raises(InputError, match="shape"):
        ctrplan.bound_with_parameters(robot(), THETA[0][:2], L[0])


def test_the_farthest_point_is_that_of_all_corners_and_of_a_ball() -> None:
    rng = np.random.default_rng(5)
    a, sides = rng.standard_normal((20, 3)), rng.standard_normal((20, 3, 5))
    corners = np.array(list(itertools.product((1.0, -1.0), repeat=5)))
    exact = np.linalg.norm(a[:, None] + np.einsum("bca,sa->bsc", sides, corners), axis=2).max(axis=1)
    moved = IntervalSides(np.zeros((20, 3)), sides)
    np.testing.assert_allclose(farthest(a, moved).length_m, exact, rtol=1e-9)
    np.testing.assert_allclose(farthest(a, moved, BaseBall(0.7)).length_m, exact + 0.7, rtol=1e-9)
    alone = np.linalg.norm(np.einsum("bca,sa->bsc", sides, corners), axis=2).max(axis=1)
    assert np.all((alone <= reach_m(moved)) & (reach_m(moved) <= 1.01 * alone))


def test_a_base_moves_a_point_by_its_shift_and_by_its_lever() -> None:
    """On a sphere of radius r: shift s and rotation w reach s + w r, across the lever."""
    lever = np.array([[0.0, 0.0, 0.2], [0.1, 0.1, 0.0]])
    still, base = IntervalSides(np.zeros((2, 3)), np.zeros((2, 3, 0))), BaseBall.of(1e-3, np.radians(0.5))
    reached = CHI95 * (1e-3 + np.radians(0.5) * np.linalg.norm(lever, axis=1))
    np.testing.assert_allclose(farthest(np.zeros((2, 3)), still, base, lever).length_m, reached, rtol=1e-9)
    np.testing.assert_allclose(reach_m(still, base, lever), reached, rtol=0.01)


def test_correlated_errors_that_cancel_are_not_added_up() -> None:
    """A common factor of all stiffnesses moves nothing without loads: that it is unknown must not matter."""
    names = [f"tube.{i}.bending_stiffness_Nm2" for i in (1, 2, 3)]
    values = [tube.bending_stiffness_Nm2 for tube in load_robot(ROBOT).tubes]
    ci95 = [f"uncertainty.ci95.{name}=[{0.9 * v}, {1.1 * v}]" for name, v in zip(names, values, strict=True)]
    together = [*ci95, f"uncertainty.correlated={names}", "uncertainty.correlation=[[1,1,1],[1,1,1],[1,1,1]]"]
    apart, alike = (ctrplan.bound_with_parameters(robot(given), THETA, L) for given in (ci95, together))
    assert np.all(alike.position_m - alike.friction_m < 0.02e-3)
    assert np.all(apart.position_m - apart.friction_m > 0.5e-3)
