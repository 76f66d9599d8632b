"""The first thing to see in report.html: the robot in motion, and what friction makes of it at each moment."""

from __future__ import annotations

import html
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.surface import capsule, rod_vertices
from ctrplan.plans.planned_motion import place_time_s, sample_time_s
from ctrplan.reports import looks
from ctrplan.reports.curves import CURSOR
from ctrplan.reports.html_page import plot, rendered, scene_script
from ctrplan.reports.plan_scene import (
    SIDES,
    PlanScene,
    Trace,
    goal_tip,
    in_anatomy,
    line_trace,
    mesh_trace,
    moved_traces,
    plate_trace,
    robot_traces,
    seen_from,
    tip_path,
    xyz,
)
from ctrplan.reports.plan_words import START_FRICTION, Kind, clearance_rows, point_words
from ctrplan.reports.robot_surface import stand, swept_surface, thinned
from ctrplan.reports.words import Markup, millimetres

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from ctrplan.plans.plan import Plan
    from ctrplan.reports.plan_scene import NarrowestPose

WAY_NAMES = {
    "as given": "as the search found it",
    "as driven": "this plan",
    "straight line": "all joints at once, as without a look at friction",
    "translations first": "translations before rotations",
}


def camera_places(scene: PlanScene) -> dict[str, Any]:
    """Points in mm and unit vectors, anatomy's frame. inside: whether there is a lumen to be looked at from the tip."""
    scenario = scene.plan.scenario
    points = np.concatenate([step.envelope.centreline_m for step in scene.path])
    _, side = seen_from(points, scenario.base_position_m)
    return {
        "side": side.tolist(),
        "base": _mm(scenario.base_position_m),
        "axis": scenario.base_R[:, 2].tolist(),
        "goal": _mm(goal_tip(scene.plan)),
        "tips": [_mm(step.tip_m) for step in scene.path],
        "along": [np.round(step.tubes[-1].tangent[-1], 4).tolist() for step in scene.path],
        "inside": any(part.role == "inside" for part in scenario.anatomy),
        **_closest(scene, side),
    }


def _closest(scene: PlanScene, side: Array) -> dict[str, Any]:
    """Across the gap where the robot comes closest, and the frame at which it does; nothing in free space."""
    if scene.narrowest is None:
        return {}
    gap = scene.narrowest.gap_m
    along = (gap[1] - gap[0]) / max(float(np.linalg.norm(gap[1] - gap[0])), 1e-12)
    beside = side - (side @ along) * along
    times = [step.time_s for step in scene.path]
    at = int(np.argmin(np.abs(np.array(times) - place_time_s(scene.plan, scene.narrowest.place))))
    return {
        "closest": _mm(gap.mean(axis=0)),
        "closest_side": (beside / max(float(np.linalg.norm(beside)), 1e-12)).tolist(),
        "closest_frame": at,
    }


def _mm(point_m: Array) -> list[float]:
    results: list[float] = np.round(point_m * 1e3, 3).tolist()
    return results


NAMES: dict[Kind, str] = {
    "nominal": "clearance without friction",
    "closest": "clearance in the worst friction state",
    "narrowest": "certified clearance",
}
NO_BREAK = "\u00a0"
WITHIN = 0.95  # of its radius: hidden where the moving robot is
LABEL_M = 6e-3  # beyond the wall
FAR_MM = 10.0  # clearances beyond look alike
NAME = f"{looks.NARROW_BODY.name}: red 0, blue {FAR_MM:g} mm or more"
SCALE = [[share, colour] for share, colour in zip((0.0, 0.3, 1.0), looks.CLEARANCES, strict=True)]


def narrowest_traces(pose: NarrowestPose) -> list[Trace]:
    """The body coloured by its clearance, and the gap at its narrowest with its number."""
    return [_body(pose), *_gap(pose)]


def _body(pose: NarrowestPose) -> Trace:
    slim = replace(pose.body, radius_m=WITHIN * pose.body.radius_m)
    trace = mesh_trace(slim.surface(SIDES), looks.NARROW_BODY.colour, 1.0, NAME)
    clearance_mm = np.concatenate([np.repeat(pose.clearance_m, SIDES), pose.clearance_m[[0, -1]]]) * 1e3
    coloured = {"colorscale": SCALE, "cmin": 0.0, "cmax": FAR_MM, "showscale": False}
    del trace["hoverinfo"]
    return (
        trace
        | coloured
        | {
            "intensity": clearance_mm.astype(np.float32),
            "hovertemplate": "clearance %{intensity:.2f} mm<extra></extra>",
        }
    )


def _gap(pose: NarrowestPose) -> list[Trace]:
    """Across the free room, and its number beyond the wall, where the robot does not cover it."""
    colour, number = looks.NARROWEST.colour, millimetres(pose.place.clearance_m)
    across = pose.gap_m[1] - pose.gap_m[0]
    beside = pose.gap_m[1] + LABEL_M * across / max(float(np.linalg.norm(across)), 1e-12)
    drawn = {"mode": "lines+markers", "line": {"color": colour, "width": 5}, "marker": {"color": colour, "size": 4}}
    hover = f"clearance {number} beyond the margin, in the worst friction state<extra></extra>"
    label = {"text": [f"<b>{number}</b>"], "textfont": {"color": colour, "size": 14}, "textposition": "middle right"}
    return [
        line_trace(xyz(pose.gap_m), **drawn, name=NAME, hovertemplate=hover, showlegend=False),
        line_trace(xyz(beside[None]), mode="text", hoverinfo="skip", **label, name=NAME, showlegend=False),
    ]


def clearance_section(plan: Plan) -> Markup:
    """Three numbers with their places, and what is assumed of friction before the start; nothing in free space."""
    return rendered(
        "plan_clearance.html",
        rows=clearance_rows(plan),
        start=START_FRICTION[plan.certificate.start_friction],
        whole=lambda text: text.replace(" ", NO_BREAK),
        point_words=point_words,
        NAMES=NAMES,
    )


SWEPT_OPACITY, SWEPT_TRIANGLES = 0.10, 15_000
SWEPT_NODES = 60_000  # of the grid of a surface that is seen through
BOUND_COLOURS = ("#2F6FB0", "#B07AA1", looks.TIP_PATH.colour)  # of the least, half of and the largest worst case
BOUND_SCALE = [[share, colour] for share, colour in zip((0.0, 0.5, 1.0), BOUND_COLOURS, strict=True)]
SWATCH = f"linear-gradient(90deg, {', '.join(BOUND_COLOURS)})"


def scene_figure(scene: PlanScene) -> go.Figure:
    """A plotly figure of the start with a frame per pose; frames are called by their time in s.

    What the motion comes to is there and not shown: the pose at the goal, the closest one, the space that is swept.
    """
    import plotly.graph_objects as go

    figure = go.Figure(start_figure(scene))
    figure.frames = motion_frames(scene)
    return figure


def motion_frames(scene: PlanScene) -> list[dict[str, Any]]:
    """plotly's frames, one a pose, as plain objects: what of the start's first traces changes."""
    tips_m, times_s, results = tip_path(scene.plan), sample_time_s(scene.plan), []
    for step, moved in zip(scene.path, moved_traces(scene.path), strict=True):
        data = [*moved, {"type": "scatter3d", **xyz(_tips_until(tips_m, times_s, step.time_s))}]
        results.append({"name": f"{step.time_s:.3f}", "data": data, "traces": list(range(len(data)))})
    return results


def start_figure(scene: PlanScene) -> dict[str, Any]:
    """The scene before the motion, without frames, as a plain object."""
    plan, path = scene.plan, scene.path
    moving = [*robot_traces(scene.start), _tip_path(plan, scene.start.time_s)]
    swept = mesh_trace(
        thinned(swept_surface(path, SWEPT_NODES), SWEPT_TRIANGLES),
        looks.ENVELOPE_LOOK.colour,
        SWEPT_OPACITY,
        "space the envelope sweeps",
    )
    narrowest = narrowest_traces(scene.narrowest) if scene.narrowest else []
    hidden = {"visible": False, "meta": {"later": True}}
    later = [trace | hidden for trace in (*_at_goal(scene), *narrowest, swept)]
    traces = [*moving, plate_trace(plan.scenario), *_goal(plan), *later]
    robots, foot = rod_vertices([step.envelope for step in path], 4), stand(plan.scenario).vertices_m
    points = np.concatenate([*robots, foot, goal_tip(plan)[None]])
    return in_anatomy(traces, plan.scenario, points)


def _at_goal(scene: PlanScene) -> list[Trace]:
    slim = [replace(rod, radius_m=0.9 * rod.radius_m) for rod in scene.goal.tubes]  # hidden where the moving robot is
    return [
        mesh_trace(rod.surface(SIDES), looks.AT_GOAL.colour, 1.0, looks.AT_GOAL.name, shown=i == 0)
        for i, rod in enumerate(slim)
    ]


def _tip_path(plan: Plan, time_s: float) -> Trace:
    """The tip's way without friction up to a time, coloured by the worst case there."""
    bound_mm = (plan.certificate.samples.bound_m * 1e3).astype(np.float32)
    largest = max(float(np.nanmax(bound_mm)), 1e-6)
    return line_trace(
        xyz(_tips_until(tip_path(plan), sample_time_s(plan), time_s)),
        mode="lines",
        line={"color": bound_mm, "width": 6, "colorscale": BOUND_SCALE, "cmin": 0, "cmax": largest, "showscale": False},
        name=html.escape(f"{looks.TIP_PATH.name} so far, red where friction may err most"),
        meta={"swatch": SWATCH},
        customdata=bound_mm,
        hovertemplate="worst-case friction error %{customdata:.3g} mm<extra></extra>",
    )


def _tips_until(tips_m: Array, times_s: Array, time_s: float) -> Array:
    """(K, 3) [m] the tip at the certificate's samples, not a number of those that are still ahead."""
    ahead = times_s > time_s
    ahead[0] = False  # a line without a point has no place
    return np.where(ahead[:, None], np.nan, tips_m)


def _goal(plan: Plan) -> list[Trace]:
    goal, tip_m = plan.scenario.goal, goal_tip(plan)
    way = [goal.tip_m for goal in plan.scenario.via if goal.tip_m is not None]
    marker = {"symbol": "diamond", "size": 6, "color": looks.GOAL_LOOK.colour}
    hover = {"hovertemplate": "goal<extra></extra>"}
    tolerance = "" if goal.tip_m is None else f", tolerance {goal.tolerance_m * 1e3:g} mm"
    name = f"{looks.GOAL_LOOK.name}{tolerance}"
    traces = [line_trace(xyz(tip_m[None]), mode="markers", marker=marker, name=name, **hover)]
    if way:
        hollow = marker | {"symbol": "diamond-open"}
        hover_way = {"hovertemplate": "target on the way<extra></extra>"}
        traces.append(
            line_trace(xyz(np.array(way)), mode="markers", marker=hollow, name="targets on the way", **hover_way)
        )
    if goal.line_m is not None:
        line = {"color": looks.GOAL_LOOK.colour, "width": 5, "dash": "dot"}
        traces.append(line_trace(xyz(goal.line_m), mode="lines", line=line, name="line to follow", hoverinfo="skip"))
    if goal.tip_m is not None:
        ball = capsule(tip_m, tip_m, goal.tolerance_m, 20)
        traces.append(mesh_trace(ball, looks.GOAL_LOOK.colour, 0.25, name, shown=False))
    if goal.direction is not None:
        arrow = np.stack([tip_m - 0.015 * goal.direction, tip_m])
        line = {"color": looks.GOAL_LOOK.colour, "width": 4}
        traces.append(line_trace(xyz(arrow), mode="lines", line=line, name="goal direction", hoverinfo="skip"))
    return traces


CURVES = ("margins", "joints")  # where the time is marked
SHORTEST_FRAME_MS, LONGEST_FRAME_MS = 60, 200  # a motion plays in real time where that is neither jerky nor dull


def shown_motion(scene: PlanScene) -> dict[str, Any]:
    """Scene and player, figures of the first moment, which the player changes, and other ways, this plan first."""
    calls = [f"addLooking(plot, {json.dumps(camera_places(scene))})"]
    calls += [f"addPlayer(plot, {json.dumps(_motion(scene))})"] if len(scene.path) > 1 else []
    code = scene_script("scene", "key", *calls, files=("player.js", "looking.js"))
    figure = start_figure(scene)
    return {
        "scene": plot(figure, "scene", frames=motion_frames(scene), with_library=True, script=code, kind="plot scene"),
        "last": len(scene.path) - 1,
        "start_s": scene.start.time_s,
        "thinned": _thinned(scene, figure),
        **{name: texts[0] for name, texts in moments(scene).items()},
    }


def moments(scene: PlanScene) -> dict[str, list[str]]:
    """Texts for each pose of the path, by the id of the element that shows them."""
    samples = scene.plan.certificate.samples
    times, at = sample_time_s(scene.plan), np.array([step.time_s for step in scene.path])
    columns = {"bound": samples.bound_m, "predicted": samples.predicted_m, "clearance": samples.clearance_m}
    return {f"now_{name}": [_length(value) for value in _then(times, column, at)] for name, column in columns.items()}


def _then(times: Array, column: Array, at: Array) -> list[float]:
    """A column of the certificate at other times; infinite where all of it is."""
    return np.interp(at, times, column).tolist() if np.isfinite(column).all() else [float(column[0])] * len(at)


def _length(value_m: float) -> str:
    return "free space" if value_m == np.inf else millimetres(value_m)


def _thinned(scene: PlanScene, figure: dict[str, Any]) -> str:
    """What is drawn of a fine mesh; distances are those of all its triangles."""
    whole = sum(len(part.shape.surface().faces) for part in scene.plan.scenario.anatomy)
    drawn = sum(len(trace["i"]) for trace in figure["data"] if "wall" in trace.get("meta", {}))
    if drawn == whole:
        return ""
    return f" The anatomy is drawn in {drawn:,} of its {whole:,} triangles; distances are to all of them."


def _motion(scene: PlanScene) -> dict[str, Any]:
    """What player.js needs to know."""
    path, duration_s = scene.path, scene.plan.trajectory.duration_s
    return {
        "frames": [f"{step.time_s:.3f}" for step in path],
        "time_s": [step.time_s for step in path],
        "figures": moments(scene),
        "curves": CURVES,
        "cursor": CURSOR,
        "step_ms": float(np.clip(1e3 * duration_s / (len(path) - 1), SHORTEST_FRAME_MS, LONGEST_FRAME_MS)),
    }
