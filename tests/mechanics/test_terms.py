"""Terms beyond the paper (loads, softening, ovality, shafts, varying precurvature) against closed forms and limits."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from places import ROBOTS
from scipy.integrate import solve_bvp

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Shape, Status
from ctrplan.mechanics.tube import Loads, Tube, TubeSection

ROBOT = load_robot(ROBOTS / "three_tube.toml")
THETA, L = np.array([0.0, 1.3, 2.9]), np.array([0.0, -0.017, -0.07])
EI, LENGTH, RADIUS = 0.02, 0.15, 1e-3
WIRE = Tube(2 * RADIUS, 1e-3, EI, 0.3, (TubeSection(LENGTH, 0.0, 0.0),))


def single(tube: Tube, loads: Loads | None = None) -> Shape:
    shape = Mechanics([tube], [], [], loads).solve([0.0], [0.0])
    assert shape.status is Status.CONVERGED
    return shape


def three_tubes(*, loads: Loads | None = None, **changes: Any) -> Mechanics:
    tubes = [replace(tube, **changes) for tube in ROBOT.tubes]
    return Mechanics(tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], loads)


def tip(mechanics: Mechanics, phi: float = 1.0) -> Array:
    shape = mechanics.solve(THETA, L, phi)
    assert shape.status is Status.CONVERGED
    return shape.tip_m


@pytest.mark.parametrize("force", [0.01, 0.1, 1.0])
def test_a_force_across_a_straight_wire_bends_it_as_the_elastica(force: float) -> None:
    arc = np.linspace(0, LENGTH, 200)
    elastica = solve_bvp(
        lambda s, y: np.array([y[1], -force / EI * np.cos(y[0])]),
        lambda base, end: np.array([base[0], end[1]]),
        arc,
        np.zeros((2, 200)),
        tol=1e-10,
        max_nodes=100_000,
    )
    slope = elastica.sol(np.linspace(0, LENGTH, 4001))[0]
    expected = [np.trapezoid(np.sin(slope), dx=LENGTH / 4000), 0.0, np.trapezoid(np.cos(slope), dx=LENGTH / 4000)]
    # chords stand for arcs of 10 mm: 0.02 % of the deflection
    np.testing.assert_allclose(single(WIRE, Loads(tip_force_N=(force, 0, 0))).tip_m, expected, atol=2e-4 * expected[0])


def test_weight_bends_a_wire_by_w_l4_over_8_ei() -> None:
    heavy = replace(WIRE, density_kg_m3=6450.0)
    weight = heavy.mass_per_length_kg_m * 9.81
    shape = single(heavy, Loads(gravity_m_s2=(0, -9.81, 0)))
    assert shape.tip_m[1] == pytest.approx(-weight * LENGTH**4 / (8 * EI), rel=2e-3)


@pytest.mark.parametrize("moment", [0.05, 0.2, 0.4])
def test_beyond_the_knee_curvature_grows_with_the_softer_tangent(moment: float) -> None:
    knee, fraction = 0.004 / RADIUS, 0.4
    soft = replace(WIRE, softening_strain=0.004, softening_fraction=fraction)
    shape = single(soft, Loads(tip_moment_Nm=(0, moment, 0)))
    linear = moment / EI
    curvature = linear if linear < knee else knee + (linear - knee) / fraction
    expected = [(1 - math.cos(curvature * LENGTH)) / curvature, 0, math.sin(curvature * LENGTH) / curvature]
    np.testing.assert_allclose(shape.tip_m, expected, atol=1e-9)
    assert shape.max_strain == pytest.approx(curvature * RADIUS, rel=1e-9)


@pytest.mark.parametrize("axis", [0.0, 0.4])
def test_an_oval_wire_bends_by_the_stiffness_of_each_axis(axis: float) -> None:
    oval = replace(WIRE, ovality=0.2, ovality_axis_rad=axis)
    moment = 1e-4  # small: no finite rotations
    tip_m = single(oval, Loads(tip_moment_Nm=(0, moment, 0))).tip_m
    c, s = math.cos(axis), math.sin(axis)  # curvature vector along x: its parts along the two axes
    kappa = moment / EI * np.array([c * c / 1.2 + s * s / 0.8, c * s / 1.2 - c * s / 0.8])
    np.testing.assert_allclose(tip_m[:2], kappa * LENGTH**2 / 2, rtol=1e-5, atol=1e-12)


def test_ovality_turned_by_a_right_angle_changes_its_sign() -> None:
    turned = three_tubes(ovality=0.1, ovality_axis_rad=0.3 + math.pi / 2)
    np.testing.assert_allclose(tip(three_tubes(ovality=-0.1, ovality_axis_rad=0.3)), tip(turned), atol=1e-9)


@pytest.mark.parametrize(
    "negligible",
    [
        {"ovality": 1e-13},
        {"softening_strain": 0.5, "softening_fraction": 0.5},
        {"softening_strain": 1e-3, "softening_fraction": 1 - 1e-12},
        {"shaft_compliance_rad_per_Nm": 1e-6},
        {"loads": Loads(tip_force_N=(1e-12, 0, 0))},
    ],
)
def test_the_general_law_contains_the_plain_one(negligible: dict[str, Any]) -> None:
    np.testing.assert_allclose(tip(three_tubes(**negligible)), tip(ROBOT.mechanics), atol=2e-8)


def test_a_uniformly_soft_robot_is_a_less_stiff_one() -> None:
    """Far beyond a tiny knee every tube has the fraction of its stiffness, its torsional one kept."""
    soft = three_tubes(softening_strain=1e-9, softening_fraction=0.5)
    weaker = [
        replace(t, bending_stiffness_Nm2=t.bending_stiffness_Nm2 / 2, poisson_ratio=(1 + t.poisson_ratio) / 2 - 1)
        for t in ROBOT.tubes
    ]
    np.testing.assert_allclose(tip(soft), tip(Mechanics(weaker, ROBOT.clearance_m, ROBOT.friction[:, 1])), atol=2e-6)


def test_a_compliant_shaft_turns_the_collar_by_its_torque() -> None:
    """Frictionless, the robot with a shaft is the rigid one whose collar stands where the shaft lets it."""
    compliance = 2.0
    tubes = [*ROBOT.tubes[:2], replace(ROBOT.tubes[2], shaft_compliance_rad_per_Nm=compliance)]
    shape = Mechanics(tubes, ROBOT.clearance_m, [0, 0]).solve(THETA, L)
    inner = shape.tubes[2]
    torque = tubes[2].bending_stiffness_Nm2 / (1 + tubes[2].poisson_ratio) * inner.curvature_per_m[0, 2]
    assert inner.theta_rad[0] - THETA[2] == pytest.approx(compliance * torque, rel=1e-6)
    rigid = Mechanics(ROBOT.tubes, ROBOT.clearance_m, [0, 0])
    np.testing.assert_allclose(rigid.solve([*THETA[:2], inner.theta_rad[0]], L).tip_m, shape.tip_m, atol=1e-8)


def test_a_varying_precurvature_is_the_limit_of_many_sections() -> None:
    gradient, pieces = 0.4, 60
    curved = ROBOT.tubes[2].sections[1]
    varying = replace(curved, gradient=gradient)
    steps = [
        TubeSection(
            curved.length_m / pieces,
            0.0,
            curved.curvature_y_per_m * (1 + gradient * (2 * (k + 0.5) / pieces - 1)),
        )
        for k in range(pieces)
    ]
    tips = []
    for sections in ([varying], steps):
        inner = replace(ROBOT.tubes[2], sections=(ROBOT.tubes[2].sections[0], *sections))
        mechanics = Mechanics([*ROBOT.tubes[:2], inner], ROBOT.clearance_m, ROBOT.friction[:, 1])
        tips += [mechanics.solve(THETA, L, 1.0, accuracy="certificate").tip_m, mechanics.zero_clearance(THETA, L).tip_m]
    np.testing.assert_allclose(tips[0], tips[2], atol=0.15e-3)  # joints of sections refine the mesh of the second one
    np.testing.assert_allclose(tips[1], tips[3], atol=0.02e-3)


def test_loads_turn_with_the_robot() -> None:
    angle = 0.7
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    force, gravity = np.array([0.1, 0.02, -0.05]), np.array([0.0, -9.81, 1.0])
    still = three_tubes(loads=Loads(tuple(force), gravity_m_s2=tuple(gravity)), density_kg_m3=6450.0)
    turned = three_tubes(loads=Loads(tuple(turn @ force), gravity_m_s2=tuple(turn @ gravity)), density_kg_m3=6450.0)
    moved = turned.solve(THETA + angle, L, 1.0)
    np.testing.assert_allclose(moved.tip_m, turn @ tip(still), atol=1e-8)


@pytest.mark.parametrize(
    "loads", [Loads((0.3, -0.2, 0.1)), Loads(tip_moment_Nm=(0.01, 0.005, 0.01)), Loads(gravity_m_s2=(0, -98.1, 0))]
)
@pytest.mark.parametrize("phi", [0.0, 1.0])
def test_loaded_shapes_agree_with_exact_geometry_as_well_as_unloaded_ones(loads: Loads, phi: float) -> None:
    away = []
    for load in (Loads(), loads):
        mechanics = three_tubes(loads=load, density_kg_m3=6450.0)
        tips = [mechanics.solve(THETA, L, phi, accuracy=a).tip_m for a in ("certificate", "exact")]  # type: ignore[arg-type]
        away.append(np.linalg.norm(tips[0] - tips[1]))
    assert away[1] < 1.3 * away[0] + 0.01e-3  # the loads move the tip by some millimetres


PLAIN = [
    "tube.1.section.1.curvature_y_per_m",
    "tube.3.section.2.curvature_x_per_m",
    "tube.3.section.2.gradient",
    "tube.2.bending_stiffness_Nm2",
    "tube.3.poisson_ratio",
    "tube.3.shaft_compliance_rad_per_Nm",
    "tube.1.ovality",
    "tube.3.softening_fraction",
    "tube.3.density_kg_m3",
    "contact.2.friction_coefficient",
    "loads.tip_force_N.1",
    "loads.tip_moment_Nm.2",
    "loads.gravity_m_s2.2",
    "theta_b.1",
    "theta_b.3",
]
GENERAL = {
    "ovality": 0.05,
    "softening_strain": 0.006,
    "softening_fraction": 0.6,
    "shaft_compliance_rad_per_Nm": 0.5,
    "density_kg_m3": 6450.0,
}
LOADS = Loads((0.05, 0.0, -0.05), (0.0, 1e-3, 0.0), (0.0, 9.81, 0.0))


def with_change(name: str, change: float, general: bool) -> tuple[Mechanics, Array]:
    """The robot and its base rotations after a parameter has changed."""
    tubes = [replace(tube, **(GENERAL if general else {})) for tube in ROBOT.tubes]
    friction, theta = ROBOT.friction[:, 1].copy(), THETA.copy()
    loads = LOADS if general else Loads()
    kind, *rest = name.split(".")
    k = int(rest[0]) - 1 if rest[0].isdecimal() else int(rest[1]) - 1
    if kind == "theta_b":
        theta[k] += change
    elif kind == "contact":
        friction[k] += change
    elif kind == "loads":
        vector = list(getattr(loads, rest[0]))
        vector[k] += change
        loads = replace(loads, **{rest[0]: tuple(vector)})
    elif rest[1] == "section":
        sections = list(tubes[k].sections)
        j = int(rest[2]) - 1
        sections[j] = replace(sections[j], **{rest[3]: getattr(sections[j], rest[3]) + change})
        tubes[k] = replace(tubes[k], sections=tuple(sections))
    else:
        tubes[k] = replace(tubes[k], **{rest[1]: getattr(tubes[k], rest[1]) + change})
    return Mechanics(tubes, ROBOT.clearance_m, friction, loads), theta


STEP = {"bending_stiffness_Nm2": 1e-5, "density_kg_m3": 10.0, "gravity_m_s2": 0.1, "tip_moment_Nm": 1e-5}


@pytest.mark.parametrize("general", [False, True], ids=["plain", "all terms"])
@pytest.mark.parametrize("phi", [(0.0, 0.0), (1.0, -1.0)])
def test_derivatives_agree_with_differences_of_solutions(general: bool, phi: tuple[float, float]) -> None:
    states = np.array([phi])
    mechanics, theta = with_change("theta_b.1", 0.0, general)
    found = mechanics.tips_with_friction(theta[None], L[None], states, parameters=PLAIN)
    assert found.status[0] == Status.CONVERGED
    for k, name in enumerate(PLAIN):
        if not general and (name.endswith("softening_fraction") or name.endswith("density_kg_m3")):
            np.testing.assert_allclose(found.position_by[0, :, k], 0.0, atol=1e-9)
            continue
        h = next((step for key, step in STEP.items() if key in name), 1e-4)
        if name == "tube.3.shaft_compliance_rad_per_Nm" and not general:
            assert np.all(np.isnan(found.position_by[0, :, k]))  # a rigid shaft has no derivative by its compliance
            continue
        tips = []
        for change in (h, -h):
            moved, turned = with_change(name, change, general)
            tips.append(moved.tips_with_friction(turned[None], L[None], states))
        scale = np.linalg.norm(found.position_by[0, :, k]) + 1e-9
        expected = (tips[0].position_m[0] - tips[1].position_m[0]) / (2 * h)
        np.testing.assert_allclose(found.position_by[0, :, k], expected, atol=2e-3 * scale, err_msg=name)
        expected = (tips[0].tangent[0] - tips[1].tangent[0]) / (2 * h)
        np.testing.assert_allclose(found.tangent_by[0, :, k], expected, atol=2e-3 * scale / 0.02, err_msg=name)


def test_the_derivative_by_insertion_follows_the_moving_mesh() -> None:
    states, change = np.array([[1.0, 1.0]]), 2e-6
    found = ROBOT.mechanics.tips_with_friction(
        THETA[None], L[None], states, parameters=["l_b.3"], accuracy="certificate"
    )
    tips = [
        ROBOT.mechanics.tips_with_friction(
            THETA[None], (L + [0, 0, d])[None], states, accuracy="certificate"
        ).position_m[0]
        for d in (change, -change)
    ]
    np.testing.assert_allclose(found.position_by[0, :, 0], (tips[0] - tips[1]) / (2 * change), atol=0.01)


@pytest.mark.parametrize("l_1", [0.0, -0.3e-3, -0.7e-3, -1e-3, -3.1e-3])
def test_common_rotation_turns_the_tip_wherever_the_outer_collar_is(l_1: float) -> None:
    """Collars on a node whose place is rounded were once not turned."""
    tubes = (
        Tube(2.4e-3, 2.2e-3, 0.0507, 0.3, (TubeSection(0.15, 0.0, 3.8),)),
        Tube(2.0e-3, 1.8e-3, 0.0145, 0.3, (TubeSection(0.1, 0.0, 0.0), TubeSection(0.1, 0.0, 12.0))),
    )
    pair = Mechanics(tubes, [1e-4], [0.2])
    theta, l_b = np.array([[0.2, 1.5]]), np.array([[l_1, -0.012]])
    found = pair.tips_with_friction(theta, l_b, np.array([[1.0]]), parameters=["theta_b.1", "theta_b.2"])
    x, y, _ = found.position_m[0]
    np.testing.assert_allclose(found.position_by[0].sum(axis=1), [-y, x, 0.0], atol=1e-6)


def test_tips_agree_with_shapes() -> None:
    states = np.array([[0.0, 0.0], [1.0, -1.0], [-1.0, -1.0]])
    tips = ROBOT.mechanics.tips_with_friction(np.tile(THETA, (3, 1)), np.tile(L, (3, 1)), states)
    for k, state in enumerate(states):
        np.testing.assert_allclose(tips.position_m[k], ROBOT.solve(THETA, L, state).tip_m, atol=1e-7)
