"""Statics: the contact forces of a solution carry exactly the moments that bend and twist its tubes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Shape, Status, TubeShape
from ctrplan.mechanics.tube import Tube, TubeSection

ROBOT = load_robot(ROBOTS / "three_tube.toml")
CURVATURE = 1 / 0.15


class Case(NamedTuple):
    """A robot and one of its equilibria, on the fine mesh."""

    tubes: tuple[Tube, ...]
    clearance_m: Array
    mu_phi: Array  # (n - 1,) share of the contact force that acts circumferentially
    l_b: Array
    shape: Shape


def pair(angle_deg: float, phi: float, clearance_m: float = 5e-5, mu: float = 0.3) -> Case:
    """Balanced pair of Table I with its 17 mm transmission."""
    curved, bore = TubeSection(0.15, 0.0, CURVATURE), 1e-3 + 2 * clearance_m
    tubes = (
        Tube(bore + 2e-4, bore, 0.0507, 0.3, (curved,)),
        Tube(1e-3, 8e-4, 0.0507, 0.3, (TubeSection(0.017, 0.0, 0.0), curved)),
    )
    l_b = np.array([0.0, -0.017])
    shape = Mechanics(tubes, [clearance_m], [mu]).solve(np.deg2rad([0, angle_deg]), l_b, phi, accuracy="certificate")
    return Case(tubes, np.array([clearance_m]), np.array([mu * phi]), l_b, shape)


def three_tubes(second_deg: float, third_deg: float, l_3: float, phi: tuple[float, float]) -> Case:
    """Robot of Table II."""
    l_b = np.array([0, -0.017, l_3])
    shape = ROBOT.mechanics.solve(np.deg2rad([0, second_deg, third_deg]), l_b, phi, accuracy="certificate")
    return Case(ROBOT.tubes, ROBOT.clearance_m, 0.2 * np.array(phi), l_b, shape)


CASES = {
    "pair, aligned": lambda: pair(0, 0),
    "pair, 45 deg": lambda: pair(45, 0),
    "pair, 135 deg, +": lambda: pair(135, 1),
    "pair, 135 deg, half": lambda: pair(135, -0.5, 2e-4),
    "pair, opposed, +": lambda: pair(180, 1),
    "three tubes, 00": lambda: three_tubes(90, 200, -0.08, (0, 0)),
    "three tubes, +-": lambda: three_tubes(90, 200, -0.08, (1, -1)),
    "three tubes, retracted": lambda: three_tubes(40, 300, -0.11, (-1, -1)),
    "three tubes, extended": lambda: three_tubes(180, 270, -0.04, (1, 1)),
}


@pytest.fixture(scope="module", params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> Case:
    solved = CASES[request.param]()
    assert solved.shape.status is Status.CONVERGED
    return solved


def rotated(vector: Array, angle: Array) -> Array:
    """(N, 2) vectors turned by (N,) angles."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vector[:, 0] - s * vector[:, 1], s * vector[:, 0] + c * vector[:, 1]], axis=1)


def bending(case: Case, i: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Curvature kappa (t' = kappa) and rotated precurvature w of tube i, twist-free frame, and where sections join."""
    tube, shape = case.tubes[i], case.shape.tubes[i]
    rate = rotated(shape.curvature_per_m[:, :2], shape.theta_rad)
    joint = case.l_b[i] + np.cumsum([0, *(section.length_m for section in tube.sections)])
    section = np.clip(np.searchsorted(joint, shape.s_m - 1e-9) - 1, 0, len(tube.sections) - 1)
    v = np.array([(part.curvature_y_per_m, -part.curvature_x_per_m) for part in tube.sections])[section]
    at_joint = np.abs(shape.s_m[:, None] - joint).min(axis=1) < 1e-9
    return np.stack([rate[:, 1], -rate[:, 0]], axis=1), rotated(v, shape.theta_rad), at_joint


def contacts(case: Case, i: int) -> list[tuple[Array, Array, Array]]:
    """Stations, force (M, 2) and friction torque (M,) on tube i from each neighbour, (38) and (41)."""
    acting = []
    for pair, sign, arm_m in (
        (i, 1, case.tubes[i].inner_diameter_m / 2),
        (i - 1, -1, case.tubes[i].outer_diameter_m / 2),
    ):
        if 0 <= pair < len(case.tubes) - 1:
            force_N, angle = case.shape.contact_force_N[pair], case.shape.contact_angle_rad[pair]
            leaning = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            across = np.stack([-leaning[:, 1], leaning[:, 0]], axis=1)
            force = sign * force_N[:, None] * (leaning + case.mu_phi[pair] * across)
            acting.append((case.shape.contact_s_m[pair], force, sign * case.mu_phi[pair] * arm_m * force_N))
    return acting


def stiffest(case: Case) -> float:
    """EI x precurvature, the moment against which errors are measured."""
    return max(tube.bending_stiffness_Nm2 * tube.sections[-1].curvature_per_m for tube in case.tubes)


def test_contact_forces_bend_each_tube(case: Case) -> None:
    """EI (kappa - w) at s is the moment of the forces beyond s, levers along the arc, in front of the plate.

    Compared point by point with what linear curvatures in the elements can follow, hence the two tolerances.
    """
    for i, tube in enumerate(case.tubes):
        s_m = case.shape.tubes[i].s_m
        kappa, w, at_joint = bending(case, i)
        moment = tube.bending_stiffness_Nm2 * (kappa - w)
        expected = np.zeros_like(moment)
        for at_m, force, _ in contacts(case, i):
            expected += np.maximum(at_m - s_m[:, None], 0) @ force
        inside = (s_m > 1e-3) & ~at_joint
        error = np.linalg.norm(moment - expected, axis=1)[inside] / stiffest(case)
        assert np.sqrt(np.mean(error**2)) <= 0.01, i
        assert error.max() <= 0.05, i


def test_bending_moments_of_all_tubes_cancel(case: Case) -> None:
    """Nothing acts from outside in front of the plate: the cross section carries no moment."""
    outer = case.shape.tubes[0]
    stations = outer.s_m[(outer.s_m > 1e-3)]
    total = np.zeros((len(stations), 2))
    for i, tube in enumerate(case.tubes):
        kappa, w, _ = bending(case, i)
        at = np.searchsorted(case.shape.tubes[i].s_m, stations - 1e-12)
        total += tube.bending_stiffness_Nm2 * (kappa - w)[at]
    assert np.abs(total).max() <= 1e-9 * stiffest(case)


def test_torsion_carries_friction_and_bending_torques(case: Case) -> None:
    """GJ theta' at s is the friction torque beyond s plus the integral of EI (kappa - w) . J w."""
    for i, tube in enumerate(case.tubes):
        shape = case.shape.tubes[i]
        kappa, w, _ = bending(case, i)
        density = tube.bending_stiffness_Nm2 * np.sum((kappa - w) * np.stack([-w[:, 1], w[:, 0]], axis=1), axis=1)
        parts = 0.5 * (density[1:] + density[:-1]) * np.diff(shape.s_m)
        torque = np.append(np.cumsum(parts[::-1])[::-1], 0)
        for at_m, _, friction in contacts(case, i):
            torque += (at_m > shape.s_m[:, None] + 1e-12) @ friction
        twist = tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio) * shape.curvature_per_m[1:, 2]  # per element
        error = twist - 0.5 * (torque[1:] + torque[:-1])
        assert np.sqrt(np.mean(error**2)) <= 3e-3 * stiffest(case), i


def test_net_tip_moment_of_the_opposed_pair() -> None:
    """0.338 N m = EI x curvature straighten each tube (Fig. 10); the moment is there from 20 mm before the tip on."""
    case = pair(180, 0)
    s_m = case.shape.contact_s_m[0]
    force_N = case.shape.contact_force_N[0] * np.cos(case.shape.contact_angle_rad[0])
    near = s_m > 0.12
    assert np.sum((s_m[near] - 0.12) * force_N[near]) == pytest.approx(-0.338, rel=0.01)  # outer tube, about s = 0.12
    assert force_N[near].sum() == pytest.approx(0, abs=0.01 * np.abs(force_N).max())


def test_contacts_press_and_keep_within_the_clearance(case: Case) -> None:
    """Between centrelines integrated one by one in space, to which the model is exact for weakly bent tubes: 25 %."""
    for pair_index, clearance_m in enumerate(case.clearance_m):
        assert np.all(case.shape.contact_force_N[pair_index] >= 0)
        offset = offset_m(*case.shape.tubes[pair_index : pair_index + 2])
        assert offset.max() <= 1.25 * clearance_m


def offset_m(outer: TubeShape, inner: TubeShape) -> Array:
    """(N,) distance of the inner centreline from the outer one in the outer tube's cross section, (18)-(19)."""
    at = np.searchsorted(inner.s_m, outer.s_m - 1e-12)
    np.testing.assert_allclose(inner.s_m[at], outer.s_m, rtol=0, atol=1e-9)
    apart, tangent = inner.centreline_m[at] - outer.centreline_m, outer.frames[:, :, 2]
    in_section = apart - np.sum(apart * tangent, axis=1, keepdims=True) * tangent
    distance: Array = np.linalg.norm(in_section, axis=1)
    return distance


@pytest.mark.parametrize("transmission_m", [0.017, 0.1])
def test_the_rim_of_the_outer_tube_holds_the_inner_one(transmission_m: float) -> None:
    """Where an overlap begins the inner tube is inside the bore too, however steeply it enters."""
    curved, bore = TubeSection(0.15, 0.0, CURVATURE), 1.02e-3
    inner = Tube(1e-3, 8e-4, 0.0507, 0.3, (TubeSection(transmission_m, 0.0, 0.0), curved))
    model = Mechanics((Tube(bore + 2e-4, bore, 0.0507, 0.3, (curved,)), inner), [1e-5], [0.0])
    shape = model.solve([0.0, np.pi], [0.0, -transmission_m])
    assert offset_m(*shape.tubes)[0] <= 1.01e-5


def test_forces_gather_and_grow_as_the_clearance_shrinks() -> None:
    """Fig. 10: the tip force times its lever stays, the lever goes with sqrt(c). Fig. 13: friction lowers the force."""
    clearance_m = np.array([1e-5, 4e-5, 1.6e-4])
    tip_force_N = [pair(180, 0, c).shape.contact_force_N[0][-1] for c in clearance_m]
    slope = np.polyfit(np.log(clearance_m), np.log(tip_force_N), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.02)
    assert pair(180, 1).shape.contact_force_N[0][-1] < pair(180, 0).shape.contact_force_N[0][-1]


def test_strain_is_the_outer_fibre(case: Case) -> None:
    """r_out |u_xy - u_hat_xy|; where sections join, of the side that is strained more."""
    for i, (tube, shape) in enumerate(zip(case.tubes, case.shape.tubes, strict=True)):
        kappa, w, at_joint = bending(case, i)
        expected = tube.outer_diameter_m / 2 * np.linalg.norm(kappa - w, axis=1)
        assert np.all(shape.strain >= expected - 1e-12)
        # inside a section, the curvature of the elements on either side differs by the force in between
        np.testing.assert_allclose(shape.strain[~at_joint], expected[~at_joint], rtol=0, atol=1e-3)
    assert case.shape.max_strain == max(shape.strain.max() for shape in case.shape.tubes)


def test_frames_are_rotations_that_follow_the_centreline(case: Case) -> None:
    for shape in case.shape.tubes:
        np.testing.assert_allclose(
            shape.frames.transpose(0, 2, 1) @ shape.frames, np.tile(np.eye(3), (len(shape.s_m), 1, 1)), atol=1e-12
        )
        assert np.linalg.det(shape.frames).min() > 0
        step = np.diff(shape.s_m)
        short = step < 3e-3  # where differences are derivatives
        chord = (np.diff(shape.centreline_m, axis=0) / step[:, None])[short]
        mean = 0.5 * (shape.frames[1:, :, 2] + shape.frames[:-1, :, 2])[short]
        np.testing.assert_allclose(chord, mean, rtol=0, atol=1e-3)
        np.testing.assert_allclose(np.linalg.norm(chord, axis=1), 1, rtol=0, atol=1e-4)


def test_frames_turn_at_the_rate_of_the_curvature(case: Case) -> None:
    """(2): R' = R <u>, by differences between stations."""
    for i, shape in enumerate(case.shape.tubes):
        at_joint = bending(case, i)[2]
        step = np.einsum("nji,njk->nik", shape.frames[:-1], shape.frames[1:])
        rate = np.stack(
            [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], axis=1
        )
        rate /= 2 * np.diff(shape.s_m)[:, None]
        mean = 0.5 * (shape.curvature_per_m[1:] + shape.curvature_per_m[:-1])
        mean[:, 2] = shape.curvature_per_m[1:, 2]
        inside = ~at_joint[1:] & ~at_joint[:-1] & (np.diff(shape.s_m) < 3e-3)
        error = np.linalg.norm(rate - mean, axis=1)[inside]
        assert np.quantile(error, 0.9) <= 0.1  # 1/m, of curvatures up to 18
