"""Figures of one object each, by one call: a robot's tubes to scale, a shape, a bound, a plan; pages within notebooks.

`plot` makes a matplotlib figure of its own, without a screen, which a notebook shows and `savefig` writes. `show` makes
what turns and answers: a plan's scene by plotly, or the report of a diagnosis or study as a page within the notebook.
`robot.plot()`, `plan.show()` and so on call them.
"""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Tube
from ctrplan.reports import looks
from ctrplan.storage.output_folder import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.mechanics.shapes import Bound, Shape
    from ctrplan.plans.plan import Plan
    from ctrplan.robot.robot import Robot
    from ctrplan.studies.study.study import Study
    from ctrplan.studies.study.table import StudyTable

ARC_STEP_M = 0.5e-3  # between drawn points of a centreline: no more than a pixel off the arc
WIDE = 10.0  # inches of a picture in a notebook


def plot(subject: Robot | Bound | Shape | Plan, **keys: Any) -> Figure:
    """A picture of a robot, a bound, a shape or a plan. Raises InputError for anything else."""
    from ctrplan.mechanics.shapes import Bound, Shape
    from ctrplan.plans.plan import Plan
    from ctrplan.robot.robot import Robot

    if isinstance(subject, Robot):
        return robot_figure(subject, **keys)
    if isinstance(subject, Bound):
        return bound_figure(subject, **keys)
    if isinstance(subject, Shape):
        return shape_figure(subject, **keys)
    if isinstance(subject, Plan):
        from ctrplan.reports.plan_picture import plan_figure
        from ctrplan.reports.plan_scene import plan_scene

        return plan_figure(plan_scene(subject, **keys))
    raise InputError("must be a Robot, a Bound, a Shape or a Plan", key="subject", value=subject)


@dataclass(frozen=True)
class Page:
    """A page that loads nothing, within a notebook; `save` writes it as a file."""

    html: str
    height: int = 700  # pixels in the notebook

    def _repr_html_(self) -> str:
        """The page in a frame of its own, whose styles leave the notebook alone."""
        style = f"width:100%;height:{self.height}px;border:0"
        return f'<iframe srcdoc="{html.escape(self.html, quote=True)}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        """How large it is: a notebook shows it, `save` writes it."""
        return f"Page of {len(self.html) / 1e6:.2g} MB, shown by a notebook, written by save(path)"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page, whole or not at all. Raises CtrplanError where the system refuses."""
        write_atomically(path, self.html)


def _brief(figure: Any) -> Any:
    """The plotly figure, which a prompt shows in a line: by itself it prints all its numbers."""
    kind = type(figure)

    class Scene(kind):  # type: ignore[misc, valid-type]
        def __repr__(self) -> str:
            return f"Scene of {len(self.frames)} poses, shown by a notebook or show(), written by write_html(path)"

        def __reduce__(self) -> Any:
            return kind, super().__reduce__()[1]

    figure.__class__ = Scene
    return figure


def show(subject: Plan | Diagnosis | Study | StudyTable, **keys: Any) -> Any:
    """What turns and answers: a plan's moving scene (a plotly figure), a diagnosis's or a study's report (a `Page`).

    frames: of a plan, poses that are solved for the scene. table: of a study, what its tasks came to. Raises InputError
    for anything else.
    """
    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.plans.plan import Plan
    from ctrplan.studies.study.study import Study
    from ctrplan.studies.study.table import StudyTable

    if isinstance(subject, Plan):
        from ctrplan.reports.plan_motion import scene_figure
        from ctrplan.reports.plan_scene import plan_scene

        return _brief(scene_figure(plan_scene(subject, **keys)))
    if isinstance(subject, Diagnosis):
        from ctrplan.reports.diagnosis_figures import selection_errors
        from ctrplan.reports.diagnosis_page import diagnosis_report_html

        return Page(str(diagnosis_report_html(subject, selection_errors(subject))), **keys)
    if isinstance(subject, Study):
        from ctrplan.reports.study_page import study_report_html

        return Page(str(study_report_html(subject, keys.pop("table"))), **keys)
    if isinstance(subject, StudyTable):
        report = (subject.folder or Path()) / "report.html"
        if not report.is_file():
            rule = "has no report beside it: ask its study, study.show(table)"
            raise InputError(rule, key="table", value=str(subject.folder or ""))
        return Page(report.read_text(encoding="utf-8"), **keys)
    raise InputError("must be a Plan, a Diagnosis, a Study or a StudyTable", key="subject", value=subject)


def robot_figure(robot: Robot) -> Figure:
    """The tubes to scale as they are bent when nothing holds them, and how far the drive moves each of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_tubes(left, robot)
    _draw_travel(right, robot)
    figure.suptitle(robot.name, x=0.01, ha="left", fontsize=13)
    return figure


def _draw_tubes(ax: Axes, robot: Robot) -> None:
    """Each tube below the one around it, on its own plane of bending, with its true diameter."""
    from matplotlib.patches import Polygon

    longest, lowest = max(tube.length_m for tube in robot.tubes), 0.0
    for i, tube in enumerate(robot.tubes):
        line, normal = _bent_line(tube)
        half = tube.outer_diameter_m / 2
        outline = np.concatenate([line + half * normal, (line - half * normal)[::-1]]) * MM_PER_M
        outline[:, 1] += lowest - outline[:, 1].max() if i else 0.0
        ax.add_patch(Polygon(outline, facecolor=looks.tube_colour(i), edgecolor=looks.INK, linewidth=0.4))
        ax.annotate(_caption(tube, i), (outline[0, 0], outline[:, 1].max()), xytext=(0, 3), textcoords="offset points",
                    fontsize=8.5, color=looks.INK)  # fmt: skip
        lowest = float(outline[:, 1].min()) - 0.1 * longest * MM_PER_M - 4
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel("along the straight base (mm)")
    ax.set_title("tubes to scale, nothing holding them", loc="left", fontsize=10)
    ax.set_yticks([])
    ax.spines[["top", "right", "left"]].set_visible(False)


def _bent_line(tube: Tube) -> tuple[Array, Array]:
    """(N, 2) [m] of a tube's own centreline in the plane where each section bends by its magnitude, and normals."""
    angle, at, points, normals = 0.0, np.zeros(2), [np.zeros(2)], [np.array([0.0, 1.0])]
    for section in tube.sections:
        count = max(2, int(np.ceil(section.length_m / ARC_STEP_M)))
        step = section.length_m / count
        for _ in range(count):
            middle = angle - section.curvature_per_m * step / 2
            at = at + step * np.array([np.cos(middle), np.sin(middle)])
            angle -= section.curvature_per_m * step
            points.append(at)
            normals.append(np.array([-np.sin(angle), np.cos(angle)]))
    return np.array(points), np.array(normals)


def _caption(tube: Tube, i: int) -> str:
    bent = [section for section in tube.sections if section.curvature_per_m > 0]
    radius = f", bent by R = {1e3 / max(s.curvature_per_m for s in bent):.3g} mm" if bent else ", straight"
    sizes = f"{tube.outer_diameter_m * 1e3:.4g} x {tube.inner_diameter_m * 1e3:.4g} mm"
    return f"tube {i + 1}: {sizes}, {tube.length_m * 1e3:.4g} mm long{radius}"


def _draw_travel(ax: Axes, robot: Robot) -> None:
    """Where the tips of the tubes can be in front of the plate, and where they are at home."""
    low, high = robot.drive.travel_m
    tips = np.array([tube.length_m for tube in robot.tubes])
    home = robot.drive.home_l_m + tips
    for i in range(robot.n):
        begin, end = (low[i] + tips[i]) * MM_PER_M, (high[i] + tips[i]) * MM_PER_M
        ax.barh(i, max(end - begin, 0.4), left=begin, height=0.5, color=looks.tube_colour(i), alpha=0.75)
        ax.plot(home[i] * MM_PER_M, i, marker="|", markersize=16, color=looks.INK)
    ax.axvline(0, color=looks.PLATE, linewidth=6, zorder=0)
    ax.set_yticks(range(robot.n), [f"tip of tube {i + 1}" for i in range(robot.n)])
    ax.invert_yaxis()
    ax.set_xlabel("in front of the plate (mm); the stroke is home")
    ax.set_title("travel of the drive", loc="left", fontsize=10)
    ax.spines[["top", "right"]].set_visible(False)


def bound_figure(bound: Bound, title: str = "") -> Figure:
    """The frictionless shape in its envelope with the corner shapes, and the envelope along the robot."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE, 4.6), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    along = figure.add_subplot(1, 2, 2)
    for corner in bound.corners:
        _draw_line(space, corner, looks.CORNER, 0.8)
    draw_shape(space, bound.frictionless, bound.corners)
    s, width = bound.frictionless.s_m * MM_PER_M, bound.envelope_m * MM_PER_M
    ahead = s >= 0
    along.fill_between(s[ahead], 0, width[ahead], color=looks.ENVELOPE, alpha=0.35, linewidth=0)
    along.plot(s[ahead], width[ahead], color=looks.ENVELOPE)
    along.plot(s[-1], bound.position_m * MM_PER_M, "o", color=looks.BOUND)
    along.annotate(f"tip: {bound.position_m * MM_PER_M:.3g} mm", (s[-1], bound.position_m * MM_PER_M), xytext=(-6, 4),
                   textcoords="offset points", ha="right", color=looks.BOUND)  # fmt: skip
    along.set_xlabel("along the robot from the plate (mm)")
    along.set_ylabel("largest deviation by friction (mm)")
    along.set_ylim(bottom=0)
    along.spines[["top", "right"]].set_visible(False)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12)
    return figure


def shape_figure(shape: Shape) -> Figure:
    """A shape, its tubes in their colours."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE / 2, WIDE / 2), layout="constrained")
    draw_shape(figure.add_subplot(projection="3d"), shape)
    return figure


def draw_shape(ax: Any, shape: Shape, others: Sequence[Shape] = ()) -> None:
    """The part of a shape in front of the plate on axes in space, from where it spreads widest; room for others."""
    from matplotlib.ticker import MaxNLocator

    points = [tube.centreline_m[tube.s_m >= -1e-9] for tube in shape.tubes]
    for i, line in reversed(list(enumerate(points))):
        if len(line):
            ax.plot(*(line * MM_PER_M).T, color=looks.tube_colour(i), linewidth=2.0 + 1.6 * (len(points) - i))
    points += [other.centreline_m[other.s_m >= -1e-9] for other in others]
    every = np.concatenate([line for line in points if len(line)]) if any(map(len, points)) else np.zeros((1, 3))
    lower, upper = (corner * MM_PER_M for corner in looks.view_box(every, np.empty((0, 3))))
    sides = upper - lower
    for name, low, high, ticks in zip("xyz", lower, upper, looks.most_ticks(sides), strict=True):
        getattr(ax, f"set_{name}lim")(low, high)
        getattr(ax, f"set_{name}label")(f"{name} (mm)", fontsize=8)
        getattr(ax, f"{name}axis").set_major_locator(MaxNLocator(ticks))
    ax.tick_params(labelsize=8, pad=0)
    ax.set_box_aspect(sides)
    azimuth = looks.side_azimuth_rad(every) if len(every) > 3 else 0.6
    ax.view_init(elev=15, azim=float(np.degrees(azimuth)))


def _draw_line(ax: Any, shape: Shape, colour: str, width: float) -> None:
    line = shape.centreline_m[shape.s_m >= -1e-9] * MM_PER_M
    if len(line):
        ax.plot(*line.T, color=colour, linewidth=width, alpha=0.8)
