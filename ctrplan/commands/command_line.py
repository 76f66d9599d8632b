"""A command line whose values may be negative, and whose refusals are one sentence."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from ctrplan.errors import InputError

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
        """As argparse, but what is left over is refused by the command that it was given to. Raises InputError."""
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"{' '.join(rest)}: is not known here")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Raises InputError, with where to look for help."""
        message = message.removeprefix("argument ").replace("-o/--output", "--output")
        raise InputError(f"{message} (see {self.prog} --help)")
