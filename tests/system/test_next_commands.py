"""What a command proposes next can be typed as it stands, whatever files are called and wherever they lie."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import ctrplan
from ctrplan.__main__ import main

FIXTURE = """
[[fixture]]
kind = "capsule"
from_mm = [0, 0, -120]
to_mm = [0, 0, -12]
radius_mm = 4
[[anatomy]]
kind = "sphere"
center_mm = [0, 0, -50]
radius_mm = 10
role = "avoid"
"""


def proposed(capsys: pytest.CaptureFixture[str], *command: str, code: int = 0) -> list[list[str]]:
    """The words of each command after "next:"."""
    capsys.readouterr()
    assert main([*command]) == code
    line = re.search(r"next: (.*)", capsys.readouterr().out)
    assert line is not None
    return [shlex.split(re.split(r",? (?=a slider|to bring)", text)[0], posix=True) for text in line[1].split("; ")]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "a b (ü)").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path / "a b (ü)"


def test_names_are_quoted_as_a_shell_needs_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, task = "a b (ü)/it's.toml", "a b (ü)/my task.toml"
    assert proposed(capsys, "init", "robot", robot) == [["ctrplan", "check", robot]]
    assert [words[-1].rstrip(",") for words in proposed(capsys, "check", robot)] == [robot, robot]
    begun = proposed(capsys, "init", "scenario", task, "--robot", robot)
    assert begun == proposed(capsys, "check", task) == [["ctrplan", "plan", task, "-o", "out"]]
    point = ["--theta-deg", "0", "0", "0", "--l-mm", "0", "-17", "-40"]
    assert robot in proposed(capsys, "bound", robot, *point)[0][-1]


def test_a_scenario_with_files_elsewhere_is_proposed_with_the_option_that_it_needs(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["init", "robot", "robot.toml"]) == 0
        and main(["init", "scenario", "task.toml", "--robot", "robot.toml"]) == 0
    )
    other = folder / "task.toml"
    other.write_text(Path("task.toml").read_text().replace('"robot.toml"', '"../robot.toml"'))
    words = proposed(capsys, "check", str(other))[0]
    assert words == ["ctrplan", "plan", str(other), "--allow-outside", "-o", "out"]
    assert main(["plan", str(other), "-o", "out"]) == 2
    assert "unless --allow-outside is given" in capsys.readouterr().err
    few = ["--candidates", "4", "--confirm", "1", "--radius-mm", "0", "--cone-deg", "0", "--quiet"]
    placed = str(folder / "placed.toml")
    words = proposed(capsys, "place", "task.toml", *few, "-o", placed)[0]
    assert words == ["ctrplan", "plan", placed, "--allow-outside", "-o", "out"]


def test_check_doubts_a_fixture_that_plan_refuses(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["init", "robot", "robot.toml"]) == 0
        and main(["init", "scenario", "task.toml", "--robot", "robot.toml"]) == 0
    )
    task = Path("task.toml")
    task.write_text(task.read_text() + FIXTURE)
    flags = ctrplan.check(task).flags
    assert len(flags) == 1 and "fixture.1 (capsule): is 14.0" in flags[0]
    assert main(["plan", "task.toml", "-o", "out"]) == 1
    assert "fixture.1 (capsule): is 14.0" in capsys.readouterr().err
