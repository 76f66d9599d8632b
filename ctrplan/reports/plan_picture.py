"""plan.png: the robot in the anatomy, and beside it what happens on the way, over time."""

from __future__ import annotations

import io
import os
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

from ctrplan.anatomy.mesh_repair import MeshDefect
from ctrplan.anatomy.patient_frame import Frame, axis_label
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.surface import Surface, capsule
from ctrplan.reports import looks
from ctrplan.reports.curves import (
    Mark,
    Panel,
    Timeline,
    error_panel,
    margin_panels,
    position_panels,
    speed_panel,
    timeline,
)
from ctrplan.reports.looks import side_azimuth_rad, view_box
from ctrplan.reports.plan_scene import goal_tip, tip_path
from ctrplan.reports.plan_words import COLOURS, standing, verdict
from ctrplan.reports.render.camera import look_at
from ctrplan.reports.render.film import SKY, rgb, write_caption
from ctrplan.reports.render.rasteriser import Body, Camera, Picture, Stage, vertex_normals
from ctrplan.reports.robot_surface import RobotPose, anatomy_surface, end_rings, stand
from ctrplan.reports.words import millimetres
from ctrplan.storage.output_folder import write_atomically

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from ctrplan.plans.plan import Plan
    from ctrplan.reports.plan_scene import NarrowestPose, PlanScene

LIMIT: dict[str, Any] = {"linestyle": "--", "linewidth": 1.1}
DASHES: dict[str, Literal["-", ":"]] = {"solid": "-", "dotted": ":"}
KEY: dict[str, Any] = {
    "frameon": False, "fontsize": 10, "handlelength": 1.6, "columnspacing": 1.2, "borderaxespad": 0.2,
}  # fmt: skip


def draw_panel(ax: Axes, panel: Panel, timeline: Timeline, *, heading: str = "") -> None:
    """A panel with its marks in words at its right end, and a legend of its curves or a heading in place of one."""
    _prepare(ax, timeline, heading or panel.title)
    ax.set_ylabel(panel.label)
    _draw_curves(ax, panel)
    if panel.from_zero:
        ax.set_ylim(0, 1.12 * max(_largest(panel), 1e-3))
    else:
        ax.margins(y=0.12)
    _draw_marks(ax, panel.marks, timeline)
    if not heading:
        _legend(ax, panel)


def draw_pair(ax: Axes, left: Panel, right: Panel, timeline: Timeline) -> None:
    """Two panels of one curve each in the same place, an axis at each side in the colour of its curve."""
    _prepare(ax, timeline, f"{left.title}, and {right.quantity}; dashed: their limits")
    other = ax.twinx()
    other.spines["top"].set_visible(False)
    for side, panel in ((ax, left), (other, right)):
        colour = panel.series[0].colour
        _draw_curves(side, panel, colour)
        values = [*panel.series[0].values, *(limit.value for limit in panel.limits), 0.0]
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        side.set_ylim(low - 0.08 * (high - low), high + 0.12 * (high - low))
        side.set_ylabel(panel.label, color=colour)
        side.tick_params(axis="y", colors=colour)


def draw_leg_key(figure: Figure, timeline: Timeline, corner: tuple[float, float]) -> None:
    """What the shades of the legs mean; `corner`: its lower right one, of the figure's width and height."""
    patches = [Patch(facecolor=colour, edgecolor=looks.MUTED, linewidth=0.4) for colour in timeline.kinds.values()]
    names = [f"{kind} leg" for kind in timeline.kinds]
    figure.legend(patches, names, loc="lower right", bbox_to_anchor=corner, ncols=len(names), **KEY)


def _prepare(ax: Axes, timeline: Timeline, heading: str) -> None:
    """Axis over time with its legs shaded by kind."""
    ax.set_title(heading, loc="left", y=1.0, fontsize=11.5, fontweight="bold", color=looks.INK)
    ax.set_xlim(0, timeline.end_s)
    for shade in timeline.shades:
        ax.axvspan(shade.start_s, shade.end_s, facecolor=shade.colour, edgecolor="none", zorder=0)
        ax.axvline(shade.end_s, color=looks.MUTED, linewidth=0.6, zorder=0.5)
    ax.grid(axis="y", color=looks.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=10, colors=looks.INK)


def _draw_curves(ax: Axes, panel: Panel, limit_colour: str | None = None) -> None:
    for series in panel.series:
        ax.plot(series.time_s, series.values, DASHES[series.dash], color=series.colour, linewidth=2)
    for limit in panel.limits:
        ax.axhline(limit.value, color=limit_colour or limit.colour, **LIMIT)


def _largest(panel: Panel) -> float:
    """The largest value of everything drawn in the panel, 0 at least."""
    drawn = [series.values[np.isfinite(series.values)] for series in panel.series]
    return float(np.concatenate([*drawn, [limit.value for limit in panel.limits], [0.0]]).max())


def _draw_marks(ax: Axes, marks: Sequence[Mark], timeline: Timeline) -> None:
    """Points, and texts beside the right end of an axis from 0, moved apart where they would overlap."""
    top, place = ax.get_ylim()[1], 0.08
    for mark in sorted(marks, key=lambda mark: mark.value):
        if mark.has_point:
            ax.plot(timeline.duration_s, mark.value, "o", color=mark.colour, markersize=7, clip_on=False)
        place = max(mark.value / top, place)
        style: dict[str, Any] = {"color": mark.colour, "va": "center", "fontsize": 10.5, "fontweight": "bold"}
        ax.text(1.012, place, mark.text, transform=ax.transAxes, **style)
        place += 0.26


def _legend(ax: Axes, panel: Panel) -> None:
    """Above the axis, right, so that it covers nothing; names stand as they are, dollar signs included."""
    handles = [Line2D([], [], color=s.colour, linestyle=DASHES[s.dash], linewidth=2) for s in panel.series]
    names = [series.name for series in panel.series]
    if panel.limits and not panel.marks:  # marks say what their limit is
        handles.append(Line2D([], [], color=looks.MUTED, **LIMIT))
        names.append(panel.limits_are)
    legend = ax.legend(handles, names, loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=len(names), **KEY)
    for text in legend.get_texts():
        text.set_parse_math(False)


TRIANGLES = 6000  # per part of the anatomy: all are sorted and drawn in Python
THINNEST_PT = 1.3
ELEVATION_DEG = 18


def draw_scene(ax: Axes3D, scene: PlanScene) -> None:
    """Draw the plan into 3-D axes made with computed_zorder=False: the robot shows through the anatomy."""
    plan, start, goal = scene.plan, scene.start, scene.goal
    anatomy = [
        (anatomy_surface(part, TRIANGLES), looks.ANATOMY_LOOK[part.role].colour) for part in plan.scenario.anatomy
    ]
    path_mm, goal_mm = tip_path(plan) * 1e3, goal_tip(plan) * 1e3
    points = np.concatenate([*(_points(p) for p in (start, goal)), path_mm * 1e-3, goal_mm[None] * 1e-3])
    solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface, _ in anatomy)])
    _frame(ax, points, solid, plan.scenario.frame)
    for surface, colour in anatomy:
        _draw_surface(ax, surface, colour, 0.22, 1)
    _draw_surface(ax, stand(plan.scenario), looks.PLATE_LOOK.colour, 0.9, 1)
    _draw_robot(ax, start, 2, [looks.START_LOOK.colour] * len(start.tubes))
    _draw_surface(ax, goal.envelope.surface(14), looks.ENVELOPE_LOOK.colour, 0.16, 3)
    for corner in goal.corners_m * 1e3:
        ax.plot(*corner.T, color=looks.CORNERS.colour, linewidth=0.8, zorder=4)
    _draw_robot(ax, goal, 5, [looks.tube_look(tube).colour for tube in range(len(goal.tubes))])
    ax.plot(*path_mm.T, color=looks.TIP_PATH.colour, linewidth=1.4, zorder=7)
    ax.plot(
        *goal_mm[:, None], marker="X", markersize=10, color=looks.GOAL_LOOK.colour, markeredgecolor="white", zorder=8
    )
    if scene.narrowest:
        _draw_narrowest(ax, scene.narrowest)
    _scene_legend(ax, scene)


def _points(pose: RobotPose) -> Array:
    return np.concatenate([pose.envelope.surface(8).vertices_m, *(rod.centreline_m for rod in pose.tubes)])


def _frame(ax: Axes3D, points_m: Array, anatomy_m: Array, frame: Frame | None) -> None:
    """Equal scales, seen from where the robot spreads widest; letters of the patient's frame at the axes."""
    lower, upper = (corner * 1e3 for corner in view_box(points_m, anatomy_m))
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    ax.set_box_aspect(tuple(upper - lower), zoom=1.04)
    ax.set_proj_type("ortho")
    ax.view_init(elev=ELEVATION_DEG, azim=float(np.degrees(side_azimuth_rad(points_m))))
    ticks = looks.most_ticks(upper - lower)
    for k, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        axis.set_major_locator(MaxNLocator(ticks[k]))
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))
        axis.set_tick_params(labelsize=9, colors=looks.MUTED)
        axis.set_label_text(f"{axis_label(k, frame)} (mm)")


def _draw_surface(ax: Axes3D, surface: Surface, colour: str, alpha: float, zorder: int) -> None:
    triangles = surface.vertices_m[surface.faces] * 1e3
    light = LightSource(azdeg=225, altdeg=35)
    ax.add_collection3d(
        Poly3DCollection(
            triangles, facecolors=colour, shade=True, lightsource=light, alpha=alpha, linewidths=0, zorder=zorder
        )
    )


def _draw_robot(ax: Axes3D, pose: RobotPose, zorder: int, colours: list[str]) -> None:
    """Tubes as lines of their own width, inner ones first: what an outer tube covers is not seen."""
    scale = _points_per_mm(ax)
    for tube in reversed(range(len(pose.tubes))):
        rod = pose.tubes[tube]
        width = max(2e3 * float(rod.radius_m.max()) * scale, THINNEST_PT + 0.8 * (len(pose.tubes) - 1 - tube))
        x, y, z = rod.centreline_m.T * 1e3
        ax.plot(x, y, z, color=colours[tube], linewidth=width, solid_capstyle="butt", zorder=zorder + 0.1)
    for tube, ring in enumerate(end_rings(pose)):
        if ring.radius_m.any():
            width = max(2e3 * float(ring.radius_m.max()) * scale, 2 * THINNEST_PT + 2.0 * (len(pose.tubes) - 1))
            ax.plot(*ring.centreline_m.T * 1e3, color=colours[tube], linewidth=width, zorder=zorder + 0.2,
                    solid_capstyle="butt")  # fmt: skip


def _draw_narrowest(ax: Axes3D, pose: NarrowestPose) -> None:
    """The gap to the anatomy with its number, on top of everything."""
    ends, colour = pose.gap_m * 1e3, looks.NARROWEST.colour
    ax.plot(*ends.T, color=colour, linewidth=1.6, marker="o", markersize=3.5, zorder=9)
    around = [patheffects.withStroke(linewidth=2.5, foreground="white")]
    style: dict[str, Any] = {"color": colour, "fontsize": 11, "fontweight": "bold", "path_effects": around}
    ax.text(*ends[1], f"  {millimetres(pose.place.clearance_m)}", zorder=10, va="center", **style)


def _points_per_mm(ax: Axes3D) -> float:
    """Length on paper of a vertical millimetre, which the view from above foreshortens."""
    ax.apply_aspect()
    x, y, z = np.tile(ax.get_xlim()[0], 2), np.tile(ax.get_ylim()[0], 2), np.array(ax.get_zlim())
    ends = np.stack(proj3d.proj_transform(x, y, z, ax.get_proj())[:2], axis=1)
    pixels = float(np.linalg.norm(np.diff(ax.transData.transform(ends), axis=0)))
    foreshortened = (z[1] - z[0]) * np.cos(np.radians(ELEVATION_DEG))
    return float(pixels / foreshortened * 72 / ax.figure.dpi)


def _scene_legend(ax: Axes3D, scene: PlanScene) -> None:
    plan = scene.plan
    tubes = map(looks.tube_look, range(plan.scenario.robot.n))
    entries: list[tuple[Line2D | Patch, str]] = [
        (Line2D([], [], color=tube.colour, linewidth=4), f"{tube.name} at the goal") for tube in tubes
    ]
    entries += [
        (Patch(facecolor=looks.ENVELOPE_LOOK.colour, alpha=0.35), looks.ENVELOPE_LOOK.name),
        (Line2D([], [], color=looks.CORNERS.colour, linewidth=0.9), looks.CORNERS.name),
        (Line2D([], [], color=looks.START_LOOK.colour, linewidth=4), looks.START_LOOK.name),
        (Line2D([], [], color=looks.TIP_PATH.colour, linewidth=1.6), looks.TIP_PATH.name),
        (Line2D([], [], color=looks.GOAL_LOOK.colour, marker="X", markersize=9, linestyle=""), looks.GOAL_LOOK.name),
    ]
    if scene.narrowest:
        entries.append((Line2D([], [], color=looks.NARROWEST.colour, marker="o", markersize=4), looks.NARROWEST.name))
    entries += [(Patch(facecolor=look.colour, alpha=0.6), look.name) for look in looks.anatomy_looks(plan.scenario)]
    handles, labels = zip(*entries, strict=True)
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.1, 1.02), "ncols": 4}
    ax.legend(handles, labels, frameon=False, fontsize=10, columnspacing=1.4, **place)


SIZE_IN, DPI = (16.0, 10.0), 100  # 1600 x 1000 pixels
LEFT, RIGHT = (0.045, 0.46), (0.545, 0.925)  # of the figure's width; beside RIGHT stand the labels of end values
COLUMN_TOP, KEY_BOTTOM = 0.858, 0.884  # of its height


def plan_figure(scene: PlanScene) -> Figure:
    """A figure of 1600 x 1000 pixels: the scene, the margins, the error, joint positions and speeds of its plan.

    Made without pyplot: it has no window, no global state, and is drawn by whatever saves it.
    """
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    _headline(figure, scene.plan)
    left = figure.add_gridspec(2, 1, left=LEFT[0], right=LEFT[1], top=0.82, bottom=0.06, hspace=0.26)
    left.set_height_ratios((3.8, 1))
    with rc_context({"grid.color": looks.GRID}):  # 3-D axes take it from nowhere else
        draw_scene(figure.add_subplot(left[0], projection="3d", computed_zorder=False), scene)
    time = timeline(scene.plan)
    below = figure.add_subplot(left[1])
    left_margin, right_margin = margin_panels(scene.plan)[:2]
    draw_pair(below, left_margin, right_margin, time)
    below.set_xlabel("time (s)")
    _draw_column(figure, scene.plan, time)
    draw_leg_key(figure, time, (RIGHT[1], KEY_BOTTOM))
    return figure


def write_plan_png(path: str | os.PathLike[str], scene: PlanScene) -> None:
    """Write plan.png, whole or not at all; as `write_atomically`."""
    write_atomically(path, looks.png(plan_figure(scene), DPI))


def _draw_column(figure: Figure, plan: Plan, time: Timeline) -> None:
    """Error, positions and speeds below each other."""
    panels = [error_panel(plan), *position_panels(plan)]
    rows = figure.add_gridspec(
        len(panels) + 1, 1, left=RIGHT[0], right=RIGHT[1], top=COLUMN_TOP, bottom=0.06, hspace=0.42
    )
    axes = [figure.add_subplot(rows[k]) for k in range(rows.nrows)]
    for ax, panel in zip(axes, panels, strict=False):
        draw_panel(ax, panel, time)
    speeds = speed_panel(plan)
    draw_panel(axes[-1], speeds, time, heading=f"{speeds.title}, colours as above, translations dotted")
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels(axes)


def _headline(figure: Figure, plan: Plan) -> None:
    name = textwrap.shorten(plan.scenario.name, 110, placeholder=" ...")
    colour = COLOURS[standing(plan)]
    plain: dict[str, Any] = {"parse_math": False, "va": "top"}
    figure.text(0.018, 0.98, name, fontsize=18, fontweight="bold", color=looks.INK, **plain)
    sentence = "\n".join(textwrap.wrap(verdict(plan), 170)[:2])
    figure.text(0.018, 0.944, sentence, fontsize=12, color=colour, **plain)


WIDTH, HEIGHT, SAMPLES = 900, 700, 2
TISSUE, EDGE = rgb("#C9B3A6"), "#D62222"
HALF_VIEW = float(np.tan(np.radians(18)))
UP = np.array([0.0, 0.0, 1.0])
MOST_EDGES = 1500  # that are drawn, the nearest ones
LEAST_SHARE, ROOM = 0.12, 2.0  # of the mesh that is seen at least, and how much more than the edges near the place


def tell_picture(defect: MeshDefect) -> None:
    """Draws the place into a file that whoever reads the refusal can open, and says where that is."""
    with suppress(OSError):  # the sentence has been said, a picture that can't be written is no failure
        png = mesh_defect_png(defect)
        number, name = tempfile.mkstemp(prefix=f"ctrplan_{defect.file.stem[:40]}_", suffix=".png")
        with os.fdopen(number, "wb") as file:
            file.write(png)
        print(f"ctrplan: a picture of the place: {name}", file=sys.stderr)


def mesh_defect_png(defect: MeshDefect) -> bytes:
    """The picture, as PNG."""
    surface, edges = defect.surface, defect.surface.vertices_m[defect.edges]
    order = np.argsort(np.linalg.norm(edges.mean(axis=1) - defect.place_m, axis=1))[:MOST_EDGES]
    across = _seen_m(defect, edges[order])
    thick = 0.006 * across
    marks = [Body(_joined([capsule(a, b, thick, 6) for a, b in edges[order]]), rgb(EDGE))] if len(order) else []
    place = Body(capsule(defect.place_m, defect.place_m, 2.5 * thick, 24), rgb(EDGE), 0.5, 1.0)
    camera = _camera(defect, across)
    stage = Stage([Body(surface, TISSUE), *marks, place], camera, WIDTH, HEIGHT, SAMPLES, SKY)
    return _labelled(stage.with_moving([]), defect)


def _joined(surfaces: list[Surface]) -> Surface:
    """One of many, which is drawn much faster."""
    before = np.cumsum([0, *(len(surface.vertices_m) for surface in surfaces)])
    faces = [surface.faces + count for surface, count in zip(surfaces, before, strict=False)]
    return Surface(np.concatenate([surface.vertices_m for surface in surfaces]), np.concatenate(faces))


def _seen_m(defect: MeshDefect, edges: Array) -> float:
    """Half of what the picture shows of the mesh's size."""
    extent = float(np.linalg.norm(np.ptp(defect.surface.vertices_m, axis=0)))
    near = edges.reshape(-1, 3)[:400]
    reach = float(np.linalg.norm(near - defect.place_m, axis=1).max(initial=0.0))
    return min(max(ROOM * reach, LEAST_SHARE * extent), extent)


def _camera(defect: MeshDefect, across_m: float) -> Camera:
    """Along the mean normal of what is near the place; where there is none, from the mesh's middle outward."""
    vertices = defect.surface.vertices_m
    near = np.argsort(np.linalg.norm(vertices - defect.place_m, axis=1))[:200]
    outward = defect.place_m - vertices.mean(axis=0)
    normal = vertex_normals(defect.surface)[near].mean(axis=0)
    normal = normal if normal @ outward >= 0 else -normal  # winding says nothing in a mesh that is not closed
    toward = normal if np.linalg.norm(normal) > 0.2 else outward
    toward = toward / np.linalg.norm(toward) if np.any(toward) else UP
    apart = across_m / HALF_VIEW
    return look_at(defect.place_m + apart * toward, defect.place_m, UP, HALF_VIEW, near_m=0.05 * apart)


def _labelled(picture: Picture, defect: MeshDefect) -> bytes:
    image = Image.fromarray(picture)
    place = ", ".join(f"{x:.1f}" for x in defect.place_m * MM_PER_M)
    count = len(defect.edges)
    text = f"{defect.file.name}: ({place}) mm in the file's frame, {count} open edges"
    stream = io.BytesIO()
    write_caption(image, text)
    image.save(stream, "PNG")
    return stream.getvalue()
