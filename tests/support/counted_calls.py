"""Which methods of the mechanics are called, for tests of what must not solve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.history import History


def count_calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the methods of the mechanics and its histories, in the order called from now on."""
    called: list[str] = []

    def counted(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            called.append(name)
            return method(*arguments, **options)

        return call

    for kind in (Mechanics, History):
        for name, method in vars(kind).items():
            if callable(method) and not name.startswith("_"):
                monkeypatch.setattr(kind, name, counted(name, method))
    return called
