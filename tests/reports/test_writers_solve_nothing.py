"""Once a plan is made and its scene is solved, writers only format: none of them asks the mechanics for anything."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from counted_calls import count_calls

from ctrplan.plans.plan import Plan, write_plan_json
from ctrplan.reports.plan_page import write_plan_report
from ctrplan.reports.plan_picture import write_plan_png
from ctrplan.reports.plan_scene import FRAMES, PlanScene, plan_scene

WRITERS: dict[str, Callable[[Path, Plan, PlanScene], None]] = {
    "plan.json": lambda path, plan, scene: write_plan_json(path, plan),
    "plan.png": lambda path, plan, scene: write_plan_png(path, scene),
    "report.html": lambda path, plan, scene: write_plan_report(path, scene),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_solves_nothing(
    plan: Plan, scene: PlanScene, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    called = count_calls(monkeypatch)
    WRITERS[name](tmp_path / name, plan, scene)
    assert called == [] and (tmp_path / name).stat().st_size > 0


def test_a_scene_is_solved_once_for_every_frame_and_where_it_is_narrowest(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    called = count_calls(monkeypatch)
    plan_scene(plan)
    assert called == ["bound"] * FRAMES + ["friction_bodies", "friction_states"]
