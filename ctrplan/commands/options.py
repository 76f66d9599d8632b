"""Options that several commands share."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array


def add_set_option(parser: argparse.ArgumentParser, what: str, example: str = "tube.2.poisson_ratio=0.28") -> None:
    """Adds --set KEY=VALUE, which changes any key of an input file."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help=f"change {what}, e.g. {example}",
    )


def add_allow_outside_option(parser: argparse.ArgumentParser) -> None:
    """Adds --allow-outside, for scenarios whose robot and meshes lie elsewhere."""
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="read files that the scenario names although they lie outside its folder",
    )


def add_joint_options(parser: argparse.ArgumentParser) -> None:
    """Adds --theta-deg and --l-mm, a number per tube; configuration() reads them."""
    for option, metavar, what in (
        ("--theta-deg", "DEG", "commanded base rotations, outermost tube first"),
        ("--l-mm", "MM", "commanded base translations, outermost tube first, <= 0"),
    ):
        parser.add_argument(option, type=float, nargs="+", required=True, metavar=metavar, help=what)


def configuration(arguments: argparse.Namespace, n: int) -> tuple[Array, Array]:
    """Commanded rotations (n,) [rad] and translations (n,) [m] of the command line.

    Raises InputError unless there is a number per tube.
    """
    import numpy as np

    for key, values in (("--theta-deg", arguments.theta_deg), ("--l-mm", arguments.l_mm)):
        if len(values) != n:
            raise InputError(f"needs {n} values, one per tube, outermost first", key=key, value=values)
        if not all(map(math.isfinite, values)):
            raise InputError("must be finite", key=key, value=values)
    return np.radians(arguments.theta_deg), np.multiply(arguments.l_mm, 1e-3)
