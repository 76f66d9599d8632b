"""A small plan on disk: a robot in free space that turns and retracts a little."""

from __future__ import annotations

from pathlib import Path

import tomli_w
from claimed_plans import claiming
from places import SCENARIOS

from ctrplan.files.scenario_file import load_scenario
from ctrplan.files.trajectory_file import trajectory_formats, write_trajectory
from ctrplan.plans.plan import write_plan_json

JOINTS = ("rotate outer", "rotate middle", "rotate inner", "translate inner")
GOAL = [0.0, 5.0, 10.0, -3.0]


def write_small_plan(folder: Path) -> None:
    """Writes scenario.toml, plan.json and trajectory.csv."""
    content = {
        "robot": str(SCENARIOS / "robots" / "three_tube.toml"),
        "start": dict.fromkeys(JOINTS, 0.0),
        "goal": {"joints": dict(zip(JOINTS, GOAL, strict=True))},
    }
    (folder / "scenario.toml").write_text(tomli_w.dumps(content))
    plan = claiming(load_scenario(folder / "scenario.toml", allow_outside=True), GOAL)
    write_plan_json(folder / "plan.json", plan)
    write_trajectory(folder, plan.trajectory, trajectory_formats(["csv"]))
