"""What a study varies: points of an anatomy, base poses, drawn numbers, files; and tasks other than bounds."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here import Here
from packed_page import unpacked
from places import ROBOTS, SCENARIOS
from scipy import stats

import ctrplan
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.base.arrays import shortest_rotation
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_robot_or_scenario
from ctrplan.reports.study_page import study_report_html
from ctrplan.studies.study.sources import matching_files
from ctrplan.studies.study.study import Study
from ctrplan.studies.study.table import sensitivity

PAIR = str(ROBOTS / "table_5_pair.toml")
VENTRICLE = str(SCENARIOS / "ventricle.toml")
FREE = str(SCENARIOS / "pair_free.toml")


def study(**keys: Any) -> Study:
    return Study.of({"scenario": VENTRICLE, "task": {"kind": "ik"}, **keys})


def points_mm(made: Study) -> Any:
    names = ("target_x_mm", "target_y_mm", "target_z_mm")
    return np.array([[made.tasks[k].inputs[name] for name in names] for k in range(made.count)])


def test_points_of_a_volume_keep_their_depth() -> None:
    anatomy = ctrplan.load_scenario(VENTRICLE).anatomy
    grid = points_mm(study(targets={"within": "anatomy.1", "step_mm": 6, "depth_mm": 2}))
    assert -anatomy[0].shape.distance(grid * 1e-3).max() >= 2e-3 and np.allclose(grid % 6 % 6, 0)
    fewer = points_mm(study(targets={"within": "anatomy", "step_mm": 6, "box_mm": [[-30, -30, 50], [30, 30, 200]]}))
    assert exact_clearance(anatomy, fewer * 1e-3).min() >= 0 and fewer[:, 2].min() >= 50
    drawn = points_mm(study(targets={"within": "anatomy", "count": 40, "seed": 3}))
    assert len(drawn) == 40 and exact_clearance(anatomy, drawn * 1e-3).min() >= -1e-8
    assert np.array_equal(drawn, points_mm(study(targets={"within": "anatomy", "count": 40, "seed": 3})))
    surface = points_mm(study(targets={"on": "anatomy.1", "step_mm": 8}))
    assert np.abs(anatomy[0].shape.distance(surface * 1e-3)).max() < 1e-6
    apart = np.linalg.norm(surface[:, None] - surface[None], axis=2) + 1e3 * np.eye(len(surface))
    assert apart.min() >= 8 and apart.min(axis=1).max() < 24


def test_base_poses_along_an_opening() -> None:
    line = {"center_mm": [0, 0, -10], "along_mm": [0, 30, 30], "normal": [0, 0, 1], "step_mm": 12, "tilts_deg": [0, 8]}
    made = study(bases={"patch": line})
    inputs = [made.tasks[k].inputs for k in range(made.count)]
    places = np.array([[row[f"base_{axis}_mm"] for axis in "xyz"] for row in inputs])
    ends = np.linspace([0, 0, -10], [0, 30, 30], 6)  # 50 mm in steps of 10
    np.testing.assert_allclose(places, np.repeat(ends, 9, axis=0), atol=1e-9)  # each straight, and tilted to 8 sides
    for change, words in (({"step_mm": None}, "step_mm: is missing"), ({"radius_mm": 3}, "does not go with radius_mm")):
        given = {key: value for key, value in {**line, **change}.items() if value is not None}
        with pytest.raises(InputError, match=words):
            study(bases={"patch": given})


def test_base_poses_of_a_patch() -> None:
    patch = {
        "center_mm": [1, 2, 3],
        "normal": [0, 1, 0],
        "radius_mm": 5,
        "step_mm": 5,
        "tilts_deg": [0, 20],
        "sides": 4,
    }
    made = study(bases={"patch": patch})
    assert made.count == 5 * (1 + 4)
    for k in range(made.count):
        inputs = made.tasks[k].inputs
        place = np.array([inputs[f"base_{axis}_mm"] for axis in "xyz"])
        scenario = ctrplan.load_scenario(VENTRICLE, made.tasks[k].overrides)
        assert np.allclose(scenario.base_position_m * 1e3, place)
        assert abs((place - [1, 2, 3])[1]) < 1e-9 and np.linalg.norm(place - [1, 2, 3]) <= 5 + 1e-9
        tilt = np.degrees(np.arccos(np.clip(scenario.base_R[1, 2], -1, 1)))
        assert tilt == pytest.approx(0 if k % 5 == 0 else 20, abs=1e-5)
    opposite = shortest_rotation([0, 0, -1.0]) @ [0, 0, 1.0]
    assert np.allclose(opposite, [0, 0, -1])
    with pytest.raises(InputError, match="must have one of direction and quaternion_wxyz"):
        study(bases={"poses": [{"position_mm": [0, 0, 0]}]})


@pytest.mark.parametrize("own", ["direction = [0, 1, 2]", "look_at = [4, 0, 90]\nroll_deg = 30"])
def test_base_poses_take_the_place_of_whatever_way_the_scenario_looks(own: str, tmp_path: Path) -> None:
    """What [base] says besides the pose stays, and rows of scenarios that differ in their pose alone are the same."""
    text = re.sub(r'(robot = )"', rf'\1"{SCENARIOS}/', Path(FREE).read_text(encoding="utf-8"))
    poses = {"poses": [{"position_mm": [1, 2, 3], "direction": [0, 1, 1]}]}
    made = []
    for name, base in (("own", own), ("other", "direction = [1, 0, 0]")):
        file = tmp_path / f"{name}.toml"
        file.write_text(f"{text}\n[base]\nrotation_sigma_deg = 2\n{base}\n", encoding="utf-8")
        content = {"scenario": str(file), "task": {"kind": "ik"}, "bases": poses}
        made.append(Study.of(content, allow_outside=True))
    found = made[0].scenario
    assert found is not None
    np.testing.assert_allclose(found.base_position_m, [1e-3, 2e-3, 3e-3])
    np.testing.assert_allclose(found.base_R[:, 2], [0, 0.5**0.5, 0.5**0.5], atol=1e-9)
    assert found.registration.rotation_sigma_rad == pytest.approx(np.radians(2))
    assert made[0].tasks[0].overrides == made[1].tasks[0].overrides


def test_scenarios_whose_bases_differ_in_more_than_the_pose_are_not_mixed(tmp_path: Path) -> None:
    text = re.sub(r'(robot = )"', rf'\1"{SCENARIOS}/', Path(FREE).read_text(encoding="utf-8"))
    for k in (1, 2):
        base = f"\n[base]\ndirection = [0, 0, 1]\nposition_sigma_mm = {k}\n"
        (tmp_path / f"{k}.toml").write_text(text + base, encoding="utf-8")
    content = {
        "scenario": str(tmp_path / "1.toml"),
        "task": {"kind": "ik"},
        "vary": [{"key": "scenario", "files": ["[12].toml"]}],
        "bases": {"poses": [{"position_mm": [0, 0, 0], "direction": [0, 1, 1]}]},
    }
    with pytest.raises(InputError, match="say the same but for the pose"):
        Study.of(content, tmp_path, allow_outside=True)


@pytest.mark.parametrize(
    ("keys", "law"),
    [
        ({"distribution": "uniform", "low": 0.1, "high": 0.3}, stats.uniform(0.1, 0.2)),
        ({"distribution": "normal", "mean": 0.2, "sigma": 0.01}, stats.norm(0.2, 0.01)),
        ({"distribution": "lognormal", "mean": -1.6, "sigma": 0.1}, stats.lognorm(0.1, scale=np.exp(-1.6))),
        ({"distribution": "triangular", "low": 0.1, "high": 0.4, "mode": 0.2}, stats.triang(1 / 3, 0.1, 0.3)),
    ],
)
def test_numbers_are_drawn_from_their_distribution(keys: dict[str, Any], law: Any) -> None:
    key = "contact.1.friction_coefficient"
    vary = [{"key": key, **keys}]
    made = Study.of({"robot": PAIR, "task": {"kind": "bound"}, "vary": vary, "draws": {"count": 800}})
    drawn = [made.tasks[k].inputs[key] for k in range(made.count)]
    assert stats.kstest(drawn, law.cdf).pvalue > 1e-3


def test_sensitivity_finds_who_matters(tmp_path: Path) -> None:
    pytest.importorskip("SALib")
    (tmp_path / "mine.py").write_text(
        "def linear(scenario, inputs, seed):\n"
        "    friction, clearance = inputs['contact.1.friction_coefficient'], inputs['contact.1.clearance_mm']\n"
        "    return {'y': 3 * friction / 0.2 + clearance / 0.1}\n",
        encoding="utf-8",
    )
    low_high = {"contact.1.friction_coefficient": 0.2, "contact.1.clearance_mm": 0.1, "tube.1.poisson_ratio": 0.1}
    content = {
        "robot": PAIR,
        "task": {"kind": "function", "function": "mine:linear"},
        "vary": [{"key": k, "distribution": "uniform", "low": 0.1, "high": 0.1 + v} for k, v in low_high.items()],
        "draws": {"method": "sobol", "count": 32},
        "keep": {"by": "y"},
    }
    made = Study.of(content, tmp_path)
    table = made.run(tmp_path / "out", executor=Here())
    found = sensitivity(made, table, "y")
    assert found is not None and made.count == 32 * 5 and found.used == 32
    assert found.total == pytest.approx([0.9, 0.1, 0.0], abs=0.1)  # variances go by squares, 9 to 1
    assert found.first == pytest.approx([0.9, 0.1, 0.0], abs=0.2)
    assert "Sobol' indices" in unescape(study_report_html(made, table))
    table.columns["y"][7] = None  # a task without a number: its base sample is left out, the others stand
    again = sensitivity(made, table, "y")
    assert again is not None and again.used == 31 and again.total == pytest.approx(found.total, abs=0.1)
    content["draws"] = {"method": "morris", "count": 10}
    made = Study.of(content, tmp_path)
    found = sensitivity(made, made.run(tmp_path / "morris", executor=Here()), "y")
    assert found is not None and found.total == pytest.approx([3, 1, 0], rel=1e-6)  # slopes over the unit ranges


def test_files_are_gone_through(tmp_path: Path) -> None:
    for name, friction in (("b", 0.3), ("a", 0.1)):
        text = Path(PAIR).read_text(encoding="utf-8").replace("[[contact]]", f"[[contact]] # {friction}")
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    task = {"kind": "bound", "theta_deg": [0, 90], "l_mm": [0, -60]}
    content = {"robot": "a.toml", "task": task, "vary": [{"key": "robot", "files": ["[ab].toml"]}]}
    table = Study.of(content, tmp_path).run(tmp_path / "out", executor=Here())
    assert table.columns["robot"] == ["a.toml", "b.toml"]
    assert table["bound_mm"][0] == table["bound_mm"][1] > 0


def test_reach_of_points_and_their_page(tmp_path: Path) -> None:
    targets = {"points_mm": [[18, 0, 80], [80, 0, 80]], "tolerance_mm": 1.5}
    made = study(targets=targets, task={"kind": "ik", "starts": 30})
    table = made.run(tmp_path / "out", executor=Here())
    tip = np.multiply([18, 0, 80], 1e-3)
    alone = ctrplan.inverse_kinematics(ctrplan.load_scenario(VENTRICLE), tip, tolerance_m=1.5e-3, starts=30)
    valid = [(c.tip_error_m + c.bound_m) * 1e3 for c in alone.valid]
    assert table["worst_mm"][0] == min(valid) and table["valid"][0] == len(valid)
    assert table.columns["status"][1] == "no answer" and "out of reach" in table.columns["reason"][1]
    assert table["nearest_mm"][1] > 1.5 and np.isnan(table["worst_mm"][1])
    html = study_report_html(made, table)
    figures = [unpacked(text) for text in re.findall(r'drawn\("targets", "([^"]+)"', html)]
    assert "Where: targets" in html and "</html>" in html and len(figures) == 1
    assert "not reached within limits and margins" in figures[0] and "within tolerance whatever" not in figures[0]


def test_plans_are_those_of_the_command_and_are_kept(tmp_path: Path) -> None:
    content = {
        "scenario": FREE,
        "task": {"kind": "plan"},
        "vary": [{"key": "planner.time_s", "values": [0.05]}],
        "seed": 4,
        "keep": {"plans": "all"},
    }
    table = Study.of(content).run(tmp_path / "out", executor=Here())
    alone = ctrplan.plan(ctrplan.load_scenario(FREE, ["planner.time_s=0.05"]), seed=4)
    assert table["cost_mm"][0] == alone.certificate.cost_mm
    assert table["goal_bound_mm"][0] == alone.certificate.goal_bound_m * 1e3
    folder = tmp_path / "out" / "plans" / "000000"
    kept = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert kept["scenario"]["path"] == FREE and kept["legs"] == alone.to_json()["legs"]
    written = ctrplan.load_plan(folder / "plan.json", overrides=["planner.time_s=0.05"])
    assert np.array_equal(written.waypoints, alone.waypoints)
    page = study_report_html(Study.of(content), table)  # of numbers that are all alike, too
    assert 'href="plans/000000/plan.json"' in page and "Best: " in page and "on 1 worker<" in page
    (folder / "plan.json").unlink()
    assert Study.of(content).run(tmp_path / "out", executor=Here()).results == table.results
    assert (folder / "plan.json").exists()


def test_many_plans_at_once() -> None:
    scenario = ctrplan.load_scenario(FREE, ["planner.time_s=0.05"])
    refused = ctrplan.load_scenario(FREE, ["margins.stability=900"])
    found, error = ctrplan.plan_many([scenario, refused], executor=Here(), seed=4)
    assert isinstance(found, ctrplan.Plan) and isinstance(error, ctrplan.NoAnswerError)
    assert "start state is not valid" in str(error)
    with pytest.raises(InputError, match=r"scenarios\[0\]"):
        ctrplan.plan_many([PAIR])  # type: ignore[list-item]


def test_ways_to_a_point_say_which_are_valid() -> None:
    robot = ctrplan.load_robot(PAIR)
    place = load_robot_or_scenario(PAIR)
    tip = robot.solve(*robot.drive.collars(place.start)).tip_m
    found = ctrplan.inverse_kinematics(robot, tip, starts=20)
    assert found.configurations and all(c.tip_error_m <= 1e-4 for c in found.configurations)
    assert [c.valid for c in found.configurations] == [not c.reason for c in found.configurations]
    assert len(found.branches) == len(found.configurations) and "reach" in found.sentence
    far = ctrplan.inverse_kinematics(robot, [0.5, 0, 0.1], starts=20)
    assert not far.configurations and "out of reach" in far.sentence and far.nearest.tip_error_m > 0.1
    for arguments, rule in (
        ({"tip_m": [0, 1]}, "must be three numbers"),
        ({"tip_m": tip, "direction": [0, 0, 0]}, "must not be zero"),
        ({"tip_m": tip, "direction_tolerance_rad": 0.1}, "goes with direction"),
        ({"tip_m": tip, "tolerance_m": -1.0}, "tolerance_m"),
    ):
        with pytest.raises(InputError, match=rule):
            ctrplan.inverse_kinematics(robot, **arguments)
    with pytest.raises(InputError, match="must be a Robot or a Scenario"):
        ctrplan.inverse_kinematics(PAIR, tip)  # type: ignore[arg-type]


def test_files_are_named_by_patterns_relative_or_absolute(tmp_path: Path) -> None:
    for name in ("b.toml", "a.toml", "c.csv"):
        (tmp_path / name).write_text("")
    both = [tmp_path / "a.toml", tmp_path / "b.toml"]
    for pattern in ("*.toml", f"{tmp_path}/*.toml", "**/*.toml"):
        assert matching_files([pattern], str(tmp_path), "key", None) == both
    assert matching_files(["b.toml", "*.toml"], str(tmp_path), "key", None) == both[::-1]
    for pattern in ("", "*.obj", "a\0*", f"{tmp_path}/none.toml", "["):
        with pytest.raises(InputError, match="names no file that exists"):
            matching_files([pattern], str(tmp_path), "key", None)
