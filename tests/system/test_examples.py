"""The examples as a reader runs them, each with a number that must come out."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

EXAMPLES = ROOT / "examples"
GOLDEN = {
    "01_bound.py": (r"^bound: ([\d.]+) mm", 17.81, 0.05),  # tips of tests/reference/three_tube_points.json
    "02_plan.py": (r"^bound at the goal: ([\d.]+) mm", 8.25, 0.02),
    "03_reorder.py": (r"^cost: [\d.]+ mm before, ([\d.]+) mm after", 219.2, 0.5),
    "04_ompl.py": (r"path with friction costs ([\d.]+) mm", 229.6, 1.0),
    "05_sweep_with_executor.py": (r"^largest bound: ([\d.]+) mm", 26.18, 0.1),
}


def test_every_example_is_tested_and_short() -> None:
    files = sorted(EXAMPLES.glob("*.py"))
    assert [file.name for file in files] == sorted(GOLDEN)
    assert all(len(file.read_text().splitlines()) < 40 for file in files)


@pytest.mark.parametrize("name", GOLDEN)
def test_example(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLES / name)]
    environment = {**os.environ, "CTRPLAN_LEAK_WARNINGS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=120, env=environment)
    assert done.returncode == 0 and "leaked" not in done.stderr, done.stderr
    pattern, golden, tolerance = GOLDEN[name]
    found = re.search(pattern, done.stdout, re.MULTILINE)
    assert found is not None, done.stdout
    assert float(found[1]) == pytest.approx(golden, abs=tolerance)
    assert not list(tmp_path.iterdir())
