"""What benchmarks share: places in the tree, tables, shares with their intervals, the look of figures."""

from __future__ import annotations

import argparse
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
is_writing = [False]  # whether documents get what is printed and drawn


class Parser(argparse.ArgumentParser):
    """A parser in whose command lines options may stand between names."""

    parse_args = argparse.ArgumentParser.parse_intermixed_args  # type: ignore[assignment]


def parser(doc: str | None) -> Parser:
    """For the arguments of a benchmark, which its docstring explains."""
    return Parser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def sections(given: Sequence[str], known: Mapping[str, Callable[[], object]], refuse: Callable[[str], object]) -> None:
    """Runs the sections that are named, all if none is."""
    if unknown := set(given) - set(known):
        refuse(f"no section {', '.join(sorted(unknown))}: there are {', '.join(known)}")
    for name in given or known:
        known[name]()


def again(name: str, *arguments: str) -> list[str]:
    """The command that runs a benchmark in a process of its own, without keeping what it prints."""
    return [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--bare", name, *arguments]


def kept(file: Path | None) -> list[dict[str, Any]]:
    """Rows that earlier runs kept in a file, a JSON object a line."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []


def keep(file: Path, row: Mapping[str, Any]) -> None:
    """Adds a row to such a file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as stream:
        stream.write(json.dumps(row) + "\n")


def spent(command: Sequence[str], environment: Mapping[str, str], output: Any) -> tuple[int, float, float, float]:
    """Exit code, seconds by the clock and of the processor, peak memory [MB] of a command, which prints to `output`."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    clock_s = time.perf_counter() - began
    return os.waitstatus_to_exitcode(status), clock_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints a Markdown table under its title; floats have three significant digits."""
    print(f"\n{title}")
    for line in (head, ["---"] * len(head), *rows):
        print(row(line), flush=True)


def row(cells: Sequence[object]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(f'{x:.3g}' if isinstance(x, float) else str(x) for x in cells)} |"


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
