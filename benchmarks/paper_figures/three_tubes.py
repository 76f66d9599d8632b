"""Section IV-D: three tubes, Table III and Fig. 14."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import Bound, Shape, Status
from ctrplan.reports import looks
from paper_figures.drawing import label, prepare, save, table
from paper_figures.pairs import (
    ROBOTS,
    angle_deg,
    apart_mm,
)


class GridPoint(NamedTuple):
    degrees: tuple[float, float, float]  # of tube 2 against 1 and of 3 against 2; l_3b [mm]
    zero: Shape
    bound: Bound


@cache
def grid() -> tuple[GridPoint, ...]:
    """The 4 x 4 x 4 grid as tests/mechanics/test_reference.py reads it: the paper does not give it in full."""
    robot = load_robot(ROBOTS / "three_tube.toml")
    found = []
    for second, third, l_3 in itertools.product((0, 90, 180, 270), (0, 90, 180, 270), np.linspace(-120.4, -34, 4)):
        q = np.deg2rad([0, second, second + third]), 1e-3 * np.array([0, -17, l_3])
        found.append(GridPoint((second, third, l_3), robot.zero_clearance(*q), robot.bound(*q, accuracy="certificate")))
    return tuple(found)


def solved(shapes: Iterable[Shape]) -> Iterator[Shape]:
    return (shape for shape in shapes if shape.status is not Status.FAILED)


TABLE_3 = {  # the paper's row, and this grid by an exact-geometry solver
    "clearance": ("1.8 (±1.0)/4.2/2.7 (±1.2)/5.1", "1.68 (±1.02)/4.15/2.64 (±1.27)/5.06"),
    "friction": ("6.1 (±5.7)/23.8/10.7 (±9.8)/45.6", "5.89 (±5.72)/23.89/10.20 (±9.74)/45.57"),
}


def table_3() -> str:
    rows = []
    for name, (paper, exact_row) in TABLE_3.items():
        mine = "/".join(f"{x.mean():.2f} (±{x.std():.2f})/{x.max():.2f}" for x in grid_deviations(name == "friction"))
        for who, cells in (("paper", paper), ("this grid, exact geometry", exact_row), ("ours", mine)):
            rows.append((f"{name}, {who}", *cells.split("/")))
    head = ("", "mean position, mm", "largest position, mm", "mean tangent, deg", "largest tangent, deg")
    return table(head, rows)


def grid_deviations(friction: bool) -> tuple[Array, Array]:
    """Tips [mm] and tip tangents [deg] away from the zero-clearance model, corners pooled."""
    both = [(s, p.zero) for p in grid() for s in solved(p.bound.corners if friction else [p.bound.frictionless])]
    position = np.array([apart_mm(shape.tip_m, zero.tip_m) for shape, zero in both])
    return position, np.array([angle_deg(shape.tip_tangent, zero.tip_tangent) for shape, zero in both])


def fig_14() -> str:
    stable = [p for p in grid() if p.bound.frictionless.status is Status.CONVERGED]
    cases = (
        ("(a), largest without friction", max(stable, key=lambda p: off_mm(p, [p.bound.frictionless]))),
        ("(b), largest with friction", max(stable, key=lambda p: off_mm(p, p.bound.corners))),
    )
    fig = Figure(figsize=(9.6, 5.2), dpi=120, facecolor="white", layout="constrained")
    panels = [prepare(fig.add_subplot(1, 4, k + 1)) for k in range(4)]
    for ax, ((title, point), axis) in zip(panels, itertools.product(cases, (0, 1)), strict=True):
        draw_shapes(ax, point, axis)
        label(ax, f"Fig. 14{title}" if axis == 0 else "", f"{'xy'[axis]} (mm)", "z (mm)" if axis == 0 else "")
    handles, _ = panels[0].get_legend_handles_labels()
    fig.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False, fontsize=8.5)
    save(fig, "fig_14")
    rows = []
    for title, p in cases:
        corners = [f"{apart_mm(shape.tip_m, p.zero.tip_m):.1f}" for shape in p.bound.corners]
        first, second = (max(apart_mm(p.bound.corners[a].tip_m, p.bound.corners[b].tip_m) for a, b in flipped)
                         for flipped in (((0, 2), (1, 3)), ((0, 1), (2, 3))))  # fmt: skip
        where = "{:g}, {:g} deg, {:.1f} mm".format(*p.degrees)
        free = f"{apart_mm(p.bound.frictionless.tip_m, p.zero.tip_m):.2f}"
        rows.append((title, where, free, " / ".join(corners), f"{first:.1f}", f"{second:.1f}"))
    head = ("", "tube 2 - 1, tube 3 - 2, l_3b", "no friction, mm", "(+, +) / (+, -) / (-, +) / (-, -), mm",
            "sign of pair 1 moves the tip by, mm", "sign of pair 2, mm")  # fmt: skip
    return table(head, rows)


def off_mm(point: GridPoint, shapes: Iterable[Shape]) -> float:
    return max(apart_mm(shape.tip_m, point.zero.tip_m) for shape in solved(shapes))


SHAPES = (  # the sign of pair 1 by line style, of pair 2 by colour
    ("zero clearance", looks.INK, 1.6, "--"),
    ("clearance, no friction", looks.SERIES[2], 2, "-"),
    ("friction (+, +)", looks.SERIES[0], 2, "-"),
    ("(+, -)", looks.SERIES[1], 2, "-"),
    ("(-, +)", looks.SERIES[4], 2, ":"),
    ("(-, -)", looks.SERIES[5], 2, ":"),
)


def draw_shapes(ax: Axes, point: GridPoint, axis: int) -> None:
    """Projected on the x-z or y-z plane; circles are tips, arrows their tangents."""
    for shape, (name, colour, width, style) in zip(
        (point.zero, point.bound.frictionless, *point.bound.corners), SHAPES, strict=True
    ):
        line = 1e3 * shape.centreline_m[shape.s_m >= 0][:, [axis, 2]]
        ax.plot(*line.T, color=colour, linewidth=width, linestyle=style, label=name)
        ax.plot(*line[-1], "o", color=colour, markersize=4)
        end = line[-1] + 15 * shape.tip_tangent[[axis, 2]]
        ax.annotate("", end, line[-1], arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.2})
    ax.set(xlim=(-45, 65), ylim=(-5, 225), aspect="equal")
