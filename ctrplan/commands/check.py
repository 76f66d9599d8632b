"""`ctrplan check`: what a file says, in numbers that a person knows, with what is most likely in another unit."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from ctrplan.commands.terminal import tell_next, typed
from ctrplan.storage.output_folder import output_folder, write_results

DESCRIPTION = (
    "Look at a robot, a scenario, measurements or a plan: implied Young's modulus, radii, strain when straightened, "
    "clearances, the drive's travel, the largest friction error of some configurations and how many have several "
    "equilibria. What is most likely in another unit is marked by !, and the exit code is 1 then."
)
EXAMPLES = """examples:
  ctrplan check robot.toml
  ctrplan check robot.toml -o look          # tubes.png: the tubes to scale; bound.png: the largest friction error
  ctrplan check scenario.toml
  ctrplan check measurements.csv --robot robot.toml
  ctrplan check out/plan.json --json
"""
OUTPUTS = ("tubes.png", "bound.png")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", metavar="FILE", help="robot, scenario, measurements (CSV or mapping file) or plan")
    parser.add_argument("--robot", metavar="ROBOT.toml", help="that measurements are of")
    parser.add_argument("-o", "--output", metavar="DIR", help=f"folder for {' and '.join(OUTPUTS)}")
    parser.add_argument("--json", action="store_true", help="machine-readable output")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns 1 where something is in doubt. Raises CtrplanError for what is no such file."""
    from ctrplan.reports.check import check
    from ctrplan.reports.looks import png

    folder = output_folder(arguments.output, OUTPUTS) if arguments.output is not None else None
    result = check(arguments.file, robot=arguments.robot)
    content = {"name": result.name, "kind": result.kind, "flags": result.flags, "notes": result.notes, **result.facts}
    print(json.dumps(content, indent=1) if arguments.json else result.text)
    if not arguments.json:
        tell_next(_following(arguments, result.kind) if not result.flags else "mend what is marked, and check again")
    if folder is not None:
        write_results(folder, {f"{name}.png": png(figure) for name, figure in result.figures().items()})
        print(f"ctrplan: written to {folder}", file=sys.stderr)
    return 1 if result.flags else 0


def _following(arguments: argparse.Namespace, kind: str) -> str:
    """What to do with a file of that kind."""
    file, robot = typed(arguments.file), typed(arguments.robot)
    return {
        "robot": f"ctrplan init scenario task.toml --robot {file}; ctrplan view {file}, a slider for every joint",
        "scenario": f"ctrplan plan {file}{_outside(arguments.file) if kind == 'scenario' else ''} -o out",
        "measurements": f"ctrplan calibrate {robot} {file} -o calibrated; ctrplan diagnose {robot} {file} -o found",
        "plan": f"ctrplan verify {file}",
    }[kind]


def _outside(file: str) -> str:
    """The option without which a scenario is refused that names files outside its folder, which this command reads."""
    from ctrplan.files.file_content import names_files_outside
    from ctrplan.storage.toml_document import read_document

    return " --allow-outside" if names_files_outside(read_document(file), Path(file)) else ""
