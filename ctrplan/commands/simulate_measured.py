"""`ctrplan simulate --measured`: a measured log followed by an observer, as a table and a picture."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.base.arguments import in_plain_digits
from ctrplan.base.interrupts import interrupt_event
from ctrplan.commands.progress_bar import ProgressBar
from ctrplan.errors import InputError
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.robot.observer.slow_parameter import SlowParameter
    from ctrplan.studies.follow import Following

OUTPUTS = ("followed.csv", "followed.png")
PATIENCE_S = 1.0


def run_simulate_measured(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError."""
    for option, value, default in (
        ("--start", arguments.start, "released"),
        ("--accuracy", arguments.accuracy, "search"),
    ):
        if value != default:
            raise InputError(
                "does not go with --measured, an observer starts from every state", key=option, value=value
            )
    with interrupt_event() as interrupted:
        from ctrplan.files.measurement_file import load_measurements
        from ctrplan.files.robot_file import load_robot
        from ctrplan.robot.observer.slow_offset import SlowOffset
        from ctrplan.studies.follow import follow

        robot = load_robot(arguments.robot, arguments.overrides)
        data = load_measurements(arguments.path, robot)
        folder = output_folder(arguments.output, OUTPUTS)
        for warning in (*robot.warnings, *data.warnings):
            print(f"ctrplan: warning: {warning}", file=sys.stderr)
        offset = SlowOffset(arguments.offset_mm * 1e-3, arguments.offset_steps)
        terminal = sys.stderr is not None and sys.stderr.isatty()
        with ProgressBar(quiet=not terminal, patience_s=PATIENCE_S) as bar:
            result = follow(
                robot,
                data,
                offset=offset,
                slow=[_slow(text) for text in arguments.slow],
                members=arguments.histories,
                progress=lambda share: bar.show("following", share),
                interrupted=interrupted,
            )
        _write(folder, result)
        print(_summary(folder, result))
    return 0


def _slow(text: str) -> SlowParameter:
    """NAME=SIGMA."""
    from ctrplan.robot.observer.slow_parameter import SlowParameter

    name, _, sigma = text.partition("=")
    value = in_plain_digits(sigma)
    if not name or value is None:
        raise InputError("must be NAME=SIGMA, as contact.1.friction_coefficient=0.1", key="--slow", value=text)
    return SlowParameter(name, value)


def _write(folder: Path, result: Following) -> None:
    from ctrplan.reports.plan_picture.following import following_png
    from ctrplan.studies.follow import followed_csv

    write_results(folder, dict(zip(OUTPUTS, (followed_csv(result), following_png(result)), strict=True)))


def _summary(folder: Path, result: Following) -> str:
    import numpy as np

    lines = [f"{result.robot.name}: {len(result.measured_m)} measured tips followed, off one step ahead:"]
    for label, error_m in (("with the observer", result.error_m), ("without", result.error_without_m)):
        error_mm = error_m[np.isfinite(error_m)] * 1e3
        if len(error_mm):
            rms, most = np.sqrt(np.mean(error_mm**2)), error_mm.max()
            lines.append(f"  {label:27} {rms:.3f} mm (rms), at most {most:.3f} mm")
    for name, values in result.parameters.items():
        lines.append(f"  {name:27} {values[-1, 0]:.4g} +- {1.96 * values[-1, 1]:.2g} in the end")
    held = np.all((result.low_m <= result.measured_m) & (result.measured_m <= result.high_m), axis=1).mean()
    lines.append(f"  {'measured within interval':27} {100 * held:.0f} % of the rows")
    lines.append(f"  {'written to':27} {folder}/{', '.join(OUTPUTS)}")
    return "\n".join(lines)
