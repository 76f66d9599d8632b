"""The report's 3-D scene: the robot moves through the anatomy, with all that friction can make of it."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from ctrplan.base.surface import Surface, capsule
from ctrplan.reports import scene_looks as looks
from ctrplan.reports.framing import view_box
from ctrplan.reports.plan_page.narrowest import narrowest_traces
from ctrplan.reports.plan_scene import PlanScene, goal_tip, tip_path
from ctrplan.reports.plan_words.numbers import millimetres
from ctrplan.reports.pose import stand
from ctrplan.reports.scene_traces import SIDES, anatomy_traces, lay_out, mesh_trace, moved_traces, robot_traces, xyz
from ctrplan.reports.surface import anatomy_surface, thinned
from ctrplan.reports.swept_space import swept_surface

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

SWEPT_OPACITY, SWEPT_TRIANGLES = 0.10, 15_000
BOUND_SCALE = [[0.0, "#2F6FB0"], [0.5, "#B07AA1"], [1.0, looks.TIP_PATH.colour]]


def scene_figure(scene: PlanScene) -> go.Figure:
    """A plotly figure of the start with a frame per pose; frames are called by their time in s."""
    plan, path = scene.plan, scene.path
    names = [f"{step.time_s:.3f}" for step in path]
    moving = robot_traces(scene.start)
    anatomy = [anatomy_surface(part) for part in plan.scenario.anatomy]
    swept = mesh_trace(
        thinned(swept_surface(path), SWEPT_TRIANGLES), looks.ENVELOPE.colour, SWEPT_OPACITY, "space the envelope sweeps"
    ).update(meta={"cut": True})
    figure = go.Figure([*moving, *_still(scene, anatomy), swept])
    figure.frames = [
        go.Frame(data=moved_traces(step), traces=list(range(len(moving))), name=name)
        for step, name in zip(path, names, strict=True)
    ]
    points = np.concatenate([step.envelope.surface(4).vertices_m for step in path] + [goal_tip(plan)[None]])
    solid = np.concatenate([np.empty((0, 3)), *(s.vertices_m for s in anatomy)])
    lay_out(figure, *view_box(points, solid), points, plan.scenario.frame)
    return figure


def _still(scene: PlanScene, anatomy: list[Surface]) -> list[Any]:
    plan, scenario = scene.plan, scene.plan.scenario
    slim = [replace(rod, radius_m=0.9 * rod.radius_m) for rod in scene.goal.tubes]  # hidden where the moving robot is
    ghost = [
        mesh_trace(rod.surface(SIDES), looks.AT_GOAL.colour, 1.0, looks.AT_GOAL.name, shown=i == 0)
        for i, rod in enumerate(slim)
    ]
    disc = mesh_trace(stand(scenario), looks.PLATE.colour, 1.0, looks.PLATE.name)
    narrow = narrowest_traces(scene.narrowest) if scene.narrowest else []
    return [*ghost, disc, _tip_path(plan), *_goal(plan), *narrow, *anatomy_traces(scenario, anatomy)]


def _tip_path(plan: Plan) -> Any:
    bound_mm = (plan.certificate.samples.bound_m * 1e3).astype(np.float32)
    bar = {
        "title": {"text": f"{looks.TIP_PATH.name}:<br>worst case (mm)", "font": {"size": 11}},
        "thickness": 10,
        "len": 0.42,
        "x": 1.0,
        "xanchor": "right",
        "y": 0.24,
        "tickfont": {"size": 11},
    }
    scale = {"colorscale": BOUND_SCALE, "cmin": 0, "cmax": max(float(np.nanmax(bound_mm)), 1e-6), "colorbar": bar}
    return go.Scatter3d(
        **xyz(tip_path(plan)),
        mode="lines",
        line={"color": bound_mm, "width": 6, **scale},
        showlegend=False,
        customdata=bound_mm,
        hovertemplate="worst-case friction error %{customdata:.2f} mm<extra></extra>",
    )


def _goal(plan: Plan) -> list[Any]:
    goal, tip_m = plan.scenario.goal, goal_tip(plan)
    way = [goal.tip_m for goal in plan.scenario.via if goal.tip_m is not None]
    marker = {"symbol": "diamond", "size": 6, "color": looks.GOAL.colour}
    hover = {"hovertemplate": "goal<extra></extra>"}
    traces = [go.Scatter3d(**xyz(tip_m[None]), mode="markers", marker=marker, name=looks.GOAL.name, **hover)]
    if way:
        hollow = marker | {"symbol": "diamond-open"}
        hover_way = {"hovertemplate": "target on the way<extra></extra>"}
        traces.append(
            go.Scatter3d(**xyz(np.array(way)), mode="markers", marker=hollow, name="targets on the way", **hover_way)
        )
    if goal.line_m is not None:
        line = {"color": looks.GOAL.colour, "width": 5, "dash": "dot"}
        traces.append(
            go.Scatter3d(**xyz(goal.line_m), mode="lines", line=line, name="line to follow", hoverinfo="skip")
        )
    if goal.tip_m is not None:
        name = f"goal tolerance {html.escape(millimetres(goal.tolerance_m))}"
        traces.append(mesh_trace(capsule(tip_m, tip_m, goal.tolerance_m, 20), looks.GOAL.colour, 0.25, name))
    if goal.direction is not None:
        arrow = np.stack([tip_m - 0.015 * goal.direction, tip_m])
        line = {"color": looks.GOAL.colour, "width": 4}
        traces.append(go.Scatter3d(**xyz(arrow), mode="lines", line=line, name="goal direction", hoverinfo="skip"))
    return traces
