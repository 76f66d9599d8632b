"""A new effect, planner, obstacle and output format are one new file each, as docs/extending.md shows them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from extending_page import PLACES, block, run, section, source, write_extension, write_inputs
from made_up_input import thorough
from places import ROOT


def used(folder: Path, heading: str, *more: str) -> str:
    """Standard output of a section's commands, where the one file that the section shows is all there is."""
    write_inputs(folder)
    write_extension(folder, PLACES[heading], source(heading))
    assert len([file for file in (folder / "EXTENSIONS").rglob("*") if file.is_file()]) == 1
    done = run(folder, block(section(heading), "sh"), *more)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def python(folder: Path, script: str) -> None:
    """Runs a script of assertions beside the extension."""
    (folder / "script.py").write_text(script)
    done = run(folder, f"{sys.executable} script.py")
    assert done.returncode == 0, done.stderr


def refusals(folder: Path, scenario: str, overrides: list[list[str]]) -> list[str]:
    """What is said of a scenario after each list of overrides, in one process."""
    script = f"""
import ctrplan

for overrides in {overrides!r}:
    try:
        ctrplan.load_scenario({scenario!r}, overrides)
    except ctrplan.InputError as error:
        print(error)
"""
    (folder / "script.py").write_text(script)
    return run(folder, f"{sys.executable} script.py").stdout.splitlines()


def columns_of(file: Path) -> dict[str, np.ndarray]:
    header, *rows = (line.split(",") for line in file.read_text().splitlines())
    wanted = [k for k, name in enumerate(header) if name != "status"]
    return {header[k]: np.array([float(row[k] or "nan") for row in rows]) for k in wanted}


def test_an_effect_is_one_file(tmp_path: Path) -> None:
    """The tips are those of the robot without it whose tube has been turned by hand."""
    rows = [f"0,{1 + np.radians(2) * l_mm},0,{l_mm / 1e3}" for l_mm in (-15.0, -30.0)]
    (tmp_path / "by_hand.csv").write_text("\n".join(["theta_1_rad,theta_2_rad,l_1_m,l_2_m", *rows]))
    used(
        *(tmp_path, "An effect"),
        "ctrplan simulate my_pair.toml by_hand.csv -o plain",
        "ctrplan simulate my_pair.toml path.csv -o without",
    )
    twisted, plain, without = (columns_of(tmp_path / name / "poses.csv") for name in ("out", "plain", "without"))
    for axis in ("x_m", "y_m", "z_m"):
        np.testing.assert_allclose(twisted[axis][[0, -1]], plain[axis][[0, -1]], atol=2e-6)
    assert abs(twisted["x_m"][-1] - without["x_m"][-1]) > 2e-3


def test_a_planner_is_one_file(tmp_path: Path) -> None:
    used(tmp_path, "A planner")
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["planner"] == "RRT"
    python(
        tmp_path,
        """
import numpy as np
import ctrplan
from ctrplan.planning import MotionChecker
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.search.ompl_set_up import SearchProblem

scenario = ctrplan.load_scenario("first.toml", ["planner.name=RRT", "planner.goal_bias=0.3"])
checker = MotionChecker(scenario)
problem = SearchProblem(checker, goal_states(checker, np.random.default_rng(0)), seed=0)
assert (problem.planner.getName(), problem.planner.getGoalBias()) == ("RRT", 0.3)
assert problem.solve(lambda cost: False, only_first=True)
assert ctrplan.reorder(problem.corners(), scenario).certificate.valid
""",
    )


def test_settings_of_a_planner_of_ones_own_are_read_strictly(tmp_path: Path) -> None:
    write_inputs(tmp_path)
    write_extension(tmp_path, PLACES["A planner"], source("A planner"))
    rules = {
        "goal_bias=2": "planner.goal_bias = 2: must be from 0 to 1, a share: is it in %?",
        "verve=2": "planner.verve = 2: unknown key, known ones, all optional, are "
        "name, time_s, settle, goal_bias, range_mm.",
        "samples_per_batch=9": "planner.samples_per_batch = 9: does not go with name = 'RRT'.",
        "name=PRM": "planner.name = 'PRM': must be one of BIT*, RRT, RRT*, RRTConnect.",
    }
    overrides = [["planner.name=RRT", f"planner.{setting}"] for setting in rules]
    assert refusals(tmp_path, "first.toml", overrides) == [f"first.toml: {rule}" for rule in rules.values()]


@thorough("test_a_planner_is_one_file")
def test_an_obstacle_is_one_file(tmp_path: Path) -> None:
    """Distances are those to the drawn surface, checked against the mesh library's own."""
    used(tmp_path, "An obstacle")
    assert 0 < json.loads((tmp_path / "out" / "plan.json").read_text())["certificate"]["min_clearance_m"] < 0.1
    python(
        tmp_path,
        """
import numpy as np
import ctrplan
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.reports.robot_surface import anatomy_surface

(part,) = ctrplan.load_scenario("boxed.toml").anatomy
drawn = anatomy_surface(part)
mesh = AnatomyPart(Mesh(drawn.vertices_m, drawn.faces), part.role, part.margin_m)
points = np.random.default_rng(0).uniform(-0.2, 0.2, (5000, 3))
inside = points.min() + (points - points.min()) * (part.shape.upper_m - part.shape.lower_m) / np.ptp(points)
points = np.vstack([points, inside - inside.min(axis=0) + part.shape.lower_m])
clearance = exact_clearance([part], points)
assert (clearance < -1e-3).sum() > 1000 and (clearance > 1e-3).sum() > 1000
np.testing.assert_allclose(clearance, exact_clearance([mesh], points), atol=1e-12)
""",
    )


def test_keys_of_an_obstacle_of_ones_own_are_read_strictly(tmp_path: Path) -> None:
    write_inputs(tmp_path)
    write_extension(tmp_path, PLACES["An obstacle"], source("An obstacle"))
    rules = {
        'anatomy=[{kind = "turned_box", lower_mm = [0, 0, 0]}]': "upper_mm: is missing, a turned_box needs "
        "lower_mm, upper_mm, turn_deg.",
        "anatomy.1.radius_mm=1": "radius_mm = 1 mm: does not go with kind = 'turned_box'.",
        "anatomy.1.colour=1": "colour = 1: unknown key, known ones are lower_mm, upper_mm, turn_deg, kind, "
        "and optional role, margin_mm.",
        "anatomy.1.upper_mm=[-60, 20, 140]": "upper_mm = [-60, 20, 140]: must exceed lower_mm.",
        "anatomy.1.kind=cube": "kind = 'cube': must be one of box, capsule, mesh, sphere, surface, turned_box, volume.",
    }
    found = refusals(tmp_path, "boxed.toml", [[override] for override in rules])
    assert found == [f"boxed.toml: anatomy.1.{rule}" for rule in rules.values()]


@thorough("test_an_effect_is_one_file")
def test_an_output_format_is_one_file(tmp_path: Path) -> None:
    """What it writes is what the CSV file says, and no format is written that was not asked for."""
    printed = used(tmp_path, "An output format")
    assert "plan.json, trajectory.csv, trajectory.jsonl, report.html, plan.png" in printed
    names = {file.name for file in (tmp_path / "out").iterdir()}
    written = {"plan.json", "trajectory.csv", "trajectory.jsonl", "report.html", "plan.png", "inputs.zip"}
    assert names == written | {"SHA256SUMS"}
    samples = [json.loads(line) for line in (tmp_path / "out" / "trajectory.jsonl").read_text().splitlines()]
    columns = columns_of(tmp_path / "out" / "trajectory.csv")
    for name, column in (("time_s", "time_s"), ("rotate 2", "rotate_2_position_rad")):
        np.testing.assert_array_equal([sample[name] for sample in samples], columns[column])


def test_files_as_shown_pass_the_linter_and_the_type_checker(tmp_path: Path) -> None:
    files = [str(write_extension(tmp_path, place, source(heading))) for heading, place in PLACES.items()]
    settings, tools = str(ROOT / "pyproject.toml"), [sys.executable, "-m"]
    known = str(Path(sys.prefix) / ".mypy_cache")  # where `make lint` has left what it knows of ctrplan
    for command in (
        [*tools, "ruff", "check", "--config", settings, *files],
        [*tools, "ruff", "format", "--check", "--config", settings, *files],
        [*tools, "mypy", "--config-file", settings, "--cache-dir", known, *files],
    ):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


def test_the_page_of_effects_is_made_with_an_extension_too(tmp_path: Path) -> None:
    write_extension(tmp_path, PLACES["An effect"], source("An effect"))
    environment = os.environ | {"CTRPLAN_EXTENSIONS": str(tmp_path / "EXTENSIONS")}
    command = [sys.executable, str(ROOT / "tools" / "effects_page.py")]
    made = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "### guide_twist" in made.stdout and "`theta_1_deg_per_mm`" in made.stdout
