"""`ctrplan calibrate`: measured poses -> robot.toml with calibrated values, calibration.json and report.html."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import SEED, Number, Whole
from ctrplan.commands.options import add_number, add_output_option, add_set_option
from ctrplan.commands.terminal import typed, warn
from ctrplan.storage.output_folder import output_folder, written_together

if TYPE_CHECKING:
    from ctrplan.calibration.calibrate import Calibration
    from ctrplan.calibration.estimates import Errors

OUTPUTS = ("calibration.json", "robot.toml", "report.html")
DESCRIPTION = (
    "Least squares over named parameters, with intervals, what the data can't tell, and the error on "
    "configurations kept aside; write robot.toml, calibration.json, report.html. The robot file itself "
    "stays as it is."
)
EXAMPLES = """examples:
  ctrplan calibrate robot.toml measurements.csv -o out
  ctrplan calibrate robot.toml measurements.toml -o out --parameters calibration effects.base_misalignment
  ctrplan calibrate robot.toml measurements.csv -o out --parameters tube.2.poisson_ratio \
tube.3.section.2.curvature_y_per_m --second-pass contact.1.friction_coefficient contact.2.friction_coefficient
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument(
        "measurements", metavar="MEASUREMENTS.csv", help="or a mapping file (TOML): docs/measurements.md"
    )
    parser.add_argument("--parameters", nargs="+", metavar="NAME", help="default: precurvatures, stiffness ratios, nu")
    parser.add_argument("--second-pass", nargs="+", metavar="NAME", default=[], help="fitted with the others held")
    parser.add_argument("--weighting", choices=["stated", "paper"], help="stated noise, or 1 deg = 1 mm as at (49)")
    help_aside = "of configurations (default: %(default)s)"
    add_number(parser, "--held-out", Number(0, 0.99), default=0.25, metavar="SHARE", help=help_aside)
    parser.add_argument("--as-read", action="store_true", help="fit the file as it stands, although it seems misread")
    help_starts = "starts of the fit (default: %(default)s)"
    add_number(parser, "--starts", Whole(1, 100), default=1, metavar="N", help=help_starts)
    add_number(parser, "--seed", SEED, default=0, help="of the starts and of what is kept aside")
    add_output_option(parser)
    add_set_option(parser, "the robot's key")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError when there is nothing to write."""
    from ctrplan.calibration.calibrate import calibrate
    from ctrplan.files.measurement_file import load_measurements
    from ctrplan.files.robot_file import load_robot, write_robot
    from ctrplan.reports.calibration_page import calibration_report_html
    from ctrplan.storage.output_folder import write_atomically

    robot = load_robot(arguments.robot, arguments.overrides)
    data = load_measurements(arguments.measurements, robot)
    folder = output_folder(arguments.output, OUTPUTS, inputs=[arguments.robot, arguments.measurements])
    result = calibrate(
        robot,
        data,
        arguments.parameters,
        second_pass=arguments.second_pass,
        weighting=arguments.weighting,
        held_out=arguments.held_out,
        starts=arguments.starts,
        seed=arguments.seed,
        as_read=arguments.as_read,
    )
    with written_together(folder, OUTPUTS) as made:
        write_robot(made / "robot.toml", result.robot_content())
        write_atomically(made / "calibration.json", json.dumps(calibration_json(result), indent=1) + "\n")
        write_atomically(made / "report.html", calibration_report_html(result))
    warn([*robot.warnings, *result.notes])
    print(_summary(folder, result, arguments.measurements))
    return 0


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """The content of calibration.json; parameters are in the units that their names end with."""
    return {
        "parameters": {name: asdict(estimate) for name, estimate in calibration.estimates.items()},
        "training": asdict(calibration.training),
        "held_out": None if calibration.held_out is None else asdict(calibration.held_out),
        "before": asdict(calibration.nominal),
        "combinations": [{"parameters": c.parameters, "left": c.posterior_share} for c in calibration.combinations],
        "model_error_mm": calibration.model_error_m * 1e3,
        "converged": calibration.fit.converged,
        "notes": list(calibration.notes),
    }


def _summary(folder: Path, calibration: Calibration, measurements: str) -> str:
    lines = [f"tips were {_errors(calibration.nominal)} off before, {_errors(calibration.training)} after calibration"]
    if calibration.held_out is not None:
        lines.append(f"  {_errors(calibration.held_out)} on {calibration.held_out.poses} poses kept aside")
    for name, e in calibration.estimates.items():
        lines.append(f"  {name:40} {e.shown}  ({e.shown_ci95})")
    lines.append(f"  written to {folder}/{', '.join(OUTPUTS)}")
    lines.append(_next(folder, calibration, measurements))
    return "\n".join(lines)


def _next(folder: Path, calibration: Calibration, measurements: str) -> str:
    """What to do with it: go on, or look for what the model lacks where more is left than the tracker's noise."""
    noise = calibration.fit.chain.robot.measurement
    robot, parent = typed(folder / "robot.toml"), typed(calibration.fit.chain.robot.path or "ROBOT.toml")
    if noise is None:
        return f"next: ctrplan check {robot}; with [measurement] in it ctrplan diagnose tells noise from faults"
    from ctrplan.reports.calibration_page import what_is_missing

    if missing := what_is_missing(calibration):
        return f"next: {missing}; ctrplan diagnose {parent} {typed(measurements)} -o found"
    return f"next: what is left is the noise of the tracker; plan with it: ctrplan check {robot}"


def _errors(errors: Errors) -> str:
    return f"{errors.rms_m * 1e3:.2f} mm rms, {errors.max_m * 1e3:.2f} mm at most"
