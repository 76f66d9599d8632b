"""Colour on a terminal, and nowhere else."""

from __future__ import annotations

import os
import sys

AMBER, PLAIN = "\033[33m", "\033[0m"


def amber(text: str) -> str:
    """The text in amber where a person reads standard output; as it is in files and pipes, and under NO_COLOR."""
    shown = sys.stdout is not None and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    return f"{AMBER}{text}{PLAIN}" if shown else text
