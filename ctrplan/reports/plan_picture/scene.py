"""The 3-D view of plan.png: anatomy, the robot at start and goal, what friction can make of it, and the tip's path."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import patheffects
from matplotlib.colors import LightSource
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ctrplan.anatomy.patient_frame import Frame, axis_label
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.reports import palette
from ctrplan.reports import scene_looks as looks
from ctrplan.reports.framing import side_azimuth_rad, view_box
from ctrplan.reports.plan_scene import goal_tip, tip_path
from ctrplan.reports.plan_words.numbers import millimetres
from ctrplan.reports.pose import Pose, stand
from ctrplan.reports.surface import anatomy_surface
from ctrplan.reports.tube_ends import end_ring

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from ctrplan.reports.narrowest_pose import NarrowestPose
    from ctrplan.reports.plan_scene import PlanScene

TRIANGLES = 6000  # per part of the anatomy: all are sorted and drawn in Python
THINNEST_PT = 1.3
ELEVATION_DEG = 18


def draw_scene(ax: Axes3D, scene: PlanScene) -> None:
    """Draw the plan into 3-D axes made with computed_zorder=False: the robot shows through the anatomy."""
    plan, start, goal = scene.plan, scene.start, scene.goal
    anatomy = [(anatomy_surface(part, TRIANGLES), looks.ANATOMY[part.role].colour) for part in plan.scenario.anatomy]
    path_mm, goal_mm = tip_path(plan) * 1e3, goal_tip(plan) * 1e3
    points = np.concatenate([*(_points(p) for p in (start, goal)), path_mm * 1e-3, goal_mm[None] * 1e-3])
    solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface, _ in anatomy)])
    _frame(ax, points, solid, plan.scenario.frame)
    for surface, colour in anatomy:
        _draw_surface(ax, surface, colour, 0.22, 1)
    _draw_surface(ax, stand(plan.scenario), looks.PLATE.colour, 0.9, 1)
    _draw_robot(ax, start, 2, [looks.START.colour] * len(start.tubes))
    _draw_surface(ax, goal.envelope.surface(14), looks.ENVELOPE.colour, 0.16, 3)
    for corner in goal.corners_m * 1e3:
        ax.plot(*corner.T, color=looks.CORNERS.colour, linewidth=0.8, zorder=4)
    _draw_robot(ax, goal, 5, [looks.tube_look(tube).colour for tube in range(len(goal.tubes))])
    ax.plot(*path_mm.T, color=looks.TIP_PATH.colour, linewidth=1.4, zorder=7)
    ax.plot(*goal_mm[:, None], marker="X", markersize=10, color=looks.GOAL.colour, markeredgecolor="white", zorder=8)
    if scene.narrowest:
        _draw_narrowest(ax, scene.narrowest)
    _legend(ax, scene)


def _points(pose: Pose) -> Array:
    return np.concatenate([pose.envelope.surface(8).vertices_m, *(rod.centreline_m for rod in pose.tubes)])


def _frame(ax: Axes3D, points_m: Array, anatomy_m: Array, frame: Frame | None) -> None:
    """Equal scales, seen from where the robot spreads widest; letters of the patient's frame at the axes."""
    lower, upper = (corner * 1e3 for corner in view_box(points_m, anatomy_m))
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    ax.set_box_aspect(tuple(upper - lower), zoom=1.04)
    ax.set_proj_type("ortho")
    ax.view_init(elev=ELEVATION_DEG, azim=float(np.degrees(side_azimuth_rad(points_m))))
    for k, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))
        axis.set_tick_params(labelsize=9, colors=palette.MUTED)
        axis.set_label_text(f"{axis_label(k, frame)} (mm)")
    ax.locator_params(nbins=6)


def _draw_surface(ax: Axes3D, surface: Surface, colour: str, alpha: float, zorder: int) -> None:
    triangles = surface.vertices_m[surface.faces] * 1e3
    light = LightSource(azdeg=225, altdeg=35)
    ax.add_collection3d(
        Poly3DCollection(
            triangles, facecolors=colour, shade=True, lightsource=light, alpha=alpha, linewidths=0, zorder=zorder
        )
    )


def _draw_robot(ax: Axes3D, pose: Pose, zorder: int, colours: list[str]) -> None:
    """Tubes as lines of their own width, inner ones first: what an outer tube covers is not seen."""
    scale = _points_per_mm(ax)
    for tube in reversed(range(len(pose.tubes))):
        rod = pose.tubes[tube]
        width = max(2e3 * float(rod.radius_m.max()) * scale, THINNEST_PT + 0.8 * (len(pose.tubes) - 1 - tube))
        x, y, z = rod.centreline_m.T * 1e3
        ax.plot(x, y, z, color=colours[tube], linewidth=width, solid_capstyle="butt", zorder=zorder + 0.1)
    for tube in range(len(pose.tubes)):
        ring = end_ring(pose, tube)
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


def _legend(ax: Axes3D, scene: PlanScene) -> None:
    plan = scene.plan
    tubes = map(looks.tube_look, range(plan.scenario.robot.n))
    entries: list[tuple[Line2D | Patch, str]] = [
        (Line2D([], [], color=tube.colour, linewidth=4), f"{tube.name} at the goal") for tube in tubes
    ]
    entries += [
        (Patch(facecolor=looks.ENVELOPE.colour, alpha=0.35), looks.ENVELOPE.name),
        (Line2D([], [], color=looks.CORNERS.colour, linewidth=0.9), looks.CORNERS.name),
        (Line2D([], [], color=looks.START.colour, linewidth=4), looks.START.name),
        (Line2D([], [], color=looks.TIP_PATH.colour, linewidth=1.6), looks.TIP_PATH.name),
        (Line2D([], [], color=looks.GOAL.colour, marker="X", markersize=9, linestyle=""), looks.GOAL.name),
    ]
    if scene.narrowest:
        entries.append((Line2D([], [], color=looks.NARROWEST.colour, marker="o", markersize=4), looks.NARROWEST.name))
    entries += [(Patch(facecolor=look.colour, alpha=0.6), look.name) for look in looks.anatomy_looks(plan.scenario)]
    handles, labels = zip(*entries, strict=True)
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.1, 1.02), "ncols": 4}
    ax.legend(handles, labels, frameon=False, fontsize=10, columnspacing=1.4, **place)
