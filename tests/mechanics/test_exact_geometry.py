"""accuracy="exact": the paper's equations on the geometry as it is, against independent solvers and against statics."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from typing import Any

import numpy as np
import paper_oracle as paper
import pytest
from made_up_input import FUZZ
from places import REFERENCE, ROOT
from scipy.interpolate import CubicSpline

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Shape, Status
from ctrplan.mechanics.tube import Loads, Tube, TubeSection

ROBOT = load_robot(ROOT / "scenarios" / "robots" / "three_tube.toml")
TABLE_5 = load_robot(ROOT / "scenarios" / "robots" / "table_5_pair.toml")
THETA, L = np.array([0.0, 1.3, 2.9]), np.array([0.0, -0.017, -0.07])
PAIRS = json.loads((REFERENCE / "pair_values.json").read_text())
TABLE_1, UNCERTAINTY_M = PAIRS["table_I_pair"], PAIRS["accuracy_m"]
POINTS = json.loads((REFERENCE / "three_tube_points.json").read_text())["points"]
EI, CURVATURE = 0.0507, 1 / 0.15


def table_1_tubes(clearance_m: float, transmission_m: float = 0.017) -> tuple[Tube, Tube]:
    curved = (TubeSection(0.15, 0.0, CURVATURE),)
    straight = (TubeSection(transmission_m, 0.0, 0.0),) if transmission_m else ()
    bore = 1e-3 + 2 * clearance_m
    return Tube(bore + 2e-4, bore, EI, 0.3, curved), Tube(1e-3, 8e-4, EI, 0.3, straight + curved)


def table_1_pair(clearance_m: float, mu: float, transmission_m: float = 0.017) -> Mechanics:
    return Mechanics(table_1_tubes(clearance_m, transmission_m), [clearance_m], [mu])


def three_tubes(widen: float = 1.0, loads: Loads | None = None, **changes: Any) -> Mechanics:
    """The robot of Table II with clearances so many times wider."""
    tubes = [replace(tube, **changes) for tube in ROBOT.tubes]
    return Mechanics(tubes, widen * ROBOT.clearance_m, ROBOT.friction[:, 1], loads)


def exact(model: Mechanics, theta_b: Any, l_b: Any, phi: Any = 0.0) -> Shape:
    """Solved to the residual of the exact equations."""
    shape = model.solve(theta_b, l_b, phi, accuracy="exact")
    assert shape.status is Status.CONVERGED
    assert shape.residual <= 1e-8
    return shape


def distance(a: Any, b: Any) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


# --- values from an independent solver ---


@pytest.mark.parametrize("row", TABLE_1["deviation_from_zero_clearance"])
def test_table_1_pair_without_friction(row: dict[str, Any]) -> None:
    """All clearances, 0.01 to 3 mm, 1 to 180 deg."""
    q = np.deg2rad([0, row["base_angle_deg"]]), [0, -0.017]
    assert distance(exact(table_1_pair(row["clearance_m"], 0.0), *q).tip_m, row["tip_m"]) <= 2e-5


@pytest.mark.parametrize("row", TABLE_1["friction_at_180_deg"])
def test_table_1_pair_with_friction(row: dict[str, Any]) -> None:
    """0.05 mm up to 0.1 mm of clearance, 2 % of the deviation up to 3 mm."""
    shape = exact(table_1_pair(row["clearance_m"], row["mu"]), [0, np.pi], [0, -0.017], row["phi"])
    error = distance(shape.tip_m, row["tip_m"])
    assert error <= 5e-5
    assert error <= 0.02 * row["deviation_m"]


@pytest.mark.parametrize("row", TABLE_1["transmission_at_180_deg"])
def test_table_1_pair_with_transmission(row: dict[str, Any]) -> None:
    transmission_m = row["transmission_m"]
    model = table_1_pair(row["clearance_m"], 0.0, transmission_m)
    tip_m = exact(model, [0, np.pi], [0, -transmission_m]).tip_m
    assert distance(tip_m, [0, 0, 0.15]) == pytest.approx(row["deviation_m"], abs=2e-5)


@pytest.mark.parametrize("row", TABLE_1["couple_at_180_deg"])
def test_table_1_pair_couple(row: dict[str, Any]) -> None:
    """The tip force times its arm to the opposite forces in the distal 100 mm, of which as much as it are counted."""
    transmission_m = row["transmission_m"]
    shape = exact(table_1_pair(row["clearance_m"], 0.0, transmission_m), [0, np.pi], [0, -transmission_m])
    s_m = shape.contact_s_m[0]
    force_N = shape.contact_force_N[0] * np.cos(shape.contact_angle_rad[0])
    tip_N, behind_m = force_N[-1], (0.15 - s_m)[:-1][::-1]
    opposite = np.clip(-force_N[:-1][::-1] * np.sign(tip_N), 0, None) * (behind_m < 0.1)
    taken = np.diff(np.minimum(np.cumsum(opposite), abs(tip_N)), prepend=0.0)
    arm_m = float(taken @ behind_m / taken.sum())
    assert abs(tip_N) == pytest.approx(row["tip_force_N"], rel=0.01)
    assert abs(tip_N) * arm_m == pytest.approx(row["couple_Nm"], rel=0.01)


@pytest.mark.parametrize("point", POINTS)
def test_three_tube_points_without_friction(point: dict[str, Any]) -> None:
    """With friction the points are up to 0.2 mm from here, and 0.1 mm from the oracle: docs/model.md."""
    shape = exact(ROBOT.mechanics, np.deg2rad(point["theta_b_deg"]), point["l_b_m"])
    assert distance(shape.tip_m, point["tip_m"]["0,0"]) <= point["uncertainty_m"]["0,0"] + 1e-6


# --- the paper's own equations solved by other means ---


@pytest.mark.parametrize("eta", [(0.0, 0.0), (1.0, -1.0), (1.0, 1.0)][: 3 if FUZZ else 2])
def test_three_tubes_with_wide_clearances_against_the_oracle(eta: tuple[float, float]) -> None:
    """Twenty times the clearances of Table II, 0.85 and 1.25 mm, where the first-order model is 0.3 to 0.5 mm off.

    0.05 mm as everywhere, of which the oracle's 2 mm mesh takes most.
    """
    model = three_tubes(20.0)
    nodes = paper.mesh(ROBOT.tubes, L, 6e-3, 2e-3, 8e-3)
    problem = paper.Problem(ROBOT.tubes, 20 * ROBOT.clearance_m, ROBOT.friction[:, 1], THETA, L, eta, nodes)
    oracle = paper.refine(problem)
    assert oracle.converged
    assert distance(exact(model, THETA, L, eta).tip_m, oracle.tip_m) <= 5e-5
    assert distance(model.solve(THETA, L, eta, accuracy="certificate").tip_m, oracle.tip_m) >= 2e-4


@pytest.mark.parametrize("row", PAIRS["table_V_pair"]["rows"][::3])
def test_table_5_pair(row: dict[str, Any]) -> None:
    """Bent by as much as turned: frictionless within 0.01 mm, friction within 0.03 mm."""
    bound = TABLE_5.bound(np.deg2rad([0, row["base_angle_deg"]]), [0, -0.0604], accuracy="exact")
    assert distance(bound.frictionless.tip_m, row["zero"]["tip_m"]) <= 1e-5
    for name, shape in zip(("plus", "minus"), bound.corners, strict=True):
        assert distance(shape.tip_m, row[name]["tip_m"]) <= 3e-5, name


# --- statics: the moment in every tube is that of the loads beyond ---


def internal_moments(model: Mechanics, shape: Shape, i: int, tubes: Any) -> tuple[Array, Array]:
    """Stations (K,) and K (u - u_hat) in the world frame (K, 3) of tube i, between the contacts."""
    tube, at = tubes[i], shape.tubes[i]
    joints = at.s_m[0] + np.cumsum([0.0] + [section.length_m for section in tube.sections])
    keep = np.array([np.abs(joints - s).min() > 1e-3 for s in at.s_m]) & (at.s_m > 0.002)
    section = np.clip(np.searchsorted(joints, at.s_m[keep]) - 1, 0, len(tube.sections) - 1)
    u_hat = np.array([[s.curvature_x_per_m, s.curvature_y_per_m, 0.0] for s in tube.sections])[section]
    stiffness = tube.bending_stiffness_Nm2 * np.array([1, 1, 1 / (1 + tube.poisson_ratio)])
    body = stiffness * (at.curvature_per_m[keep] - u_hat)
    return at.s_m[keep], np.einsum("kab,kb->ka", at.frames[keep], body)


def contact_loads(shape: Shape, pair: int, tubes: Any, share: float, clearance_m: float) -> tuple[Array, Array, Array]:
    """Stations (M,), forces on the outer tube (M, 3) and friction torques over the radius (M,)."""
    s_m, force_N, angle = (x[pair] for x in (shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad))
    outer = shape.tubes[pair]
    frames = CubicSpline(outer.s_m, outer.frames)(s_m)
    theta = np.interp(s_m, outer.s_m, outer.theta_rad)[:, None]
    e1 = np.cos(theta) * frames[:, :, 0] - np.sin(theta) * frames[:, :, 1]
    e2 = np.sin(theta) * frames[:, :, 0] + np.cos(theta) * frames[:, :, 1]
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    normal, across = cosine * e1 + sine * e2, cosine * e2 - sine * e1
    return s_m, force_N[:, None] * (normal + share * across), share * force_N


@pytest.mark.parametrize("loads", [None, Loads(tip_force_N=(0.3, -0.2, 0.1), tip_moment_Nm=(0.0, 0.01, -0.005))])
def test_moments_in_every_tube_balance_the_forces_beyond(loads: Loads | None) -> None:
    """(37) once more, from the shapes alone: arms and forces of the contacts in the world frame, tip loads included.

    Within 0.5 % of the robot's own moments, which interpolation between the stations and the barrier's torques leave.
    """
    phi, widen = np.array([1.0, -1.0]), 6.0
    model, tubes = three_tubes(widen, loads), ROBOT.tubes
    shape = exact(model, THETA, L, phi)
    own = max(t.bending_stiffness_Nm2 * s.curvature_y_per_m for t in tubes for s in t.sections)
    share = phi * ROBOT.friction[:, 1]
    for i, tube in enumerate(tubes):
        at = shape.tubes[i]
        position, tangent = CubicSpline(at.s_m, at.centreline_m), CubicSpline(at.s_m, at.frames[:, :, 2])
        s_m, expected = internal_moments(model, shape, i, tubes)
        moment = np.zeros_like(expected)
        for pair, sign, radius in ((i, 1, tube.inner_diameter_m / 2), (i - 1, -1, tube.outer_diameter_m / 2)):
            if not 0 <= pair < len(tubes) - 1:
                continue
            where, force, twist = contact_loads(shape, pair, tubes, share[pair], widen * ROBOT.clearance_m[pair])
            beyond = (where[None, :] > s_m[:, None])[..., None]
            arm = position(where)[None] - position(s_m)[:, None]
            each = np.cross(arm, sign * force[None]) + sign * (radius * twist)[:, None] * tangent(where)
            moment += np.where(beyond, each, 0.0).sum(1)
        if loads is not None and i == len(tubes) - 1:
            moment += np.cross(shape.tip_m - position(s_m), loads.tip_force_N) + loads.tip_moment_Nm
        error = np.abs(moment - expected).max(1) / own
        assert np.quantile(error, 0.9) <= 5e-3


# --- laws ---


def test_common_rotation_turns_the_solution() -> None:
    model, turn = three_tubes(10.0), 0.7
    c, s = np.cos(turn), np.sin(turn)
    plain, turned = exact(model, THETA, L, 1.0), exact(model, THETA + turn, L, 1.0)
    np.testing.assert_allclose(turned.tip_m, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ plain.tip_m, atol=5e-7)


def test_mirrored_joints_mirror_the_solution() -> None:
    """Reflection in the plane of the precurvatures turns angles and friction states around."""
    model, phi = three_tubes(10.0), np.array([1.0, -0.5])
    plain, mirrored = exact(model, THETA, L, phi), exact(model, -THETA, L, -phi)
    np.testing.assert_allclose(mirrored.tip_m, plain.tip_m * [1, -1, 1], atol=5e-7)


def test_difference_from_the_first_order_model_goes_with_the_clearance() -> None:
    widths, apart = np.array([0.5, 1.0, 2.0, 4.0, 8.0]), []
    for widen in widths:
        model = three_tubes(float(widen))
        first_order = model.solve(THETA, L, accuracy="certificate").tip_m
        apart.append(distance(exact(model, THETA, L).tip_m, first_order))
    slope = np.polyfit(np.log(widths), np.log(apart), 1)[0]
    assert 0.8 <= slope <= 1.3


def test_no_contact_is_no_difference() -> None:
    """One tube has nothing to be off from."""
    curved = Tube(1e-3, 8e-4, EI, 0.3, (TubeSection(0.05, 0.0, 0.0), TubeSection(0.1, 3.0, CURVATURE)))
    model = Mechanics([curved], [], [])
    np.testing.assert_allclose(
        model.solve([0.4], [0.0], accuracy="exact").tip_m, model.solve([0.4], [0.0]).tip_m, atol=1e-12
    )


@pytest.mark.parametrize("changes", [{"softening_strain": 0.002, "softening_fraction": 0.4}, {"ovality": 0.2}])
def test_other_cross_sections_converge_too(changes: dict[str, float]) -> None:
    model = three_tubes(**changes)
    first_order = model.solve(THETA, L, 1.0, accuracy="certificate").tip_m
    assert 0 < distance(exact(model, THETA, L, 1.0).tip_m, first_order) <= 2e-4


def test_bound_many_agrees_with_bound() -> None:
    bound = ROBOT.bound(THETA, L, accuracy="exact")
    many = ROBOT.bound_many([THETA], [L], accuracy="exact")
    assert many.position_m[0] == pytest.approx(bound.position_m, abs=1e-9)
    assert many.residual[0] <= 1e-8


def test_histories_say_that_they_are_of_first_order() -> None:
    with pytest.raises(InputError, match='"search" or "certificate"'):
        ROBOT.history(accuracy="exact")


# --- order of convergence ---

REFINEMENTS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])


@pytest.mark.parametrize("accuracy", ["certificate", "exact"])
def test_order_of_convergence_in_the_element_length(accuracy: Any) -> None:
    """Geometric mean of tip errors over pairs with friction, against 16 times shorter elements.

    Beam elements converge faster by themselves; angles and the places of contact forces leave between 1 and 2.
    Measured: 1.7 (certificate), 1.5 (exact).
    """
    errors = []
    for clearance_m, angle_deg in itertools.product([5e-5, 2.5e-4, 1e-3], [40, 60, 90, 120, 150, 170]):
        model, q = table_1_pair(clearance_m, 0.2), (np.deg2rad([0, angle_deg]), [0, -0.017])
        tips = [
            model.solve(*q, 1.0, accuracy=accuracy, refinement=float(r)).tip_m for r in np.append(REFINEMENTS, 16.0)
        ]
        errors.append([distance(tip, tips[-1]) for tip in tips[:-1]])
    mean = np.exp(np.log(errors).mean(0))
    order = -np.polyfit(np.log(REFINEMENTS), np.log(mean), 1)[0]
    assert 1.3 <= order <= 2.2
    assert np.all(np.diff(mean) < 0)
    assert mean[REFINEMENTS == 1.0][0] <= 2e-6


@pytest.mark.parametrize("refinement", [0.0, 0.1, 17.0, float("nan")])
def test_refinement_has_limits(refinement: float) -> None:
    with pytest.raises(InputError, match="refinement"):
        ROBOT.mechanics.solve(THETA, L, refinement=refinement)


def test_corners_that_slide_have_the_geometry_of_their_own_solution() -> None:
    """In this configuration friction leaves two corners no equilibrium near the frictionless one."""
    model = Mechanics(ROBOT.tubes, ROBOT.clearance_m, np.full(2, 0.4))
    theta_b, l_b = [0.0, -0.4755, 3.5579], [0.0, -0.017, -0.113]
    found = model.bound(theta_b, l_b, accuracy="exact")
    for phi, corner in zip(itertools.product((1.0, -1.0), repeat=2), found.corners, strict=True):
        alone = exact(model, theta_b, l_b, phi)
        assert distance(corner.tip_m, alone.tip_m) <= 0.02e-3
