"""What the core refuses, as the errors of this package."""

from __future__ import annotations

from typing import Any

from ctrplan import _model
from ctrplan.errors import InputError


class input_errors:
    """Turns the core's refusals into InputError."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, _model.InvalidInput):
            raise InputError(str(error)) from None
