"""The studies that ship: what friction takes away is never given back, and without friction nothing is taken."""

from __future__ import annotations

import importlib.util
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.studies.study.study import Study

STUDIES = SCENARIOS / "studies"
TARGETS_MM = [
    [-2.9546, 1.7151, 26.4303],
    [22.5, -2.03, 87.08],
]  # one that friction leaves within 2 mm, one that it does not
FEW = 12  # starts


class Here(Executor):
    """Does a task when it is given."""

    def submit(self, function: Any, /, *arguments: Any, **keys: Any) -> Any:
        future: Future[Any] = Future()
        future.set_result(function(*arguments, **keys))
        return future


@pytest.fixture(scope="module")
def reach_map() -> Any:
    found = importlib.util.spec_from_file_location("reach_map", STUDIES / "reach_map.py")
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    import sys

    sys.modules["reach_map"] = module  # which dataclasses look for
    found.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["ventricle", "airway"])
def test_the_studies_that_ship_have_2000_targets_in_the_lumen(name: str) -> None:
    study = Study.read(STUDIES / f"reach_{name}.toml")
    assert study.count == 2000 and study.scenario is not None
    first = np.array([study.tasks[k].settings["target"]["tip_mm"] for k in range(50)]) * 1e-3
    part = study.scenario.anatomy[0]
    radius = study.robot.tubes[-1].outer_diameter_m / 2
    assert part.shape.distance(first).max() <= -(part.margin_m + radius)


def test_friction_only_takes_away(tmp_path: Path) -> None:
    study = Study.read(STUDIES / "reach_ventricle.toml", ["targets.count=2", f"task.options={{starts={FEW}}}"])
    table = study.run(tmp_path / "out", executor=Here())
    assert table.done.all() and np.any(table["free_within_2_mm"] == 1)
    for near in ("1", "2"):
        assert np.all(table[f"within_{near}_mm"] <= table[f"free_within_{near}_mm"])
    for kind in ("within", "free_within"):
        assert np.all(table[f"{kind}_1_mm"] <= table[f"{kind}_2_mm"])
    known = np.isfinite(table["worst_mm"])
    assert np.all(table["worst_mm"][known] >= table["free_mm"][known])
    assert np.array_equal(table["within_tolerance"], table["within_2_mm"])  # whose tolerance that is


def test_the_worst_error_is_that_of_the_shapes(reach_map: Any) -> None:
    """By inverse kinematics of the robot with friction, which looks at other configurations of the same branches."""
    scenario = ctrplan.load_scenario(SCENARIOS / "ventricle.toml")
    goal = replace(scenario.goal, tip_m=np.array(TARGETS_MM[0]) * 1e-3, tolerance_m=2e-3)
    row = reach_map.reach(replace(scenario, goal=goal), {}, 0, starts=FEW)
    found = ctrplan.inverse_kinematics(scenario, goal.tip_m, tolerance_m=2e-3, starts=FEW)
    least = min(way.tip_error_m + way.bound_m for way in found.valid) * 1e3
    assert row["worst_mm"] == pytest.approx(least, abs=0.3)


def test_without_friction_nothing_differs(reach_map: Any) -> None:
    place = reach_map.Place(ctrplan.load_scenario(SCENARIOS / "ventricle.toml"))
    goal = replace(place.scenario.goal, tip_m=np.array(TARGETS_MM[1]) * 1e-3, tolerance_m=2e-3)
    free = reach_map.reach(replace(place.frictionless, goal=goal), {}, 0, starts=FEW)
    real = reach_map.reach(replace(place.scenario, goal=goal), {}, 0, starts=FEW)
    assert free["worst_mm"] == pytest.approx(free["free_mm"], abs=1e-6) and free["within_1_mm"]
    assert real["free_mm"] == pytest.approx(free["free_mm"], abs=1e-9) and not real["within_2_mm"]


def test_the_entry_study_that_ships_tries_poses_beside_the_scenarios_own() -> None:
    study = Study.read(STUDIES / "entry_ventricle.toml")
    assert study.count == 13 * 13 * 8 and study.scenario is not None
    own = ctrplan.load_scenario(SCENARIOS / "ventricle.toml").base_R
    assert 0 < np.degrees(np.arccos(np.clip(study.scenario.base_R[2] @ own[2], -1, 1))) < 10


def test_more_friction_is_never_less_error_and_the_inner_pair_matters_most(tmp_path: Path) -> None:
    from ctrplan.studies.study.table import sensitivity

    study = Study.read(STUDIES / "friction_ventricle.toml", ["draws.count=16"])
    table = study.run(tmp_path / "out", executor=Here())
    found = sensitivity(study, table, "bound_mm")
    assert table.done.all() and found is not None
    assert found.keys[int(np.argmax(found.total))] == "contact.2.friction_coefficient"
    keys = [f"contact.{k}.friction_coefficient" for k in (1, 2)]
    middle = {name: (vary.low + vary.high) / 2 for vary in study.entry.vary for name in [vary.key]}
    bounds = []
    for mu in (0.1, 0.2, 0.3):
        values = {**middle, **dict.fromkeys(keys, mu)}
        vary = [{"key": key, "values": [value]} for key, value in values.items()]
        content = {"robot": str(SCENARIOS / "robots" / "three_tube_insertion.toml"), "task": dict(study.job.task)}
        bounds.append(Study.of({**content, "vary": vary}).run(tmp_path / f"{mu}", executor=Here())["bound_mm"][0])
    assert bounds == sorted(bounds)
    assert table["bound_mm"].min() > 0.8 * bounds[0] and table["bound_mm"].max() < 1.2 * bounds[2]
