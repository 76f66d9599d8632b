"""Scenarios that are planned and certified in a second, for laws that hold for every robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from places import SCENARIOS

from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.scenario.scenario import Scenario

NEAR = "goal.joints={'rotate outer' = 6, 'rotate inner' = 10, 'translate inner' = -27}"  # of pair_free.toml: soon there

PAIR = {
    "robot": "robots/table_5_pair.toml",
    "start": {"rotate outer": 0, "rotate inner": 0, "translate inner": -30},
    "goal": {"tip_mm": [50, 10, 200], "tolerance_mm": 1},
    "anatomy": [{"kind": "sphere", "center_mm": [30, 30, 150], "radius_mm": 12, "margin_mm": 1}],
}


def pair_past_a_sphere(**planner: Any) -> Scenario:
    """Scenario of two tubes, whose certificate takes a fraction of the time of one with three."""
    return scenario_from_dict({**PAIR, "planner": {"time_s": 0.5, **planner}}, file=str(SCENARIOS / "case.toml"))


def pair_without_named_joints(folder: Path, time_s: float = 0.5, **cost: float) -> Scenario:
    """Without [[joint]] every tube has its own translation, and many configurations reach a tip."""
    robot = (SCENARIOS / "robots" / "table_5_pair.toml").read_text().split("[[joint]]")[0]
    (folder / "robot.toml").write_text(robot)
    content = {
        "robot": "robot.toml",
        "start": {f"{what} {tube}": 0 for tube in (1, 2) for what in ("rotate", "translate")},
        "goal": {"tip_mm": [50, 10, 200], "tolerance_mm": 2},
        "cost": cost,
        "planner": {"time_s": time_s},
    }
    return scenario_from_dict(content, file=str(folder / "case.toml"))
