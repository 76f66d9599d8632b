"""`ctrplan bound --sweep`: the friction bound over one or two axes, as a table and a picture."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.commands.options import configuration
from ctrplan.commands.progress_bar import ProgressBar
from ctrplan.errors import InputError
from ctrplan.storage.output_folder import DEFAULT, output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.studies.sweep import Sweep

OUTPUTS = ("sweep.csv", "sweep.png")
PATIENCE_S = 1.0  # before a progress bar shows up


def run_sweep(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code, 1 if no point has a bound. Raises CtrplanError."""
    from ctrplan.files.robot_file import robot_from_dict
    from ctrplan.storage.toml_document import read_document
    from ctrplan.studies.sweep import check_axes, sweep
    from ctrplan.studies.sweep_axis import parse_axis

    if arguments.json:
        raise InputError("goes with one configuration; a sweep writes sweep.csv", key="--json")
    document = read_document(arguments.robot, arguments.overrides)
    robot = robot_from_dict(document.content, file=document.file)
    commanded = configuration(arguments, robot.n)
    axes = [parse_axis(text, robot.n) for text in arguments.sweep]
    check_axes(axes)
    accuracy: Accuracy = arguments.accuracy or "search"
    folder = output_folder(DEFAULT if arguments.output is None else arguments.output, OUTPUTS)
    terminal = sys.stderr is not None and sys.stderr.isatty()
    with ProgressBar(quiet=not terminal, patience_s=PATIENCE_S) as bar:
        result = sweep(document.content, axes, *commanded, file=document.file, accuracy=accuracy, progress=bar.show)
    _warn(result)
    _write(folder, result)
    print(_summary(folder, result))
    return 0 if result.usable.any() else 1


def _warn(result: Sweep) -> None:
    """Every warning about the robot as it is, and how many more the axes' values bring up."""
    own = result.robot.warnings
    new = [warning for warning in result.warnings if warning not in own]
    more = [f"{len(new) - 1} more like the last at other values of the sweep."] if len(new) > 1 else []
    for warning in (*own, *new[:1], *more):
        print(f"ctrplan: warning: {warning}", file=sys.stderr)


def _write(folder: Path, result: Sweep) -> None:
    from ctrplan.reports.plan_picture.sweep import sweep_png
    from ctrplan.studies.sweep import sweep_csv

    write_results(folder, dict(zip(OUTPUTS, (sweep_csv(result), sweep_png(result)), strict=True)))


def _summary(folder: Path, result: Sweep) -> str:
    from ctrplan.mechanics.shapes import Status

    count = " x ".join(map(str, result.shape))
    lines = [f"{result.robot.name}: {count} points over {' and '.join(axis.key for axis in result.axes)}"]
    lines += [f"  {label:27} {text}" for label, text in _extremes(result).items()]
    found = Counter(Status(status).name for status in result.bounds.status.tolist())
    lines.append(f"  {'status':27} {', '.join(f'{number} {name}' for name, number in found.most_common())}")
    lines.append(f"  {'written to':27} {folder}/sweep.csv, sweep.png")
    return "\n".join(lines)


def _extremes(result: Sweep) -> dict[str, str]:
    import numpy as np

    if not result.usable.any():
        return {"worst-case friction error": "no bound is promised at any point"}
    bound_mm = np.where(result.usable, result.bounds.position_m * 1e3, np.nan)
    texts = {}
    for label, k in (("smallest friction error", np.nanargmin(bound_mm)), ("largest", np.nanargmax(bound_mm))):
        where = zip(result.axes, result.values[k].tolist(), strict=True)
        texts[label] = f"{bound_mm[k]:.3f} mm at {', '.join(axis.at(value) for axis, value in where)}"
    return texts
