"""What is a bound? Corner shapes of a three-tube robot and the tip farthest from the frictionless one, for README.md.

python benchmarks/run.py [--write] corner_shapes
"""

import itertools

import common
import numpy as np
from common import ROBOTS, prepare, save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from scipy.interpolate import CubicSpline

import ctrplan
from ctrplan import Bound, Shape
from ctrplan.base.arrays import Array
from ctrplan.reports import looks

ROBOT = ROBOTS / "three_tube.toml"
THETA_RAD = np.radians([0, 180, 180])  # of the collars: the outer tube's curve against those of the inner ones
L_M = np.array([0, -17, -60]) * 1e-3
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")  # of the corners
FROM_M = 0.125  # along the robot: before it the shapes lie on each other
SIDE_MM = 6  # beside the circle, for the signs of corners


def view(bound: Bound) -> Array:
    """(2, 3) axes of the plane in which the worst corner's tip is seen at its true distance, the others spread most."""
    tips = np.array([corner.tip_m for corner in bound.corners]) - bound.frictionless.tip_m
    across = tips[bound.worst_corner] / np.linalg.norm(tips[bound.worst_corner])
    rest = tips - np.outer(tips @ across, across)
    along = np.linalg.svd(rest)[2][0]
    return np.array([across, along if along[2] >= 0 else -along])


def draw_side(ax: Axes, bound: Bound) -> None:
    """Every shape from the middle to the tip, seen obliquely: upwards half bending, half what friction does."""
    across, bending = view(bound)[0], bound.frictionless.tip_m * [1, 1, 0]
    bending = bending - (bending @ across) * across
    axes = np.array([[0, 0, 1], across + bending / np.linalg.norm(bending)]) / [[1], [np.sqrt(2)]]
    for shape, colour, width in styles(bound):
        seen = smooth(shape) @ axes.T * 1e3
        ax.plot(*seen.T, color=colour, linewidth=width, solid_capstyle="round")
        ax.plot(*seen[-1], "o", color=colour, markersize=6)
        label = "no friction" if shape is bound.frictionless else "corner"
        ax.annotate(label, seen[-1], (9, 0), textcoords="offset points", va="center", fontsize=10, color=colour)
    left = smooth(bound.frictionless)[0] @ axes.T * 1e3
    ax.annotate(f"front plate {FROM_M * 1e3:.0f} mm to the left", left, (2, 12), textcoords="offset points", fontsize=9,
                color=looks.MUTED)  # fmt: skip
    ax.annotate("four corners: friction of both\npairs of tubes at its limit", (0.03, 0.95), xycoords="axes fraction",
                va="top", fontsize=10, color=looks.INK)  # fmt: skip
    ax.margins(x=0.02, y=0.15)
    ax.set_xlim(right=ax.get_xlim()[1] + 15)
    ax.set_aspect("equal")
    ax.set_xlabel("mm along insertion", fontsize=9.5)
    ax.set_ylabel("mm, seen obliquely", fontsize=9.5)
    ax.set_title("The same joint values, five equilibria", loc="left", fontsize=11.5, color=looks.INK)


def smooth(shape: Shape) -> Array:
    """(200, 3) [m] the centreline from FROM_M to the tip."""
    return CubicSpline(shape.s_m, shape.centreline_m)(np.linspace(FROM_M, shape.s_m[-1], 200))


def draw_tips(ax: Axes, bound: Bound) -> None:
    """The tips, with a circle of the bound's radius around the frictionless one."""
    axes, centre, radius = view(bound), bound.frictionless.tip_m, bound.position_m * 1e3
    ax.add_patch(Circle((0, 0), radius, facecolor="#FBEFEA", edgecolor=looks.BOUND, linewidth=1.2, linestyle="--"))
    for (shape, colour, _), pair in itertools.zip_longest(
        styles(bound), itertools.product("+\N{MINUS SIGN}", repeat=2)
    ):
        tip = (shape.tip_m - centre) @ axes.T * 1e3
        ax.plot(*tip, "o", color=colour, markersize=8, zorder=4)
        if pair is None:
            text, offset, side = "frictionless", (-7, 11), "right"
        elif abs(tip[0]) > 0.8 * radius:
            text, offset, side = f"({pair[0]}, {pair[1]})", (np.sign(tip[0]) * 9, 0), "left" if tip[0] > 0 else "right"
        else:
            text, offset, side = f"({pair[0]}, {pair[1]})", (0, -16), "center"
        ax.annotate(text, tip, offset, textcoords="offset points", fontsize=10.5, ha=side, va="center", color=colour)
    worst = (bound.corners[bound.worst_corner].tip_m - centre) @ axes.T * 1e3
    arrow = {"arrowstyle": "<|-|>", "color": looks.BOUND, "lw": 1.8, "shrinkA": 5, "shrinkB": 5}
    ax.annotate("", worst, (0, 0), arrowprops=arrow)
    ax.annotate(f"bound {radius:.1f} mm", worst / 2, (0, 9), textcoords="offset points", ha="center", fontsize=10.5,
                color=looks.BOUND, fontweight="bold")  # fmt: skip
    ax.set(xlim=(-radius - SIDE_MM, radius + SIDE_MM), ylim=(-radius - 1, radius + 1))
    ax.set_aspect("equal")
    ax.set_xlabel("mm", fontsize=9.5)
    ax.set_title("Their tips: the farthest one is the bound", loc="left", fontsize=11.5, color=looks.INK)


def styles(bound: Bound) -> list[tuple[Shape, str, float]]:
    """Shapes with colours and widths of their lines; the frictionless one last, on top."""
    corners = [(corner, colour, 2.2) for corner, colour in zip(bound.corners, COLOURS, strict=True)]
    return [*corners, (bound.frictionless, looks.INK, 2.6)]


def main() -> None:
    common.arguments(__doc__)
    bound = ctrplan.load_robot(ROBOT).bound(THETA_RAD, L_M, accuracy="certificate")
    figure = Figure(figsize=(10.4, 4.2), dpi=130, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.35, 1])
    draw_side(prepare(left), bound)
    draw_tips(prepare(right), bound)
    save(figure, "corner_shapes")
    print(f"bound {bound.position_m * 1e3:.1f} mm")
