"""`ctrplan compare`: two plans side by side: their figures in a table, both robots in one scene, their curves."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import TYPE_CHECKING, Any

from ctrplan.commands.options import add_allow_outside_option
from ctrplan.commands.terminal import aligned, finite, tell_next, typed, warn
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ctrplan.base.arrays import Array
    from ctrplan.files.plan_file import WrittenPlan
    from ctrplan.reports.curves import Panel, Timeline
    from ctrplan.reports.robot_surface import RobotPose

DESCRIPTION = (
    "Put two plans side by side: the figures of their certificates with their differences, and with -o a page that "
    "plays both in one scene, and a picture of bound, clearance and the tip's way along both."
)
EXAMPLES = """examples:
  ctrplan compare out/plan.json other/plan.json
  ctrplan compare monday.ctrplan tuesday.ctrplan -o compared
"""
OUTPUTS = ("compare.html", "compare.png")
SHOWN = {"m": (1e3, "mm"), "rad": (180 / math.pi, "deg"), "mm": (1.0, "mm"), "number": (1.0, ""), "count": (1.0, "")}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("first", metavar="A", help="a plan.json, its folder or a .ctrplan file")
    parser.add_argument("second", metavar="B", help="another one")
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for {' and '.join(OUTPUTS)}")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    add_allow_outside_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for what is no plan."""
    from ctrplan.files.plan_file import load_plan
    from ctrplan.reports.looks import png

    folder = output_folder(arguments.output, OUTPUTS) if arguments.output is not None else None
    names = arguments.first, arguments.second
    first, second = (load_plan(name, allow_outside=arguments.allow_outside) for name in names)
    warn(dict.fromkeys((*first.warnings, *second.warnings)))
    rows = compared(first, second)
    if arguments.json:
        print(json.dumps({title: {"a": a, "b": b, "unit": unit} for title, a, b, unit in rows}, indent=1))
    else:
        print("\n".join([*_heads(first, second, names), *aligned(_table(rows))]))
    if folder is not None:
        contents = compared_html(first, second, names), png(compared_figure(first, second, names))
        write_results(folder, dict(zip(OUTPUTS, contents, strict=True)))
        print(f"ctrplan: written to {folder}/{', '.join(OUTPUTS)}", file=sys.stderr)
        tell_next(f"open {typed(folder / OUTPUTS[0])}, both plans in one scene")
    elif not arguments.json:
        tell_next("-o DIR draws both plans in one scene")
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
    terms = [plan.content["reorder"].get("terms_after_mm", {}) for plan in (first, second)]
    rows += [(f"Of the cost, {name}", terms[0].get(name), terms[1].get(name), "mm") for name in terms[0] | terms[1]]
    return rows


def _heads(first: WrittenPlan, second: WrittenPlan, names: tuple[str, str]) -> list[str]:
    """Lines that name the plans and say whether robot and scenario are the same."""
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
    """Bound and clearance over the time of both plans, and the ways of their tips in space."""
    import numpy as np
    from matplotlib.figure import Figure

    from ctrplan.reports.looks import INK, SERIES
    from ctrplan.reports.plan_picture import draw_panel

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    heads = zip(_heads(first, second, names)[:2], ("blue", "orange"), strict=True)
    lines = "\n".join(f"{head}, {colour}" for head, colour in heads)
    figure.suptitle(lines, x=0.01, ha="left", fontsize=9, parse_math=False)
    panels, time = _panels((first, second))
    for k, panel in enumerate(panels):
        ax = figure.add_subplot(1, 3, k + 1)
        draw_panel(ax, panel, time, heading=panel.title)
        ax.set_xlabel("time (s)")
    space: Any = figure.add_subplot(1, 3, 3, projection="3d")
    for plan, colour in zip((first, second), SERIES, strict=False):
        tips = np.array(plan.content["certificate"]["samples"]["tip_m"], dtype=float) * 1e3
        space.plot(*tips.T, color=colour)
        space.plot(*tips[-1:].T, "o", color=colour)
    space.tick_params(labelsize=8)
    space.set_title("Way of the tip without friction (mm)", loc="left", fontsize=11.5, fontweight="bold", color=INK)
    return figure


def _column(plan: WrittenPlan, name: str) -> Array:
    """(K,) of the certificate's samples; NaN throughout where it has no such column."""
    import numpy as np

    samples = plan.content["certificate"]["samples"]
    return plan.column(name) if name in samples else np.full(len(plan.certified_places), np.nan)


FRAMES = 40  # of the scene
LETTERS = "AB"


def compared_html(first: WrittenPlan, second: WrittenPlan, names: tuple[str, str]) -> str:
    """A page that plays both plans at once in one scene; solves the model FRAMES times for each.

    Raises SolverError where a plan has no pose with a solution.
    """
    import numpy as np

    from ctrplan.reports.curves import stacked_figure
    from ctrplan.reports.html_page import plot, rendered, scene_script
    from ctrplan.reports.looks import SERIES
    from ctrplan.reports.plan_scene import poses_along
    from ctrplan.reports.words import millimetres

    plans = first, second
    ends = [float(plan.time_s[-1]) for plan in plans]
    times = np.linspace(0.0, max(ends), FRAMES)
    courses = [poses_along(plan.scenario, plan, FRAMES) for plan in plans]
    paths = [
        [course[min(round(t / max(end, 1e-9) * (len(course) - 1)), len(course) - 1)] for t in times.tolist()]
        for course, end in zip(courses, ends, strict=True)
    ]
    figures = {
        f"now_{letter}": [millimetres(pose.bound_m) for pose in path]
        for letter, path in zip(LETTERS, paths, strict=True)
    }
    steps = [f"{t:.3f}" for t in times.tolist()]
    motion = {
        "frames": steps,
        "time_s": times.tolist(),
        "figures": figures,
        "curves": ["curves"],
        "cursor": 0,
        "step_ms": 100,
    }
    code = scene_script("scene", "key", f"addPlayer(plot, {json.dumps(motion)})", files=("player.js",))
    scene, frames = _scene(plans, paths, steps)
    return rendered(
        "compare.html",
        title="Two plans - ctrplan",
        names=[plan.scenario.name for plan in plans],
        scene=plot(scene, "scene", frames=frames, with_library=True, script=code, kind="plot scene"),
        last=FRAMES - 1,
        now=[(letter, SERIES[k], figures[f"now_{letter}"][0]) for k, letter in enumerate(LETTERS)],
        heads=_heads(first, second, names),
        rows=[row for row in _table(compared(first, second))[1:]],
        curves=plot(stacked_figure(*_panels(plans)), "curves"),
    )


def _scene(plans: tuple[WrittenPlan, WrittenPlan], paths: list[list[RobotPose]], steps: list[str]) -> tuple[Any, Any]:
    """Both robots, each in its colour, with their envelopes, goals and anatomies; and a frame for each of `steps`."""
    import numpy as np

    from ctrplan.reports.looks import GOAL, SERIES
    from ctrplan.reports.plan_scene import in_anatomy, line_trace, moved_traces, plate_trace, robot_traces, xyz

    moving, still, counts = list[Any](), list[Any](), list[int]()
    scenarios = [plan.scenario for plan in plans]
    for letter, colour, path, scenario in zip(LETTERS, SERIES, paths, scenarios, strict=False):
        *tubes, envelope, _ = robot_traces(path[0])
        for k, trace in enumerate((*tubes, envelope)):
            name = f"plan {letter}" if trace is not envelope else f"envelope of friction of {letter}"
            trace.update(color=colour, name=name, showlegend=k in (0, len(tubes)))
        moving += [*tubes, envelope]
        counts.append(len(tubes) + 1)
        still.append(plate_trace(scenario))
    goals = [scenario.goal.tip_m for scenario in scenarios]
    alike = all(goal is not None for goal in goals) and np.allclose(np.array(goals[0]), np.array(goals[1]))
    named = (
        [("goal of both", GOAL, goals[0])]
        if alike
        else list(zip(("goal of A", "goal of B"), SERIES, goals, strict=False))
    )
    for name, colour, goal in named:
        if goal is not None:
            marker = {"symbol": "diamond", "size": 6, "color": colour}
            still.append(line_trace(xyz(goal[None]), mode="markers", marker=marker, name=name))
    points = np.concatenate([pose.envelope.surface(4).vertices_m for path in paths for pose in path])
    figure = in_anatomy([*moving, *still], scenarios[0], points)
    moved = [moved_traces(path) for path in paths]
    frames = [
        {
            "data": [t for traces, count in zip(moved, counts, strict=True) for t in traces[k][:count]],
            "traces": list(range(len(moving))),
            "name": step,
        }
        for k, step in enumerate(steps)
    ]
    return figure, frames


def _panels(plans: tuple[WrittenPlan, WrittenPlan]) -> tuple[list[Panel], Timeline]:
    """Bound and clearance of both over their times."""
    import numpy as np

    from ctrplan.reports.curves import Panel, Series, Timeline
    from ctrplan.reports.looks import SERIES

    panels = []
    for column, title in (("bound_m", "Worst-case friction error"), ("clearance_m", "Clearance beyond the margins")):
        series = []
        for letter, colour, plan in zip(LETTERS, SERIES, plans, strict=False):
            values = _column(plan, column) * 1e3
            if np.isfinite(values).any():
                time_s = np.interp(plan.certified_places, plan.places, plan.time_s)
                series.append(Series(f"plan {letter}", time_s, values, colour))
        if series:
            panels.append(Panel(title, "length", "mm", tuple(series)))
    return panels, Timeline(max(float(plan.time_s[-1]) for plan in plans), ())
