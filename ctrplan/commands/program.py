"""The command line: what `ctrplan --help` lists. Every failure is one sentence on stderr and an exit code."""

from __future__ import annotations

import argparse
import difflib
import errno
import io
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, NoReturn

import ctrplan
from ctrplan.errors import CtrplanError, InputError

# The commands in the order of `ctrplan --help`, with what it says of each. The module of that name in
# ctrplan.commands is imported when its command is given: DESCRIPTION and EXAMPLES are for its own help,
# `add_options(parser)` adds its arguments, `run(arguments)` returns the exit code.
COMMANDS = {
    "plan": "plan a certified motion and write a trajectory for the drive",
    "case": "a patient's scan and points to a certified plan: scenario, base, plan, report, 3D Slicer's scene",
    "verify": "judge a written plan: hunt for what breaks its certificate",
    "compare": "two plans side by side: figures, curves, the tip's way",
    "render": "a plan's motion as MP4 or GIF",
    "export": "write a plan for 3D Slicer: curves, models, a sequence over time, a scene",
    "init": "write a robot, scenario or mapping file to begin with, commented and ready to run",
    "check": "what a file says, in numbers that a person knows; names what is in another unit",
    "bound": "bound the friction error at one configuration, or over a sweep",
    "ik": "every way to bring the tip to a point, with the friction bound of each",
    "place": "where the robot could stand: base poses for a scenario's targets, ranked",
    "simulate": "predict what friction does to the tip along a joint path",
    "study": "thousands of bounds, plans or goals over what varies, on this machine or a cluster",
    "design": "which tubes to make: error whatever friction does, reach and stability for a set of targets",
    "calibrate": "fit named parameters of a robot file to measured poses",
    "diagnose": "find which effect the model lacks, from measured poses",
    "view": "the robot in a browser, with a slider for every joint",
}
GONE = {"field": "is no command any more: the search solves every bound, which takes about a millisecond"}

# What looks like an option but is a value: -17e0, -1,+1, -.5, -inf. No option of ours begins like this.
NEGATIVE_VALUE = re.compile(r"-(\.?\d|inf|nan)")


class CommandLine(argparse.ArgumentParser):
    """A parser, of the program or of one of its commands."""

    def __init__(self, *arguments: Any, **keys: Any) -> None:
        """Arguments of argparse.ArgumentParser."""
        super().__init__(*arguments, **keys)
        self._negative_number_matcher = NEGATIVE_VALUE  # before Python 3.14 argparse knows -17 and -0.5 only

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parses as argparse does; the command refuses what is left over. Raises InputError."""
        result, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"{' '.join(rest)}: is not known here")
        return result, rest

    def error(self, message: str) -> NoReturn:
        """Raises InputError, with where to look for help."""
        message = message.removeprefix("argument ").replace("-o/--output", "--output")
        if (wrong := re.match(r"COMMAND: invalid choice: '(.*?)'", message)) is not None:
            meant = difflib.get_close_matches(wrong[1], COMMANDS, n=1)
            message = message.replace(" (choose", f"{f', did you mean {meant[0]}?' if meant else ''} (choose", 1)
        raise InputError(f"{message} (see {self.prog} --help)")


class CommandParser(CommandLine):
    """The parser of a command, whose module is imported when the command is given."""

    def __init__(self, command: str, **keys: Any) -> None:
        """command: its name. keys: of argparse.ArgumentParser."""
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **keys)
        self._command, self._is_filled = command, False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parses as CommandLine does, with the command's own arguments."""
        if not self._is_filled:
            self._is_filled = True
            command = import_module(f"ctrplan.commands.{self._command}")
            self.description, self.epilog = command.DESCRIPTION, command.EXAMPLES
            command.add_options(self)
            self.set_defaults(run=command.run)
        return super().parse_known_args(args, namespace)


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns its exit code. Raises KeyboardInterrupt where Ctrl-C left no result."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name the terminal can't show must not end the program
    is_shown = _standard_streams_are_open()
    try:
        given = sys.argv[1:] if arguments is None else arguments
        _refuse_gone(given)
        if not all(argument.isascii() for argument in given):
            from ctrplan.base.arguments import refuse_other_text

            for argument in given:
                refuse_other_text(argument)
        parsed = parser().parse_args(arguments)
        code = int(parsed.run(parsed))
        if not is_shown:
            raise OSError(errno.EBADF, "standard output is closed")
        sys.stdout.flush()
        return code
    except CtrplanError as error:
        print(f"ctrplan: {error}", file=sys.stderr)
        if (defect := getattr(error, "defect", None)) is not None:  # a mesh is refused because of a place in it
            from ctrplan.reports.plan_picture import tell_picture

            tell_picture(defect)
        return error.exit_code
    except MemoryError:
        print("ctrplan: there is not enough memory for this.", file=sys.stderr)
        return CtrplanError.exit_code
    except BrokenPipeError:  # the reader of our output went away
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.filename is not None:  # none of ours: those of files have sentences of their own
            print(f"ctrplan: {os.fsdecode(error.filename)}: {error.strerror or error}.", file=sys.stderr)
            return 1
        with suppress(OSError):  # it was closed
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"ctrplan: could not print the result: {error.strerror or error}.", file=sys.stderr)
        return 1


def _standard_streams_are_open() -> bool:
    """Whether standard output leads anywhere. Where a stream is closed, nothing else may get its place.

    The next file that is opened would, and what libraries print would be written into it.
    """
    is_shown = sys.stdout is not None
    for name, number in (("stdin", 0), ("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            with suppress(OSError):
                os.fstat(number)
                continue
            while os.open(os.devnull, os.O_RDWR) < number:
                pass
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # print() would write to standard output what is for standard error
            setattr(sys, name, io.StringIO())
    return is_shown


def parser() -> CommandLine:
    """The parser of the program, with one for each of its commands."""
    program = CommandLine(prog="ctrplan", description=(ctrplan.__doc__ or "").splitlines()[0])
    program.add_argument("--version", action="version", version=f"ctrplan {ctrplan.__version__}")
    commands = program.add_subparsers(required=True, metavar="COMMAND", parser_class=CommandParser)
    for name, sentence in COMMANDS.items():
        commands.add_parser(name, help=sentence, command=name)
    return program


def _refuse_gone(arguments: Sequence[str]) -> None:
    """Raises InputError for a command of an earlier version, with what is there in its place."""
    if arguments and arguments[0] in GONE:
        raise InputError(GONE[arguments[0]], key="COMMAND", value=arguments[0])
