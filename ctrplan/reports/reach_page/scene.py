"""The ways to a point in space: the robot in the best configuration of each branch, solved before they are drawn."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.planning.goals.branches import Configuration, Reach
from ctrplan.planning.scenario import Scenario
from ctrplan.reports import palette
from ctrplan.reports import scene_looks as looks
from ctrplan.reports.framing import view_box
from ctrplan.reports.pose import Pose, pose, stand
from ctrplan.reports.scene_traces import anatomy_traces, lay_out, mesh_trace, xyz
from ctrplan.reports.surface import anatomy_surface

MOST_DRAWN = len(palette.SERIES)  # branches, which have a colour each
SIDES = 10


@dataclass(frozen=True, eq=False)
class ReachScene:
    """What was found, and what is drawn of it."""

    scenario: Scenario
    configurations: tuple[Configuration, ...]  # lowest bound first
    branches: tuple[int, ...]  # of each, from 0
    target_m: Array  # (3,) anatomy's frame
    poses: tuple[tuple[int, Pose], ...]  # branch, and the robot in its first configuration


def reach_scene(scenario: Scenario, found: Reach, branches: list[int]) -> ReachScene:
    """Solves a bound for each branch that is drawn."""
    poses = []
    for branch in range(min(MOST_DRAWN, len(set(branches)))):
        with suppress(SolverError):
            poses.append((branch, pose(scenario, found.configurations[branches.index(branch)].joints)))
    target = scenario.located(np.asarray(found.target.tip_m))
    return ReachScene(scenario, found.configurations, tuple(branches), target, tuple(poses))


def reach_figure(scene: ReachScene) -> go.Figure:
    """All these robots at once, each in its branch's colour with its envelope."""
    surfaces = [anatomy_surface(part) for part in scene.scenario.anatomy]
    traces = [mesh_trace(stand(scene.scenario), looks.PLATE.colour, 1.0, looks.PLATE.name)]
    for branch, shown in scene.poses:
        colour, name = palette.SERIES[branch], f"branch {branch + 1}"
        for tube, rod in enumerate(shown.tubes):
            traces.append(mesh_trace(rod.surface(SIDES), colour, 1.0, name, shown=tube == 0))
        traces.append(mesh_trace(shown.envelope.surface(SIDES), colour, 0.15, name, shown=False))
    marker = {"symbol": "diamond", "size": 6, "color": looks.GOAL.colour}
    point = go.Scatter3d(**xyz(scene.target_m[None]), mode="markers", marker=marker, name="the point asked for")
    figure = go.Figure([*traces, point, *anatomy_traces(scene.scenario, surfaces)])
    robots = [shown.envelope.surface(4).vertices_m for _, shown in scene.poses]
    points = np.concatenate([*robots, scene.target_m[None], scene.scenario.located(np.zeros((1, 3)))])
    solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface in surfaces)])
    lay_out(figure, *view_box(points, solid), points, scene.scenario.frame)
    return figure
