"""A robot file is read as it stands, in SI units, or refused in one sentence with file, key, value, unit and rule."""

from __future__ import annotations

import contextlib
import copy
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrplan.errors import InputError
from ctrplan.robot import Robot, load_robot, nesting_violation, robot_from_dict

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SHIPPED = Path(__file__).parents[1] / "scenarios" / "robots"

PAIR = """
name = "pair"
[[tube]]
outer_diameter_mm = 1.3
inner_diameter_mm = 1.1
bending_stiffness_Nm2 = 0.05
poisson_ratio = 0.3
[[tube.section]]
length_mm = 150
curvature_x_per_m = 0
curvature_y_per_m = 6.5
[[tube]]
outer_diameter_mm = 1.0
inner_diameter_mm = 0.8
bending_stiffness_Nm2 = 0.04
poisson_ratio = -0.2
collar_length_mm = 17
[[tube.section]]
length_mm = 200
curvature_x_per_m = 0
curvature_y_per_m = 5
[[contact]]
friction_coefficient = 0.2
[measurement]
position_sigma_mm = 0.4
tangent_sigma_deg = 0.5
[home]
theta_deg = [0, 90]
l_mm = [0, -17]
[[joint]]
name = "rotate inner"
moves = { theta = [0, 1] }
max_velocity_deg_s = 30
[[joint]]
name = "translate inner"
moves = { l = [0, 1] }
min_mm = -33
max_mm = 0
max_velocity_mm_s = 5
"""
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
name = "pair" -> [effects]\ntip_load = 1
    effects.tip_load = 1: must be a table.
name = "pair" -> model_error_mm = -1
    model_error_mm = -1 mm: must be >= 0.
poisson_ratio = 0.3 ->
    tube.1.poisson_ratio: is missing.
poisson_ratio = 0.3 -> poisson_ratio = 'x'
    tube.1.poisson_ratio = 'x': must be a number.
poisson_ratio = 0.3 -> poisson_ratio = true
    tube.1.poisson_ratio = true: must be a number.
poisson_ratio = 0.3 -> poisson_ratio = 2020-01-01
    tube.1.poisson_ratio = 2020-01-01: must be a number.
poisson_ratio = 0.3 -> poisson_ratio = nan
    tube.1.poisson_ratio = nan: must be a finite number.
poisson_ratio = 0.3 -> poisson_ratio = 0.51
    tube.1.poisson_ratio = 0.51: must be <= 0.5.
poisson_ratio = 0.3 -> poisson_ratio = -0.999
    tube.1.poisson_ratio = -0.999: must be > -0.999.
poisson_ratio = 0.3 -> poison_ratio = 0.3
    tube.1.poison_ratio = 0.3: unknown key, did you mean poisson_ratio?
length_mm = 150 -> length_mm = inf
    tube.1.section.1.length_mm = inf mm: must be a finite number.
length_mm = 150 -> length_mm = 0
    tube.1.section.1.length_mm = 0 mm: must be > 0.
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
    tube.2.bending_stiffness_Nm2 = 0 N m^2: must be > 0.
bending_stiffness_Nm2 = 0.04 -> bending_stiffness_Nmm2 = 4e4
    tube.2.bending_stiffness_Nmm2 = 40000.0: unknown key, expected bending_stiffness_Nm2 (in N m^2).
collar_length_mm = 17 -> collar_length_mm = -1
    tube.2.collar_length_mm = -1 mm: must be >= 0.
collar_length_mm = 17 -> max_strain = 8
    tube.2.max_strain = 8: must be <= 1.
[[contact]]\nfriction_coefficient = 0.2 ->
    contact: must be given once per neighbouring pair of tubes, 1 in all, not 0.
[[contact]]\n -> [[contact]]\nfriction_coefficient = 0.1\n[[contact]]\n
    contact: must be given once per neighbouring pair of tubes, 1 in all, not 2.
friction_coefficient = 0.2 -> friction_coefficient = -0.1
    contact.1.friction_coefficient = -0.1: must be a number from 0 to 2, or an interval [low, high] within 0 to 2
    with low <= high.
friction_coefficient = 0.2 -> friction_coefficient = 2.1
    contact.1.friction_coefficient = 2.1: must be a number from 0 to 2, or an interval [low, high] within 0 to 2
    with low <= high.
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
    contact.1.clearance_mm = 0 mm: must be > 0.
tangent_sigma_deg = 0.5 -> tangent_sigma_rad = 0.01
    measurement.tangent_sigma_rad = 0.01: unknown key, expected tangent_sigma_deg (in deg).
tangent_sigma_deg = 0.5 ->
    measurement.tangent_sigma_deg: is missing.
theta_deg = [0, 90] -> theta_rad = [0, 1.57]
    home.theta_rad = [0, 1.57]: unknown key, expected theta_deg (in deg).
theta_deg = [0, 90] -> theta_deg = [0]
    home.theta_deg = [0]: must have one value per tube, 2.
theta_deg = [0, 90] -> theta_deg = [0, true]
    home.theta_deg.2 = true: must be a number.
l_mm = [0, -17] -> l_mm = [0, -17, -34]
    home.l_mm = [0, -17, -34]: must have one value per tube, 2.
l_mm = [0, -17] -> l_mm = [0, -1e4]
    home.l_mm.2 = -10000.0 mm: must be >= -5000.
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
    joint.2.moves.x = [0, 1]: unknown key, known ones are theta, l.
moves = { theta = [0, 1] } -> moves = { theta = [0, 0.5] }
    joint.1.moves.theta = [0, 0.5]: must be whole numbers for an unlimited rotation, else give min_deg and
    max_deg.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_mm = -5
    joint.1.min_mm = -5 mm: does not go with a rotation joint (moves.theta), expected min_deg.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_deg = -5
    joint.1.max_deg: is missing, give both limits or neither.
moves = { theta = [0, 1] } -> moves = { theta = [0, 1] }\nmin_deg = 5\nmax_deg = 5
    joint.1.min_deg = 5 deg: must be smaller than max_deg = 5 deg.
max_velocity_deg_s = 30 -> max_velocity_deg_s = 0
    joint.1.max_velocity_deg_s = 0 deg/s: must be > 0.
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
    joint.2.min_mm = -33000 mm: must be >= -5000.
max_mm = 0 -> max_mm = -40
    joint.2.min_mm = -33 mm: must be smaller than max_mm = -40 mm.
max_velocity_mm_s = 5 -> max_velocity_mm_s = 5\nmax_jerk_deg_s3 = 5
    joint.2.max_jerk_deg_s3 = 5 deg/s^3: does not go with a translation joint (moves.l), expected max_jerk_mm_s3.
"""
ABSURD = [
    ("", "tube: is missing."),
    ("tube = 3", "tube = 3: must be a list."),
    ("tube = []", "tube = []: must be a list of length >= 1."),
    ("tube = [1]", "tube.1 = 1: must be a table."),
    ("x = " + "[" * 24 + "]" * 24, "is nested too deeply."),
    ("model_error_mm = " + "9" * 5000, "holds a number with thousands of digits."),
    ("model_error_mm = 0x" + "f" * 5000, "model_error_mm = <int> mm: must be a finite number."),
]


def refused() -> list[tuple[str, str]]:
    """Text of the file and the sentence, for every entry of REFUSED."""
    cases = []
    for entry in re.split(r"\n(?! )", REFUSED.strip()):
        change, *sentence = entry.split("\n")
        old, new = (text.strip().replace(r"\n", "\n") for text in f"{change} ".split(" -> "))
        assert old in PAIR, old
        cases.append((PAIR.replace(old, new, 1), " ".join(line.strip() for line in sentence)))
    return cases


CASES = refused() + ABSURD


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pair(old: str = "", new: str = "") -> dict[str, Any]:
    """Content of PAIR, with the first `old` replaced."""
    assert old in PAIR
    return tomllib.loads(PAIR.replace(old, new, 1))


@pytest.mark.parametrize(("text", "sentence"), CASES, ids=[sentence for _, sentence in CASES])
def test_every_fault_is_one_sentence_with_file_key_value_and_rule(folder: Path, text: str, sentence: str) -> None:
    (folder / "robot.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_robot("robot.toml")
    assert str(caught.value) == f"robot.toml: {sentence}"
    assert caught.value.exit_code == 2


def test_values_arrive_in_si_units() -> None:
    content = pair()
    robot = robot_from_dict(content)
    for tube, table in zip(robot.tubes, content["tube"], strict=True):
        assert tube.outer_diameter_m * 1e3 == pytest.approx(table["outer_diameter_mm"], rel=1e-15)
        assert tube.inner_diameter_m * 1e3 == pytest.approx(table["inner_diameter_mm"], rel=1e-15)
        assert tube.collar_length_m * 1e3 == pytest.approx(table.get("collar_length_mm", 0), rel=1e-15)
        assert tube.bending_stiffness_Nm2 == table["bending_stiffness_Nm2"]
        assert tube.poisson_ratio == table["poisson_ratio"]
        assert tube.length_m * 1e3 == pytest.approx(sum(s["length_mm"] for s in table["section"]), rel=1e-15)
        assert [s.curvature_y_per_m for s in tube.sections] == [s["curvature_y_per_m"] for s in table["section"]]
    assert robot.measurement is not None
    assert robot.measurement.position_sigma_m == pytest.approx(0.4e-3, rel=1e-15)
    assert math.degrees(robot.measurement.tangent_sigma_rad) == pytest.approx(0.5, rel=1e-15)
    assert np.degrees(robot.drive.home_theta_rad) == pytest.approx([0, 90], rel=1e-15)
    assert robot.drive.home_l_m * 1e3 == pytest.approx([0, -17], rel=1e-15)
    assert robot.clearance_m * 1e3 == pytest.approx([0.05], rel=1e-12)
    assert robot.friction.tolist() == [[0.2, 0.2]]


def test_a_friction_interval_and_a_given_clearance_are_kept() -> None:
    robot = robot_from_dict(pair("= 0.2\n", "= [0.15, 0.25]\nclearance_mm = 0.09\n"))
    assert robot.friction.tolist() == [[0.15, 0.25]]
    assert robot.clearance_m * 1e3 == pytest.approx([0.09], rel=1e-12)
    assert robot.warnings == ()  # within the rounding of diameters


def test_effects_are_kept_as_they_stand_and_put_to_work() -> None:
    terms = {"tip_load": {"force_x_N": 0.1, "provenance": {"data": "a.csv", "day": "monday"}}}
    assert robot_from_dict({**pair(), "effects": terms}).effects == terms


def test_doubtful_clearances_are_warned_about() -> None:
    disagree = robot_from_dict(pair("= 0.2\n", "= 0.2\nclearance_mm = 0.11\n"), file="a.toml")
    assert disagree.warnings == (
        "a.toml: contact.1: radial clearance 0.11 mm is used, but the diameters leave 0.05 mm.",
    )
    wide = pair("outer_diameter_mm = 1.3\ninner_diameter_mm = 1.1", "outer_diameter_mm = 9\ninner_diameter_mm = 8")
    assert robot_from_dict(wide, file="a.toml").warnings == (
        "a.toml: contact.1: radial clearance 3.5 mm is above 2 % of the smallest radius of curvature (153.846 mm), "
        "the model is less accurate there.",
    )


def test_one_tube_needs_no_contact_and_thirteen_are_refused() -> None:
    content = pair()
    alone = {"tube": content["tube"][:1]}
    robot = robot_from_dict(alone)
    assert (robot.n, robot.clearance_m.shape, robot.friction.shape) == (1, (0,), (0, 2))
    with pytest.raises(InputError, match=r"^tube: must be a list of length <= 12\.$"):
        robot_from_dict({"tube": alone["tube"] * 13})


SHIPPED_CLEARANCES_MM = {
    "table_1_pair": [0.05],
    "table_4_pair": [1.625],
    "table_5_pair": [0.0375],
    "three_tube": [0.0425, 0.0625],
    "three_tube_calibrated": [0.0425, 0.0625],
    "three_tube_insertion": [0.0425, 0.0625],
}
SHIPPED_RADII_MM = {  # y-curvature of the curved section of each tube
    "table_1_pair": [150, 150],
    "table_4_pair": [365, 56],
    "table_5_pair": [288.1, 79.3],
    "three_tube": [265, 265, 55],
    "three_tube_calibrated": [282.8, 212.6, 62.37],
    "three_tube_insertion": [265, 265, 55],
}


def test_every_shipped_robot_is_listed_here() -> None:
    assert {path.stem for path in SHIPPED.glob("*.toml")} == set(SHIPPED_CLEARANCES_MM)


@pytest.mark.parametrize("name", SHIPPED_CLEARANCES_MM)
def test_shipped_robots_are_those_of_the_paper(name: str) -> None:
    robot = load_robot(SHIPPED / f"{name}.toml")
    assert robot.clearance_m * 1e3 == pytest.approx(SHIPPED_CLEARANCES_MM[name], rel=1e-12)
    radii_mm = [1e3 / tube.sections[-1].curvature_y_per_m for tube in robot.tubes]
    assert radii_mm == pytest.approx(SHIPPED_RADII_MM[name], rel=1e-10)
    assert len(robot.warnings) == (name == "table_4_pair")
    q = np.zeros(len(robot.drive.joints))
    for moved in (q, np.where(robot.drive.is_rotation, 0, robot.drive.lower)):
        assert nesting_violation(robot, *robot.drive.collars(moved)) is None


def test_calibrated_values_are_those_of_tables_five_and_seven() -> None:
    pair_, three = load_robot(SHIPPED / "table_5_pair.toml"), load_robot(SHIPPED / "three_tube_calibrated.toml")
    stiffness = [tube.bending_stiffness_Nm2 / 5.07e-2 for tube in (*pair_.tubes, *three.tubes)]
    assert stiffness == pytest.approx([1, 0.221, 1, 0.9929, 0.1990], rel=1e-6)
    assert [tube.poisson_ratio for tube in three.tubes] == [0.3, 0.3256, -0.1543]
    x_radii_m = [1 / tube.sections[-1].curvature_x_per_m for tube in (*pair_.tubes, *three.tubes)]
    assert x_radii_m == pytest.approx([-24.9684, -2.5907, -291.3, -9.879, -3.313], rel=1e-9)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything within a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(inner for key, item in items for inner in places(item, (*path, key)))]


CONTENT = tomllib.loads(PAIR)
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
