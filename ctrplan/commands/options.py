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


def add_allow_outside_option(parser: argparse.ArgumentParser) -> None:
    """Adds --allow-outside, for scenarios whose robot and meshes lie elsewhere."""
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="read files that the scenario names although they lie outside its folder",
    )
