"""Options of commands that send poses over OpenIGTLink."""

from __future__ import annotations

import argparse

from ctrplan.base.arguments import Whole
from ctrplan.commands.options import add_number

USUAL_PORT = 18944


def add_igtl_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds --igtl."""
    add_number(
        parser,
        "--igtl",
        Whole(0, 65535),
        metavar="PORT",
        help=f"send {what} over OpenIGTLink, on this port of 127.0.0.1 (usually {USUAL_PORT}; 0: a free one)",
    )
