"""The guides: their files and commands, in the order of the page, do what the page says."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

from ctrplan.__main__ import main

GUIDES = ROOT / "docs" / "guides"
BLOCK = re.compile(
    r'^```(?P<language>\w+)(?: title="(?P<file>[^",]+)(?P<append>, appended)?")?\n(?P<text>.*?)^```$', re.M | re.S
)


def follow(page: str, folder: Path) -> dict[str, str]:
    """Saves the page's files and runs its commands in `folder`; what each command printed."""
    printed: dict[str, str] = {}
    for block in BLOCK.finditer((GUIDES / page).read_text(encoding="utf-8")):
        if block["language"] == "sh":
            printed |= {
                line: (typed if line.startswith("ctrplan ") else run)(line, folder)
                for line in block["text"].splitlines()
            }
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


def typed(line: str, folder: Path) -> str:
    """A command of ctrplan in this process; the search of a plan that the page only compares with is short."""
    _, *words = shlex.split(line)
    quick = ["--time", "0.3"] if "blind" in words else []
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as said:
        patch.chdir(folder)
        assert main([*words, *quick]) == 0, line
    return said.getvalue()


def number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, pattern
    return float(found[1])


def transcripts(page: str) -> list[str]:
    """What the page says that commands print: its indented blocks."""
    text = BLOCK.sub("", (GUIDES / page).read_text(encoding="utf-8"))
    return [line[4:].rstrip() for line in text.splitlines() if line.startswith("    ")]


def test_guides_show_what_commands_print_to_the_digit(
    planned: tuple[Path, dict[str, str]], diagnosed: dict[str, str]
) -> None:
    """Every line of a transcript is one that a command of its page printed."""
    for page, printed in (("plan_for_your_robot.md", planned[1]), ("diagnose.md", diagnosed)):
        said = {line.rstrip() for text in printed.values() for line in text.splitlines()}
        shown = transcripts(page)
        assert shown and [line for line in shown if line not in said] == []


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


@pytest.fixture(scope="module")
def diagnosed(planned: tuple[Path, dict[str, str]]) -> dict[str, str]:
    """What was printed to somebody who goes on with the second guide."""
    return follow("diagnose.md", planned[0])


def test_guide_from_a_miss_to_a_diagnosis(planned: tuple[Path, dict[str, str]], diagnosed: dict[str, str]) -> None:
    page = (GUIDES / "diagnose.md").read_text(encoding="utf-8")
    verdict = next(text for line, text in diagnosed.items() if line.startswith("ctrplan diagnose")).splitlines()
    assert verdict[0] in page
    lower, upper = map(float, re.findall(r"theta_2 = \S+ \((\S+) to (\S+)\)", verdict[1])[0])
    assert lower < 0.05 < upper
    ours, theirs = (next(text for line, text in p.items() if "bound" in line) for p in (planned[1], diagnosed))
    assert ours != theirs
