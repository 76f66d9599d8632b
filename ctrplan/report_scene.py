"""The report's 3-D scene: the robot moves through the anatomy, with all that friction can make of it."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from ctrplan import palette
from ctrplan.drive import Array
from ctrplan.html_page import FONT
from ctrplan.scene import Pose, goal_tip, plate, pose, poses, side_azimuth_rad, tip_path, view_box
from ctrplan.surface import Surface, anatomy_surface, capsule
from ctrplan.verdict import millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

FRAMES = 50
SIDES, ENVELOPE_SIDES = 10, 12
SHORTEST_FRAME_MS, LONGEST_FRAME_MS = 60, 200  # a motion plays in real time where that is neither jerky nor dull
TILT = np.radians(16)
BOUND_SCALE = [[0.0, "#2F6FB0"], [0.5, "#B07AA1"], [1.0, palette.BOUND]]
LIGHT = {"ambient": 0.75, "diffuse": 0.5, "specular": 0.15, "roughness": 0.7}


def scene_figure(plan: Plan) -> go.Figure:
    """A plotly figure with a frame per pose; frames are called by their time in s."""
    path = poses(plan, FRAMES)
    names = [f"{step.time_s:.3f}" for step in path]
    moving = _robot(path[-1])
    anatomy = [anatomy_surface(part) for part in plan.scenario.anatomy]
    figure = go.Figure([*moving, *_still(plan, anatomy)])
    figure.frames = [
        go.Frame(data=_moved(step), traces=list(range(len(moving))), name=name)
        for step, name in zip(path, names, strict=True)
    ]
    points = np.concatenate([step.envelope.surface(4).vertices_m for step in path] + [goal_tip(plan)[None]])
    _lay_out(figure, *view_box(points, np.concatenate([np.empty((0, 3)), *(s.vertices_m for s in anatomy)])), points)
    if len(path) > 1:
        _add_player(figure, names, plan.trajectory.duration_s)
    return figure


def _robot(pose: Pose) -> list[Any]:
    """The traces that move; their faces stay, and only their vertices come with the frames."""
    tubes = [
        _mesh(rod.surface(SIDES), palette.tube_colour(i), 1.0, f"tube {i + 1}") for i, rod in enumerate(pose.tubes)
    ]
    envelope = _mesh(pose.envelope.surface(ENVELOPE_SIDES), palette.ENVELOPE, 0.22, "envelope of friction")
    corners = go.Scatter3d(
        **_corner_lines(pose),
        mode="lines",
        line={"color": palette.CORNER, "width": 2},
        name="corner shapes",
        hoverinfo="skip",
    )
    return [*tubes, envelope, corners]


def _moved(pose: Pose) -> list[Any]:
    rods = [rod.surface(SIDES) for rod in pose.tubes] + [pose.envelope.surface(ENVELOPE_SIDES)]
    return [*(go.Mesh3d(**_xyz(surface.vertices_m)) for surface in rods), go.Scatter3d(**_corner_lines(pose))]


def _corner_lines(pose: Pose) -> dict[str, Any]:
    """All corner shapes as one line with gaps."""
    gap = np.full((len(pose.corners_m), 1, 3), np.nan)
    return _xyz(np.concatenate([pose.corners_m, gap], axis=1).reshape(-1, 3))


def _still(plan: Plan, anatomy: list[Surface]) -> list[Any]:
    scenario = plan.scenario
    start = pose(scenario, plan.legs[0].start)
    slim = [replace(rod, radius_m=0.9 * rod.radius_m) for rod in start.tubes]  # hidden where the moving robot is
    ghost = [
        _mesh(rod.surface(SIDES), palette.START, 1.0, "robot at the start", shown=i == 0) for i, rod in enumerate(slim)
    ]
    traces = [*ghost, _mesh(plate(scenario).surface(32), palette.PLATE, 1.0, "front plate"), _tip_path(plan)]
    traces += _goal(plan)
    names = {"avoid": "anatomy to avoid", "inside": "lumen to stay inside"}
    roles = [part.role for part in scenario.anatomy]
    for k, (role, surface) in enumerate(zip(roles, anatomy, strict=True)):
        opacity = 0.35 if role == "avoid" else 0.2
        traces.append(_mesh(surface, palette.ANATOMY[role], opacity, names[role], shown=role not in roles[:k]))
    return traces


def _tip_path(plan: Plan) -> Any:
    bound_mm = (plan.certificate.samples.bound_m * 1e3).astype(np.float32)
    bar = {"title": {"text": "path of the tip:<br>error bound (mm)"}, "thickness": 14, "len": 0.5, "x": 1.0, "y": 0.4}
    scale = {"colorscale": BOUND_SCALE, "cmin": 0, "cmax": max(float(np.nanmax(bound_mm)), 1e-6), "colorbar": bar}
    return go.Scatter3d(
        **_xyz(tip_path(plan)),
        mode="lines",
        line={"color": bound_mm, "width": 6, **scale},
        showlegend=False,
        customdata=bound_mm,
        hovertemplate="worst-case friction error %{customdata:.2f} mm<extra></extra>",
    )


def _goal(plan: Plan) -> list[Any]:
    goal, tip_m = plan.scenario.goal, goal_tip(plan)
    marker = {"symbol": "diamond", "size": 6, "color": palette.GOAL}
    hover = {"hovertemplate": "goal<extra></extra>"}
    traces = [go.Scatter3d(**_xyz(tip_m[None]), mode="markers", marker=marker, name="goal", **hover)]
    if goal.tip_m is not None:
        name = f"goal tolerance {html.escape(millimetres(goal.tolerance_m))}"
        traces.append(_mesh(capsule(tip_m, tip_m, goal.tolerance_m, 20), palette.GOAL, 0.25, name))
    if goal.direction is not None:
        arrow = np.stack([tip_m - 0.015 * goal.direction, tip_m])
        line = {"color": palette.GOAL, "width": 4}
        traces.append(go.Scatter3d(**_xyz(arrow), mode="lines", line=line, name="goal direction", hoverinfo="skip"))
    return traces


def _mesh(surface: Surface, colour: str, opacity: float, name: str, shown: bool = True) -> Any:
    i, j, k = surface.faces.T.astype(np.int32)
    return go.Mesh3d(
        **_xyz(surface.vertices_m),
        i=i,
        j=j,
        k=k,
        color=colour,
        opacity=opacity,
        name=name,
        legendgroup=name,
        showlegend=shown,
        lighting=LIGHT,
        hoverinfo="skip",
    )


def _xyz(points_m: Array) -> dict[str, Any]:
    """Coordinates in mm, in single precision: a third of the size, and more than a screen can show."""
    x, y, z = (points_m * 1e3).astype(np.float32).T
    return {"x": x, "y": y, "z": z}


def _lay_out(figure: go.Figure, lower_m: Array, upper_m: Array, robot_m: Array) -> None:
    """Equal scales that stay while the robot moves; seen from where it spreads widest."""
    axis = {"backgroundcolor": "#F8FAFB", "gridcolor": palette.GRID, "zeroline": False, "nticks": 6}
    ranges = (np.stack([lower_m, upper_m], axis=1) * 1e3).tolist()
    axes = {f"{n}axis": axis | {"title": {"text": f"{n} (mm)"}, "range": r} for n, r in zip("xyz", ranges, strict=True)}
    azimuth, extent = side_azimuth_rad(robot_m), upper_m - lower_m
    toward = np.array([np.cos(TILT) * np.cos(azimuth), np.cos(TILT) * np.sin(azimuth), np.sin(TILT)])
    eye = (0.65 + 1.65 * extent.max() / np.cbrt(extent.prod())) * toward  # plotly's scenes have unit volume
    light = dict(zip("xyz", (1e5 * toward).tolist(), strict=True))
    camera = {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "center": {"x": 0, "y": 0, "z": 0.0}}
    figure.update_traces(lightposition=light, selector={"type": "mesh3d"})
    figure.update_layout(
        height=760,
        margin={"l": 0, "r": 0, "t": 30, "b": 100},
        scene={"aspectmode": "data", "domain": {"x": [0.14, 0.92]}, "camera": camera, **axes},
        legend={"x": 0.0, "y": 1.0, "bgcolor": "rgba(255,255,255,0.7)", "itemsizing": "constant"},
        uirevision="stays",
        font={"color": palette.INK, "size": 13, "family": FONT},
    )


def _add_player(figure: go.Figure, names: list[str], duration_s: float) -> None:
    step_ms = float(np.clip(1e3 * duration_s / (len(names) - 1), SHORTEST_FRAME_MS, LONGEST_FRAME_MS))
    still = {"mode": "immediate", "frame": {"duration": 0, "redraw": True}, "transition": {"duration": 0}}
    play = still | {"frame": {"duration": step_ms, "redraw": True}, "fromcurrent": True}
    buttons = [
        {"label": "Play", "method": "animate", "args": [None, play]},
        {"label": "Pause", "method": "animate", "args": [[None], still]},
    ]
    steps = [{"label": f"{float(name):.1f}", "method": "animate", "args": [[name], still]} for name in names]
    place = {"x": 0.0, "y": 0.0, "xanchor": "left", "yanchor": "top", "pad": {"t": 32, "r": 10}}
    figure.update_layout(
        updatemenus=[{"type": "buttons", "direction": "left", "showactive": False, "buttons": buttons, **place}],
        sliders=[
            {
                "active": len(names) - 1,
                "steps": steps,
                "x": 0.17,
                "len": 0.83,
                "y": 0.0,
                "pad": {"t": 14},
                "font": {"size": 11},
                "currentvalue": {"prefix": "time ", "suffix": " s", "font": {"size": 13}},
            }
        ],
    )
