"""`ctrplan init` writes files that run as they are, and nothing over what is there."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from made_up_input import FUZZ
from measured_data import measured, pair_robot, waypoints, write_csv
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.commands.init import CATALOGUE
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.files.starting_files import mapping_text, robot_text, tube_choice
from ctrplan.mechanics.shapes import Status
from ctrplan.storage.toml_document import parsed_toml, read_document

MESHES = SCENARIOS / "meshes"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a robot of three tubes, as init makes it where nothing is said, and one of two."""
    folder = tmp_path_factory.mktemp("init")
    two = ["--tube", "2.64x2.39,0,100,265", "--tube", "1.825x1.6,60,90,55"]
    assert main(["init", "robot", str(folder / "robot.toml")]) == 0
    assert main(["init", "robot", str(folder / "pair.toml"), *two]) == 0
    return folder


@pytest.mark.parametrize(
    "tubes",
    [
        (),
        ("2.64x2.39,0,150,265", "1.825x1.60,100,86,55"),
        ("2.64 x 2.39 20 100 200", "1.825x1.60,60,80,40", "1.4x1.15,140,60,30"),
        ("1.6x1.2,80,40,0",),
    ],
)
def test_a_robot_is_read_nothing_is_in_doubt_and_its_bound_is_solved(tubes: tuple[str, ...], tmp_path: Path) -> None:
    said = [word for tube in tubes for word in ("--tube", tube)]
    assert main(["init", "robot", str(tmp_path / "r.toml"), *said, "--name", "mine"]) == 0
    robot = load_robot(tmp_path / "r.toml")
    assert robot.name == "mine" and robot.n == (len(tubes) or 3) and robot.warnings == ()
    result = ctrplan.check(robot)
    assert result.flags == ()
    home = robot.bound(robot.drive.home_theta_rad, robot.drive.home_l_m)
    assert home.frictionless.status == Status.CONVERGED and np.isfinite(home.position_m)


def test_catalogue_tubes_make_a_robot() -> None:
    assert len(CATALOGUE) == 12
    for text in CATALOGUE:
        outer, inner = map(float, text.split("x"))
        assert 0 < inner < outer


@pytest.mark.parametrize("text", ["2.64x2.39", "a,b,c,d,e", "1,2,3,4,-5", "2.64x2.39,0,150,nan", ""])
def test_what_is_no_tube_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--tube = .*: must be OUTERxINNER,STRAIGHT,BENT,RADIUS in mm"):
        tube_choice(text)


@pytest.mark.parametrize(
    ("tube", "said"),
    [
        ("2.64x2.39,10,150,265", ["from the base: straight", "then bent"]),
        ("2.64x2.39,0,150,265", ["from the base: bent"]),
        ("2.64x2.39,10,150,0", ["from the base: straight", "then straight, for want of a radius_mm"]),
        ("2.64x2.39,0,150,0", ["from the base: straight, for want of a radius_mm"]),
    ],
)
def test_what_is_said_of_a_section_is_what_it_is(tube: str, said: list[str]) -> None:
    """A section without a radius was "then bent", also where nothing came before it."""
    lines = robot_text([tube_choice(tube)]).splitlines()
    assert [line.partition("# ")[2] for line in lines if line.startswith("[[tube.section]]")] == said


def test_a_tube_without_length_is_refused_by_its_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", "robot", str(tmp_path / "a.toml"), "--tube", "2.64x2.39,0,0,265"]) == 2
    assert "--tube = '2.64x2.39,0,0,265': has no length" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_tubes_in_metres_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", "robot", str(tmp_path / "r.toml"), "--tube", "0.0026x0.0024,0,0.15,0.265"]) == 2
    assert "are the diameters in metres?" in capsys.readouterr().err and not (tmp_path / "r.toml").exists()


def test_tubes_that_do_not_fit_are_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = ["--tube", "1.8x1.6,0,100,80", "--tube", "2.6x2.4,0,150,80"]
    assert main(["init", "robot", str(tmp_path / "r.toml"), *said]) == 2
    assert "list the outermost first" in capsys.readouterr().err and not (tmp_path / "r.toml").exists()


@pytest.mark.parametrize("robot", ["pair.toml", "robot.toml"] if FUZZ else ["pair.toml"])
def test_a_scenario_is_planned_as_it_is(robot: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task = folder / f"task_of_{robot}"
    assert main(["init", "scenario", str(task), "--robot", str(folder / robot)]) == 0
    assert f"next: ctrplan plan {task} -o out" in capsys.readouterr().out
    scenario = ctrplan.load_scenario(task)
    assert scenario.warnings == () and ctrplan.check(task).flags == ()
    plan = ctrplan.plan(ctrplan.load_scenario(task, ["planner.time_s=0.3"]), seed=0)
    assert plan.certificate.valid
    assert main(["init", "scenario", str(task), "--robot", str(folder / robot)]) == 2
    assert "is there already" in capsys.readouterr().err


def test_a_scenario_around_a_mesh(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box((20, 20, 20)).apply_translation((150, 0, 100)).export(folder / "organ.stl")
    said = ["--robot", str(folder / "robot.toml"), "--mesh", str(folder / "organ.stl")]
    assert main(["init", "scenario", str(folder / "organ.toml"), *said]) == 0
    (part,) = ctrplan.load_scenario(folder / "organ.toml").anatomy
    assert part.role == "avoid" and part.shape.name == "organ.stl"
    shutil.copy(folder / "organ.stl", folder.parent / "outside.stl")
    said[-1] = str(folder.parent / "outside.stl")
    capsys.readouterr()
    assert main(["init", "scenario", str(folder / "other.toml"), *said]) == 2
    assert "must lie in the folder of other.toml or below: copy it there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("mesh", "robot"),
    [("vessel", "three_tube")] + ([("airway", "three_tube_insertion"), ("ribs", "three_tube")] if FUZZ else []),
)
def test_a_scenario_with_a_shipped_anatomy_is_planned_as_it_is(mesh: str, robot: str, tmp_path: Path) -> None:
    """A lumen is one: every vessel was to be avoided, with the robot in it and the goal outside."""
    for file in (MESHES / f"{mesh}.stl", ROBOTS / f"{robot}.toml"):
        shutil.copy(file, tmp_path)
    said = ["--robot", str(tmp_path / f"{robot}.toml"), "--mesh", str(tmp_path / f"{mesh}.stl")]
    assert main(["init", "scenario", str(tmp_path / "t.toml"), *said]) == 0
    scenario = ctrplan.load_scenario(tmp_path / "t.toml", ["planner.time_s=1"])
    assert scenario.anatomy[0].role == ("avoid" if mesh == "ribs" else "inside")
    assert scenario.warnings == () and ctrplan.check(scenario).flags == ()
    assert ctrplan.plan(scenario, seed=0).certificate.valid


def test_a_mesh_that_the_robot_can_t_stand_clear_of_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in (MESHES / "airway.stl", ROBOTS / "three_tube.toml"):
        shutil.copy(file, tmp_path)
    said = ["--robot", str(tmp_path / "three_tube.toml"), "--mesh", str(tmp_path / "airway.stl")]
    assert main(["init", "scenario", str(tmp_path / "t.toml"), *said]) == 0
    assert f"say in it where the base is, ctrplan check {tmp_path / 't.toml'}" in capsys.readouterr().out
    assert "does not stand clear of this mesh" in (tmp_path / "t.toml").read_text()


def test_a_mapping_file_reads_the_table_that_it_was_made_for(tmp_path: Path) -> None:
    robot = pair_robot()
    data = measured(robot, waypoints(robot, 4))
    write_csv(tmp_path / "plain.csv", data)
    header, *rows = (tmp_path / "plain.csv").read_text().splitlines()
    names = {"theta_1_rad": "rot1", "theta_2_rad": "rot2", "l_1_m": "trans1", "l_2_m": "trans2"}
    names |= {"x_m": "tip_x", "y_m": "tip_y", "z_m": "tip_z"}
    named = ",".join(names.get(name, name) for name in header.split(","))
    (tmp_path / "log.csv").write_text("\n".join([named, *rows]))
    write_robot(tmp_path / "robot.toml", dict(robot.content))
    said = ["--table", str(tmp_path / "log.csv"), "--robot", str(tmp_path / "robot.toml")]
    assert main(["init", "mapping", str(tmp_path / "map.toml"), *said]) == 0
    read = ctrplan.load_measurements(tmp_path / "map.toml", robot)
    np.testing.assert_allclose(read.position_m, data.position_m)
    np.testing.assert_allclose(read.tangent[0], data.tangent[0], atol=1e-9)


def test_columns_that_were_not_found_are_left_to_be_said(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("alpha0_deg,alpha1_deg,beta0_mm,beta1_mm,px,py,foo\n1,2,3,4,5,6,7\n")
    text = mapping_text(tmp_path / "log.csv", pair_robot())
    assert 'theta = ["alpha0_deg", "alpha1_deg"]' in text and 'l = ["beta0_mm", "beta1_mm"]' in text
    assert 'position = ["px", "py", "COLUMN"]   # say those called COLUMN' in text
    assert 'theta = "deg"' in text and 'l = "mm"' in text


def test_a_robot_s_text_explains_its_keys() -> None:
    text = robot_text()
    assert text.count("[[tube]]") == 3 and text.count("#") > 15


@pytest.mark.parametrize(
    "header",
    [
        "run,base1 angle [deg],base2 angle [deg],base1 [mm],base2 [mm],tip x [mm],tip y [mm],tip z [mm]",
        "seq,rot1_deg,rot2_deg,ins1_mm,ins2_mm,tip_x_mm,tip_y_mm,tip_z_mm",
        "trial,Theta_1 (deg),Theta_2 (deg),L1 (mm),L2 (mm),X (mm),Y (mm),Z (mm)",
        "s,alpha0_deg,alpha1_deg,beta0_mm,beta1_mm,px_mm,py_mm,pz_mm",
    ],
)
def test_columns_are_guessed_as_laboratories_call_them(header: str, tmp_path: Path) -> None:
    columns = header.split(",")
    (tmp_path / "log.csv").write_text(header + "\n" + ",".join("0" * len(columns)) + "\n")
    (tmp_path / "map.toml").write_text(mapping_text(tmp_path / "log.csv", pair_robot()))
    said = read_document(tmp_path / "map.toml").content
    assert [*said["columns"]["theta"], *said["columns"]["l"], *said["columns"]["position"]] == columns[1:]
    assert said["columns"]["sequence"] == columns[0] and said["units"] == {"theta": "deg", "l": "mm", "position": "mm"}


BARE = """
name = "no joints and no home"
[[tube]]
outer_diameter_mm = 2.5
inner_diameter_mm = 2.2
youngs_modulus_GPa = 60
poisson_ratio = 0.3
section = [{ length_mm = 60 }, { length_mm = 60, radius_mm = 250 }]
[[tube]]
outer_diameter_mm = 2.1
inner_diameter_mm = 1.85
youngs_modulus_GPa = 60
poisson_ratio = 0.3
collar_length_mm = 20
section = [{ length_mm = 120 }, { length_mm = 80, radius_mm = 90 }]
[[contact]]
friction_coefficient = 0.2
"""


def test_a_start_keeps_its_limits_in_the_digits_that_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Drawn back to its limits a robot had nothing in front of the plate, its start once written with six digits."""
    robot, task = tmp_path / "robot.toml", tmp_path / "task.toml"
    robot.write_text(BARE)
    assert main(["init", "scenario", str(task), "--robot", str(robot)]) == 0
    assert main(["check", str(task)]) == 0 and "Nothing is in doubt" in capsys.readouterr().out
    scenario = ctrplan.load_scenario(task)
    assert ctrplan.MotionChecker(scenario).check(scenario.start[None])[0].valid


@pytest.mark.parametrize(
    ("start", "phrase"),
    [
        ((-120.0, -180.0), "nothing of it is in front"),
        ((-60.0, -80.0), r"the robot cuts .* mm into anatomy.1 \(sphere\) at"),
    ],
)
def test_a_start_that_cannot_be_is_marked(
    start: tuple[float, float], phrase: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was a traceback, and a body in the anatomy was in no doubt."""
    (tmp_path / "robot.toml").write_text(BARE)
    (tmp_path / "task.toml").write_text(
        'robot = "robot.toml"\ngoal = {tip_mm = [30, 10, 120]}\n'
        f'start = {{"rotate 1" = 0, "rotate 2" = 0, "translate 1" = {start[0]}, "translate 2" = {start[1]}}}\n'
        'anatomy = [{kind = "sphere", center_mm = [0, 0, 50], radius_mm = 8}]\n'
    )
    main(["check", str(tmp_path / "task.toml")])
    assert re.search(rf"! .*task.toml: start: .*{phrase}", capsys.readouterr().out)


def test_a_table_in_the_place_of_a_robot_is_called_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "m.csv"
    table.write_text("theta_1_rad,l_1_m\n0,0\n")
    assert main(["diagnose", str(table), str(tmp_path / "robot.toml")]) == 2
    assert "it is a table: are two files exchanged?" in capsys.readouterr().err


def test_what_code_gets_wrong_is_said(tmp_path: Path) -> None:
    """Lists are read; other shapes, kinds and numbers that are none were AttributeErrors and ValueErrors."""
    (tmp_path / "robot.toml").write_text(BARE)
    robot = load_robot(tmp_path / "robot.toml")
    start = np.array([0.0, 0.0, -0.06, -0.08])
    given = dict(name="code", robot=robot, start=start, goal=ctrplan.Goal(None, np.array([0.03, 0.01, 0.12]), 1e-3))
    checker = ctrplan.MotionChecker(ctrplan.Scenario(**given))
    assert checker.motion(start.tolist(), (start + [0, 0.1, 0, 0]).tolist()).valid
    with pytest.raises(InputError, match="must be a list of 4 finite numbers"):
        checker.motion(np.zeros(3), np.zeros(3))
    assert "must be finite" in checker.motion(start, np.full(4, np.nan)).reason
    unnested = np.array([[0, 0, 0, -0.18], [0, 0, -0.06, 0], [0, 0, -0.02, 0.01]])
    tip, base, limit = (motion.reason for motion in checker.check(unnested))
    assert re.search("not nested: .* keep the tips in order, but tube 2 ends at 0 mm and tube 1 at 120 mm", tip)
    assert re.search("tubes are not nested: .* must be at least 20 mm apart, the collar of tube 2", base)
    assert limit == "translate 2 = 10 mm: must be within -180 and 0 mm"
    ball = ctrplan.Anatomy(ctrplan.Sphere([0, 0, 0.3], 0.01))
    for changed, phrase in (
        ({"anatomy": ball}, "must be a list of"),
        ({"goal": {"tip_m": [0, 0, 0.1]}}, "ctrplan.Goal"),
    ):
        with pytest.raises(InputError, match=phrase):
            ctrplan.Scenario(**given | changed)


def test_names_are_written_as_they_are(tmp_path: Path) -> None:
    """Quotes, backslashes and umlauts, in names of robots, joints, columns and files."""
    name, folder = 'a "b" \\n c: ü', tmp_path / 'q"u'
    folder.mkdir()
    file = folder / 'ro"bot\\.toml'
    assert main(["init", "robot", str(file), "--name", name]) == 0
    assert load_robot(file).name == name and "-0.0" not in file.read_text()
    own = file.read_text().replace('name = "rotate 1"', "name = 'turn \"1\" \\ ü'")
    file.write_text(own)
    assert main(["init", "scenario", str(folder / "task.toml"), "--robot", str(file)]) == 0
    assert ctrplan.load_scenario(folder / "task.toml").robot.drive.names[0] == 'turn "1" \\ ü'
    table = folder / 'log "1".csv'
    table.write_text('"theta_1 ""a"" (deg)","l_1 \\ (mm)",x,y,z\n0,0,0,0,100\n')
    one = folder / "one.toml"
    assert main(["init", "robot", str(one), "--tube", "2.64x2.39,0,150,265"]) == 0
    content = parsed_toml(mapping_text(table, load_robot(one)), "map.toml")
    assert content["run"][0]["file"] == table.name
    assert content["columns"]["theta"] == ['theta_1 "a" (deg)'] and content["columns"]["l"] == ["l_1 \\ (mm)"]


def test_options_of_another_kind_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for kind, *option in (("robot", "--mesh", "a.stl"), ("robot", "--robot", "r.toml"), ("scenario", "--name", "x")):
        assert main(["init", kind, str(tmp_path / "x.toml"), *option]) == 2
        assert f"{option[0]}: goes with init " in capsys.readouterr().err
    assert main(["init", "robot", str(tmp_path / "robot.csv")]) == 2  # which check would take for measurements
    assert "must end with .toml" in capsys.readouterr().err and not list(tmp_path.iterdir())
