"""Wrong inputs of a newcomer, and the sentence that each gets: it names the mistake, and the way out."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from measured_data import measured, pair_robot, waypoints, write_csv
from places import ROBOTS, SCENARIOS

from ctrplan.__main__ import main
from ctrplan.files.robot_file import write_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, a scenario in a vessel, measured tips of another robot."""
    folder = tmp_path_factory.mktemp("first hour")
    shutil.copy(ROBOTS / "three_tube.toml", folder / "robot.toml")
    shutil.copytree(SCENARIOS / "meshes", folder / "meshes")
    text = (SCENARIOS / "vessel.toml").read_text()
    (folder / "task.toml").write_text(text.replace("robots/three_tube.toml", "robot.toml"))
    pair = pair_robot()
    write_robot(folder / "pair.toml", dict(pair.content))
    write_csv(folder / "tips.csv", measured(pair, waypoints(pair, 10)))
    return folder


# command, file that is changed, what is written in the place of what, the sentence
MISTAKES: dict[str, tuple[str, str, str, str, str]] = {
    "a robot for a scenario": (
        "plan robot.toml", "", "", "",
        "robot.toml: tube: is a key of robot files, this must be a scenario (ctrplan init scenario writes one); "
        "to change its robot, write robot.tube after --set.",
    ),
    "a goal in metres": (
        "plan task.toml", "task.toml", "[51, 2, 168]", "[0.051, 0.002, 0.168]",
        "task.toml: goal.tip_mm = [0.051, 0.002, 0.168]: lies 0.176 mm from the base, the robot is 270 mm long: "
        "are these in metres?",
    ),
    "a lumen that is to be avoided": (
        "plan task.toml -o out", "task.toml", '"inside"', '"avoid"',
        "warning: task.toml: anatomy.1.role = 'avoid': holds every goal, which nothing may enter: is it a lumen "
        '(role = "inside"), or the target itself?',
    ),
    "a role of one's own": (
        "plan task.toml", "task.toml", '"inside"', '"lumen"',
        "task.toml: anatomy.1.role = 'lumen': must be one of avoid (an obstacle), inside (a lumen that the robot stays "
        "in); did you mean inside?",
    ),
    "a kind of file for a kind of part": (
        "plan task.toml", "task.toml", 'kind = "mesh"', 'kind = "stl"',
        "task.toml: anatomy.1.kind = 'stl': must be one of box, capsule, mesh, sphere, surface, volume; did you mean "
        "mesh?",
    ),
    "a unit in words": (
        "plan task.toml", "task.toml", 'unit = "mm"', 'unit = "millimeters"',
        "task.toml: anatomy.1.unit = 'millimeters': must be one of mm, cm, m, in; did you mean mm?",
    ),
    "repair as yes or no": (
        "plan task.toml", "task.toml", 'unit = "mm"', 'unit = "mm"\nrepair = true',
        "task.toml: anatomy.1.repair = true: must be one of off (nothing is closed), holes (small openings, the "
        "default), caps (flat cuts of any size too); did you mean holes?",
    ),
    "a frame by its side": (
        "plan task.toml", "task.toml", 'unit = "mm"', 'unit = "mm"\nframe = "ras"',
        "task.toml: anatomy.1.frame = 'ras': must be one of RAS (x right, y front, z head, as 3D Slicer shows), LPS (x "
        "left, y back, z head, as DICOM counts); did you mean RAS?",
    ),
    "a key without its unit": (
        "plan task.toml", "task.toml", "tip_mm", "tip",
        "task.toml: goal.tip = [51, 2, 168]: unknown key, expected tip_mm (in mm).",
    ),
    "text without quotes": (
        "plan task.toml", "task.toml", '"vessel branch"', "vessel branch",
        "task.toml: is not valid TOML at line 2, column 8: Invalid value (text needs quotes, and numbers a point for "
        "the comma).",
    ),
    "a joint of another name": (
        "plan task.toml", "task.toml", '"rotate outer"', '"rotate_outer"',
        "task.toml: start.rotate_outer = 20: unknown joint, the robot has rotate outer, rotate middle, rotate inner, "
        "translate inner; did you mean rotate outer?",
    ),
    "a tube wider inside than outside": (
        "check robot.toml", "robot.toml", "outer_diameter_mm = 2.64 ", "outer_diameter_mm = 0.5 ",
        "robot.toml: tube.1.inner_diameter_mm = 2.39 mm: must be smaller than outer_diameter_mm = 0.5 mm.",
    ),
    "a curvature in 1/mm": (
        "bound robot.toml --theta-deg 0 0 0 --l-mm 0 -17 -34", "robot.toml", "3.773584905660377  # 1/265 mm", "0.00377",
        "warning: robot.toml: tube.1.section.1.curvature_y_per_m = 0.00377 1/m: bends by a radius of 2.653e+05 mm, "
        "0.032 deg over its length: is its curvature in 1/mm?",
    ),
    "a stiffness in N mm2": (
        "bound robot.toml --theta-deg 0 0 0 --l-mm 0 -17 -34", "robot.toml", "0.0145", "14500",
        "warning: robot.toml: tube.3.bending_stiffness_Nm2 = 14500 N m^2: Young's modulus would be 6.5e+16 Pa: is it "
        "in N mm^2?",
    ),
    "a contact too few": (
        "check pair.toml", "pair.toml", "    { friction_coefficient = 0.0 },\n", "",
        "pair.toml: contact = []: must be given once per neighbouring pair of tubes, 1 in all, not 0.",
    ),
    "bases in front of the plate": (
        "bound robot.toml --theta-deg 0 0 0 --l-mm 0 17 34", "", "", "",
        "--l-mm = [0.0, 17.0, 34.0] mm: the base of tube 2 at l_2b = 17 mm and the base of tube 1 at l_1b = 0 mm must "
        "be at least 17 mm apart, the collar of tube 2.",
    ),
    "a key that there is not": (
        "check robot.toml", "robot.toml", "friction_coefficient = 0.2", "mu = 0.2",
        "robot.toml: contact.1.mu = 0.2: unknown key, known ones are friction_coefficient, and optional clearance_mm.",
    ),
    "columns of other names": (
        "calibrate pair.toml tips.csv", "tips.csv", "x_m,", "tip_x,",
        "tips.csv: x_m: is missing (is tip_x meant?): the columns are sequence, time_s, theta_1_rad, theta_2_rad, "
        "l_1_m, l_2_m, tip_x, y_m, z_m, tx, ty, tz; a mapping file says what each of them is (ctrplan init mapping).",
    ),
    "columns in degrees": (
        "calibrate pair.toml tips.csv", "tips.csv", "theta_1_rad", "theta_1_deg",
        "tips.csv: theta_1_rad: is missing, found theta_1_deg: columns are in rad and m.",
    ),
    "semicolons": (
        "diagnose pair.toml tips.csv", "tips.csv", ",", ";",
        "tips.csv: has its columns separated by semicolons, must be commas.",
    ),
    "a table of measurements for a plan": (
        "verify tips.csv", "", "", "",
        "tips.csv: is no JSON (line 1: Expecting value): a plan.json is meant, which ctrplan plan -o DIR writes.",
    ),
    "a command that is spelt wrong": (
        "plna task.toml", "", "", "", "COMMAND: invalid choice: 'plna', did you mean plan? (choose from",
    ),
    "no file of that name": ("plan taks.toml", "", "", "", "taks.toml: does not exist."),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_gets_the_sentence_that_names_it(
    name: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command, file, old, new, sentence = MISTAKES[name]
    shutil.copytree(folder, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    if file:
        text = Path(file).read_text()
        assert old in text
        Path(file).write_text(text.replace(old, new) if old == "," else text.replace(old, new, 1))
    code = main(command.split())
    told = capsys.readouterr().err
    assert f"ctrplan: {sentence}" in told, told
    assert "Traceback" not in told and (code == 0) == sentence.startswith("warning: robot")
    assert not list(Path().glob("out/*")) or code == 0


def test_tubes_from_inside_are_recognised(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head, *tubes = re.split(r"(?=\[\[tube\]\])", (folder / "robot.toml").read_text().split("[[contact]]")[0])
    rest = "[[contact]]\nfriction_coefficient = 0.2\n" * 2
    turned = folder / "turned.toml"
    turned.write_text(head + "".join(reversed(tubes)) + rest)
    assert main(["check", str(turned)]) == 2
    rule = 'fit into each other from the last to the first: list the outermost first, or write order = "inner first".'
    assert f"turned.toml: tube: {rule}" in capsys.readouterr().err
    turned.write_text('order = "inner first"\n' + turned.read_text())
    assert main(["check", str(turned)]) == 0


def test_calibrate_says_what_comes_next(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = ["calibrate", str(folder / "pair.toml"), str(folder / "tips.csv"), "-o", str(tmp_path / "cal")]
    assert main(said) == 0
    assert "next: what is left is the noise of the tracker" in capsys.readouterr().out
    lines = (folder / "tips.csv").read_text().splitlines()
    column = lines[0].split(",").index("x_m")
    rng, moved = np.random.default_rng(0), [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[column] = repr(float(cells[column]) + rng.normal(0, 3e-3)) if cells[column] else ""
        moved.append(",".join(cells))
    (folder / "off.csv").write_text("\n".join(moved))
    said[2] = str(folder / "off.csv")
    assert main(said) == 0
    told = capsys.readouterr().out
    assert "something is missing in the model; ctrplan diagnose" in told and "off.csv' -o found" in told
    names = {"theta": ["theta_1_rad", "theta_2_rad"], "l": ["l_1_m", "l_2_m"], "position": ["x_m", "y_m", "z_m"]}
    content = {"run": [{"file": "off.csv"}], "columns": names | {"sequence": "sequence"}}
    (folder / "lab.toml").write_text(tomli_w.dumps(content))
    said[2] = str(folder / "lab.toml")
    assert main(said) == 0
    assert f" '{folder / 'lab.toml'}' -o found" in capsys.readouterr().out  # what reads the table, not the table
