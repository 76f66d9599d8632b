"""What the core refuses, as the errors of this package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ctrplan import _model
from ctrplan.errors import InputError, SolverError


@contextmanager
def input_errors() -> Iterator[None]:
    """Turns the core's refusals into InputError, and that it got no memory into SolverError."""
    try:
        yield
    except _model.InvalidInput as refusal:
        raise InputError(str(refusal)) from None
    except MemoryError:
        raise SolverError("there is not enough memory for so many solves at once") from None
