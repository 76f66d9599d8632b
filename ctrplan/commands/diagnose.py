"""`ctrplan diagnose`: measurements against a robot file -> verdict, new robot file, report."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_output_option, add_set_option
from ctrplan.commands.terminal import ProgressBar, tell_next, typed, warn
from ctrplan.storage.output_folder import output_folder, require_kept, written_together

if TYPE_CHECKING:
    from ctrplan.calibration.reading import MisreadError
    from ctrplan.diagnosis import Diagnosis
    from ctrplan.robot.robot import Robot

OUTPUTS = ("diagnosis.json", "robot.toml", "report.html")


DESCRIPTION = (
    "Compare the model with measurements, name the effect that is missing if the data can tell, "
    "and show the gap on poses kept aside; write diagnosis.json, robot.toml (with the effect) and report.html."
)
EXAMPLES = """examples:
  ctrplan diagnose robot.toml measurements.csv -o out
  ctrplan diagnose robot.toml measurements.csv -o out --without friction --without backlash
  ctrplan diagnose robot.toml monday.csv --confirm tuesday.csv -o out
  ctrplan bound out/robot.toml --theta-deg 0 90 180 --l-mm 0 -17 -62.8
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument(
        "measurements", metavar="MEASUREMENTS.csv", help="or a mapping file (TOML): docs/measurements.md"
    )
    add_output_option(parser)
    parser.add_argument(
        "--without",
        metavar="EFFECT",
        action="append",
        default=[],
        help="leave an effect out of the catalogue, to see what would be said if it were unknown; repeatable",
    )
    parser.add_argument(
        "--confirm",
        metavar="OTHER.csv",
        action="append",
        default=[],
        help="runs that nothing reads until the verdict is given, then once: confirmed or not, effect by effect; "
        "repeatable",
    )
    parser.add_argument(
        "--propose", metavar="FILE.csv", help="write the poses that would tell A from B, as joint paths to be driven"
    )
    parser.add_argument(
        "--decide",
        metavar="NEW.csv",
        help="poses that decide between A and B, those proposed or others; fitted to none",
    )
    parser.add_argument("--as-read", action="store_true", help="fit the file as it stands, although it seems misread")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    add_set_option(parser, "the robot's key")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises CtrplanError when there is nothing to write."""
    with interrupt_event() as interrupted:
        from ctrplan.calibration.reading import MisreadError
        from ctrplan.diagnosis import CATALOGUE, diagnose
        from ctrplan.diagnosis.confirmation import confirm
        from ctrplan.diagnosis.workbench import reduced
        from ctrplan.diagnosis.workflow import decide
        from ctrplan.files.measurement_file import load_measurements
        from ctrplan.files.robot_file import load_robot

        reduced(CATALOGUE, arguments.without, key="--without")
        robot = load_robot(arguments.robot, arguments.overrides)
        data = load_measurements(arguments.measurements, robot)
        others = [load_measurements(path, robot) for path in arguments.confirm]
        deciding = load_measurements(arguments.decide, robot) if arguments.decide is not None else None
        read = [arguments.robot, arguments.measurements, *arguments.confirm, arguments.decide]
        folder = output_folder(arguments.output, OUTPUTS, inputs=read)
        if arguments.propose is not None:
            require_kept(Path(arguments.propose), read, "--propose")
        warn([*robot.warnings, *data.warnings])
        with ProgressBar(quiet=arguments.quiet) as bar:
            try:
                result = diagnose(
                    robot,
                    data,
                    bar.show,
                    without=arguments.without,
                    interrupted=interrupted,
                    as_read=arguments.as_read,
                )
            except MisreadError as error:
                _write_misread(folder, error, robot)
                raise
            if deciding is not None and not result.interrupted:
                result = decide(result, deciding, bar.show, interrupted=interrupted)
            confirmed = tuple(confirm(result, other) for other in others if not result.interrupted)
            result = replace(result, confirmations=confirmed)
        _write(folder, result)
        print(summary(folder, result))
        if arguments.propose is not None:
            _propose(Path(arguments.propose), result)
        page, robot_file = typed(folder / "report.html"), typed(folder / "robot.toml")
        tell_next(f"open {page}; ctrplan check {robot_file}, the model with what was found in it")
        return INTERRUPTED if result.interrupted else 0


def _write(folder: Path, diagnosis: Diagnosis) -> None:
    """All files or none."""
    from ctrplan.files.robot_file import write_robot
    from ctrplan.reports.diagnosis_figures import selection_errors
    from ctrplan.reports.diagnosis_page import write_diagnosis_report
    from ctrplan.storage.output_folder import write_atomically

    errors = selection_errors(diagnosis)  # writers solve nothing
    with written_together(folder, OUTPUTS) as made:
        write_atomically(made / "diagnosis.json", json.dumps(diagnosis.to_json(), indent=1, allow_nan=False) + "\n")
        write_robot(made / "robot.toml", diagnosis.robot_content())
        write_diagnosis_report(made / "report.html", diagnosis, errors)


def _propose(file: Path, diagnosis: Diagnosis) -> None:
    """The proposed poses as `ctrplan simulate` reads joint paths."""
    from ctrplan.diagnosis.next_experiment import proposed_waypoints
    from ctrplan.storage.output_folder import write_atomically

    if not diagnosis.proposals:
        print("  nothing to propose: no two explanations are left, nothing was written")
        return
    n, (sequence, theta, places) = diagnosis.robot.n, proposed_waypoints(diagnosis.proposals)
    names = [*(f"theta_{i}_rad" for i in range(1, n + 1)), *(f"l_{i}_m" for i in range(1, n + 1))]
    rows = [
        ",".join([str(run), *(f"{x:.6f}" for x in angles), *(f"{x:.7f}" for x in lengths)])
        for run, angles, lengths in zip(sequence.tolist(), theta.tolist(), places.tolist(), strict=True)
    ]
    write_atomically(file, "\n".join([",".join(["sequence", *names]), *rows]) + "\n")
    print(f"  written to {file}: drive it, measure every second row, and ask again with --decide")


def _write_misread(folder: Path, error: MisreadError, robot: Robot) -> None:
    """What the file seems to mean, in the place of all that an earlier run wrote."""
    from ctrplan.diagnosis.result import misread_json
    from ctrplan.storage.output_folder import write_results

    content = json.dumps(misread_json(error, robot), indent=1, allow_nan=False) + "\n"
    write_results(folder, {OUTPUTS[0]: content}, OUTPUTS[1:])


def summary(folder: Path, diagnosis: Diagnosis) -> str:
    """What a person wants to know first."""
    from ctrplan.reports.diagnosis_words import effect_lines, verdict_sentence

    gap = diagnosis.gap
    read = [reading.sentence for reading in diagnosis.reading]
    lines = [*read, verdict_sentence(diagnosis), *(f"  {line}" for line in effect_lines(diagnosis))]
    lines.append(
        f"  on {gap.after.poses} poses kept aside: {gap.before.rms_m * 1e3:.2f} mm rms calibrated, "
        f"{gap.after.rms_m * 1e3:.2f} mm with the effects, noise {gap.floor_m * 1e3:.2f} mm"
    )
    lines += [f"  {diagnosis.place.sentence}", f"  next: {diagnosis.next_experiment}"]
    lines += [f"  {decision.sentence}" for decision in diagnosis.decisions]
    lines += [f"  {confirmation.sentence}" for confirmation in diagnosis.confirmations]
    lines += [f"  note: {note}" for note in diagnosis.notes]
    lines.append(f"  written to {folder}/{', '.join(OUTPUTS)}")
    return "\n".join(lines)
