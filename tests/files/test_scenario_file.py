"""A scenario file is read as it stands, in SI units, or refused in one sentence with file, key, value and rule."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusals
from written_scenario import SCENARIO, place

from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning.search.planners.bit_star import BITStar
from ctrplan.planning.search.planners.rrt_star import RRTStar
from ctrplan.scenario.scenario import Cost, Margins

if sys.version_info >= (3, 11):
    pass
else:
    pass


JOINT_GOAL = """[goal]
joints = { "rotate outer" = 0, "rotate middle" = 0, "rotate inner" = 0, "translate inner" = 0 }
"""
# A text of SCENARIO, what replaces it, and below it the sentence after the file's name.
REFUSED = r"""
name = "past the ribs" -> name = 3
    scenario.toml: name = 3: must be text.
robot = "robots/three_tube.toml" ->
    scenario.toml: robot: is missing.
robot = "robots/three_tube.toml" -> robot = "../robots/three_tube.toml"
    scenario.toml: robot = '../robots/three_tube.toml': must lie in the folder of this file or below,
    unless --allow-outside is given.
robot = "robots/three_tube.toml" -> robot = "robots/none.toml"
    scenario.toml: robot = 'robots/none.toml': is not a file that exists.
robot = "robots/three_tube.toml" -> robot = "a\u0000b"
    scenario.toml: robot = 'a\x00b': is not a file that exists.
position_mm = [1, 2, 3] -> position_mm = [1, nan, 3]
    scenario.toml: base.position_mm.2 = nan mm: must be a finite number.
position_mm = [1, 2, 3] -> position_m = [1, 2, 3]
    scenario.toml: base.position_m = [1, 2, 3]: unknown key, expected position_mm (in mm).
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] -> quaternion_wxyz = [1, 0, 0, 0.1]
    scenario.toml: base.quaternion_wxyz = [1, 0, 0, 0.1]: must have norm 1 within 0.001, has 1.00499.
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] -> direction = [0, 0, 0]
    scenario.toml: base.direction = [0, 0, 0]: must not be zero.
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] -> look_at = [1, 2, 3]
    scenario.toml: base.look_at = [1, 2, 3]: must not be the base's own position_mm.
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] -> direction = [0, 1]
    scenario.toml: base.direction = [0, 1]: must be a list of length 3.
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] -> direction = [0, 0, 1]\nlook_at = [1, 2, 9]
    scenario.toml: base: must be turned in one way, not by direction and look_at.
position_mm = [1, 2, 3] -> position_mm = [1, 2, 3]\ndirection = [0, 0, 1]
    scenario.toml: base: must be turned in one way, not by quaternion_wxyz and direction.
position_mm = [1, 2, 3] -> position_mm = [1, 2, 3]\nroll_deg = 5
    scenario.toml: base.roll_deg = 5 deg: goes with direction or look_at.
"rotate middle" = 90 ->
    scenario.toml: start.rotate middle: is missing, every joint needs a value (in deg).
"rotate middle" = 90 -> "rotate middle" = "90"
    scenario.toml: start.rotate middle = '90': must be a number (in deg).
"rotate middle" = 90 -> "rotate middle" = true
    scenario.toml: start.rotate middle = true: must be a number (in deg).
"rotate middle" = 90 -> "rotate midle" = 90
    scenario.toml: start.rotate midle = 90: unknown joint, the robot has rotate outer, rotate middle, rotate
    inner, translate inner; did you mean rotate middle?
"rotate outer" = 0 -> "rotate outer" = 181
    scenario.toml: start.rotate outer = 181 deg: must be within the joint's limits, -180 to 180 deg.
"translate inner" = -86.4 -> "translate inner" = 1
    scenario.toml: start.translate inner = 1 mm: must be within the joint's limits, -86.4 to 0 mm.
[goal] -> [goals]
    scenario.toml: goals: unknown key, did you mean goal?
tip_mm = [12, 40, 190] ->
    scenario.toml: goal: must have one of joints, tip_mm and line_mm.
tip_mm = [12, 40, 190] -> line_mm = [[1, 2, 3], [4, 5, 6]]\njoints = { "rotate outer" = 0 }
    scenario.toml: goal: must have one of joints, tip_mm and line_mm; joints may have the tip_mm that they are for.
tip_mm = [12, 40, 190] -> joints = { "rotate outer" = 0 }
    scenario.toml: goal.direction = [0, 3, 4]: goes with tip_mm, not with joints.
tip_mm = [12, 40, 190] -> tip_cm = [1.2, 4, 19]
    scenario.toml: goal.tip_cm = [1.2, 4, 19]: unknown key, expected tip_mm (in mm).
tolerance_mm = 0.5 -> tolerance_mm = 0
    scenario.toml: goal.tolerance_mm = 0 mm: must be from 0.001 to 1000.
direction = [0, 3, 4] -> direction = [0, 0, 0]
    scenario.toml: goal.direction = [0, 0, 0]: must not be zero.
direction = [0, 3, 4] ->
    scenario.toml: goal.direction: is missing, direction and direction_tolerance_deg go together.
direction_tolerance_deg = 10 ->
    scenario.toml: goal.direction_tolerance_deg: is missing, direction and direction_tolerance_deg go together.
direction_tolerance_deg = 10 -> direction_tolerance_deg = 181
    scenario.toml: goal.direction_tolerance_deg = 181 deg: must be above 0 and at most 180.
kind = "sphere" -> kind = "cube"
    scenario.toml: anatomy.1.kind = 'cube': must be one of box, capsule, mesh, sphere, surface, volume.
kind = "sphere" ->
    scenario.toml: anatomy.1.kind: is missing.
kind = "sphere" -> kind = "capsule"
    scenario.toml: anatomy.1.center_mm = [10, 20, 30]: does not go with kind = 'capsule'.
center_mm = [10, 20, 30] ->
    scenario.toml: anatomy.1.center_mm: is missing, a sphere needs center_mm, radius_mm.
radius_mm = 5 -> radius_mm = 5\nunit = "mm"
    scenario.toml: anatomy.1.unit = 'mm': does not go with kind = 'sphere'.
radius_mm = 5 -> radius_mm = 5\nmargin_mm = -1
    scenario.toml: anatomy.1.margin_mm = -1 mm: must be from 0 to 100000.
file = "meshes/wedge.stl" -> file = "../wedge.stl"
    scenario.toml: anatomy.3.file = '../wedge.stl': must lie in the folder of this file or below,
    unless --allow-outside is given.
file = "meshes/wedge.stl" -> file = "meshes/none.stl"
    scenario.toml: anatomy.3.file = 'meshes/none.stl': is not a file that exists.
unit = "cm" -> unit = "inch"
    scenario.toml: anatomy.3.unit = 'inch': must be one of mm, cm, m, in; did you mean in?
max_strain = 0.05 -> max_strain = 5
    scenario.toml: margins.max_strain = 5: must be above 0 and at most 1, a share: is it in %?
mm_per_rad = 10 -> mm_per_rad = 0
    scenario.toml: cost.mm_per_rad = 0 mm/rad: must be from 0.001 to 100000.
name = "RRT*" -> name = "PRM"
    scenario.toml: planner.name = 'PRM': must be one of BIT*, RRT*, RRTConnect.
name = "RRT*" ->
    scenario.toml: planner.goal_bias = 0.2: does not go with name = 'BIT*'.
goal_bias = 0.2 -> goal_bias = 1.5
    scenario.toml: planner.goal_bias = 1.5: must be from 0 to 1.
goal_bias = 0.2 -> goal_bais = 0.2
    scenario.toml: planner.goal_bais = 0.2: unknown key, did you mean goal_bias?
goal_bias = 0.2 -> verve = 0.2
    scenario.toml: planner.verve = 0.2: unknown key, known ones, all optional, are name, time_s, settle,
    goal_bias, range_mm.
goal_bias = 0.2 -> samples_per_batch = 10
    scenario.toml: planner.samples_per_batch = 10: does not go with name = 'RRT*'.
time_s = 2.5 -> time_s = 3601
    scenario.toml: planner.time_s = 3601 s: must be above 0 and at most 3600.
time_s = 2.5 -> time_ms = 2500
    scenario.toml: planner.time_ms = 2500: unknown key, expected time_s (in s).
settle = "oscillate" -> settle = true
    scenario.toml: planner.settle = true: must be one of auto, none, oscillate.
"""


def with_joint_goal(text: str = SCENARIO) -> str:
    return re.sub(r"\[goal\]\n.*?(?=\[\[)", lambda match: JOINT_GOAL, text, flags=re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place(tmp_path / "case")
    monkeypatch.chdir(tmp_path / "case")
    return tmp_path / "case"


def refusal(*arguments: Any, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        load_scenario(*arguments, **options)
    assert caught.value.exit_code == 2
    return str(caught.value)


CASES = refusals(REFUSED, SCENARIO)


@pytest.mark.parametrize(("text", "sentence"), CASES, ids=[sentence for _, sentence in CASES])
def test_every_fault_is_one_sentence_with_file_key_value_and_rule(folder: Path, text: str, sentence: str) -> None:
    (folder / "scenario.toml").write_text(text)
    assert refusal("scenario.toml") == sentence


def test_values_arrive_in_si_units(folder: Path) -> None:
    scenario = load_scenario("scenario.toml")
    assert (scenario.name, scenario.path, scenario.robot.n) == ("past the ribs", "scenario.toml", 3)
    np.testing.assert_allclose(scenario.base_position_m, [1e-3, 2e-3, 3e-3], rtol=1e-15)
    np.testing.assert_allclose(scenario.base_R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)  # x of the robot is y
    np.testing.assert_allclose(scenario.start, [0, np.pi / 2, -4 * np.pi, -0.0864], rtol=1e-15)
    goal = scenario.goal
    assert goal.joints is None and goal.tip_m is not None and goal.direction is not None
    np.testing.assert_allclose(goal.tip_m, [0.012, 0.040, 0.190], rtol=1e-15)
    np.testing.assert_allclose(goal.direction, [0, 0.6, 0.8], rtol=1e-15)
    assert goal.tolerance_m == pytest.approx(0.5e-3, rel=1e-15)
    assert goal.direction_tolerance_rad == pytest.approx(np.pi / 18, rel=1e-15)
    assert scenario.margins == Margins(0.2, 0.05)
    assert scenario.cost == Cost(2, 10, 3, 4, 1.5e-3)
    assert scenario.planner == RRTStar(time_s=2.5, settle="oscillate", goal_bias=0.2)


def test_points_are_located_alike_however_many_there_are(folder: Path) -> None:
    """Rotated and moved one by one, in one table, and in more than are multiplied at once."""
    scenario = load_scenario("scenario.toml")
    points = np.random.default_rng(0).normal(size=(40_000, 3)) * 0.1
    found = scenario.located(points)
    for k in (0, 16_383, 16_384, 39_999):
        expected = scenario.base_R @ points[k] + scenario.base_position_m
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(scenario.located(points[k]), expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(scenario.located(points.reshape(100, 400, 3)).reshape(-1, 3), found)
    assert scenario.located(points[:0]).shape == (0, 3)


def test_the_anatomy_arrives_in_si_units(folder: Path) -> None:
    sphere, capsule, mesh = load_scenario("scenario.toml").anatomy
    assert isinstance(sphere.shape, Sphere) and isinstance(capsule.shape, Capsule) and isinstance(mesh.shape, Mesh)
    assert (sphere.role, sphere.margin_m, sphere.shape.radius_m) == ("avoid", 0, 5e-3)
    np.testing.assert_allclose(sphere.shape.center_m, [0.01, 0.02, 0.03], rtol=1e-15)
    assert (capsule.role, capsule.margin_m, capsule.shape.radius_m) == ("inside", 1.5e-3, 60e-3)
    np.testing.assert_allclose((capsule.shape.from_m, capsule.shape.to_m), [[0, 0, -0.01], [0, 0, 0.2]], rtol=1e-15)
    assert (mesh.shape.file, mesh.shape.name) == (str(Path("meshes/wedge.stl")), "wedge.stl")
    np.testing.assert_allclose(np.ptp(mesh.shape.vertices_m, axis=0), 0.01, rtol=1e-6)  # unit = "cm"


def test_everything_optional_has_the_documented_default(folder: Path) -> None:
    text = SCENARIO[: SCENARIO.index("direction = ")].replace("tolerance_mm = 0.5", "")
    text = re.sub(r"\[base\].*?(?=\[start)", "", text.replace('name = "past the ribs"', ""), flags=re.DOTALL)
    (folder / "plain.toml").write_text(text)
    scenario = load_scenario("plain.toml")
    assert scenario.name == "plain"
    assert (scenario.margins, scenario.cost, scenario.planner) == (Margins(), Cost(), BITStar())
    assert (scenario.goal.tolerance_m, scenario.goal.direction, scenario.anatomy) == (1e-3, None, ())
    np.testing.assert_array_equal(scenario.base_position_m, np.zeros(3))
    np.testing.assert_array_equal(scenario.base_R, np.eye(3))


def test_a_joint_goal_has_the_order_of_the_drive(folder: Path) -> None:
    (folder / "scenario.toml").write_text(with_joint_goal().replace('"rotate inner" = 0,', '"rotate inner" = 45,'))
    goal = load_scenario("scenario.toml").goal
    assert goal.tip_m is None and goal.joints is not None
    np.testing.assert_allclose(goal.joints, [0, 0, np.pi / 4, 0], rtol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            *("joints = {", 'joints = { "bend" = 1,'),
            "goal.joints.bend = 1: unknown joint, the robot has "
            "rotate outer, rotate middle, rotate inner, translate inner.",
        ),
        (
            *('"rotate inner" = 0, ', ""),
            "goal.joints.rotate inner: is missing, every joint needs a value (in deg).",
        ),
        (
            *('"translate inner" = 0 }', '"translate inner" = -90 }'),
            "goal.joints.translate inner = -90 mm: must be within the joint's limits, -86.4 to 0 mm.",
        ),
        (
            *('"translate inner" = 0 }', '"translate inner" = 0 }\ndirection = [0, 0, 1]'),
            "goal.direction = [0, 0, 1]: goes with tip_mm, not with joints.",
        ),
    ],
)
def test_a_joint_goal_is_checked_like_the_start(folder: Path, old: str, new: str, sentence: str) -> None:
    assert old in JOINT_GOAL
    (folder / "scenario.toml").write_text(with_joint_goal().replace(old, new, 1))
    assert refusal("scenario.toml") == f"scenario.toml: {sentence}"


def test_a_start_whose_tubes_do_not_nest_contradicts_itself(folder: Path) -> None:
    robot = (folder / "robots" / "three_tube.toml").read_text()
    (folder / "robots" / "three_tube.toml").write_text(robot.replace("max_mm = 0 ", "max_mm = 5 "))
    (folder / "scenario.toml").write_text(SCENARIO.replace('"translate inner" = -86.4', '"translate inner" = 4'))
    assert refusal("scenario.toml") == (
        "scenario.toml: start: the base of tube 3 (moved by translate inner) at l_3b = -30 mm and the base of tube 2 "
        "at l_2b = -17 mm must be at least 17 mm apart, the collar of tube 3."
    )


def test_quaternions_are_rotations(folder: Path) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        wxyz = rng.normal(size=4)
        wxyz *= rng.uniform(0.9991, 1.0009) / np.linalg.norm(wxyz)
        R = load_scenario("scenario.toml", [f"base.quaternion_wxyz={wxyz.tolist()}"]).base_R
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1, abs=1e-14)
        w, axis = wxyz[0] / np.linalg.norm(wxyz), wxyz[1:] / np.linalg.norm(wxyz[1:])
        np.testing.assert_allclose(R @ axis, axis, atol=1e-14)
        assert np.trace(R) == pytest.approx(4 * w**2 - 1, abs=1e-13)  # 1 + 2 cos(angle)


def test_a_base_looks_along_its_direction_and_rolls_about_it(folder: Path) -> None:
    rng, plain = np.random.default_rng(1), SCENARIO.replace("quaternion_wxyz", "# quaternion_wxyz")
    (folder / "scenario.toml").write_text(plain)
    for _ in range(10):
        direction, roll = rng.normal(size=3), rng.uniform(-180, 180)
        there = (np.array([1, 2, 3]) + direction).tolist()
        R, rolled, looking, far = (
            load_scenario("scenario.toml", [f"base.{key}" for key in keys]).base_R
            for keys in (
                [f"direction={direction.tolist()}"],
                [f"direction={direction.tolist()}", f"roll_deg={roll}"],
                [f"look_at={there}"],
                [f"direction={(1e9 * direction).tolist()}"],
            )
        )
        z = direction / np.linalg.norm(direction)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(R[:, 2], z, atol=1e-14)
        assert np.trace(R) == pytest.approx(1 + 2 * z[2], abs=1e-13)  # turned by the angle between, which is least
        np.testing.assert_allclose(looking, R, atol=1e-12)
        np.testing.assert_allclose(far, R, atol=1e-14)
        angle = np.radians(roll)
        about_z = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        np.testing.assert_allclose(R.T @ rolled, about_z, atol=1e-13)


@pytest.mark.parametrize(("z", "R"), [(1, np.eye(3)), (-1, np.diag([1, -1, -1])), (-1e-300, np.diag([1, -1, -1]))])
def test_a_base_may_look_along_z_or_against_it(folder: Path, z: float, R: Any) -> None:
    (folder / "scenario.toml").write_text(SCENARIO.replace("quaternion_wxyz", "# quaternion_wxyz"))
    np.testing.assert_allclose(load_scenario("scenario.toml", [f"base.direction=[0, 0, {z}]"]).base_R, R, atol=1e-15)


def test_files_outside_the_folder_need_permission(folder: Path) -> None:
    shutil.move(folder / "robots", folder.parent)
    (folder / "scenario.toml").write_text(SCENARIO.replace('"robots/', '"../robots/'))
    assert refusal("scenario.toml").endswith("below, unless --allow-outside is given.")
    assert load_scenario("scenario.toml", allow_outside=True).robot.n == 3
    os.symlink(folder.parent / "robots", folder / "robots")  # a link out of the folder is outside, too
    (folder / "scenario.toml").write_text(SCENARIO)
    assert refusal("scenario.toml").endswith("below, unless --allow-outside is given.")


def test_the_place_of_the_caller_makes_no_difference(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = load_scenario("scenario.toml")
    monkeypatch.chdir(folder.parent)
    assert load_scenario(Path("case") / "scenario.toml").sha256 == here.sha256


def test_overrides_go_to_the_file_they_name(folder: Path) -> None:
    overrides = ["goal.tolerance_mm=2", "robot.contact.1.friction_coefficient=0.1", "start.rotate outer=30"]
    scenario = load_scenario("scenario.toml", overrides)
    robot = load_robot("robots/three_tube.toml", ["contact.1.friction_coefficient=0.1"])
    assert scenario.robot.sha256 == robot.sha256
    assert scenario.goal.tolerance_m == pytest.approx(2e-3, rel=1e-15)
    assert scenario.start[0] == pytest.approx(np.pi / 6, rel=1e-15)
    text = SCENARIO.replace("tolerance_mm = 0.5", "tolerance_mm = 2").replace('outer" = 0', 'outer" = 30')
    given = load_scenario("scenario.toml")
    (folder / "scenario.toml").write_text(text)
    edited = load_scenario("scenario.toml", ["robot.contact.1.friction_coefficient=0.1"])
    assert scenario.sha256 == edited.sha256 != given.sha256
    shutil.copy("robots/three_tube.toml", "robots/other.toml")
    assert load_scenario("scenario.toml", ["robot=robots/other.toml"]).robot.path == str(Path("robots/other.toml"))


def test_a_bad_override_names_the_file_it_went_to(folder: Path) -> None:
    rule = "no such entry to override: positions go from 1 to 3."
    robot_file = Path("robots/three_tube.toml")
    assert refusal("scenario.toml", ["anatomy.4.margin_mm=1"]) == f"scenario.toml: anatomy.4: {rule}"
    assert refusal("scenario.toml", ["robot.tube.9.poisson_ratio=1"]) == f"{robot_file}: tube.9: {rule}"


def test_warnings_of_the_robot_are_passed_on(folder: Path) -> None:
    (warning,) = load_scenario("scenario.toml", ["robot.contact.1.clearance_mm=0.2"]).warnings
    assert warning.startswith(str(Path("robots/three_tube.toml")) + ": contact.1: radial clearance 0.2 mm is used, but")
