"""Tube designs: the same search whoever does it, fronts that nothing dominates, steps that never make it worse."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here import Here
from places import SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.files.design_file import MadeEntry, StockEntry
from ctrplan.files.robot_file import load_robot
from ctrplan.reports.study_page import design_report_html
from ctrplan.scenario.scenario import Goal
from ctrplan.studies.child_process import ChildExecutor
from ctrplan.studies.design.search import confirm, is_better
from ctrplan.studies.design.space import StockChoice
from ctrplan.studies.study.engine import ExecutorEngine
from ctrplan.studies.study.store import Store
from ctrplan.studies.study.study import Study
from ctrplan.studies.study.table import load_study
from ctrplan.studies.target_set import (
    RobotPair,
    bound_by,
    dominates,
    robot_at,
    target_checker,
    target_value,
    value_nearby,
    with_target,
)

pytestmark = pytest.mark.skipif(find_spec("optuna") is None, reason="optuna is not installed")

PAIR = SCENARIOS / "pair_free.toml"
POINTS_MM = [[27, 17, 166], [-33, 19, 160]]
CURVATURE = "robot.tube.2.section.2.curvature_y_per_m"
TUBES = [(2.5, 2.1), (2.305, 1.95), (1.875, 1.6), (1.75, 1.5)]
STOCK = [
    {
        "name": f"{outer} x {inner}",
        "outer_diameter_mm": outer,
        "inner_diameter_mm": inner,
        "youngs_modulus_GPa": 60.0,
        "diameter_tolerance_mm": 0.005,
    }
    for outer, inner in TUBES
]


def content(**changes: Any) -> dict[str, Any]:
    """A search for the tubes of a pair in free space, with two targets."""
    parameters = [
        {"key": CURVATURE, "name": "inner", "low": 8.0, "high": 18.0, "tolerance_percent": 3.0},
        {"key": "robot.tube.1.section.2.curvature_y_per_m", "name": "outer", "low": 1.0, "high": 5.0},
    ]
    search = {"objectives": ["robust_mm", "reach", "stability"], "trials": 4, "together": 2, "starts": 8}
    targets = {"points_mm": POINTS_MM, "tolerance_mm": 1.0}
    own = {"scenario": str(PAIR), "targets": targets, "parameter": parameters, "stock": STOCK, **search}
    return {**own, "local": {"designs": 1, "steps": 3}, **changes}


def run(folder: Path, executor: Any = None, **changes: Any) -> ctrplan.TubeDesigns:
    workers = getattr(executor, "workers", 1)
    return ctrplan.TubeDesign.of(content(**changes)).run(folder, executor=executor or Here(), workers=workers)


@pytest.fixture(scope="module")
def found(tmp_path_factory: Any) -> Iterator[ctrplan.TubeDesigns]:
    yield run(tmp_path_factory.mktemp("design") / "out")


def test_two_workers_find_the_same(found: ctrplan.TubeDesigns, tmp_path: Path) -> None:
    with ChildExecutor(2) as executor:
        beside = run(tmp_path / "out", executor)
    assert beside.table.results == found.table.results
    assert beside.entries() == found.entries() and len(set(beside.table.columns["worker"])) == 2


def test_a_search_that_was_killed_goes_on(found: ctrplan.TubeDesigns, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    first = run(folder, Here(most=4))
    assert first.interrupted and first.did < len(found.archive.all)
    with open(folder / "rows.jsonl", "ab") as file:
        file.write(b'{"key": "0123')  # what a kill in the middle of a line leaves
    rest = Here()
    again = run(folder, rest)
    assert rest.done == found.did - first.did
    assert again.table.results == found.table.results and again.entries() == found.entries()
    nothing = Here()
    assert run(folder, nothing).entries() == found.entries() and nothing.done == 0


def test_nothing_dominates_the_front(found: ctrplan.TubeDesigns) -> None:
    archive = found.archive
    done = [archive.values(looked) for looked in archive.all if looked.is_done]
    front = [archive.values(looked) for looked in found.front]
    assert front and not any(dominates(other, own) for own in front for other in done)
    for other in done:  # and what is not on it is dominated by something that is, or as good
        assert any(dominates(own, other) or own == other for own in front)


def test_local_steps_never_make_the_robust_error_worse(found: ctrplan.TubeDesigns) -> None:
    rows = [looked for looked in found.archive.all if looked.is_done]
    trials = [looked for looked in rows if looked.row["inputs"]["stage"] == "search"]
    steps = [looked for looked in rows if looked.row["inputs"]["stage"] == "local step"]
    best = min(trials, key=lambda looked: looked.numbers["robust_mm"])
    assert steps
    for looked in rows:
        assert looked.numbers["robust_mm"] >= looked.numbers["robust_first_order_mm"] >= looked.numbers["error_mm"]
    for step in steps:
        if is_better(step, best, "robust_mm"):
            assert step.numbers["robust_mm"] < best.numbers["robust_mm"]
            assert step.numbers["reach"] >= best.numbers["reach"]
            best = step
    assert found.front[0].numbers["robust_mm"] <= best.numbers["robust_mm"]
    assert best in steps  # on this smooth problem a step down the derivatives leads down


def test_wider_tolerances_cost_more(tmp_path: Path) -> None:
    costs = []
    for percent in (1.0, 2.0):
        parameters = [{**content()["parameter"][0], "tolerance_percent": percent}]
        made = run(tmp_path / f"{percent}", parameter=parameters, trials=1, local={"designs": 0})
        costs.append({row["name"]: row["costs_mm"] for row in made.entries()[0]["tolerances"]})
    assert costs[1]["inner"] == pytest.approx(2 * costs[0]["inner"], rel=1e-3) and costs[0]["inner"] > 0
    rest = [name for name in costs[0] if name != "inner"]
    assert len(rest) == 4 and [costs[0][name] for name in rest] == [costs[1][name] for name in rest]


def test_giving_up_early_loses_nothing(tmp_path: Path) -> None:
    changes = {"sampler": "random", "trials": 6, "local": {"designs": 0}, "objectives": ["error_mm", "stability"]}
    whole, pruned = (run(tmp_path / f"{prune}", prune=prune, **changes) for prune in (False, True))
    assert pruned.counts[1] > 0 and whole.counts[1] == 0
    plain = [[{k: v for k, v in row.items() if k != "row"} for row in each.entries()] for each in (whole, pruned)]
    assert plain[0] == plain[1]


@pytest.mark.parametrize(
    ("key", "step", "within"),
    [
        (CURVATURE, 0.02, 0.002),
        ("robot.tube.2.outer_diameter_mm", 1e-4, 0.02),
        ("robot.tube.2.section.2.length_mm", 0.05, 0.05),  # the mesh moves with the tube: 4e-5 of the tip's motion
    ],
)
def test_slopes_of_the_bound_are_those_of_robots_solved_again(key: str, step: float, within: float) -> None:
    goal = Goal(None, np.array(POINTS_MM[0]) * 1e-3, 1e-7)
    scenario = with_target(ctrplan.load_scenario(PAIR), goal)
    at = target_value(replace(scenario, goal=replace(goal, tolerance_m=1e-4)), 10, 0)
    assert at is not None
    start = value_nearby(scenario, at)  # to the target within a nanometre or so
    assert start is not None
    own = key.removeprefix("robot.")
    steps = own.split(".")
    value: Any = scenario.robot.content
    for name in steps:
        value = value[int(name) - 1] if name.isdecimal() else value[name]
    low, high = (load_robot(scenario.robot.path or "", [f"{own}={value + side * step}"]) for side in (-1, 1))
    pair = RobotPair("one", low, high)
    slope = bound_by(target_checker(scenario), start.joints, [pair])[0]
    ends = [
        value_nearby(replace(scenario, robot=robot_at(scenario.robot, [pair], np.array([side]))), start)
        for side in (-1.0, 1.0)
    ]
    assert ends[0] is not None and ends[1] is not None
    assert slope == pytest.approx((ends[1].bound_m - ends[0].bound_m) / 2, rel=within)


def test_whatever_is_chosen_from_stock_nests() -> None:
    stock = [StockEntry(f"{k}", 3 - 0.13 * k, 2.7 - 0.13 * k, 60.0, 0.3, 0.01) for k in range(12)]
    choice = StockChoice(stock, MadeEntry(least_clearance_mm=0.02, most_clearance_mm=0.3), 3)
    for shares in np.random.default_rng(0).random((200, 3)):
        for outer, inner in zip(tubes := choice.chosen(shares.tolist()), tubes[1:], strict=False):
            clearance = (outer.inner_diameter_mm - inner.outer_diameter_mm) / 2
            assert 0.02 + 0.01 - 1e-9 <= clearance <= 0.3 + 1e-9
    ends = [choice.chosen([share] * 3) for share in (0.0, 1.0)]
    assert [tube.name for tube in ends[0]] != [tube.name for tube in ends[1]]


def test_what_cannot_be_set_is_not_made(tmp_path: Path) -> None:
    made = run(tmp_path / "out", made={"most_strain": 0.001}, trials=2)
    assert made.did == 0 and not made.front and made.counts == (0, 0, 2)
    assert "strains a tube" in made.table.columns["reason"][0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stock": STOCK[:1]}, "no 2 tubes that fit into each other"),
        ({"parameter": [{"key": CURVATURE, "low": 3, "high": 2}]}, "must be below high"),
        ({"parameter": [{"key": "robot.tube.9.length_mm", "low": 1, "high": 2}]}, "tube.9"),
        ({"parameter": [], "stock": []}, "nothing may be chosen"),
        ({"stock": [], "parameter": [{"key": CURVATURE, "low": 1, "high": 2}]}, "nothing has a tolerance"),
        ({"objectives": ["speed", "reach"]}, "objectives"),
        ({"set": {"name": datetime.date(2026, 1, 1)}}, "numbers, texts"),
        ({"set": {"robot.tube.7.length_mm": 3}}, "tube.7"),
        ({"scenario": "missing.toml"}, "not a file that exists"),
    ],
)
def test_bad_input_gets_a_sentence(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        ctrplan.TubeDesign.of(content(**changes))


def test_a_search_that_nobody_means_to_wait_for_is_refused_with_its_time(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"1,000,000 trials would take about [\d.]+ days on 1 workers: --yes"):
        run(tmp_path / "out", trials=1_000_000)
    assert not (tmp_path / "out").exists()


def test_without_optuna_a_sentence_says_what_to_install(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr("ctrplan.studies.design.search.find_spec", lambda name: None)
    assert main(["design", str(SCENARIOS / "studies" / "design_ventricle.toml")]) == 2
    assert "pip install 'ctrplan[design]'" in capsys.readouterr().err


def test_the_command_writes_the_front_and_its_robots(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    import tomli_w

    monkeypatch.setattr("ctrplan.studies.study.study.is_installed", lambda: False)  # dask starts in two seconds
    monkeypatch.setattr("ctrplan.studies.study.study.PoolEngine", lambda workers: ExecutorEngine(Here(), workers))
    (tmp_path / "design.toml").write_text(tomli_w.dumps(content(trials=2, local={"designs": 0})), encoding="utf-8")
    folder = tmp_path / "out"
    arguments = ["--allow-outside", "--workers", "1", "--quiet"]
    assert main(["design", str(tmp_path / "design.toml"), "-o", str(folder), *arguments]) == 0
    entries = json.loads((folder / "front.json").read_text(encoding="utf-8"))
    assert f"{len(entries)} on the front" in capsys.readouterr().out
    for entry in entries:
        robot = ctrplan.load_robot(folder / "robots" / f"{entry['number']:02d}.toml")
        assert robot.tubes[1].sections[1].curvature_y_per_m == entry["choices"]["inner"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "What tolerances of design 1 cost" in page and "robots/01.toml" in page


def test_plans_confirm_what_a_design_is_worth(tmp_path: Path) -> None:
    targets = {"points_mm": POINTS_MM[:1], "tolerance_mm": 1.0}
    quickly = {"planner.time_s": 0.1}
    made = run(tmp_path / "out", trials=1, plans=1, local={"designs": 0}, targets=targets, set=quickly)
    plans = made.plans
    assert plans is not None and plans.done.all() and plans["valid"].tolist() == [1]
    assert plans["worst_mm"][0] == pytest.approx(made.front[0].numbers["error_mm"], abs=0.05)
    (goal,) = made.entries()[0]["goals"]
    kept = json.loads((tmp_path / "out" / "plans" / "plans" / "000000" / "plan.json").read_text(encoding="utf-8"))
    end = {name: next(iter(value.values())) for name, value in kept["legs"][-1]["end"].items()}
    assert end == pytest.approx(goal["joints"], abs=1e-9) and plans.columns["to"] == ["joints"]
    drive = (again := ctrplan.load_scenario(PAIR, [*made.entries()[0]["set"], goal["set"]])).robot.drive
    assert again.goal.joints is not None and drive.named(again.goal.joints) == pytest.approx(goal["joints"])
    assert "With a valid certificate" in design_report_html(made)
    json.loads((tmp_path / "out" / "front.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_where_no_way_to_the_joints_is_found_one_to_the_tip_is_sought(
    found: ctrplan.TubeDesigns, monkeypatch: pytest.MonkeyPatch
) -> None:
    def blocked(scenario: ctrplan.Scenario, **_: Any) -> None:
        raise NoAnswerError("to joints" if scenario.goal.joints is not None else "to a tip")

    monkeypatch.setattr("ctrplan.planning.plan", blocked)
    store, engine = Store(found.folder), ExecutorEngine(Here(most=3), 1)
    with pytest.raises(KeyboardInterrupt):  # and what was not done then is done afterwards
        confirm(found.search, found.front[:1], store, engine, lambda _: None)
    engine = ExecutorEngine(Here(), 1)
    confirm(found.search, found.front[:1], store, engine, lambda _: None)
    plans = load_study(found.folder / "plans")
    assert plans.columns["reason"] == ["to joints"] * 2 + ["to a tip"] * 2
    assert plans["target_x_mm"].tolist() == [27, -33] * 2 and plans.columns["to"] == ["joints"] * 2 + ["tip"] * 2


def test_the_design_that_ships_has_the_targets_of_the_entry_study() -> None:
    search = ctrplan.TubeDesign.read(SCENARIOS / "studies" / "design_ventricle.toml")
    entry = Study.read(SCENARIOS / "studies" / "entry_ventricle.toml")
    assert search.points_mm.tolist() == [entry.tasks[k].settings["target"]["tip_mm"] for k in range(8)]
    for share in (0.0, 1.0):  # every design keeps the tubes' lengths and can begin
        made = search.space.design([share] * len(search.space.names))
        scenario = ctrplan.load_scenario(SCENARIOS / "ventricle.toml", search.space.overrides(made))
        assert [tube.length_m for tube in scenario.robot.tubes[:2]] == pytest.approx([0.15, 0.167])
