"""The examples as a reader runs them, each with a number that must come out."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from made_up_input import FUZZ
from places import ROOT

from ctrplan.diagnosis import CATALOGUE

EXAMPLES = ROOT / "examples"
GOLDEN = {
    "01_bound.py": (r"^bound: ([\d.]+) mm", 17.81, 0.05),  # tips of tests/reference/three_tube_points.json
    "02_plan.py": (r"^bound at the goal: ([\d.]+) mm", 8.25, 0.02),
    "03_reorder.py": (r"^cost: [\d.]+ mm before, ([\d.]+) mm after", 219.2, 0.5),
    "04_ompl.py": (r"path with friction costs ([\d.]+) mm", 229.6, 1.0),
    "09_in_code.py": (r"bound at the goal: ([\d.]+) mm", 0.95, 0.02),
    "10_least_bound_slsqp.py": (r"mm before, ([\d.]+) mm after", 0.98, 0.02),
    "11_follow_qp.py": (r"least clearance ([\d.]+) mm", 1.45, 0.02),
    "12_tip_tracker.py": (r"^largest distance left: ([\d.]+) mm", 0.05, 0.05),  # the tolerance is 0.1 mm
    "13_own_rrt_connect.py": (r"certified: True, cost ([\d.]+) mm", 210.0, 1.0),
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


NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


def notebooks() -> Any:
    spec = importlib.util.spec_from_file_location("notebooks", ROOT / "tools" / "notebooks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def texts(cell: dict[str, Any]) -> str:
    """What a cell prints, and shows as text."""
    parts = [out.get("text") or out["data"]["text/plain"] for out in cell["outputs"]]
    return "".join("".join(part) for part in parts)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_kept_in_it(path: Path, tmp_path: Path) -> None:
    kept = json.loads(path.read_text(encoding="utf-8"))
    text = path.read_text(encoding="utf-8").replace("range(48)", "range(24)")  # poses that are diagnosed
    if not FUZZ:
        others = sorted(set(CATALOGUE) - {"tip_load", "joint_scale"})
        text = text.replace("diagnose(robot, measurements)", f"diagnose(robot, measurements, without={others})")
    given = json.loads(text)
    made = notebooks().run(given, path.parent)
    cells = [(old, new) for old, new in zip(kept["cells"], made["cells"], strict=True) if old["cell_type"] == "code"]
    assert len(cells) >= 4 and kept["cells"][0]["cell_type"] == "markdown"
    for old, new in cells:
        assert bool(old["outputs"]) == bool(new["outputs"]), "".join(old["source"])
        if path.stem.startswith("06"):  # whose numbers no clock decides on
            assert texts(old) == texts(new)
    pictures = [out for old, _ in cells for out in old["outputs"] if "image/png" in out.get("data", {})]
    assert len(path.read_text()) < 600_000 and (pictures or "diagnosis" in path.stem)


def test_there_are_three_notebooks() -> None:
    assert len(NOTEBOOKS) == 3


def test_recipes_run_one_after_the_other(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 7
    code = "\n".join(blocks).replace('"tubes.png"', repr(str(tmp_path / "tubes.png")))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 0, done.stderr
    found = re.search(r"bound: ([\d.]+) mm before, ([\d.]+) mm after (\d+) evaluations", done.stdout)
    assert found is not None, done.stdout
    assert float(found[1]) > 15 and float(found[2]) < 1 and int(found[3]) < 60
    assert (tmp_path / "tubes.png").stat().st_size > 10_000
