"""Options that several commands share."""

from __future__ import annotations

import argparse


def add_set_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds --set KEY=VALUE, which changes any key of an input file."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help=f"change {what}, e.g. tube.2.poisson_ratio=0.28",
    )
