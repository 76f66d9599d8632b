"""Objects show themselves: in few lines, as tables, by figures of one call, as pages within a notebook."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here import Here
from matplotlib.figure import Figure
from measured_data import measured, pair_robot, waypoints
from places import ROBOTS, SCENARIOS
from small_scenarios import NEAR

import ctrplan
from ctrplan.base.package import MOST_LINES, summary
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.studies.study.study import Study

CONFIGURATION = [0.0, 1.3, 2.9], [0.0, -0.017, -0.07]


@pytest.fixture(scope="module")
def plan() -> ctrplan.Plan:
    return ctrplan.plan(ctrplan.load_scenario(SCENARIOS / "pair_free.toml", [NEAR, "planner.time_s=0.2"]), seed=0)


@pytest.fixture(scope="module")
def objects(plan: ctrplan.Plan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    robot, pair = load_robot(ROBOTS / "three_tube.toml"), pair_robot()
    data = measured(pair, waypoints(pair, 8))
    folder = plan.save(tmp_path_factory.mktemp("plan") / "out")
    history = robot.history()
    return {
        "robot": robot,
        "drive": robot.drive,
        "bound": robot.bound(*CONFIGURATION),
        "bounds": robot.bound_many(*(np.tile(x, (500, 1)) for x in CONFIGURATION)),
        "shape": robot.solve(*CONFIGURATION),
        "zero clearance": robot.zero_clearance(*CONFIGURATION),
        "tube shape": robot.solve(*CONFIGURATION).tubes[0],
        "tips": robot.mechanics.tips_with_friction(*(np.tile(x, (9, 1)) for x in CONFIGURATION), np.zeros((9, 2))),
        "history step": history.advance(*CONFIGURATION),
        "history": history,
        "mechanics": robot.mechanics,
        "tube": robot.tubes[0],
        "joint": robot.drive.joints[0],
        "goal": plan.scenario.targets[0],
        "scene": plan.show(frames=2),
        "scenario": plan.scenario,
        "scenario with anatomy": ctrplan.load_scenario(SCENARIOS / "vessel.toml"),
        "anatomy": ctrplan.load_scenario(SCENARIOS / "vessel.toml").anatomy[0],
        "mesh": ctrplan.load_scenario(SCENARIOS / "vessel.toml").anatomy[0].shape,
        "plan": plan,
        "certificate": plan.certificate,
        "samples": plan.certificate.samples,
        "trajectory": plan.trajectory,
        "written plan": ctrplan.load_plan(folder / "plan.json", plan.scenario),
        "inverse kinematics": ctrplan.inverse_kinematics(robot, [0.034, -0.047, 0.2], starts=20),
        "measurements": data,
        "calibration": ctrplan.calibrate(pair, data, ["tube.1.poisson_ratio"]),
        "check": ctrplan.check(robot),
    }


NAMES = (
    "robot", "drive", "bound", "bounds", "shape", "zero clearance", "tube shape", "tips", "history step", "scenario",
    "scenario with anatomy", "anatomy", "mesh", "plan", "certificate", "samples", "trajectory", "written plan",
    "inverse kinematics", "measurements", "calibration", "check", "history", "mechanics", "tube", "joint", "goal",
    "scene",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_an_object_shows_itself_in_few_lines(name: str, objects: dict[str, Any]) -> None:
    text = repr(objects[name])
    assert len(text.splitlines()) <= MOST_LINES == 30
    assert max(map(len, text.splitlines())) <= 140
    assert "array(" not in text and "0x" not in text


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"check", "history", "mechanics", "scene"}))
def test_and_as_a_table_with_every_field(name: str, objects: dict[str, Any]) -> None:
    given = objects[name]
    page = given._repr_html_()
    assert page.count("<tr>") == min(MOST_LINES - 1, sum(f.repr and not f.name.startswith("_") for f in fields(given)))
    assert page.count("<table>") == page.count("</table>") == 1 and "<script" not in page


def test_public_dataclasses_show_themselves() -> None:
    """Whatever is public and holds arrays: no name of the package prints them."""
    bare = []
    for name in ctrplan.__all__:
        value = getattr(ctrplan, name)
        if isinstance(value, type) and is_dataclass(value) and value.__repr__.__module__ != "ctrplan.base.package":
            bare.append(name)
    assert set(bare) <= {"Check", "Page", "Study", "TubeDesign"}  # which have few words of their own


def test_headlines_say_what_the_object_is_about(objects: dict[str, Any]) -> None:
    assert repr(objects["robot"]).startswith("Robot: three-tube robot (Table II), 3 tubes up to 270.4 mm long\n")
    assert re.match(
        r"Bound: friction may move the tip by [\d.]+ mm and turn it by [\d.]+ deg\n", repr(objects["bound"])
    )
    assert re.match(r"Shape: tip at \(.*\) mm, CONVERGED\n", repr(objects["shape"]))
    assert re.match(r"Plan: tube pair in free space, \d legs? in [\d.]+ s", repr(objects["plan"]))


def test_summaries_of_values() -> None:
    assert summary(np.arange(6.0)) == "[0, 1, 2, 3, 4, 5]" and summary(np.zeros((9, 3))) == "9 x 3, 0 to 0"
    assert summary(np.array([[np.nan, np.inf, 2.0]])) == "1 x 3, 2 to 2" and summary(np.full(9, np.nan)) == "9"
    assert summary({"a": 1}) == "1 by name: a" and summary(()) == "()" and summary("x" * 200).endswith("...")
    assert summary((1, 2.5, "a")) == "(1, 2.5, 'a')" and summary([print] * 9) == "9 of builtin_function_or_method"


@pytest.mark.parametrize("name", ["robot", "bound", "shape", "plan"])
def test_one_call_makes_a_figure_without_a_screen(name: str, objects: dict[str, Any], tmp_path: Path) -> None:
    figure = objects[name].plot()
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "a.png", dpi=50)
    assert (tmp_path / "a.png").stat().st_size > 4000
    assert len(figure.axes) >= 1


def test_a_plan_s_scene_is_a_figure_that_moves(plan: ctrplan.Plan) -> None:
    figure = plan.show(frames=4)
    assert len(figure.data) > 3 and len(figure.frames) in (0, 4)


def test_a_study_s_report_is_a_page(tmp_path: Path) -> None:
    task = {"kind": "bound", "theta_deg": [0, 180], "l_mm": [0, -60.4]}
    vary = [{"key": "theta_2", "low": 0, "high": 180, "count": 3}]
    content = {"robot": str(ROBOTS / "table_5_pair.toml"), "task": task, "vary": vary}
    study = Study.of(content, tmp_path, allow_outside=True)
    page = study.show(study.run(tmp_path / "out", executor=Here(), workers=1))
    assert "<iframe" in page._repr_html_() and len(repr(page)) < 120
    page.save(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text() == page.html


def test_what_can_not_be_drawn_is_refused() -> None:
    with pytest.raises(InputError, match="subject = 3: must be a Robot, a Bound"):
        ctrplan.plot(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="subject = 3: must be a Plan, a Diagnosis"):
        ctrplan.show(3)  # type: ignore[arg-type]
