"""`ctrplan verify`: judges a written plan, and shows what breaks it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ctrplan.base.arguments import SEED, Number
from ctrplan.base.long_work import INTERRUPTED, interrupt_event
from ctrplan.commands.options import add_number, add_output_option, add_plan_arguments, read_plan
from ctrplan.commands.terminal import ProgressBar, tell_next, typed
from ctrplan.storage.output_folder import output_folder

if TYPE_CHECKING:
    from ctrplan.audit.audited_plan import WorstFigure
    from ctrplan.audit.verify import Verification

DEFAULT_FOLDER = "counterexample"
TIME = Number(0, 86400, "s", above=True)

DESCRIPTION = (
    "Compute the figures of a plan.json anew, and hunt for a state or a history that breaks what its "
    "certificate claims, apart from planner and certificate. What breaks it is written as a scene."
)
EXAMPLES = """The trajectory is trajectory.csv beside PLAN.json. Without SCENARIO.toml the plan says which one it is.
Exit code 0: no claim was found broken; 1: one is; 2: the files are no plan of this scenario and robot.

examples:
  ctrplan verify out/plan.json
  ctrplan verify out/plan.json scenarios/vessel.toml --time 60 --seed 3
  ctrplan verify out/plan.json --accuracy exact -o broken --set robot.contact.1.friction_coefficient=0.3
"""
CLAIMS = {
    "clearance": "clearance",
    "bound": "friction error at its place",
    "worst bound": "largest friction error",
    "predicted": "predicted friction error",
    "stability": "least stability",
    "strain": "largest strain",
}
UNITS = {"stability": (1.0, ""), "strain": (100.0, " %")}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    add_output_option(parser, "folder for a counter-example", DEFAULT_FOLDER)
    add_number(parser, "--time", TIME, metavar="S", help="seconds until which the hunt goes on, when its work is done")
    add_number(parser, "--seed", SEED, default=0, help="seed of the hunt (default: %(default)s)")
    parser.add_argument(
        "--accuracy",
        choices=["search", "certificate", "exact"],
        default="certificate",
        help="mesh on which findings count (default: %(default)s)",
    )
    add_plan_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for what is no plan."""
    with interrupt_event() as interrupted:
        from ctrplan.audit.scene import outputs, write_scene
        from ctrplan.audit.verify import WORK, verify

        plan = read_plan(arguments)
        folder = output_folder(arguments.output, list(outputs(plan.scenario)))
        with ProgressBar(quiet=arguments.quiet) as bar:
            result = verify(
                plan,
                seed=arguments.seed,
                work=WORK,
                time_s=arguments.time,
                accuracy=arguments.accuracy,
                progress=bar.show,
                interrupted=interrupted,
            )
        print("\n".join(_report(result)))
        if result.is_kept:
            plan_file = typed(arguments.plan)
            frame = "" if result.plan.scenario.frame else " --frame RAS (or LPS, if the anatomy is in that)"
            tell_next(
                f"ctrplan render {plan_file} -o motion.gif; ctrplan export {plan_file} --to slicer -o scene{frame}"
            )
        if (outcome := result.counterexample) is not None:
            commands = write_scene(folder, result, outcome)
            print(
                "\n  ".join(
                    [
                        f"a scene of the broken {outcome.claim} is in {folder}; look at it, and replay it, with",
                        *commands,
                    ]
                )
            )
        return 1 if not result.is_kept else INTERRUPTED if result.interrupted else 0


def _report(result: Verification) -> Iterator[str]:
    name = result.plan.scenario.name
    verdict = "no claim was found broken" if result.is_kept else "the certificate does not hold"
    yield f"{name}: {verdict}{', interrupted' if result.interrupted else ''}"
    if result.refusal:
        yield f"  {result.refusal}"
    if result.unchecked:
        yield f"  figures were not computed anew: {result.unchecked}"
    yield from (f"  {sentence}" for sentence in result.missed)
    for difference in result.differences:
        yield f"  {difference.sentence}"
    yield from (_line(finding) for finding in result.worst)
    yield from (f"{_line(outcome)}, which is not claimed" for outcome in result.beside)
    if result.snaps:
        yield f"  simulated robots snapped {result.snaps} times"


def _line(figure: WorstFigure) -> str:
    factor, unit = UNITS.get(figure.claim, (1e3, " mm"))
    stated = "nothing" if figure.stated != figure.stated else f"{factor * figure.stated:.2f}{unit}"
    broken = "BROKEN: " if figure.is_broken else ""
    within = f" (meshes may differ by {factor * figure.allowance:.2f})" if figure.excess > 0 and not broken else ""
    figures = f"{broken}{factor * figure.value:.2f}{unit} found, {stated} claimed{within}"
    return f"  {CLAIMS[figure.claim]:32} {figures}; {figure.where}, {figure.how}"
