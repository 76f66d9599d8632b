"""report.html of inverse kinematics: every configuration that reaches a point, drawn and in a table, the safest
first.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.planning.reach import Configuration, Reach
from ctrplan.reports import looks
from ctrplan.reports.html_page import plot, rendered, scene_script
from ctrplan.reports.plan_scene import SIDES, in_anatomy, line_trace, mesh_trace, plate_trace, xyz
from ctrplan.reports.robot_surface import RobotPose, pose, stand
from ctrplan.reports.words import digits, millimetres, term
from ctrplan.scenario.scenario import Scenario

MOST_DRAWN = len(looks.SERIES)  # branches, which have a colour each


@dataclass(frozen=True, eq=False)
class ReachScene:
    """What was found, and what is drawn of it."""

    scenario: Scenario
    configurations: tuple[Configuration, ...]  # lowest bound first
    branches: tuple[int, ...]  # of each, from 0
    target_m: Array  # (3,) anatomy's frame
    poses: tuple[tuple[int, RobotPose], ...]  # branch, and the robot in its first configuration


def reach_scene(scenario: Scenario, reach: Reach, branches: list[int]) -> ReachScene:
    """Solves a bound for each branch that is drawn."""
    poses = []
    for branch in range(min(MOST_DRAWN, len(set(branches)))):
        with suppress(SolverError):
            poses.append((branch, pose(scenario, reach.configurations[branches.index(branch)].joints)))
    target = scenario.located(np.asarray(reach.target.tip_m))
    return ReachScene(scenario, reach.configurations, tuple(branches), target, tuple(poses))


def reach_figure(scene: ReachScene) -> dict[str, Any]:
    """All these robots at once, each in its branch's colour with its envelope."""
    traces = [plate_trace(scene.scenario)]
    for branch, shown in scene.poses:
        colour, name = looks.SERIES[branch], f"branch {branch + 1}"
        for tube, rod in enumerate(shown.tubes):
            traces.append(mesh_trace(rod.surface(SIDES), colour, 1.0, name, shown=tube == 0))
        traces.append(mesh_trace(shown.envelope.surface(SIDES), colour, 0.15, name, shown=False))
    marker = {"symbol": "diamond", "size": 6, "color": looks.GOAL_LOOK.colour}
    traces.append(line_trace(xyz(scene.target_m[None]), mode="markers", marker=marker, name="the point asked for"))
    robots = [shown.envelope.surface(4).vertices_m for _, shown in scene.poses]
    points = np.concatenate([*robots, scene.target_m[None], stand(scene.scenario).vertices_m])
    return in_anatomy(traces, scene.scenario, points)


WORDS = ("branch", "worst-case friction error", "clearance", "stability", "envelope of friction")


def reach_report_html(scene: ReachScene) -> str:
    """The content of report.html; there must be a configuration."""
    scenario, best = scene.scenario, _best(scene)
    joints = scenario.robot.drive.joints
    return rendered(
        "reach.html",
        title=f"Ways to a point - {scenario.name}",
        scenario=scenario,
        robot=scenario.robot,
        headline=_headline(scene),
        sentence=_sentence(scene),
        standing="good" if any(c.valid for c in scene.configurations) else "bad",
        figures=[
            (millimetres(best.bound_m), term("worst-case friction error", "smallest worst-case friction error")),
            (millimetres(best.tip_error_m), "tip without friction from the point, there"),
            (_clearance(best), term("clearance", "clearance beyond margins, there")),
            (digits(best.stability), term("stability", "stability, there")),
        ],
        figure=plot(
            reach_figure(scene), "scene", with_library=True, script=scene_script("scene", "key"), kind="plot scene"
        ),
        all_drawn=len(set(scene.branches)) <= MOST_DRAWN,
        rows=list(zip(scene.configurations, scene.branches, strict=True)),
        names=[f"{joint.name} ({joint.unit})" for joint in joints],
        values=lambda c: [value / joint.si_per_unit for value, joint in zip(c.joints.tolist(), joints, strict=True)],
        clearance=_clearance,
        colours=looks.SERIES,
        MUTED=looks.MUTED,
        WORDS=WORDS,
    )


def _best(scene: ReachScene) -> Configuration:
    """With the lowest worst case, of the valid ones if there are any."""
    return next((c for c in scene.configurations if c.valid), scene.configurations[0])


def _headline(scene: ReachScene) -> str:
    count, branches = len(scene.configurations), len(set(scene.branches))
    ways = "1 configuration" if count == 1 else f"{count} configurations"
    return f"{ways} in {branches} {'branch' if branches == 1 else 'branches'}"


def _sentence(scene: ReachScene) -> str:
    x, y, z = (scene.target_m * 1e3).tolist()
    valid, best = sum(c.valid for c in scene.configurations), _best(scene)
    kept = f"{valid} of them keep all limits and margins" if valid else "none of them keeps all limits and margins"
    return (
        f"The tip without friction reaches ({x:.1f}, {y:.1f}, {z:.1f}) mm; {kept}. In the best of these friction "
        f"can take it up to {millimetres(best.bound_m)} away."
    )


def _clearance(c: Configuration) -> str:
    return "free space" if math.isinf(c.clearance_m) else millimetres(c.clearance_m)
