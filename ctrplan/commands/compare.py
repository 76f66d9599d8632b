"""`ctrplan compare`: two plans side by side, their figures in a table and their course as curves."""

from __future__ import annotations

import argparse
import io
import json
import math
import sys
from typing import TYPE_CHECKING, Any

from ctrplan.commands.options import add_allow_outside_option
from ctrplan.commands.terminal import aligned, finite
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ctrplan.base.arrays import Array
    from ctrplan.files.plan_file import WrittenPlan

DESCRIPTION = (
    "Put two plans side by side: the figures of their certificates with their differences, and with -o a picture of "
    "bound, clearance and the tip's way along both."
)
EXAMPLES = """examples:
  ctrplan compare out/plan.json other/plan.json
  ctrplan compare monday.ctrplan tuesday.ctrplan -o compared
"""
OUTPUTS = ("compare.png",)
SHOWN = {"m": (1e3, "mm"), "rad": (180 / math.pi, "deg"), "mm": (1.0, "mm"), "number": (1.0, ""), "count": (1.0, "")}
COLUMNS = (("bound_m", "bound (mm)"), ("clearance_m", "clearance (mm)"))  # of the certificate's samples


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("first", metavar="A", help="a plan.json, its folder or a .ctrplan file")
    parser.add_argument("second", metavar="B", help="another one")
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for {OUTPUTS[0]}")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    add_allow_outside_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for what is no plan."""
    from ctrplan.files.plan_file import load_plan

    folder = output_folder(arguments.output, OUTPUTS) if arguments.output is not None else None
    names = arguments.first, arguments.second
    first, second = (load_plan(name, allow_outside=arguments.allow_outside) for name in names)
    rows = compared(first, second)
    if arguments.json:
        print(json.dumps({title: {"a": a, "b": b, "unit": unit} for title, a, b, unit in rows}, indent=1))
    else:
        print("\n".join([*_heads(first, second, names), *aligned(_table(rows))]))
    if folder is not None:
        stream = io.BytesIO()
        compared_figure(first, second, names).savefig(stream, format="png", dpi=110)
        write_results(folder, {OUTPUTS[0]: stream.getvalue()})
        print(f"ctrplan: written to {folder / OUTPUTS[0]}", file=sys.stderr)
    return 0


def compared(first: WrittenPlan, second: WrittenPlan) -> list[tuple[str, float | None, float | None, str]]:
    """Title, value of each plan and unit of every figure that either certificate has a number for."""
    from ctrplan.certificate.certificate import FIGURES

    rows: list[tuple[str, float | None, float | None, str]] = [
        ("Duration of the motion", float(first.time_s[-1]), float(second.time_s[-1]), "s"),
        ("Legs", float(len(first.waypoints) - 1), float(len(second.waypoints) - 1), ""),
    ]
    for key, figure in FIGURES.items():
        values = [plan.certificate.get(key) for plan in (first, second)]
        if not figure.title or figure.unit not in SHOWN or not any(isinstance(value, (int, float)) for value in values):
            continue
        factor, unit = SHOWN[figure.unit]
        a, b = (None if not isinstance(value, (int, float)) else finite(value * factor) for value in values)
        rows.append((figure.title, a, b, unit))
    return rows


def _heads(first: WrittenPlan, second: WrittenPlan, names: tuple[str, str]) -> list[str]:
    """Which plans they are, and whether they are of one robot and one scenario."""
    lines = [
        f"{letter}: {name} ({p.scenario.name})" for letter, name, p in zip("AB", names, (first, second), strict=True)
    ]
    for key in ("robot", "scenario"):
        same = first.content[key]["sha256"] == second.content[key]["sha256"]
        lines.append(f"{'the same' if same else 'another'} {key}")
    return lines


def _table(rows: list[tuple[str, float | None, float | None, str]]) -> list[list[str]]:
    def shown(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    width = max(len(title) for title, *_ in rows)
    table = [["".ljust(width), "A", "B", "B - A", "unit"]]
    for title, a, b, unit in rows:
        apart = "" if a is None or b is None else f"{b - a:+.2g}"
        table.append([title.ljust(width), shown(a), shown(b), apart, unit])
    return table


def compared_figure(first: WrittenPlan, second: WrittenPlan, names: tuple[str, str]) -> Figure:
    """Bound and clearance along both plans, and the ways of their tips in space."""
    import numpy as np
    from matplotlib.figure import Figure

    from ctrplan.reports.looks import SERIES

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    axes: list[Any] = [figure.add_subplot(1, 3, k + 1) for k in range(2)]
    space: Any = figure.add_subplot(1, 3, 3, projection="3d")
    for plan, name, colour in zip((first, second), names, SERIES, strict=False):
        share = plan.certified_places / max(float(plan.certified_places[-1]), 1e-12)
        for ax, (column, label) in zip(axes, COLUMNS, strict=True):
            values = _column(plan, column)
            if np.isfinite(values).any():
                ax.plot(100 * share, values * 1e3, color=colour, label=name)
            ax.set_ylabel(label)
            ax.set_xlabel("along the plan (% of its legs)")
            ax.spines[["top", "right"]].set_visible(False)
        tips = np.array(plan.content["certificate"]["samples"]["tip_m"], dtype=float) * 1e3
        space.plot(*tips.T, color=colour)
        space.plot(*tips[-1:].T, "o", color=colour)
    axes[0].legend(frameon=False, fontsize=8)
    space.set_title("way of the tip without friction (mm)", fontsize=9)
    return figure


def _column(plan: WrittenPlan, name: str) -> Array:
    """(K,) of the certificate's samples; NaN throughout where it has no such column."""
    import numpy as np

    samples = plan.content["certificate"]["samples"]
    return plan.column(name) if name in samples else np.full(len(plan.certified_places), np.nan)
