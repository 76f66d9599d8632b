"""Where things lie in the tree."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = ROOT / "scenarios"
ROBOTS = SCENARIOS / "robots"
REFERENCE = ROOT / "tests" / "reference"
