"""`ctrplan init`: a robot, scenario or mapping file to begin with."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ctrplan.commands.options import refuse_alone
from ctrplan.commands.terminal import typed
from ctrplan.errors import InputError

# Drawn nitinol tubes as makers list them, outer x inner diameter in mm; each fits into the ones before it.
CATALOGUE = (
    *("2.90x2.60", "2.64x2.39", "2.50x2.20", "2.305x2.05", "2.305x1.95", "2.10x1.85", "1.95x1.65", "1.825x1.60"),
    *("1.75x1.50", "1.60x1.35", "1.50x1.20", "1.40x1.15"),
)
OPTIONS = {"robot": ("tube", "name"), "scenario": ("robot", "mesh", "unit"), "mapping": ("robot", "table")}  # of kinds
DESCRIPTION = (
    "Write a file to begin with, commented and ready to run: a robot from tubes, a scenario for a robot, or a mapping "
    "file for a table of measurements, whose columns are guessed by their names."
)
EXAMPLES = """examples:
  ctrplan init robot robot.toml                    # three nitinol tubes
  ctrplan init robot robot.toml --tube 2.64x2.39,0,150,265 --tube 1.825x1.60,100,86,55
  ctrplan init scenario task.toml --robot robot.toml
  ctrplan init scenario task.toml --robot robot.toml --mesh organ.stl --unit mm
  ctrplan init mapping map.toml --table log.csv --robot robot.toml

A tube is OUTERxINNER,STRAIGHT,BENT,RADIUS in mm, outermost first. Drawn nitinol tubes that makers list: {catalogue}.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.epilog = EXAMPLES.format(catalogue=", ".join(CATALOGUE))
    parser.add_argument("kind", choices=tuple(OPTIONS), help="what to write")
    parser.add_argument("file", metavar="FILE.toml", help="where to; must not be there yet")
    parser.add_argument("--tube", action="append", metavar="OxI,S,B,R", help="of a robot, outermost first; repeatable")
    parser.add_argument("--name", help="of a robot (default: my robot)")
    parser.add_argument("--robot", metavar="ROBOT.toml", help="that a scenario or measurements are of")
    parser.add_argument("--mesh", metavar="FILE", help="of a scenario: what to avoid, or the lumen around it")
    parser.add_argument("--unit", choices=("mm", "cm", "m", "in"), help="of the mesh (default: mm, of glTF m)")
    parser.add_argument("--table", metavar="FILE.csv", help="of a mapping file: the measurements")


def run(arguments: argparse.Namespace) -> int:
    """Runs the command; returns its exit code. Raises InputError for a file that is there and what does not fit."""
    from ctrplan.storage.output_folder import write_atomically

    path = Path(arguments.file)
    if path.suffix.lower() != ".toml":
        raise InputError("must end with .toml, by which other commands know it", key="FILE", value=arguments.file)
    if path.exists():
        raise InputError("is there already: name another file, nothing is written over", file=arguments.file)
    for name in sorted({name for names in OPTIONS.values() for name in names} - {*OPTIONS[arguments.kind]}):
        if getattr(arguments, name) is not None:
            kinds = " or ".join(kind for kind, names in OPTIONS.items() if name in names)
            raise InputError(f"goes with init {kinds}, not with {arguments.kind}", key=f"--{name}")
    if arguments.mesh is None:
        refuse_alone({"--unit": arguments.unit}, "--mesh")
    text, following = _text(arguments, path)
    write_atomically(path, text)
    print(f"written to {path}; next: {following}")
    return 0


def _text(arguments: argparse.Namespace, path: Path) -> tuple[str, str]:
    """The file's text, and the command to go on with."""
    from ctrplan.files.robot_file import load_robot, robot_from_dict
    from ctrplan.files.starting_files import NO_ROOM, USUAL, mapping_text, robot_text, scenario_text, tube_choice
    from ctrplan.storage.toml_document import Document, parsed_toml

    if arguments.kind == "robot":
        tubes = [tube_choice(text) for text in arguments.tube] if arguments.tube else USUAL
        text = robot_text(tubes, "my robot" if arguments.name is None else arguments.name)
        robot_from_dict(parsed_toml(text, str(path)), file=str(path))  # refuses tubes that don't fit
        return text, f"ctrplan check {typed(path)}"
    if arguments.robot is None:
        raise InputError(f"is needed: whose {arguments.kind} it is", key="--robot")
    robot = load_robot(arguments.robot)
    if arguments.kind == "mapping":
        if arguments.table is None:
            raise InputError("is needed: the CSV file of measurements", key="--table")
        if Path(arguments.table).resolve().parent != path.resolve().parent:
            raise InputError("must be in the folder of its table", key="FILE", value=str(path))
        return mapping_text(arguments.table, robot), f"ctrplan check {typed(path)} --robot {typed(arguments.robot)}"
    inside = [
        _beside(name, path, key) for key, name in (("--robot", arguments.robot), ("--mesh", arguments.mesh)) if name
    ]
    text = scenario_text(robot, inside[0], inside[1] if arguments.mesh else None, arguments.unit, str(path))
    Document(parsed_toml(text, str(path)), str(path))
    return (
        text,
        f"say in it where the base is, ctrplan check {typed(path)}"
        if NO_ROOM in text
        else f"ctrplan plan {typed(path)} -o out",
    )


def _beside(name: str, path: Path, key: str) -> str:
    """A file as a scenario at `path` names it. Raises InputError unless it lies in its folder or below."""
    folder = path.resolve().parent
    if not Path(name).is_file():
        raise InputError("does not exist", key=key, value=name)
    if not Path(name).resolve().is_relative_to(folder):
        raise InputError(f"must lie in the folder of {path.name} or below: copy it there", key=key, value=name)
    return Path(os.path.relpath(Path(name).resolve(), folder)).as_posix()
