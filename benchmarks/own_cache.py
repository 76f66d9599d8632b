"""A cache of the benchmarks' own: what a user has kept would change how long things take."""

from __future__ import annotations

import os
from pathlib import Path


def use_own_cache() -> None:
    """Keeps distance fields and friction laws under build/, where no bound field is ever put."""
    os.environ["CTRPLAN_CACHE_DIR"] = str(Path(__file__).resolve().parents[1] / "build" / "benchmark-cache")
