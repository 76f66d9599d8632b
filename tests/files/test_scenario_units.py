"""Places and sizes of a scenario that are in another unit are named by the robot's own length."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario, scenario_from_dict
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.sizes import nearest_tip_m

THREE = ROBOTS / "three_tube.toml"
START = {"rotate outer": 20, "rotate middle": -60, "rotate inner": 80, "translate inner": -86.4}


def scenario(tmp_path: Path, **keys: Any) -> Any:
    content = {"robot": str(THREE), "start": START, "goal": {"tip_mm": [30.0, 10.0, 150.0]}} | keys
    return scenario_from_dict(content, file=str(tmp_path / "s.toml"), allow_outside=True)


def tunnel(folder: Path, size_mm: float, factor: float) -> str:
    box = trimesh.creation.box((size_mm, size_mm, 400)).apply_translation((0, 0, 100)).apply_scale(factor)
    box.export(folder / "lumen.stl")
    return "lumen.stl"


def sphere(center_mm: list[float], radius_mm: float) -> dict[str, Any]:
    return {"anatomy": [{"kind": "sphere", "center_mm": center_mm, "radius_mm": radius_mm, "margin_mm": 1.0}]}


@pytest.mark.parametrize("file", sorted(SCENARIOS.glob("*.toml")), ids=lambda file: file.stem)
def test_no_shipped_scenario_is_in_doubt(file: Path) -> None:
    told = load_scenario(file, allow_outside=True).warnings
    assert not [text for text in told if "robot is" in text or "?" in text]


@pytest.mark.parametrize(
    ("start", "phrase"),
    [
        (
            {"rotate outer": 0.349, "rotate middle": -1.047, "rotate inner": 1.396},
            "start.rotate outer = 0.349: is a whole",
        ),
        (
            {"rotate outer": 0.0, "rotate middle": 3.1416, "rotate inner": 0.0},
            "start.rotate middle = 3.1416: is a whole",
        ),
        (
            {"rotate outer": 0.0, "rotate middle": 3.14159, "rotate inner": 90.0},
            "start.rotate middle = .*: is it in rad",
        ),
        ({"translate inner": -0.0864}, "start.translate inner = -0.0864: moves by 0.0864 mm, .*are these in metres"),
        ({"rotate outer": 3.0, "rotate middle": -1.5, "rotate inner": 0.5}, ""),
        ({"translate inner": -0.5}, ""),
    ],
)
def test_a_start_in_radians_or_metres_is_named(start: dict[str, float], phrase: str, tmp_path: Path) -> None:
    told = scenario(tmp_path, start=START | start).warnings
    assert len(told) == bool(phrase) and all(re.search(phrase, text) for text in told)
    there = scenario(tmp_path, goal={"joints": START | start}).warnings
    assert len(there) == bool(phrase) and all(re.search(phrase.replace("start", "goal.joints"), t) for t in there)


def test_a_goal_in_another_unit_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"goal.tip_mm = .*: lies 0.176 mm from the base.*: are these in metres"):
        load_scenario(SCENARIOS / "vessel.toml", ["goal.tip_mm=[0.051, 0.002, 0.168]"])
    with pytest.raises(InputError, match=r"goal.tip_mm = .*: lies .* mm from the base.*: are these in micrometres"):
        scenario(tmp_path, goal={"tip_mm": [3e4, 1e4, 9e4]})


def test_several_targets_a_line_and_a_base_in_metres(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"target.2.tip_mm = .*are these in metres"):
        scenario(tmp_path, goal=None, target=[{"tip_mm": [30, 10, 150]}, {"tip_mm": [0.03, 0.01, 0.15]}])
    with pytest.raises(InputError, match=r"goal.line_mm.1.*are these in metres"):
        scenario(tmp_path, goal={"line_mm": [[0.03, 0.01, 0.14], [0.03, 0.01, 0.15]]})
    with pytest.raises(
        InputError, match=r"base.position_mm = .*: puts the goals 1.02e\+03 mm .*: is the base in metres"
    ):
        scenario(tmp_path, base={"position_mm": [0.5, 0.2, 0.7]}, goal={"tip_mm": [530.0, 210.0, 850.0]})
    assert scenario(tmp_path, goal={"tip_mm": [500.0, 10.0, 850.0]}).warnings == ()  # merely out of reach


@pytest.mark.parametrize(
    ("factor", "name"),
    [(1e-3, "1000 times too small (m read as mm)"), (1 / 25.4, "25.4 times too small (inches read as mm)")]
    + [(0.1, "10 times too small (cm read as mm) or 25.4 times too small (inches read as mm)"), (4.99, "")],
)
def test_a_lumen_that_holds_no_goal_is_named_with_the_factor_that_would(
    factor: float, name: str, tmp_path: Path
) -> None:
    lumen = {"kind": "mesh", "file": tunnel(tmp_path, 80, factor), "unit": "mm", "role": "inside"}
    if not name:
        assert scenario(tmp_path, anatomy=[lumen]).warnings == ()
        return
    if factor == 1e-3:
        with pytest.raises(InputError) as caught:
            scenario(tmp_path, anatomy=[lumen])
        told = str(caught.value)
    else:  # such a lumen may be, and the goals be elsewhere
        (told,) = scenario(tmp_path, anatomy=[lumen]).warnings
    assert "anatomy.1.unit = 'mm': is " in told and f"none of the goals is in it: is it {name}?" in told


def shipped_with_meshes_times(folder: Path, name: str, factor: float, **changes: Any) -> ctrplan.Scenario:
    """A shipped scenario whose meshes have their numbers multiplied by a factor."""
    content = dict(load_scenario(SCENARIOS / f"{name}.toml").content) | changes
    content["anatomy"] = [dict(part) for part in content["anatomy"]]
    for part in content["anatomy"]:
        if part["kind"] == "mesh":
            trimesh.load(SCENARIOS / part["file"], force="mesh").apply_scale(factor).export(folder / f"{name}.stl")
            part["file"] = f"{name}.stl"
    content["robot"] = str(SCENARIOS / content["robot"])
    return scenario_from_dict(content, file=str(folder / "s.toml"), allow_outside=True)


@pytest.mark.parametrize(
    ("name", "factor", "phrase"),
    [
        (
            "ribs",
            0.1,
            r"ends 11.1 mm from the base, the goals are 208 mm away: is it 10 times too small \(cm read as mm\)",
        ),
        ("deploy", 1 / 25.4, r"ends 4.38 mm .* or 25.4 times too small \(inches read as mm\)\?"),
        ("ribs", 10.0, r"begins 710 mm .*: is it 10 times too large \(mm read as cm\) .* or in another frame than"),
        ("airway", 10.0, r"is 1.14e\+03 mm across, .*: is it 10 times too large \(mm read as cm\)\?"),
        ("heart_chamber", 10.0, r"is 1.67e\+03 mm across, .*: is it 10 times too large \(mm read as cm\)\?"),
    ],
)
def test_anatomies_that_hinder_nothing_in_their_unit_are_named(
    name: str, factor: float, phrase: str, tmp_path: Path
) -> None:
    """Obstacles that all end before a tenth of the robot or begin beyond it, and halls: each was read in silence."""
    (told,) = shipped_with_meshes_times(tmp_path, name, factor).warnings
    assert "anatomy.1.unit = 'mm': " in told and re.search(phrase, told)


def test_a_lumen_and_its_goal_in_the_same_wrong_unit(tmp_path: Path) -> None:
    goal = {"tip_mm": [5.1, 0.2, 16.8], "tolerance_mm": 1.0}
    (told,) = shipped_with_meshes_times(tmp_path, "vessel", 0.1, goal=goal).warnings
    assert "mm to its wall, the thinnest tube is 1.82 mm wide: are anatomy and goals 10 times too small" in told


@pytest.mark.parametrize("robot", ["three_tube", "three_tube_insertion", "liver_needle", "table_1_pair"])
def test_no_tip_is_nearer_to_the_base_than_the_arc_of_the_most_bent_tube(robot: str) -> None:
    made = load_robot(ROBOTS / f"{robot}.toml")
    q = JointSpace.of_robot(made).sample(np.random.default_rng(3), 200)
    tips, *_ = made.mechanics.tips(*made.drive.collars(q))
    assert np.nanmin(np.linalg.norm(tips, axis=1)) >= nearest_tip_m(made) - 1e-4


def test_a_goal_in_centimetres_in_free_space_is_named_and_one_merely_out_of_reach_is_not(tmp_path: Path) -> None:
    (told,) = scenario(tmp_path, goal={"tip_mm": [3.0, 1.0, 15.0]}).warnings
    assert re.search(r"lies 15.3 mm from the base, .*: are these in centimetres\?", told)
    (told,) = scenario(tmp_path, goal={"tip_mm": [1.0, 1.0, 8.0]}).warnings
    assert re.search(r"are these in centimetres or inches\?", told)
    assert scenario(tmp_path, goal={"tip_mm": [30.0, 10.0, 60.0]}).warnings == ()


def test_a_goal_near_a_base_far_from_the_origin_is_not_taken_for_one_in_micrometres(tmp_path: Path) -> None:
    """Divided by a thousand every goal lies at the frame's origin, which may be as far from the base as tips are."""
    for at in ([50.0, -90.0, 160.0], [0.0, 0.0, 150.0], [-120.0, 40.0, 0.0]):
        goal = [at[0] + 30.0, at[1] + 10.0, at[2] + 60.0]
        assert scenario(tmp_path, goal={"tip_mm": goal}, base={"position_mm": at}).warnings == ()


def test_an_obstacle_out_of_all_proportion_is_warned_about(tmp_path: Path) -> None:
    part = {"kind": "mesh", "file": tunnel(tmp_path, 30, 1e-3), "unit": "mm", "margin_mm": 0.0}
    (warning,) = scenario(tmp_path, anatomy=[part]).warnings
    assert "anatomy.1.unit = 'mm': is 0.4 mm across, the robot 270 mm long: is it 1000 times too small" in warning


@pytest.mark.parametrize(
    ("keys", "phrase"),
    [
        (sphere([19, 2, 108], 0.006), r"anatomy.1.radius_mm = 0.006 mm: is 0.012 mm across.*: is it in metres\?"),
        (sphere([30000, -40000, 14000], 5), r"anatomy.1.center_mm = .*: lies 51.* m from the base"),
        (sphere([30, -40, 14], 5), ""),
        ({"base": {"position_mm": [0.01, 0, -0.02]}}, "base.position_mm = .*: moves the base by 0.022 mm"),
        ({"base": {"quaternion_wxyz": [0, 0, 0, 1]}}, "base.quaternion_wxyz = .*: turns the base by 180 deg"),
        ({"base": {"direction": [0, 0, 1], "roll_deg": 1.5708}}, r"base.roll_deg = 1.5708 deg: .* is it in radians\?"),
        ({"base": {"direction": [0, 0, 1], "roll_deg": 1.5, "position_mm": [0, 0, -20]}}, ""),
    ],
)
def test_places_of_obstacles_and_of_the_base(keys: dict[str, Any], phrase: str, tmp_path: Path) -> None:
    """Each was certified without a word."""
    warned = scenario(tmp_path, **keys).warnings
    assert len(warned) == bool(phrase) and all(re.search(phrase, text) for text in warned)


def test_a_thickness_in_metres_beside_places_in_millimetres(tmp_path: Path) -> None:
    rod = {"kind": "capsule", "from_mm": [-40, 30, 90], "to_mm": [40, 30, 90], "radius_mm": 0.004, "margin_mm": 1.0}
    (told,) = scenario(tmp_path, anatomy=[rod]).warnings
    assert re.search(
        r"anatomy.1.radius_mm = 0.004 mm: is finer than any tracker sees: is it in metres or inches\?", told
    )
    assert scenario(tmp_path, anatomy=[rod | {"radius_mm": 0.4}]).warnings == ()


def test_obstacles_in_millimetres_in_code() -> None:
    given = scenario(Path())
    far = ctrplan.Anatomy(ctrplan.Capsule([30, -40, 115], [30, 8, 115], 4), margin_m=1e-3)
    with pytest.warns(UserWarning, match="lies 1.* m from the base"):
        made = given.with_(anatomy=(far,))
    assert any("from the base" in text for text in made.warnings)


@pytest.mark.parametrize(
    ("said", "phrase"),
    [
        ("goal.tolerance_mm=0.001", r"goal.tolerance_mm = 0.001 mm: .*: is it in metres\?"),
        ("goal.tolerance_mm=500", r"goal.tolerance_mm = 500 mm: .*: is it in micrometres\?"),
        (
            "goal.direction=[0,0,1];goal.direction_tolerance_deg=0.0873",
            r"direction_tolerance_deg = .*: is it in radians\?",
        ),
        ("goal.tolerance_mm=100", r"goal.tolerance_mm = 100 mm: is more than a fifth of the robot's length"),
        ("anatomy.1.margin_mm=0.0005", r"anatomy.1.margin_mm = 0.0005 mm: .*: is it in metres\?"),
        ("cost.max_error_goal_mm=0.002", r"cost.max_error_goal_mm = 0.002 mm: .*: is it in metres\?"),
        ("base.position_sigma_mm=0.0005", r"base.position_sigma_mm = 0.0005 mm: .*: is it in metres\?"),
        ("base.rotation_sigma_deg=0.0087", r"base.rotation_sigma_deg = 0.0087 deg: .*: is it in radians\?"),
        ("goal.tolerance_mm=0.1", ""),
        ("base.rotation_sigma_deg=0.5", ""),
    ],
)
def test_tolerances_and_margins_of_a_scenario_by_what_they_would_mean(said: str, phrase: str) -> None:
    file = SCENARIOS / "vessel.toml"
    scenario = load_scenario(file, said.split(";"))
    told = [text for text in scenario.warnings if text not in load_scenario(file).warnings]
    flags = ctrplan.check(scenario).flags
    assert len(told) == len(flags) == bool(phrase)
    assert all(re.search(phrase, text) for text in (*told, *flags))


@pytest.mark.parametrize(
    ("said", "phrase"),
    [
        ("goal.tip_mm=[34, -47, -200]", r"goal.tip_mm = .*: lies 200 mm behind the base, where none of 64 tips was"),
        (
            "goal.tip_mm=[134, -247, 1200]",
            r"lies 1.23e\+03 mm from the base, .*: are the goal and \[base\] in the same",
        ),
        ("goal.tip_mm=[30, 10, 60]", r"lies 67.8 mm from the base, no tip ends nearer to it than 108 mm"),
        ("base.direction=[0, 0, -1]", r"lies 200 mm behind the base"),
        ("goal.tip_mm=[34, -47, 200]", ""),
    ],
)
def test_check_marks_goals_that_no_tip_gets_to(said: str, phrase: str) -> None:
    flags = ctrplan.check(load_scenario(SCENARIOS / "ribs.toml", [said])).flags
    assert len(flags) == bool(phrase) and all(re.search(phrase, text) for text in flags)


def test_check_marks_a_target_within_an_obstacle() -> None:
    scenario = load_scenario(SCENARIOS / "biopsy_tour.toml", ["target.2.tip_mm=[21, -30, 77.5]"])
    (flag,) = ctrplan.check(scenario).flags
    assert "target.2.tip_mm" in flag and "mm inside anatomy.1 (ribs.stl), which is to be avoided" in flag


def test_a_start_in_degrees_given_in_code_is_named() -> None:
    scenario = load_scenario(SCENARIOS / "vessel.toml")
    start = np.array([0.0, 90.0, -60.0, scenario.start[3]])
    with pytest.warns(UserWarning, match=r"start.rotate middle = 5156.6.*: are these degrees given for radians\?"):
        scenario.with_(start=start)
