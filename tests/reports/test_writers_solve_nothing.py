"""Once a plan is made and its scene is solved, writers only format: none of them asks the mechanics for anything."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.history import History
from ctrplan.planning.plan import Plan
from ctrplan.planning.plan_json import write_plan_json
from ctrplan.reports.plan_page.page import write_plan_report
from ctrplan.reports.plan_picture.picture import write_plan_png
from ctrplan.reports.plan_scene import FRAMES, PlanScene, plan_scene

WRITERS: dict[str, Callable[[Path, Plan, PlanScene], None]] = {
    "plan.json": lambda path, plan, scene: write_plan_json(path, plan),
    "plan.png": lambda path, plan, scene: write_plan_png(path, scene),
    "report.html": lambda path, plan, scene: write_plan_report(path, scene),
}


def count_calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the methods of the mechanics and its histories, in the order called from now on."""
    called: list[str] = []

    def counted(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            called.append(name)
            return method(*arguments, **options)

        return call

    for kind in (Mechanics, History):
        for name, method in vars(kind).items():
            if callable(method) and not name.startswith("_"):
                monkeypatch.setattr(kind, name, counted(name, method))
    return called


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_solves_nothing(
    plan: Plan, scene: PlanScene, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    called = count_calls(monkeypatch)
    WRITERS[name](tmp_path / name, plan, scene)
    assert called == [] and (tmp_path / name).stat().st_size > 0


def test_a_scene_is_solved_once_for_every_frame(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    called = count_calls(monkeypatch)
    plan_scene(plan)
    assert called == ["bound"] * FRAMES
