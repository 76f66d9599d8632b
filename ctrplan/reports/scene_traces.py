"""Traces of a robot in its anatomy, for the report's scene and the live view."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from ctrplan.anatomy.patient_frame import Frame, axis_label
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT
from ctrplan.reports.looks import side_azimuth_rad
from ctrplan.reports.robot_surface import RobotPose, tube_surface

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

SIDES, ENVELOPE_SIDES = 10, 12
FINENESS = 128  # parts of a mm
TILT = np.radians(16)
LIGHT = {"ambient": 0.75, "diffuse": 0.5, "specular": 0.15, "roughness": 0.7}


def robot_traces(pose: RobotPose) -> list[Any]:
    """The traces that move; their faces stay, and only their vertices come with the frames."""
    tubes = [
        mesh_trace(tube_surface(pose, i, SIDES), looks.tube_look(i).colour, 1.0, looks.tube_look(i).name)
        for i in range(len(pose.tubes))
    ]
    envelope = mesh_trace(
        pose.envelope.surface(ENVELOPE_SIDES), looks.ENVELOPE_LOOK.colour, 0.22, looks.ENVELOPE_LOOK.name
    )
    corners = go.Scatter3d(
        **_corner_lines(pose),
        mode="lines",
        line={"color": looks.CORNERS.colour, "width": 2},
        name=looks.CORNERS.name,
        hoverinfo="skip",
    )
    return [*tubes, envelope, corners]


def moved_traces(pose: RobotPose) -> list[Any]:
    """What of `robot_traces` changes with the pose."""
    tubes = [tube_surface(pose, i, SIDES) for i in range(len(pose.tubes))]
    surfaces = [*tubes, pose.envelope.surface(ENVELOPE_SIDES)]
    return [*(go.Mesh3d(**xyz(surface.vertices_m)) for surface in surfaces), go.Scatter3d(**_corner_lines(pose))]


def _corner_lines(pose: RobotPose) -> dict[str, Any]:
    """All corner shapes as one line with gaps."""
    gap = np.full((len(pose.corners_m), 1, 3), np.nan)
    return xyz(np.concatenate([pose.corners_m, gap], axis=1).reshape(-1, 3))


def anatomy_traces(scenario: Scenario, surfaces: list[Surface]) -> list[Any]:
    """What to avoid and what to stay inside, translucent."""
    roles, traces = [part.role for part in scenario.anatomy], []
    for k, (role, surface) in enumerate(zip(roles, surfaces, strict=True)):
        look, opacity = looks.ANATOMY_LOOK[role], 0.35 if role == "avoid" else 0.2
        trace = mesh_trace(surface, look.colour, opacity, look.name, shown=role not in roles[:k])
        traces.append(trace.update(meta={"cut": True, "wall": opacity}))  # for looking.js
    return traces


def mesh_trace(surface: Surface, colour: str, opacity: float, name: str, shown: bool = True) -> Any:
    """A lit surface that does not get in the way of the mouse."""
    i, j, k = surface.faces.T.astype(np.int32)
    return go.Mesh3d(
        **xyz(surface.vertices_m),
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


def xyz(points_m: Array) -> dict[str, Any]:
    """Coordinates in mm to 1/128, in single precision: more than a screen can show, and pages are half as large."""
    x, y, z = (np.round(points_m * 1e3 * FINENESS) / FINENESS).astype(np.float32).T
    return {"x": x, "y": y, "z": z}


def lay_out(figure: go.Figure, lower_m: Array, upper_m: Array, robot_m: Array, frame: Frame | None = None) -> None:
    """Equal scales that stay while the robot moves; seen from where it spreads widest.

    frame: of the patient, whose letters then stand at the ends of the axes.
    """
    axis = {"backgroundcolor": "#F8FAFB", "gridcolor": looks.GRID, "zeroline": False, "nticks": 6}
    ranges = (np.stack([lower_m, upper_m], axis=1) * 1e3).tolist()
    axes = {
        f"{'xyz'[k]}axis": axis | {"title": {"text": f"{axis_label(k, frame)} (mm)"}, "range": r}
        for k, r in enumerate(ranges)
    }
    azimuth, extent = side_azimuth_rad(robot_m), upper_m - lower_m
    toward = np.array([np.cos(TILT) * np.cos(azimuth), np.cos(TILT) * np.sin(azimuth), np.sin(TILT)])
    sides = extent / np.cbrt(extent.prod())
    eye = (0.6 + 1.45 * sides.max()) * toward  # until fit_camera.js knows the shape of the window
    aspect = dict(zip("xyz", sides.tolist(), strict=True))
    light = dict(zip("xyz", (1e5 * toward).tolist(), strict=True))
    camera = {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "center": {"x": 0, "y": 0, "z": 0.0}}
    figure.update_traces(lightposition=light, selector={"type": "mesh3d"})
    figure.update_layout(
        autosize=True,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={"aspectmode": "manual", "aspectratio": aspect, "camera": camera, **axes},
        showlegend=False,  # the key is beside the scene
        uirevision="stays",
        font=FIGURE_TEXT,
    )
