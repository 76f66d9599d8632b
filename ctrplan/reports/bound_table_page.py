"""report.html of a table of bounds: how much friction can do where, and how well the table knows it."""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go

from ctrplan.base.version import __version__
from ctrplan.mechanics.bound_lookup import FieldLookup
from ctrplan.motion.bound_table import Axis, BoundTable
from ctrplan.reports import looks
from ctrplan.reports.html_page import FONT, Markup, facts, page, plot, section, table, tag
from ctrplan.reports.words import glossary, millimetres, term

WORDS = ("worst-case friction error", "stability", "Coulomb friction")
MEANING = (
    "The worst-case friction error was solved on a grid over the joints that matter: turning all tubes together "
    "changes nothing. `ctrplan plan` looks it up while it searches, which is faster, and adds the margin to every "
    "value looked up. Certificates do not use the table, they solve the model itself."
)


def bound_table_report_html(found: BoundTable) -> str:
    """The content of report.html."""
    name = found.robot.name
    return page(
        f"Table of bounds of {name}",
        tag("p", f"Table of bounds of {name}", kind="kicker"),
        tag("h1", _headline(found)),
        _tiles(found),
        section("How large the worst-case error is", plot(bounds_figure(found), "bounds", with_library=True)),
        section("The grid", _axis_table(found)),
        section("What this means", tag("p", MEANING), glossary(*WORDS)),
        section("Where this comes from", _provenance(found)),
    )


def bounds_mm(found: BoundTable) -> np.ndarray:
    """(K,) worst-case errors of the configurations that have one."""
    entries = FieldLookup.entries(found.values.astype(np.float64))
    return np.asarray(entries.position_m[entries.valid > 0] * 1e3)


def bounds_figure(found: BoundTable) -> go.Figure:
    """Share of the configurations with at most some error."""
    ordered = np.sort(bounds_mm(found))
    share = 100 * np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
    kept = np.unique(np.linspace(0, max(len(ordered) - 1, 0), min(len(ordered), 500)).astype(int))
    line = {"color": looks.BOUND, "width": 2}
    figure = go.Figure(go.Scatter(x=ordered[kept], y=share[kept], mode="lines", line=line, showlegend=False))
    axis = {"gridcolor": looks.GRID, "zeroline": False}
    figure.update_xaxes(title_text="worst-case friction error (mm)", rangemode="tozero", **axis)
    figure.update_yaxes(title_text="configurations with at most it (%)", range=[0, 101], **axis)
    figure.update_layout(
        height=340, margin={"l": 60, "r": 20, "t": 20, "b": 50}, plot_bgcolor="white", paper_bgcolor="white",
        font={"family": FONT, "color": looks.INK, "size": 13},
    )  # fmt: skip
    return figure


def _headline(found: BoundTable) -> str:
    known = bounds_mm(found)
    if not len(known):
        return "No configuration of the grid has a bound"
    low, middle, high = np.quantile(known, [0.05, 0.5, 0.95])
    return f"Friction can move the tip by {low:.2f} to {high:.2f} mm in 9 of 10 configurations, {middle:.2f} mm in half"


def _tiles(found: BoundTable) -> Markup:
    margin, largest = (
        "none" if found.error.answers_nothing else millimetres(error)
        for error in (found.error.margin_m, found.error.largest_m)
    )
    shown = [
        (f"{len(found.values):,}", "configurations in the table"),
        (margin, "added to each value looked up, enough for 99 %"),
        (largest, "largest error of interpolation found"),
        (f"{100 * found.error.uncovered:.1f} %", term("stability", "without an answer, next to unstable ones")),
    ]
    return tag("div", *(tag("div", tag("b", v), tag("span", n), kind="tile") for v, n in shown), kind="tiles")


def _axis_table(found: BoundTable) -> Markup:
    return table(("Coordinate", "From", "To", "Step", "Points"), map(_axis_row, found.axes))


def _axis_row(axis: Axis) -> tuple[str, ...]:
    unit, si = ("°", math.pi / 180) if axis.rotation else (" mm", 1e-3)
    name = f"tube {axis.tube + 1} against tube {axis.tube}" if axis.rotation else f"translation of tube {axis.tube + 1}"
    ends = axis.lower, axis.lower + axis.step * (axis.count if axis.rotation else axis.count - 1), axis.step
    return name, *(f"{value / si:.1f}{unit}" for value in ends), str(axis.count)


def _provenance(found: BoundTable) -> Markup:
    robot = found.robot
    return facts(
        [
            ("Robot", f"{robot.name}, {robot.path or 'not from a file'}"),
            ("SHA-256 of the robot", tag("code", robot.sha256)),
            ("Key in the cache", tag("code", found.key)),
            ("ctrplan", __version__),
        ]
    )
