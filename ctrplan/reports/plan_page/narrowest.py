"""Where the robot comes closest to the anatomy, in the report: in the scene, and as a table of three numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from ctrplan.reports import palette
from ctrplan.reports import scene_looks as looks
from ctrplan.reports.glossary import term
from ctrplan.reports.html_page import Markup, lines, section, table, tag
from ctrplan.reports.plan_words.clearance_rows import START_FRICTION, ClearanceRow, Kind, clearance_rows, point_words
from ctrplan.reports.plan_words.numbers import millimetres
from ctrplan.reports.scene_traces import SIDES, mesh_trace, xyz

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.reports.narrowest_pose import NarrowestPose

NAMES: dict[Kind, str] = {
    "nominal": "clearance without friction",
    "closest": "clearance in the worst friction state",
    "narrowest": "certified clearance",
}
NO_BREAK = "\u00a0"
WITHIN = 0.95  # of its radius: hidden where the moving robot is
LABEL_M = 6e-3  # beyond the wall
FAR_MM = 10.0  # clearances beyond look alike
NAME = f"{looks.NARROW_BODY.name}: red 0, blue {FAR_MM:g} mm"  # a colour bar would cover the robot in small windows
SCALE = [[share, colour] for share, colour in zip((0.0, 0.3, 1.0), palette.CLEARANCES, strict=True)]


def narrowest_traces(pose: NarrowestPose) -> list[Any]:
    """The body coloured by its clearance, and the gap at its narrowest with its number."""
    return [_body(pose), *_gap(pose)]


def _body(pose: NarrowestPose) -> Any:
    slim = replace(pose.body, radius_m=WITHIN * pose.body.radius_m)
    trace = mesh_trace(slim.surface(SIDES), looks.NARROW_BODY.colour, 1.0, NAME)
    clearance_mm = np.concatenate([np.repeat(pose.clearance_m, SIDES), pose.clearance_m[[0, -1]]]) * 1e3
    trace.update(intensity=clearance_mm.astype(np.float32), colorscale=SCALE, cmin=0.0, cmax=FAR_MM, showscale=False)
    trace.update(hoverinfo=None, hovertemplate="clearance %{intensity:.2f} mm<extra></extra>")
    return trace


def _gap(pose: NarrowestPose) -> list[Any]:
    """Across the free room, and its number beyond the wall, where the robot does not cover it."""
    colour, number = looks.NARROWEST.colour, millimetres(pose.place.clearance_m)
    name = f"{looks.NARROWEST.name}: {number} beyond the margin"
    across = pose.gap_m[1] - pose.gap_m[0]
    beside = pose.gap_m[1] + LABEL_M * across / max(float(np.linalg.norm(across)), 1e-12)
    drawn = {"mode": "lines+markers", "line": {"color": colour, "width": 5}, "marker": {"color": colour, "size": 4}}
    hover = f"clearance {number} beyond the margin, in the worst friction state<extra></extra>"
    label = {"text": [f"<b>{number}</b>"], "textfont": {"color": colour, "size": 14}, "textposition": "middle right"}
    return [
        go.Scatter3d(**xyz(pose.gap_m), **drawn, name=name, hovertemplate=hover),
        go.Scatter3d(**xyz(beside[None]), mode="text", hoverinfo="skip", **label, name=name, showlegend=False),
    ]


def clearance_section(plan: Plan) -> Markup:
    """Three numbers with their places, and what is assumed of friction before the start; nothing in free space."""
    rows = clearance_rows(plan)
    if not rows:
        return Markup()
    header = ("Clearance beyond the margins", "", "Where, in the anatomy's frame", "When")
    start = f"Friction before the start: {START_FRICTION[plan.certificate.start_friction]}."
    return section("How near it comes to the anatomy", table(header, map(_cells, rows)), tag("p", start, kind="quiet"))


def _cells(row: ClearanceRow) -> tuple[Markup | str, ...]:
    where = (f"tube {row.place.tube} to {row.place.part}", point_words(row.place.point_m))
    state = "no friction" if row.kind == "nominal" else f"friction {row.friction}"
    return (
        term(NAMES[row.kind]),
        tag("b", millimetres(row.clearance_m).replace(" ", NO_BREAK)),
        lines(where),
        lines(text.replace(" ", NO_BREAK) for text in (row.when, state)),
    )
