"""Robots given by the numbers that people have: moduli, torsional stiffness, radii, the innermost tube first."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from measured_data import measured, waypoints

from ctrplan.calibration.calibrate import calibrate
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict

Content = dict[str, Any]
E_GPA, G_GPA = 75.0, 25.0


def tube(outer: float, inner: float, *lengths: float, **keys: Any) -> Content:
    """A straight section and a bent one."""
    straight, bent = ({"length_mm": length} for length in lengths)
    curves = ({"curvature_x_per_m": 0.0, "curvature_y_per_m": kappa} for kappa in (0.0, 8.0))
    sections = [straight | next(curves), bent | next(curves)]
    return {"outer_diameter_mm": outer, "inner_diameter_mm": inner, "section": sections} | keys


def robot(*tubes: Content, **keys: Any) -> Content:
    return {"tube": list(tubes), "contact": [{"friction_coefficient": 0.1}] * (len(tubes) - 1)} | keys


def moment_m4(outer: float, inner: float) -> float:
    return math.pi / 64 * (outer**4 - inner**4) * 1e-12


OUTER, INNER = (2.4, 2.0, 30.0, 60.0), (1.8, 1.5, 80.0, 50.0)
PLAIN = {"bending_stiffness_Nm2": 0.02, "poisson_ratio": 0.3}


def test_moduli_and_diameters_are_stiffnesses() -> None:
    moduli = {"youngs_modulus_GPa": E_GPA, "shear_modulus_GPa": G_GPA}
    made = robot_from_dict(robot(tube(*OUTER, **moduli), tube(*INNER, **moduli)))
    for given, (outer, inner, *_) in zip(made.tubes, (OUTER, INNER), strict=True):
        assert given.bending_stiffness_Nm2 == pytest.approx(E_GPA * 1e9 * moment_m4(outer, inner), rel=1e-12)
        GJ = given.bending_stiffness_Nm2 / (1 + given.poisson_ratio)
        assert pytest.approx(G_GPA * 1e9 * 2 * moment_m4(outer, inner), rel=1e-12) == GJ
        assert given.poisson_ratio == pytest.approx(0.5)


@pytest.mark.parametrize("ratio", [-0.7, 0.3, 1.97, 10.0])
def test_a_torsional_stiffness_of_its_own_is_that_of_the_model(ratio: float) -> None:
    """E and G that were fitted apart, whose ratio is that of no material."""
    keys = {"bending_stiffness_Nm2": 0.02, "torsional_stiffness_Nm2": 0.02 / (1 + ratio)}
    made = robot_from_dict(robot(tube(*OUTER, **PLAIN), tube(*INNER, **keys)))
    assert made.tubes[1].poisson_ratio == pytest.approx(ratio, rel=1e-12)
    # twisted freely behind the plate it turns by its torque over that stiffness
    shape = made.zero_clearance([0.0, 1.5], [0.0, -40.0e-3])
    torsion = shape.tubes[1].curvature_per_m[:, 2]
    assert np.isfinite(torsion).all() and abs(torsion[1]) > 1e-3


@pytest.mark.parametrize(
    ("keys", "phrase"),
    [
        (
            {"youngs_modulus_GPa": 75.0} | PLAIN,
            "youngs_modulus_GPa = 75.0.*: and bending_stiffness_Nm2 exclude each other",
        ),
        ({"shear_modulus_GPa": 25.0} | PLAIN, "shear_modulus_GPa = 25.0.*: and poisson_ratio exclude each other"),
        ({"poisson_ratio": 0.3}, "tube.1.bending_stiffness_Nm2: is missing: .* in its place by youngs_modulus_GPa"),
        ({"youngs_modulus_GPa": 75.0}, "poisson_ratio: is missing: .* by shear_modulus_GPa or torsional_stiffness_Nm2"),
        (PLAIN | {"poisson_ratio": -1.5}, "poisson_ratio = -1.5: must be above -0.999"),
        (
            {"bending_stiffness_Nm2": 0.02, "torsional_stiffness_Nm2": 1e-8},
            "torsional_stiffness_Nm2 = 1e-08.*EI / GJ = 2e.06",
        ),
        ({"youngs_modulus_GPa": 1e-6, "poisson_ratio": 0.3}, "makes a bending stiffness of 8.43e-10 N m.2"),
    ],
)
def test_choices_that_contradict_or_are_missing(keys: Content, phrase: str) -> None:
    with pytest.raises(InputError, match=phrase):
        robot_from_dict(robot(tube(*OUTER, **keys), tube(*INNER, **PLAIN)))


def test_a_ratio_of_no_material_is_taken_with_a_warning_that_names_the_key_for_it() -> None:
    made = robot_from_dict(robot(tube(*OUTER, **PLAIN), tube(*INNER, **(PLAIN | {"poisson_ratio": 1.974848}))))
    assert made.tubes[1].poisson_ratio == 1.974848
    (warning,) = [text for text in made.warnings if "poisson" in text]
    assert "tube.2.poisson_ratio = 1.974848: is above 0.5, which no material is" in warning
    assert "say torsional_stiffness_Nm2 = 0.00672303 in its place" in warning


def test_a_radius_is_an_arc_towards_x() -> None:
    arc = {
        "outer_diameter_mm": 2.0,
        "inner_diameter_mm": 1.6,
        **PLAIN,
        "section": [{"length_mm": 100, "radius_mm": 125}],
    }
    straight = {**arc, "section": [{"length_mm": 100}]}
    assert robot_from_dict(robot(straight)).tubes[0].sections[0].curvature_per_m == 0
    tip = robot_from_dict(robot(arc)).zero_clearance([0.0], [0.0]).tip_m
    np.testing.assert_allclose(tip, [0.125 * (1 - math.cos(0.8)), 0, 0.125 * math.sin(0.8)], atol=1e-9)
    with pytest.raises(InputError, match="section.1.radius_mm = 125.*: and curvature_x_per_m exclude each other"):
        robot_from_dict(robot({**arc, "section": [{"length_mm": 100, "radius_mm": 125, "curvature_x_per_m": 0.0}]}))
    with pytest.raises(InputError, match="curvature_y_per_m: is missing: say both curvatures, radius_mm in"):
        robot_from_dict(robot({**arc, "section": [{"length_mm": 100, "curvature_x_per_m": 0.0}]}))


def with_drive(tubes: list[Content], forward: bool) -> Content:
    step = slice(None, None, 1 if forward else -1)
    joints = [
        {"name": f"turn {i}", "moves": {"theta": [float(k == i) for k in range(3)][step]}}
        | {"max_velocity_deg_s": 60, "max_acceleration_deg_s2": 200, "max_jerk_deg_s3": 2000}
        for i in range(3)
    ]
    joints.append(
        {"name": "slide", "moves": {"l": [0.0, 0.0, 1.0][step]}, "min_mm": -40, "max_mm": 0}
        | {"max_velocity_mm_s": 10, "max_acceleration_mm_s2": 50, "max_jerk_mm_s3": 500}
    )
    home = {"theta_deg": [10.0, 20.0, 30.0][step], "l_mm": [0.0, -20.0, -40.0][step]}
    contact = [{"friction_coefficient": 0.1}, {"friction_coefficient": 0.2}]
    return {"tube": tubes[step], "contact": contact[step], "home": home, "joint": joints}


def test_the_innermost_tube_first_is_the_same_robot_where_it_is_said() -> None:
    tubes = [tube(*OUTER, **PLAIN), tube(*INNER, **PLAIN), tube(1.3, 1.0, 120.0, 60.0, **PLAIN)]
    plain, turned = with_drive(tubes, True), with_drive(tubes, False)
    one, other = robot_from_dict(plain), robot_from_dict(turned | {"order": "inner first"})
    assert one.tubes == other.tubes and one.contacts == other.contacts
    for name in ("matrix_theta", "matrix_l", "home_theta_rad", "home_l_m"):
        np.testing.assert_array_equal(getattr(one.drive, name), getattr(other.drive, name))
    assert robot_from_dict(dict(other.content)).tubes == one.tubes
    with pytest.raises(InputError, match='tube: fit into each other from the last .*order = "inner first"'):
        robot_from_dict(turned)
    with pytest.raises(InputError, match="order = 'inner first': does not go with effects, which numbers tubes"):
        robot_from_dict(turned | {"order": "inner first", "effects": {"tip_load": {"force_x_N": 0.1}}})
    with pytest.raises(InputError, match="order = 'inner': must be one of outer first .* did you mean inner first"):
        robot_from_dict(turned | {"order": "inner"})


def test_a_calibrated_robot_of_such_keys_is_a_file_that_is_read_again(tmp_path: Path) -> None:
    keys = {"youngs_modulus_GPa": E_GPA, "torsional_stiffness_Nm2": 0.004}
    sensor = {"measurement": {"position_sigma_mm": 0.1, "tangent_sigma_deg": 0.2}}
    content = robot(tube(*OUTER, **keys), tube(*INNER, **keys), **sensor)
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(content))
    given = load_robot(tmp_path / "robot.toml")
    assert given.tubes[0].poisson_ratio > 0.5
    result = calibrate(
        given, measured(given, waypoints(given, 8)), ["tube.1.poisson_ratio", "tube.2.bending_stiffness_Nm2"]
    )
    again = robot_from_dict(result.robot_content())
    for one, other in zip(again.tubes, result.robot.tubes, strict=True):
        assert one.poisson_ratio == pytest.approx(other.poisson_ratio, rel=1e-5)
        assert one.bending_stiffness_Nm2 == pytest.approx(other.bending_stiffness_Nm2, rel=1e-5)
