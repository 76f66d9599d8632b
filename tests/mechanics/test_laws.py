"""Symmetries, limits and closed forms that any model of concentric tubes with clearance and friction must obey."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from places import ROBOTS
from table_1_pair import table_1_pair

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Bound, Shape, Status
from ctrplan.mechanics.tube import Tube, TubeSection

ROBOT = load_robot(ROBOTS / "three_tube.toml")
THREE_TUBES = ROBOT.mechanics


def random_joints(seed: int, count: int) -> tuple[Array, Array]:
    """Base rotations (count, 3) anywhere, tube 3 between fully retracted and fully extended."""
    rng = np.random.default_rng(seed)
    l_b = np.tile([0.0, -0.017, 0.0], (count, 1))
    l_b[:, 2] = rng.uniform(-0.1204, -0.034, count)
    return rng.uniform(-np.pi, np.pi, (count, 3)), l_b


def shapes(bound: Bound) -> tuple[Shape, ...]:
    return (bound.frictionless, *bound.corners)


def three_tubes(mu: float) -> Mechanics:
    return Mechanics(ROBOT.tubes, ROBOT.clearance_m, [mu, mu])


@pytest.mark.parametrize("seed", range(8))
def test_common_rotation_turns_the_robot_and_leaves_the_bound(seed: int) -> None:
    (theta_b,), (l_b,) = random_joints(seed, 1)
    turn = np.random.default_rng(seed).uniform(-4 * np.pi, 4 * np.pi)
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    before, after = THREE_TUBES.bound(theta_b, l_b), THREE_TUBES.bound(theta_b + turn, l_b)
    for a, b in zip(shapes(before), shapes(after), strict=True):
        np.testing.assert_allclose(b.centreline_m, a.centreline_m @ R.T, rtol=0, atol=1e-9)
    assert after.position_m == pytest.approx(before.position_m, abs=1e-9)
    assert after.tangent_rad == pytest.approx(before.tangent_rad, abs=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_mirrored_joints_and_friction_mirror_the_robot(seed: int) -> None:
    """With precurvature about y alone the plane y = 0 is one of symmetry: theta and phi change sign."""
    (theta_b,), (l_b,) = random_joints(100 + seed, 1)
    before, after = THREE_TUBES.bound(theta_b, l_b), THREE_TUBES.bound(-theta_b, l_b)
    mirrored = (after.frictionless, *reversed(after.corners))  # product((1, -1)) negated is itself reversed
    for a, b in zip(shapes(before), mirrored, strict=True):
        np.testing.assert_allclose(b.centreline_m, a.centreline_m * [1, -1, 1], rtol=0, atol=1e-9)
    assert after.position_m == pytest.approx(before.position_m, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_full_turns_change_nothing(seed: int) -> None:
    (theta_b,), (l_b,) = random_joints(200 + seed, 1)
    turned = THREE_TUBES.bound(theta_b + 2 * np.pi * np.array([1, 1, 1]), l_b)
    assert turned.position_m == pytest.approx(THREE_TUBES.bound(theta_b, l_b).position_m, abs=1e-9)


def test_bound_vanishes_with_friction_and_begins_linearly() -> None:
    theta_b, l_b = random_joints(1, 12)
    none, little, double = (three_tubes(mu).bound_many(theta_b, l_b) for mu in (0.0, 1e-3, 2e-3))
    assert none.position_m.max() <= 1e-9
    assert none.tangent_rad.max() <= 1e-7
    np.testing.assert_allclose(double.position_m, 2 * little.position_m, rtol=0.01)
    np.testing.assert_allclose(double.tangent_rad, 2 * little.tangent_rad, rtol=0.01)


def test_bound_grows_with_friction() -> None:
    """Away from folds, which a corner passes where friction carries it over to another branch."""
    theta_b, l_b = random_joints(2, 60)
    bounds = [three_tubes(mu).bound_many(theta_b, l_b) for mu in np.linspace(0, 0.5, 7)]
    regular = (bounds[0].stability > 1) & np.all([bound.status == Status.CONVERGED for bound in bounds], axis=0)
    assert regular.sum() >= 50
    for quantity in ("position_m", "tangent_rad"):
        steps = np.diff([getattr(bound, quantity)[regular] for bound in bounds], axis=0)
        assert steps.min() > 0


@pytest.mark.parametrize("angle_deg", [30, 90, 180, 250])
def test_partial_friction_lies_between_the_corners(angle_deg: float) -> None:
    """The tip moves monotonically from one corner to the other, and so does the twist between the tubes, which lags."""
    model, q = table_1_pair(5e-5, 0.3), (np.deg2rad([0, angle_deg]), [0, -0.017])
    states = [model.solve(*q, phi) for phi in np.linspace(-1, 1, 9)]
    way = states[-1].tip_m - states[0].tip_m
    assert np.all(np.diff([shape.tip_m @ way for shape in states]) > 0)
    assert np.all(np.diff([shape.tubes[1].theta_rad[-1] - shape.tubes[0].theta_rad[-1] for shape in states]) < 0)
    bound = model.bound(*q)
    for shape in states:
        assert np.linalg.norm(shape.tip_m - bound.frictionless.tip_m) <= bound.position_m + 1e-9


def test_solve_at_a_corner_is_the_corner_of_the_bound() -> None:
    (theta_b,), (l_b,) = random_joints(3, 1)
    bound = THREE_TUBES.bound(theta_b, l_b)
    for phi, corner in zip(itertools.product((1, -1), repeat=2), bound.corners, strict=True):
        np.testing.assert_allclose(THREE_TUBES.solve(theta_b, l_b, phi).tip_m, corner.tip_m, rtol=0, atol=1e-7)


def test_bound_is_the_largest_deviation_of_its_shapes() -> None:
    (theta_b,), (l_b,) = random_joints(4, 1)
    bound = THREE_TUBES.bound(theta_b, l_b)
    free = bound.frictionless
    away = np.array([np.linalg.norm(corner.centreline_m - free.centreline_m, axis=1) for corner in bound.corners])
    np.testing.assert_allclose(bound.envelope_m, away.max(axis=0), rtol=0, atol=1e-12)
    assert bound.position_m == pytest.approx(bound.envelope_m[-1], abs=1e-12)
    assert bound.worst_corner == away[:, -1].argmax()
    turned = [math.acos(min(1.0, float(corner.tip_tangent @ free.tip_tangent))) for corner in bound.corners]
    assert bound.tangent_rad == pytest.approx(max(turned), abs=1e-6)


@pytest.mark.parametrize("l_b", [0.0, -0.04])
def test_one_tube_is_an_arc(l_b: float) -> None:
    """Straight behind the plate, an arc in front; nothing rubs; the lowest torsional mode is a quarter wave."""
    curvature, angle, length = 8.0, 0.7, 0.15 + l_b
    model = Mechanics((Tube(1.2e-3, 1e-3, 0.05, 0.3, (TubeSection(0.15, 0.0, curvature),)),), [], [])
    bound, zero_clearance = model.bound([angle], [l_b]), model.zero_clearance([angle], [l_b])
    bent, height = (1 - math.cos(curvature * length)) / curvature, math.sin(curvature * length) / curvature
    tip_m = [bent * math.cos(angle), bent * math.sin(angle), height]
    for shape in (bound.frictionless, zero_clearance):
        assert shape.status is Status.CONVERGED
        np.testing.assert_allclose(shape.tip_m, tip_m, rtol=0, atol=1e-12)
    assert (bound.position_m, bound.tangent_rad, len(bound.corners)) == (0, 0, 1)
    assert bound.frictionless.stability == pytest.approx((np.pi / 2) ** 2, rel=1e-3)


def test_precurvature_about_x_bends_towards_minus_y() -> None:
    model = Mechanics((Tube(1.2e-3, 1e-3, 0.05, 0.3, (TubeSection(0.15, 8.0, 0.0),)),), [], [])
    tip_m = model.solve([0.0], [0.0]).tip_m
    assert tip_m[1] == pytest.approx(-(1 - math.cos(1.2)) / 8)
    assert tip_m[0] == pytest.approx(0, abs=1e-12)


def test_two_aligned_tubes_of_one_curvature_are_one_tube() -> None:
    section = (TubeSection(0.15, 0.0, 5.0),)
    tubes = (Tube(1.2e-3, 1e-3, 0.05, 0.3, section), Tube(9e-4, 8e-4, 0.02, -0.1, section))
    bound = Mechanics(tubes, [5e-5], [0.3]).bound([0.3, 0.3], [0.0, 0.0])
    alone = Mechanics(tubes[:1], [], []).solve([0.3], [0.0])
    assert bound.position_m <= 1e-9
    np.testing.assert_allclose(bound.frictionless.tip_m, alone.tip_m, rtol=0, atol=1e-9)


def test_cutting_a_section_in_two_changes_nothing() -> None:
    half = TubeSection(0.075, 0.0, 1 / 0.15)
    tubes = (Tube(1.3e-3, 1.1e-3, 0.0507, 0.3, (half, half)), Tube(1e-3, 8e-4, 0.0507, 0.3, (half, half)))
    q = [0.0, 2.0], [0.0, 0.0]
    cut = Mechanics(tubes, [5e-5], [0.2]).bound(*q, accuracy="certificate")
    whole = table_1_pair(5e-5, 0.2, 0.0).bound(*q, accuracy="certificate")
    for a, b in zip(shapes(whole), shapes(cut), strict=True):
        np.testing.assert_allclose(a.tip_m, b.tip_m, rtol=0, atol=5e-5)  # a joint of sections refines the mesh


@pytest.mark.parametrize(("angle_deg", "order"), [(60, 0.5), (90, 0.5), (135, 0.5), (180, 1.0)])
def test_small_clearance_tends_to_the_zero_clearance_model(angle_deg: float, order: float) -> None:
    """The end couple acts over a length that goes with sqrt(c), and so does the tip; at 180 deg it shifts by c / 2.

    Without a transmission: behind the plate the zero-clearance model is a definition, not this limit.
    """
    q = np.deg2rad([0, angle_deg]), [0, 0]
    clearance_m = np.array([1e-5, 2e-5, 4e-5, 8e-5])
    limit = table_1_pair(1e-5, 0, 0.0).zero_clearance(*q).tip_m
    tips = [table_1_pair(c, 0, 0.0).solve(*q, accuracy="certificate").tip_m for c in clearance_m]
    away = np.linalg.norm(np.subtract(tips, limit), axis=1)
    slope = np.polyfit(np.log(clearance_m), np.log(away), 1)[0]
    assert slope == pytest.approx(order, abs=0.06)
    if angle_deg == 180:
        np.testing.assert_allclose(away, clearance_m / 2, rtol=1e-3)


def test_forces_scale_with_stiffness_and_shapes_do_not() -> None:
    """With and without friction, which is why Table IV can give stiffness ratios alone."""
    (theta_b,), (l_b,) = random_joints(5, 1)
    stiffer = [replace(tube, bending_stiffness_Nm2=4 * tube.bending_stiffness_Nm2) for tube in ROBOT.tubes]
    scaled = Mechanics(stiffer, ROBOT.clearance_m, [0.2, 0.2]).bound(theta_b, l_b)
    plain = THREE_TUBES.bound(theta_b, l_b)
    for a, b in zip(shapes(plain), shapes(scaled), strict=True):
        np.testing.assert_allclose(a.tip_m, b.tip_m, rtol=0, atol=5e-6)  # the barrier's own force does not scale
        for low, high in zip(a.contact_force_N, b.contact_force_N, strict=True):
            assert high.max() == pytest.approx(4 * low.max(), rel=0.01)


def test_tips_converge_in_the_mesh() -> None:
    """Search against certificate on random configurations; 0.3 mm is promised for the grid of Table III."""
    theta_b, l_b = random_joints(6, 60)
    coarse = THREE_TUBES.bound_many(theta_b, l_b)
    fine = THREE_TUBES.bound_many(theta_b, l_b, accuracy="certificate")
    solved = (coarse.status == Status.CONVERGED) & (fine.status == Status.CONVERGED) & (fine.stability > 0.5)
    assert solved.sum() >= 55
    assert np.linalg.norm(coarse.tip_m - fine.tip_m, axis=1)[solved].max() <= 5e-5  # without friction
    error_m = np.abs(coarse.position_m - fine.position_m)[solved]
    assert np.quantile(error_m, 0.95) <= 3e-4
    assert error_m.max() <= 6e-4
