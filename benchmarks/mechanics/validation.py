"""Does the model reproduce the paper's numerical experiments? Figures and tables of docs/validation.md.

    python benchmarks/run.py --write validation        # figures go to docs/images/validation

Figure and table numbers are those of Ha, Fagogenis, Dupont, IEEE T-RO 35(2), 2019. Hollow markers in the figures and
"exact" in the tables are values of an independent exact-geometry solver (tests/reference/pair_values.json).
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import common
import numpy as np
import paper_pairs as paper
from common import ROBOTS, distance_mm, prepare, table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import CubicHermiteSpline

from ctrplan import Bound, Shape, Status, load_robot
from ctrplan.base.arrays import Array
from ctrplan.reports import looks

Rows = tuple[str | Sequence[str], Sequence[Sequence[object]]]  # of a table, after its columns


class GridPoint(NamedTuple):
    degrees: tuple[float, float, float]  # of tube 2 against 1 and of 3 against 2; l_3b [mm]
    zero: Shape
    bound: Bound


@cache
def grid() -> tuple[GridPoint, ...]:
    """Solved at the joints of Table III."""
    robot = load_robot(ROBOTS / "three_tube.toml")
    of = ((at, robot.zero_clearance(*q), robot.bound(*q, accuracy="certificate")) for at, q in paper.table_3_joints())
    return tuple(GridPoint(*point) for point in of)


def solved(shapes: Iterable[Shape]) -> Iterator[Shape]:
    return (shape for shape in shapes if shape.status is not Status.FAILED)


TABLE_3 = {  # the paper's row, and this grid by an exact-geometry solver
    "clearance": ("1.8 (±1.0)/4.2/2.7 (±1.2)/5.1", "1.68 (±1.02)/4.15/2.64 (±1.27)/5.06"),
    "friction": ("6.1 (±5.7)/23.8/10.7 (±9.8)/45.6", "5.89 (±5.72)/23.89/10.20 (±9.74)/45.57"),
}


def table_3() -> Rows:
    rows = []
    for name, (theirs, exact_row) in TABLE_3.items():
        mine = "/".join(f"{x.mean():.2f} (±{x.std():.2f})/{x.max():.2f}" for x in grid_deviations(name == "friction"))
        for who, cells in (("paper", theirs), ("this grid, exact geometry", exact_row), ("ours", mine)):
            rows.append((f"{name}, {who}", *cells.split("/")))
    return " | mean position, mm | largest position, mm | mean tangent, deg | largest tangent, deg", rows


def grid_deviations(friction: bool) -> tuple[Array, Array]:
    """Tips [mm] and tip tangents [deg] away from the zero-clearance model, corners pooled."""
    both = [(s, p.zero) for p in grid() for s in solved(p.bound.corners if friction else [p.bound.frictionless])]
    position = np.array([distance_mm(shape.tip_m, zero.tip_m) for shape, zero in both])
    return position, np.array([paper.angle_deg(shape.tip_tangent, zero.tip_tangent) for shape, zero in both])


def fig_14() -> Rows:
    stable = [p for p in grid() if p.bound.frictionless.status is Status.CONVERGED]
    cases = (
        ("(a), largest without friction", max(stable, key=lambda p: off_mm(p, [p.bound.frictionless]))),
        ("(b), largest with friction", max(stable, key=lambda p: off_mm(p, p.bound.corners))),
    )
    fig = Figure(figsize=(9.6, 5.2), dpi=120, facecolor="white", layout="constrained")
    panels = [prepare(fig.add_subplot(1, 4, k + 1)) for k in range(4)]
    for ax, ((title, point), axis) in zip(panels, itertools.product(cases, (0, 1)), strict=True):
        draw_shapes(ax, point, axis)
        paper.label(ax, f"Fig. 14{title}" if axis == 0 else "", f"{'xy'[axis]} (mm)", "z (mm)" if axis == 0 else "")
    handles, _ = panels[0].get_legend_handles_labels()
    fig.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False, fontsize=8.5)
    paper.save(fig, "fig_14")
    rows = []
    for title, p in cases:
        corners = [f"{distance_mm(shape.tip_m, p.zero.tip_m):.1f}" for shape in p.bound.corners]
        first, second = (max(distance_mm(p.bound.corners[a].tip_m, p.bound.corners[b].tip_m) for a, b in flipped)
                         for flipped in (((0, 2), (1, 3)), ((0, 1), (2, 3))))  # fmt: skip
        where = "{:g}, {:g} deg, {:.1f} mm".format(*p.degrees)
        free = f"{distance_mm(p.bound.frictionless.tip_m, p.zero.tip_m):.2f}"
        rows.append((title, where, free, " / ".join(corners), f"{first:.1f}", f"{second:.1f}"))
    head = " | tube 2 - 1, tube 3 - 2, l_3b | no friction, mm | (+, +) / (+, -) / (-, +) / (-, -), mm"
    return f"{head} | sign of pair 1 moves the tip by, mm | sign of pair 2, mm", rows


def off_mm(point: GridPoint, shapes: Iterable[Shape]) -> float:
    return max(distance_mm(shape.tip_m, point.zero.tip_m) for shape in solved(shapes))


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


def fig_4_5() -> None:
    fig, axes = paper.figure(2)
    for clearance, colour in zip(paper.CLEARANCES_MM, paper.COLOURS, strict=False):
        known = paper.exact("deviation_from_zero_clearance", clearance_m=1e-3 * clearance)
        for ax, angles in zip(axes, (np.arange(0, 180.1, 5), np.arange(0, 20.1, 0.5)), strict=True):
            ax.plot(angles, [deviation_mm(clearance, a) for a in angles], color=colour, label=f"{clearance:g} mm")
            shown = [row for row in known if row["base_angle_deg"] <= angles[-1]]
            paper.points(ax, [r["base_angle_deg"] for r in shown], [1e3 * r["deviation_m"] for r in shown], colour)
    paper.label(axes[0], "Fig. 4", "base angle (deg)", "tip difference (mm)")
    paper.label(axes[1], "Fig. 5, small angles", "base angle (deg)", "tip difference (mm)")
    axes[0].set(xticks=range(0, 181, 30), ylim=(0, 7))
    axes[1].set(xticks=range(0, 21, 5), ylim=(0, 1.8))
    paper.legend(axes[0], "clearance", checked=True)
    paper.save(fig, "fig_4_5")


def deviation_mm(clearance_mm: float, angle: float) -> float:
    zero = paper.pair(clearance_mm).zero_clearance(*paper.joints(angle))
    return distance_mm(paper.turned(clearance_mm, angle).tip_m, zero.tip_m)


def fig_6_7() -> Rows:
    fig, axes = paper.figure(2)
    straight = (0, 0, paper.OUTER_LENGTH_M)
    smooth = np.geomspace(0.01, 3, 40)
    for mu, colour in zip(paper.FRICTIONS, paper.COLOURS, strict=False):
        axes[0].plot(
            smooth, [distance_mm(paper.opposed(c, mu).tip_m, straight) for c in smooth], color=colour, label=f"{mu:g}"
        )
        known = paper.exact("friction_at_180_deg", mu=mu)
        paper.points(axes[0], [1e3 * r["clearance_m"] for r in known], [1e3 * r["deviation_m"] for r in known], colour)
    axes[0].set(
        xscale="log", ylim=(0, None), xticks=paper.CLEARANCES_MM, xticklabels=[f"{c:g}" for c in paper.CLEARANCES_MM]
    )
    axes[0].minorticks_off()
    paper.label(axes[0], "Fig. 6, base angle 180 deg", "clearance (mm)", "tip difference (mm)")
    paper.legend(axes[0], "friction coefficient", checked=True)
    shares = np.linspace(-0.5, 0.5, 41)
    for clearance, colour in zip(paper.CLEARANCES_MM, paper.COLOURS, strict=False):
        tips = np.array([1e3 * paper.opposed(clearance, abs(m), phi=np.sign(m)).tip_m for m in shares])
        axes[1].plot(tips[:, 1], tips[:, 0], color=colour, label=f"{clearance:g} mm")
        known = paper.exact("friction_at_180_deg", clearance_m=1e-3 * clearance)
        paper.points(axes[1], [1e3 * r["tip_m"][1] for r in known], [1e3 * r["tip_m"][0] for r in known], colour)
    paper.label(axes[1], "Fig. 7, friction coefficient 0 to 0.5 either way", "tip y (mm)", "tip x (mm)")
    axes[1].plot(0, 0, "+", color=looks.INK, markersize=9)
    axes[1].annotate("zero clearance", (0, 0), (6, -1), textcoords="offset points", fontsize=8.5, color=looks.INK)
    axes[1].set_ylim(-0.4, 7.6)
    paper.legend(axes[1], "clearance", ncols=3, loc="upper center", checked=True)
    paper.save(fig, "fig_6_7")
    rows = [(f"{c:g} mm", *(_beside(c, mu) for mu in paper.FRICTIONS), _share(c)) for c in paper.CLEARANCES_MM]
    return (("clearance", *(f"mu = {mu:g}" for mu in paper.FRICTIONS), "tip error, % of the difference"), rows)


def _beside(clearance: float, mu: float) -> str:
    (known,) = paper.exact("friction_at_180_deg", clearance_m=1e-3 * clearance, mu=mu)
    return f"{distance_mm(paper.opposed(clearance, mu).tip_m, (0, 0, 0.15)):.2f} ({1e3 * known['deviation_m']:.2f})"


def _share(clearance: float) -> str:
    known = paper.exact("friction_at_180_deg", clearance_m=1e-3 * clearance)
    errors = [
        distance_mm(paper.opposed(clearance, row["mu"]).tip_m, row["tip_m"]) / row["deviation_m"] for row in known
    ]
    return f"{0.1 * max(errors):.1f}"


def fig_8() -> Rows:
    fig, axes = paper.figure(2, 3.0)
    rows = []
    for ax, length, title in zip(axes, (paper.SMALL_MM, paper.TRANSMISSION_MM), ("(a) no", "(b) 17 mm"), strict=True):
        shape = paper.opposed(3, 0, length)
        for tube, colour, name in zip(shape.tubes, (looks.START, looks.INK), ("outer", "inner"), strict=True):
            curve = CubicHermiteSpline(tube.s_m, tube.centreline_m, tube.frames[:, :, 2])
            x, _, z = 1e3 * curve(np.linspace(tube.s_m[0], tube.s_m[-1], 400)).T
            ax.plot(z, x, color=colour, linewidth=2, label=name)
        outer, inner = (1e3 * tube.centreline_m[-1, 0] for tube in shape.tubes)
        paper.label(ax, f"Fig. 8{title} transmission, clearance 3 mm", "z (mm)", "x (mm)")
        ax.axhline(0, color=looks.MUTED, linewidth=0.8)
        rows.append((f"{round(length):d} mm", f"{outer:.2f} mm", f"{inner:.2f} mm", f"{abs(outer + inner) / 2:.2f} mm"))
    for ax in axes:
        ax.set(ylim=(-3.4, 9), xlim=(-20, 155))
    paper.legend(axes[0], "tube", loc="upper left")
    paper.save(fig, "fig_8")
    return (("transmission", "outer tip x", "inner tip x", "mean"), rows)


def fig_9() -> Rows:
    fig, (ax,) = paper.figure(1)
    lengths = np.concatenate([[paper.SMALL_MM], np.arange(0.5, 20, 0.5), np.arange(20, 260.1, 5)])
    rows = []
    for clearance, colour in zip(paper.CLEARANCES_MM, paper.COLOURS, strict=False):
        shapes = [paper.opposed(clearance, 0, length) for length in lengths]
        stable = [shape.status is Status.CONVERGED for shape in shapes]
        count = stable.index(False) if False in stable else len(stable)
        far = [distance_mm(shape.tip_m, (0, 0, paper.OUTER_LENGTH_M)) for shape in shapes[:count]]
        ax.plot(lengths[:count], far, color=colour, label=f"{clearance:g} mm")
        known = paper.exact("transmission_at_180_deg", clearance_m=1e-3 * clearance)
        paper.points(ax, [1e3 * r["transmission_m"] for r in known], [1e3 * r["deviation_m"] for r in known], colour)
        rows.append((f"{clearance:g} mm", f"{lengths[count - 1]:g} mm"))
    limit = zero_clearance_limit_mm()
    ax.axvline(limit, color=looks.LIMIT, linestyle="--", linewidth=1.1)
    ax.annotate("zero-clearance pair\nunstable beyond", (limit, 11.8), (6, 0), textcoords="offset points",
                fontsize=8.5, color=looks.LIMIT)  # fmt: skip
    paper.label(ax, "Fig. 9, base angle 180 deg", "transmission length (mm)", "tip difference (mm)")
    ax.set(ylim=(0, 13.5), xlim=(-5, 230))
    paper.legend(ax, "clearance", checked=True)
    paper.save(fig, "fig_9")
    return "clearance | stable up to", [*rows, ("none", f"{limit:.0f} mm")]


def zero_clearance_limit_mm() -> float:
    """Longest transmission at which the zero-clearance pair is stable at 180 deg."""
    low, high = paper.TRANSMISSION_MM, 1000.0
    while high - low > 0.1:
        middle = (low + high) / 2
        shape = paper.pair(0.05, 0.0, middle).zero_clearance(*paper.joints(180, middle))
        low, high = (middle, high) if shape.status is Status.CONVERGED else (low, middle)
    return low


def stems(ax: Axes, found: Sequence[paper.Region], colour: str, name: str, mu: float = 0.0) -> None:
    """A stem per contact region at its centroid, as high as normal force and friction together."""
    for k, r in enumerate(found):
        at, force = 1e3 * r.s_m, float(np.hypot(1, mu)) * r.force_N
        ax.plot([at, at], [0, force], color=colour, linewidth=1.4)
        ax.plot(at, force, "o", color=colour, markersize=5, label=name if k == 0 else None)


def fig_10_13() -> Rows:
    fig, axes = paper.figure(2)
    for clearance, colour in zip(paper.CLEARANCES_MM, paper.COLOURS, strict=False):
        stems(
            axes[0], [r for r in paper.regions(paper.opposed(clearance)) if r.s_m > 0.08], colour, f"{clearance:g} mm"
        )
    axes[0].set(yscale="log", ylim=(4, 200), yticks=(5, 10, 20, 50, 100), yticklabels=("5", "10", "20", "50", "100"))
    axes[0].minorticks_off()
    paper.label(axes[0], "Fig. 10, base angle 180 deg, no friction", "arc length (mm)", "force of a contact region (N)")
    paper.legend(axes[0], "clearance", loc="upper left")
    for k, mu in enumerate((0.0, 0.2, 0.5)):
        found = [r for r in paper.regions(paper.opposed(0.05, mu)) if r.s_m > 0.1]
        stems(axes[1], found, paper.COLOURS[k], f"{mu:g}", mu)
    axes[1].set(ylim=(44, 52), xlim=(141, 151))
    paper.label(axes[1], "Fig. 13, clearance 0.05 mm", "arc length (mm)", "force, normal and friction (N)")
    paper.legend(axes[1], "friction coefficient", loc="upper center")
    paper.save(fig, "fig_10_13")
    rows = []
    for clearance in paper.CLEARANCES_MM:
        (known,) = paper.exact("couple_at_180_deg", clearance_m=1e-3 * clearance, transmission_m=0.017)
        mine = paper.couple(paper.opposed(clearance))
        given = known["tip_force_N"], known["arm_m"], known["couple_Nm"]
        force, arm, moment = zip(mine, given, strict=True)
        cells = ("{:.1f} ({:.1f})".format(*force), "{:.1f} ({:.1f})".format(*np.multiply(1e3, arm)))
        rows.append((f"{clearance:g} mm", *cells, "{:.3f} ({:.3f})".format(*moment)))
    return (("clearance", "tip force, N", "arm, mm", "couple, N m"), rows)


def fig_13() -> Rows:
    rows = []
    for mu in paper.FRICTIONS:
        shape = paper.opposed(0.05, mu)
        middle, tip = paper.regions(shape)[-2:]
        twist = shape.tubes[1].theta_rad[-1] - shape.tubes[0].theta_rad[-1]
        forces = [f"{np.hypot(1, mu) * r.force_N:.1f} ({r.force_N:.1f})" for r in (tip, middle)]
        rows.append((f"{mu:g}", *forces, f"{np.rad2deg(twist):.1f}"))
    return "mu | at the tip, N, with friction (normal alone) | opposite, N | relative angle at the tips, deg", rows


def fig_11_12() -> None:
    fig, axes = paper.figure(2)
    angles = (30, 60, 90, 120, 150, 180)
    for angle in (60, 120, 180):
        colour = paper.COLOURS[angles.index(angle)]
        shape = paper.turned(0.05, angle)
        half = np.deg2rad(angle) / 2  # the plane a balanced pair bends in
        along, across = 1e3 * shape.centreline_m[:, 2], 1e3 * shape.centreline_m[:, :2] @ [np.cos(half), np.sin(half)]
        axes[0].plot(along, across, color=colour, linewidth=1.8, label=f"{angle} deg")
        for r in paper.regions(shape):
            at = [np.interp(r.s_m, shape.s_m, values) for values in (along, across)]
            axes[0].plot(*at, "o", markersize=0.45 * r.force_N, color=looks.SERIES[2], alpha=0.55, markeredgewidth=0)
    axes[0].set_xlim(-22, 165)
    axes[0].set_aspect("equal", adjustable="datalim")
    paper.label(axes[0], "Fig. 11, diameter in proportion to the force", "z (mm)", "in the bending plane (mm)")
    paper.legend(axes[0], "base angle", loc="upper left")
    for angle, colour in zip(angles, paper.COLOURS, strict=False):
        stems(axes[1], paper.regions(paper.turned(0.05, angle)), colour, f"{angle} deg")
    axes[1].set(ylim=(0, 55), xlim=(-3, 156))
    paper.label(axes[1], "Fig. 12, clearance 0.05 mm, no friction", "arc length (mm)", "force of a contact region (N)")
    paper.legend(axes[1], "base angle", loc="upper center")
    paper.save(fig, "fig_11_12")


def fig_17() -> Rows:
    robot = load_robot(ROBOTS / "table_4_pair.toml")
    narrow = load_robot(ROBOTS / "table_4_pair.toml", ["contact.1.clearance_mm=0.8125"])
    clearance_mm = 1e3 * float(robot.clearance_m[0])
    fig, axes = paper.figure(2, 4.0)
    rows = []
    for angle, colour in zip(range(0, 181, 30), paper.COLOURS, strict=True):
        shape = robot.solve(*paper.joints(angle), accuracy="certificate")
        found = paper.regions(shape)
        draw_contact(axes, shape, found, colour, clearance_mm, angle)
        half = paper.regions(narrow.solve(*paper.joints(angle), accuracy="certificate"))
        cells = [f"{1e3 * r.s_m:.1f} mm, {round(_on_tube_deg(shape, r))} deg" for r in found]
        rows.append((f"{angle} deg", *cells, *(f"{1e3 * (f[-1].s_m - f[-2].s_m):.1f} mm" for f in (found, half))))
    axes[0].axhline(clearance_mm, color=looks.MUTED, linestyle="--", linewidth=1.1)
    axes[0].annotate("clearance", (0, clearance_mm), (0, 4), textcoords="offset points", fontsize=8.5)
    paper.label(axes[0], "Fig. 17(a)", "arc length (mm)", "distance of the wire from the wall (mm)")
    paper.label(axes[1], "Fig. 17(b)", "arc length (mm)", "where the wire leans, on the clear tube (deg)")
    axes[0].set(ylim=(-0.3, 1.8), yticks=np.arange(0, 1.7, 0.25))
    axes[1].set(ylim=(-190, 190), yticks=range(-180, 181, 60))
    paper.legend(axes[1], "relative angle", loc="upper left", ncols=3, bbox_to_anchor=(0, 0.93))
    paper.save(fig, "fig_17")
    return "relative angle | proximal contact | middle contact | tip contact | distal arm | arm at 0.8125 mm", rows


def draw_contact(
    axes: Sequence[Axes], shape: Shape, found: Sequence[paper.Region], colour: str, clearance_mm: float, angle: int
) -> None:
    s, offset = paper.offset_m(shape)
    s, offset = s[s >= 0], offset[s >= 0]
    gap = clearance_mm - 1e3 * np.abs(offset)
    lean = _wrapped_deg(np.angle(offset) - np.interp(s, shape.tubes[0].s_m, shape.tubes[0].theta_rad))
    axes[0].plot(1e3 * s, np.maximum(gap, 0), color=colour, linewidth=1.5)
    lean[np.abs(np.diff(lean, append=lean[-1])) > 90] = np.nan
    axes[1].plot(1e3 * s, lean, color=colour, linewidth=1.3, label=f"{angle} deg")
    for r in found:
        row = -0.05 - 0.035 * (angle / 30)
        axes[0].plot(
            [1e3 * r.begin_m - 0.5, 1e3 * r.end_m + 0.5], [row, row], color=colour, lw=2.4, solid_capstyle="butt"
        )
        axes[1].plot(1e3 * r.s_m, _on_tube_deg(shape, r), "o", color=colour, markersize=6)


def _on_tube_deg(shape: Shape, region: paper.Region) -> float:
    outer = shape.tubes[0]
    return float(_wrapped_deg(region.angle_rad - np.interp(region.s_m, outer.s_m, outer.theta_rad)))


def _wrapped_deg(angle_rad: Any) -> Array:
    """In [-175, 185): contacts at 180 deg stay on one side."""
    wrapped: Array = (np.rad2deg(angle_rad) + 175) % 360 - 175
    return wrapped


MADE = (fig_4_5, fig_6_7, fig_8, fig_9, fig_10_13, fig_11_12, fig_13, table_3, fig_14, fig_17)
KNOWN: dict[str, Callable[[], Rows | None]] = {work.__name__: work for work in MADE}


def main() -> None:
    for name in common.arguments(__doc__, ("names*", KNOWN)).names or KNOWN:
        if (rows := KNOWN[name]()) is not None:  # none of a figure whose values no document tells
            table(name, *rows)
