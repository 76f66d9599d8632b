"""Options that several commands share."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import Number, Whole, in_plain_digits, require
from ctrplan.base.units import LONGEST_MM, MOST_TURNS_DEG
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
    turns = Number(-MOST_TURNS_DEG, MOST_TURNS_DEG, "deg")
    travel = Number(-LONGEST_MM, LONGEST_MM, "mm")
    for option, kind, metavar, what in (
        ("--theta-deg", turns, "DEG", "commanded base rotations, outermost tube first"),
        ("--l-mm", travel, "MM", "commanded base translations, outermost tube first, <= 0"),
    ):
        add_number(parser, option, kind, nargs="+", required=True, metavar=metavar, help=what)


def add_number(
    parser: argparse.ArgumentParser,
    option: str,
    kind: Number | Whole,
    *,
    short: str = "",
    **keys: Any,
) -> None:
    """Adds an option whose values, one or with nargs several, are numbers of a kind; keys are those of argparse.

    A value that is none is refused with the option, the value, the unit and the range.
    """

    def read(text: str) -> float:
        value = in_plain_digits(text, isinstance(kind, Whole))
        require(option, text if value is None else value, kind)
        return value  # type: ignore[return-value]  # `require` refuses what is no number

    parser.add_argument(*([short] if short else []), option, type=read, **keys)


def configuration(arguments: argparse.Namespace, n: int) -> tuple[Array, Array]:
    """Commanded rotations (n,) [rad] and translations (n,) [m] of the command line.

    Raises InputError unless there is a number per tube.
    """
    import numpy as np

    for key, values in (("--theta-deg", arguments.theta_deg), ("--l-mm", arguments.l_mm)):
        if len(values) != n:
            raise InputError(f"needs {n} values, one per tube, outermost first", key=key, value=values)
    return np.radians(arguments.theta_deg), np.multiply(arguments.l_mm, 1e-3)
