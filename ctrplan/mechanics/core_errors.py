"""What the core refuses, as the errors of this package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ctrplan import _model
from ctrplan.errors import InputError


@contextmanager
def input_errors() -> Iterator[None]:
    """Turns the core's refusals into InputError."""
    try:
        yield
    except _model.InvalidInput as refusal:
        raise InputError(str(refusal)) from None
