"""How finely a robot is discretised, and on what geometry."""

from __future__ import annotations

from typing import Literal, get_args

from ctrplan.errors import InputError

Accuracy = Literal["search", "certificate", "exact"]
"""Mesh error of a tip on the Table III grid: 0.3, 0.05 mm; "exact" also drops the first order in the clearance."""


def known(accuracy: Accuracy) -> Accuracy:
    """The accuracy, if it is one. Raises InputError."""
    if accuracy not in get_args(Accuracy):
        raise InputError('must be "search", "certificate" or "exact"', key="accuracy", value=accuracy)
    return accuracy


def first_order(accuracy: Accuracy) -> Accuracy:
    """The accuracy, if it is one of the first order in the clearance. Raises InputError."""
    if accuracy == "exact":
        raise InputError('must be "search" or "certificate" here', key="accuracy", value=accuracy)
    return known(accuracy)
