"""A plan's folder: plan.json, the trajectory, report.html and plan.png, all of them or none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ctrplan.files.trajectory_file import TrajectoryFormat, trajectory_formats, write_trajectory
from ctrplan.plans.plan import Plan
from ctrplan.plans.plan_json import write_plan_json
from ctrplan.reports.plan_page import write_plan_report
from ctrplan.reports.plan_picture import write_plan_png
from ctrplan.reports.plan_scene import plan_scene
from ctrplan.storage.output_folder import output_folder, written_together

FORMATS = ("csv", "ros2")  # of the trajectory, where nothing else is asked for


def plan_outputs(formats: Sequence[TrajectoryFormat]) -> list[str]:
    """The names of the files."""
    return ["plan.json", *(chosen.file_name for chosen in formats), "report.html", "plan.png"]


def save_plan(plan: Plan, folder: str | os.PathLike[str], formats: Sequence[str] = FORMATS) -> Path:
    """Writes them as `ctrplan plan` does; returns the folder, which is made if need be. Raises CtrplanError."""
    chosen = trajectory_formats(formats)
    outputs = plan_outputs(chosen)
    place = output_folder(os.fspath(folder), outputs)
    scene = plan_scene(plan)  # writers solve nothing
    with written_together(place, outputs) as made:
        write_plan_json(made / "plan.json", plan)
        write_trajectory(made, plan.trajectory, chosen)
        write_plan_png(made / "plan.png", scene)
        write_plan_report(made / "report.html", scene)
    return place
