"""What benchmarks share: places in the tree, tables, shares with their intervals, the look of figures."""

from __future__ import annotations

import argparse
import functools
import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS, IMAGES = ROOT / "scenarios", ROOT / "docs" / "images"
ROBOTS, STUDIES = SCENARIOS / "robots", SCENARIOS / "studies"
SHIPPED = sorted(path.stem for path in SCENARIOS.glob("*.toml"))  # names of scenarios
is_writing = [False]  # whether documents get what is printed and drawn
tables: dict[str, dict[str, Any]] = {}  # columns and rows of what was printed, by title


class Parser(argparse.ArgumentParser):
    """A parser in whose command lines options may stand between names."""

    parse_args = argparse.ArgumentParser.parse_intermixed_args  # type: ignore[assignment]


def arguments(doc: str | None, *places: str | tuple[str, Iterable[str]], **options: Any) -> Any:
    """What a command line gives to a benchmark, whose docstring explains it.

    Places are names that end with * or ? where there need not be one, or pairs of name and choices. Options are given
    by their defaults, or by a type where they have none; one that is False is a switch, a list takes several values.
    """

    def among(choices: Iterable[str], text: str) -> str:  # argparse takes no name at all for a wrong choice
        if text not in choices:
            raise argparse.ArgumentTypeError(f"no {text}: there are {', '.join(choices)}")
        return text

    parser = Parser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for place in places:
        text, kind = (place, str) if isinstance(place, str) else (place[0], functools.partial(among, place[1]))
        parser.add_argument(text.rstrip("*?"), nargs=text[-1] if text[-1] in "*?" else None, type=kind)
    for name, default in options.items():
        flag, is_type = f"--{name.replace('_', '-')}", isinstance(default, type)
        if default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, list):
            parser.add_argument(flag, nargs="*", type=type(default[0]), default=default)
        else:
            kind, value = (default, None) if is_type else (type(default), default)
            parser.add_argument(flag, type=kind, default=value)
    return parser.parse_args()


Table = tuple[str, str, Callable[[], Iterable[Sequence[object]]]]  # title, head and rows


def chosen(names: Sequence[str], known: Iterable[str]) -> list[str]:
    """The given names, all that are known if there are none; ends with a sentence for a name that is not known."""
    there = list(known)
    for name in set(names).difference(there):
        sys.exit(f"no {name}: there are {', '.join(there)}")
    return list(names) or there


def sections(names: Sequence[str], known: Mapping[str, Callable[[], object] | Table]) -> None:
    """Runs the sections that are named, all if none is."""
    for name in chosen(names, known):
        work = known[name]
        table(work[0], work[1], work[2]()) if isinstance(work, tuple) else work()


def end_searches_by_count() -> None:
    """From here on a search ends when it has counted its work, however busy the machine is."""
    from ctrplan.base import long_work

    long_work.LEAST_REAL_S = np.inf


def again(name: str, *arguments: str) -> list[str]:
    """The command that runs a benchmark in a process of its own, without keeping what it prints."""
    return [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--bare", name, *arguments]


def elsewhere(checkout: Path, name: str, *arguments: str) -> list[float]:
    """Numbers that a benchmark prints in a process of its own, with the ctrplan of a checkout."""
    if not list((checkout / "ctrplan").glob("_model*")):
        sys.exit(f"{checkout}: is no checkout with a compiled model in its ctrplan/")
    command, environment = again(name, *arguments), os.environ | {"PYTHONPATH": str(checkout)}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return [float(text) for text in done.stdout.split()]


def kept(file: Path | None) -> list[dict[str, Any]]:
    """Rows that earlier runs kept in a file, a JSON object a line."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []


def keep(file: Path, row: Mapping[str, Any]) -> None:
    """Adds a row to such a file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as stream:
        stream.write(json.dumps(row) + "\n")


def took(work: Callable[..., object], *given: Any) -> tuple[float, float]:
    """Seconds of a call, by the clock and of this process's processors."""
    began = time.perf_counter(), time.process_time()
    work(*given)
    return time.perf_counter() - began[0], time.process_time() - began[1]


def spent(command: Sequence[str], environment: Mapping[str, str], output: Any) -> tuple[int, float, float, float]:
    """Exit code, seconds by the clock and of the processor, peak memory [MB] of a command, which prints to `output`."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    clock_s = time.perf_counter() - began
    return os.waitstatus_to_exitcode(status), clock_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def table(title: str, head: str | Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints a Markdown table under its title, each row as it comes, floats with three significant digits.

    A head may be one text with bars between its cells.
    """
    columns = head.split(" | ") if isinstance(head, str) else list(head)
    written = tables.setdefault(title, {"columns": columns, "rows": []})["rows"]
    print(f"\n{title}\n{line(columns)}\n{line(['---'] * len(columns))}")
    for row in rows:
        written.append([f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row])
        print(line(written[-1]), flush=True)


def line(cells: Iterable[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def processors() -> str:
    """What times by the clock depend on, as words of a line."""
    return f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}"


def tube(
    outer_mm: float, inner_mm: float, stiffness_Nm2: float, sections: Iterable[Sequence[float]], **more: Any
) -> dict[str, Any]:
    """A tube of a robot file; of each section its length [mm] and curvature (x, y) [1/m]."""
    keys = ("length_mm", "curvature_x_per_m", "curvature_y_per_m")
    sizes = {"outer_diameter_mm": outer_mm, "inner_diameter_mm": inner_mm, "bending_stiffness_Nm2": stiffness_Nm2}
    return {"poisson_ratio": 0.3, "section": [dict(zip(keys, of, strict=True)) for of in sections], **sizes, **more}


def finer(times: float) -> Any:
    """Steps of histories, so many times as short as the default ones."""
    from ctrplan.mechanics.shapes import HistoryOptions

    steps = ("rotation_rad", "translation_m", "state_change")
    return HistoryOptions(**{name: getattr(HistoryOptions, name) / times for name in steps})


def distance_mm(a: Any, b: Any) -> float:
    """Distance of two points given in m."""
    return 1e3 * float(np.linalg.norm(np.subtract(a, b)))


def prepare(ax: Any) -> Any:
    """Axes in the style of the documents."""
    from ctrplan.reports import looks

    ax.grid(color=looks.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(looks.MUTED)
    ax.tick_params(colors=looks.MUTED, labelcolor=looks.INK, labelsize=9)
    return ax


def panels(rows: int, columns: int, size_in: tuple[float, float]) -> tuple[Any, Any]:
    """A figure and its axes (rows, columns), in the style of the documents."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, dpi=120, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        prepare(ax)
    return figure, axes


def save(figure: Any, name: str, colours: int = 256) -> None:
    """Writes a figure to docs/images where documents are written, in few colours to keep it small."""
    from PIL import Image

    if not is_writing[0]:
        return
    file, content = IMAGES / f"{name}.png", io.BytesIO()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(content, format="png", dpi=120)
    small = Image.open(content).convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    small.save(file, optimize=True)
