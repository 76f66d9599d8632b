"""`ctrplan export`: a written plan in files that other programs read."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ctrplan.commands.options import add_plan_arguments, add_steps_option, read_plan, solved_motion
from ctrplan.commands.terminal import PATIENCE_S, ProgressBar, tell_next, typed
from ctrplan.storage.output_folder import output_folder, write_results

if TYPE_CHECKING:
    from ctrplan.reports.plan_scene import WrittenMotion

PROGRAMS = ("slicer",)
STEPS = 60
DESCRIPTION = (
    "Solve a written plan's robot at equal steps of the time; write a folder that 3D Slicer opens: "
    "the tip's path and centrelines (.mrk.json), the anatomy, tubes and the space that the envelope of friction "
    "sweeps (.ply), the motion (.seq.mrb), the robot's base (.tfm), and a scene that loads them (.mrml)."
)
EXAMPLES = """3D Slicer opens scene.mrml with the anatomy, the robot over time and the space it sweeps: docs/slicer.md.
No Slicer is needed to write it. All files are in LPS and mm, and say so.

examples:
  ctrplan export out/plan.json --to slicer --frame LPS -o case
  ctrplan export out/plan.json scenarios/airway.toml --to slicer --frame RAS -o case --steps 200
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    add_plan_arguments(parser)
    parser.add_argument("--to", choices=PROGRAMS, required=True, help="the program that shall read it")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="folder for the files")
    parser.add_argument(
        "--frame",
        metavar="RAS|LPS",
        help="where the axes of the anatomy's frame point in the patient: to the right, the front and the head, or to "
        "the left, the back and the head as in DICOM; needed where the scenario does not say it",
    )
    add_steps_option(parser, STEPS)


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for what is no plan, and without a frame."""
    from ctrplan.files.slicer_markups import SCENE, patient_frame
    from ctrplan.reports.slicer_case import case_files

    plan = read_plan(arguments)
    frame = patient_frame(plan.scenario, arguments.frame)
    folder = output_folder(
        arguments.output, [SCENE], [f"anatomy_{k + 1}.ply" for k in range(len(plan.scenario.anatomy))]
    )
    with ProgressBar(quiet=arguments.quiet, patience_s=PATIENCE_S) as bar:
        motion = solved_motion(plan, arguments.steps, bar)
        bar.show("writing", 0.0)
        files = case_files(motion, frame)
    write_results(folder, files)
    print(_summary(motion, str(folder / SCENE), len(files), frame))
    tell_next(f"open {typed(folder / SCENE)} in 3D Slicer")
    return 0


def _summary(motion: WrittenMotion, scene: str, count: int, frame: str) -> str:
    poses, seconds = len(motion.path), motion.times_s[-1]
    lines = [f"{motion.scenario.name}: {count} files for 3D Slicer, {poses} poses in {seconds:.1f} s"]
    lines.append(f"  {'frame':27} the anatomy's is {frame}; files are in LPS and mm")
    lines.append(f"  {'between two poses':27} the centreline moves {motion.step_m * 1e3:.2f} mm at most")
    if not motion.plan.certificate["valid"]:
        lines.append(f"  {'note':27} the plan says that it is not certified")
    lines.append(f"  {'open in 3D Slicer':27} {scene}")
    return "\n".join(lines)
