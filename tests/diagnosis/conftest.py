"""A diagnosis that does not look for a built term, for tests of what is named beside an error that nothing explains."""

from __future__ import annotations

import pytest
from unbuilt import build_nothing


@pytest.fixture
def without_building(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is built in this test."""
    build_nothing(monkeypatch)
