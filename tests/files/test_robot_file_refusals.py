"""A robot file that can't be one is refused in one sentence with file, key, value, unit and rule."""

from __future__ import annotations

import contextlib
import copy
import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pair_file import PAIR, pair
from refusals import refusals

from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.robot.robot import Robot

# A text of PAIR, what replaces it ("\n" is a new line), and below it the sentence after the file's name.
REFUSED = r"""
name = "pair" -> name = 3
    name = 3: must be text.
name = "pair" -> name = ""
    name = '': must be text of length >= 1.
name = "pair" -> name = "a\tb"
    name = 'a\tb': must be one line of printable text.
name = "pair" -> nmae = "pair"
    nmae = 'pair': unknown key, did you mean name?
name = "pair" -> "" = "pair"
    "" = 'pair': unknown key, known ones are tube, and optional name, order, contact, home, joint, execution,
    model_error_mm, friction_memory, measurement, marker, uncertainty, effects, provenance.
name = "pair" -> [effects]\ntip_load = 1
    effects.tip_load = 1: must be a table.
name = "pair" -> model_error_mm = -1
    model_error_mm = -1 mm: must be from 0 to 1000.
poisson_ratio = 0.3 ->
    tube.1.poisson_ratio: is missing: the torsion is said by it, or in its place by shear_modulus_GPa or
    torsional_stiffness_Nm2.
poisson_ratio = 0.3 -> poisson_ratio = 'x'
    tube.1.poisson_ratio = 'x': must be a number.
poisson_ratio = 0.3 -> poisson_ratio = true
    tube.1.poisson_ratio = true: must be a number.
poisson_ratio = 0.3 -> poisson_ratio = 2020-01-01
    tube.1.poisson_ratio = 2020-01-01: must be a number.
poisson_ratio = 0.3 -> poisson_ratio = nan
    tube.1.poisson_ratio = nan: must be a finite number.
poisson_ratio = 0.3 -> poisson_ratio = 100
    tube.1.poisson_ratio = 100: must be above -0.999 and at most 99.
poisson_ratio = 0.3 -> poisson_ratio = -0.999
    tube.1.poisson_ratio = -0.999: must be above -0.999 and at most 99.
poisson_ratio = 0.3 -> poison_ratio = 0.3
    tube.1.poison_ratio = 0.3: unknown key, did you mean poisson_ratio?
length_mm = 150 -> length_mm = inf
    tube.1.section.1.length_mm = inf mm: must be a finite number.
length_mm = 150 -> length_mm = 0
    tube.1.section.1.length_mm = 0 mm: must be above 0 and at most 100000.
length_mm = 150 -> length_mm = 15000
    tube.1.section.1.length_mm = 15000 mm: must be at most 5000 mm, is it in millimetres?
length_mm = 150 -> length_cm = 15
    tube.1.section.1.length_cm = 15: unknown key, expected length_mm (in mm).
length_mm = 150 -> length = 150
    tube.1.section.1.length = 150: unknown key, expected length_mm (in mm).
length_mm = 150 ->
    tube.1.section.1.length_mm: is missing.
curvature_y_per_m = 6.5 -> curvature_y_per_mm = 0.0065
    tube.1.section.1.curvature_y_per_mm = 0.0065: unknown key, expected curvature_y_per_m (in 1/m).
curvature_y_per_m = 6.5 -> curvature_y_per_m = 6500
    tube.1.section.1.curvature_y_per_m = 6500 1/m: must be within -1000 to 1000 1/m, is it per metre?
outer_diameter_mm = 1.3 -> outer_diameter_m = 0.0013
    tube.1.outer_diameter_m = 0.0013: unknown key, expected outer_diameter_mm (in mm).
outer_diameter_mm = 1.3 -> outer_diameter_mm = 1.05
    tube.1.inner_diameter_mm = 1.1 mm: must be smaller than outer_diameter_mm = 1.05 mm.
outer_diameter_mm = 1.3 -> outer_diameter_mm = 1.1
    tube.1.inner_diameter_mm = 1.1 mm: must be smaller than outer_diameter_mm = 1.1 mm.
outer_diameter_mm = 1.0 -> outer_diameter_mm = 1.1
    tube.2.outer_diameter_mm = 1.1 mm: must be smaller than tube.1.inner_diameter_mm = 1.1 mm.
length_mm = 200 -> length_mm = 160
    tube.2: sections add up to 160 mm, must be at least 167 mm: the length of tube 1 (150 mm) and this tube's
    collar (17 mm).
bending_stiffness_Nm2 = 0.04 -> bending_stiffness_Nm2 = 0
    tube.2.bending_stiffness_Nm2 = 0 N m^2: must be from 1e-09 to 1e+06.
bending_stiffness_Nm2 = 0.04 -> youngs_modulus_GPa = 65e9
    tube.2.youngs_modulus_GPa = 65000000000.0 GPa: must be from 1e-06 to 10000: is it in Pa?
bending_stiffness_Nm2 = 0.04 -> youngs_modulus_GPa = 65000
    tube.2.youngs_modulus_GPa = 65000 GPa: must be from 1e-06 to 10000: is it in MPa?
bending_stiffness_Nm2 = 0.04 -> bending_stiffness_Nmm2 = 4e4
    tube.2.bending_stiffness_Nmm2 = 40000.0: unknown key, expected bending_stiffness_Nm2 (in N m^2).
collar_length_mm = 17 -> collar_length_mm = -1
    tube.2.collar_length_mm = -1 mm: must be from 0 to 5000.
collar_length_mm = 17 -> max_strain = 8
    tube.2.max_strain = 8: must be above 0 and at most 1, a share: is it in %?
[[contact]]\nfriction_coefficient = 0.2 ->
    contact: must be given once per neighbouring pair of tubes, 1 in all, not 0.
[[contact]]\n -> [[contact]]\nfriction_coefficient = 0.1\n[[contact]]\n
    contact: must be given once per neighbouring pair of tubes, 1 in all, not 2.
friction_coefficient = 0.2 -> friction_coefficient = -0.1
    contact.1.friction_coefficient = -0.1: must be a number from 0 to 2, or an interval [low, high] within 0 to 2
    with low <= high.
friction_coefficient = 0.2 -> friction_coefficient = 2.1
    contact.1.friction_coefficient = 2.1: must be a number from 0 to 2, or an interval [low, high] within 0 to 2
    with low <= high: is it in %?
friction_coefficient = 0.2 -> friction_coefficient = [0.3, 0.1]
    contact.1.friction_coefficient = [0.3, 0.1]: must be a number from 0 to 2, or an interval [low, high] within 0
    to 2 with low <= high.
friction_coefficient = 0.2 -> friction_coefficient = [0.3]
    contact.1.friction_coefficient = [0.3]: must be a number from 0 to 2, or an interval [low, high] within 0 to 2
    with low <= high.
friction_coefficient = 0.2 -> friction_coefficient = [0.1, '0.3']
    contact.1.friction_coefficient.2 = '0.3': must be a number.
friction_coefficient = 0.2 -> friction_coefficient = [0.1, nan]
    contact.1.friction_coefficient.2 = nan: must be a finite number.
friction_coefficient = 0.2 -> friction_coefficient = 'low'
    contact.1.friction_coefficient = 'low': must be a number or a list.
friction_coefficient = 0.2 -> friction_coefficient = 0.2\nclearance_mm = 0
    contact.1.clearance_mm = 0 mm: must be above 0 and at most 1000.
tangent_sigma_deg = 0.5 -> tangent_sigma_rad = 0.01
    measurement.tangent_sigma_rad = 0.01: unknown key, expected tangent_sigma_deg (in deg).
tangent_sigma_deg = 0.5 -> tangent_sigma_deg = 0
    measurement.tangent_sigma_deg = 0 deg: must be from 1e-06 to 180.
theta_deg = [0, 90] -> theta_rad = [0, 1.57]
    home.theta_rad = [0, 1.57]: unknown key, expected theta_deg (in deg).
theta_deg = [0, 90] -> theta_deg = [0]
    home.theta_deg = [0]: must have one value per tube, 2.
theta_deg = [0, 90] -> theta_deg = [0, true]
    home.theta_deg.2 = true: must be a number.
l_mm = [0, -17] -> l_mm = [0, -17, -34]
    home.l_mm = [0, -17, -34]: must have one value per tube, 2.
l_mm = [0, -17] -> l_mm = [0, -1e4]
    home.l_mm.2 = -10000.0 mm: must be from -5000 to 5000.
l_mm = [0, -17] -> l_mm = [1, -17]
    home.l_mm = [1, -17]: no joint values within limits nest the tubes, at home the base of tube 1 at l_1b = 1 mm
    must be at or behind the plate, l_1b <= 0.
l_mm = [0, -17] -> l_mm = [-20, 20]
    home.l_mm = [-20, 20]: no joint values within limits nest the tubes, at home the base of tube 2 (moved by
    translate inner) at l_2b = 20 mm and the base of tube 1 at l_1b = -20 mm must be at least 17 mm apart, the
    collar of tube 2.
l_mm = [0, -17] -> l_mm = [0, -90]
    home.l_mm = [0, -90]: no joint values within limits nest the tubes, at home the base of tube 2 (moved by
    translate inner) at l_2b = -90 mm and the base of tube 1 at l_1b = 0 mm must keep the tips in order, but tube
    2 ends at 110 mm and tube 1 at 150 mm.
name = "translate inner" -> name = "rotate inner"
    joint.2.name = 'rotate inner': must differ from the names of the other joints.
name = "translate inner" -> name = "rotate_inner"
    joint.2.name = 'rotate_inner': must differ from the names of the other joints by more than blanks and underscores.
name = "translate inner" ->
    joint.2.name: is missing.
moves = { l = [0, 1] } -> moves = { l = [0, 1], theta = [0, 1] }
    joint.2.moves: must have either theta or l.
moves = { l = [0, 1] } -> moves = {}
    joint.2.moves: must have either theta or l.
moves = { l = [0, 1] } -> moves = { l = [1] }
    joint.2.moves.l = [1]: must have one value per tube, 2, not all zero.
moves = { l = [0, 1] } -> moves = { l = [0, 0] }
    joint.2.moves.l = [0, 0]: must have one value per tube, 2, not all zero.
moves = { l = [0, 1] } -> moves = { x = [0, 1] }
    joint.2.moves.x = [0, 1]: unknown key, known ones, all optional, are theta, l.
moves = { theta = [0, 1] } -> moves = { theta = [0, 0.5] }
    joint.1.moves.theta = [0, 0.5]: must be whole numbers for an unlimited rotation, else give min_deg and
    max_deg.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_mm = -5
    joint.1.min_mm = -5 mm: does not go with a rotation joint (moves.theta), expected min_deg.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_deg = -5
    joint.1.max_deg: is missing, give both limits or neither.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_deg = 5\nmax_deg = 5
    joint.1.min_deg = 5 deg: must be smaller than max_deg = 5 deg: leave out a joint that does not move, [home] says
    where it stands.
max_velocity_deg_s = 30 -> max_velocity_deg_s = 0
    joint.1.max_velocity_deg_s = 0 deg/s: must be from 0.001 to 1e+06.
max_velocity_deg_s = 30 -> max_velocity_rad_s = 1
    joint.1.max_velocity_rad_s = 1: unknown key, expected max_velocity_deg_s (in deg/s) or max_velocity_mm_s (in
    mm/s).
max_velocity_deg_s = 30 -> max_velocity = 1
    joint.1.max_velocity = 1: unknown key, expected max_velocity_deg_s (in deg/s) or max_velocity_mm_s (in mm/s).
min_mm = -33 ->
    joint.2.min_mm: is missing, a translation is limited.
min_mm = -33 -> min_deg = -33
    joint.2.min_deg = -33 deg: does not go with a translation joint (moves.l), expected min_mm.
min_mm = -33 -> min_mm = -33000
    joint.2.min_mm = -33000 mm: must be from -5000 to 5000.
max_mm = 0 -> max_mm = -40
    joint.2.min_mm = -33 mm: must be smaller than max_mm = -40 mm.
max_velocity_mm_s = 5 -> max_velocity_mm_s = 5\nmax_jerk_deg_s3 = 5
    joint.2.max_jerk_deg_s3 = 5 deg/s^3: does not go with a translation joint (moves.l), expected max_jerk_mm_s3.
"""
ABSURD = [
    ("name = 'a'", "tube: is missing."),
    ("tube = 3", "tube = 3: must be a list."),
    ("tube = []", "tube = []: must be a list of length >= 1."),
    ("tube = [1]", "tube.1 = 1: must be a table."),
    ("x = " + "[" * 24 + "]" * 24, "is nested too deeply."),
    ("model_error_mm = " + "9" * 5000, "holds a number with thousands of digits."),
    ("model_error_mm = 0x" + "f" * 5000, "model_error_mm = <int> mm: must be a finite number."),
]


CASES = refusals(REFUSED, PAIR) + ABSURD


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("text", "sentence"), CASES, ids=[sentence for _, sentence in CASES])
def test_every_fault_is_one_sentence_with_file_key_value_and_rule(folder: Path, text: str, sentence: str) -> None:
    (folder / "robot.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_robot("robot.toml")
    assert str(caught.value) == f"robot.toml: {sentence}"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("share", [0.5, 0.999, 1.001, 1.4])
@pytest.mark.parametrize("towards", [0.0, 0.7, 2.5])
def test_a_section_that_bends_within_the_tube_s_own_radius_is_refused(
    folder: Path, share: float, towards: float
) -> None:
    """However its curvature is divided between the axes: of a tube of 2 mm outer radius, above 500 1/m."""
    bend = share / 2e-3
    text = PAIR.replace("outer_diameter_mm = 1.3", "outer_diameter_mm = 4", 1)
    text = text.replace("curvature_x_per_m = 0", f"curvature_x_per_m = {bend * math.sin(towards)!r}", 1)
    text = text.replace("curvature_y_per_m = 6.5", f"curvature_y_per_m = {bend * math.cos(towards)!r}", 1)
    (folder / "robot.toml").write_text(text)
    if share < 1:
        assert load_robot("robot.toml").tubes[0].sections[0].curvature_per_m == pytest.approx(bend)
        return
    with pytest.raises(InputError) as caught:
        load_robot("robot.toml")
    place = f"robot.toml: tube.1.section.1: bends by a radius of {1e3 / bend:.3g} mm"
    assert re.fullmatch(
        re.escape(f"{place}, must be more than the tube's own outer radius") + r"(: is it its radius in [^.]*\?|\.)",
        str(caught.value),
    )


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything within a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(inner for key, item in items for inner in places(item, (*path, key)))]


CONTENT = pair()
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.dates()
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(max_size=3) | st.sampled_from(["theta", "l", "name"]), inner, max_size=3)
    ),
    max_leaves=6,
)
CHANGES = st.lists(st.tuples(st.sampled_from(places(CONTENT)[1:]), VALUES), min_size=1, max_size=3)


def changed(content: dict[str, Any], path: tuple[Any, ...], value: Any) -> None:
    for key in path[:-1]:
        content = content[key]
    content[path[-1]] = value


@settings(max_examples=200)
@given(CHANGES | st.dictionaries(st.sampled_from(sorted(CONTENT)) | st.text(max_size=5), VALUES))
def test_any_content_gives_a_robot_or_an_input_error(damage: Any) -> None:
    content: dict[str, Any] = damage
    if isinstance(damage, list):
        content = copy.deepcopy(CONTENT)
        for path, value in damage:
            with contextlib.suppress(KeyError, IndexError, TypeError):  # a place that an earlier change removed
                changed(content, path, value)
    try:
        assert isinstance(robot_from_dict(content), Robot)
    except InputError as error:
        assert str(error).isprintable()
