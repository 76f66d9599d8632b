"""The guides: their files and commands, in the order of the page, do what the page says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

GUIDES = ROOT / "docs" / "guides"
BLOCK = re.compile(
    r'^```(?P<language>\w+)(?: title="(?P<file>[^",]+)(?P<append>, appended)?")?\n(?P<text>.*?)^```$', re.M | re.S
)


def follow(page: str, folder: Path) -> dict[str, str]:
    """Saves the page's files and runs its commands in `folder`; what each command printed."""
    printed: dict[str, str] = {}
    for block in BLOCK.finditer((GUIDES / page).read_text(encoding="utf-8")):
        if block["language"] == "sh":
            printed |= {line: run(line, folder) for line in block["text"].splitlines()}
        else:
            save(folder / block["file"], block["text"], append=block["append"] is not None)
    return printed


def save(file: Path, text: str, append: bool) -> None:
    before = file.read_text(encoding="utf-8") + "\n" if append else ""
    file.write_text(before + text, encoding="utf-8")


def run(line: str, folder: Path) -> str:
    """A command as a reader types it, with this environment's programs first on the path."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        line, shell=True, capture_output=True, text=True, cwd=folder, timeout=300, env={**os.environ, "PATH": path}
    )
    assert done.returncode == 0, f"{line}: {done.stderr}"
    return done.stdout


def number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, pattern
    return float(found[1])


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The folder of somebody who has followed the first guide, and what was printed."""
    folder = tmp_path_factory.mktemp("reader")
    return folder, follow("plan_for_your_robot.md", folder)


def test_guide_from_a_robot_to_a_plan(planned: tuple[Path, dict[str, str]]) -> None:
    folder, printed = planned
    page = (GUIDES / "plan_for_your_robot.md").read_text(encoding="utf-8")
    assert len(printed) == 4
    plan = json.loads((folder / "out" / "plan.json").read_text(encoding="utf-8"))
    assert plan["certificate"]["valid"]
    worst = r"worst-case friction error +([\d.]+) mm at the goal"
    assert number(worst, printed["ctrplan plan task.toml -o out"]) == pytest.approx(number(worst, page), abs=0.05)
    shown = number(r"Here it is ([\d.]+) mm", page)
    bound = next(text for line, text in printed.items() if line.startswith("ctrplan bound"))
    assert number(r"friction error of the tip: ([\d.]+) mm", bound) == pytest.approx(shown, abs=0.05)


def test_guide_from_a_miss_to_a_diagnosis(planned: tuple[Path, dict[str, str]]) -> None:
    folder, _ = planned
    printed = follow("diagnose.md", folder)
    page = (GUIDES / "diagnose.md").read_text(encoding="utf-8")
    verdict = next(text for line, text in printed.items() if line.startswith("ctrplan diagnose")).splitlines()
    assert verdict[0] in page
    lower, upper = map(float, re.findall(r"theta_2 = \S+ \((\S+) to (\S+)\)", verdict[1])[0])
    assert lower < 0.05 < upper
    kept_aside = r"([\d.]+) mm rms calibrated"
    assert number(kept_aside, verdict[2]) == pytest.approx(number(kept_aside, page), abs=0.05)
    ours, theirs = (next(text for line, text in p.items() if "bound" in line) for p in (planned[1], printed))
    assert ours != theirs
