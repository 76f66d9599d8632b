"""Files are data: nothing in them is run, nothing outside their folder is read, nothing goes to the network."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from measured_data import measured, pair_robot, waypoints, write_csv
from places import SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.diagnosis import CATALOGUE
from ctrplan.errors import InputError
from ctrplan.files.robot_file import write_robot
from ctrplan.files.scenario_file import load_scenario

PACKAGE = Path(ctrplan.__file__).parent
RUNS_ITS_INPUT = {"eval", "exec", "compile", "__import__", "system", "popen", "load_module", "unsafe_load"}
HOSTILE = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"
# Runs the command line with every way to the network closed; a try ends the process with 99.
OFFLINE = """
import os, socket, sys
def refuse(*arguments, **keys):
    print("used the network:", arguments, file=sys.stderr, flush=True)
    os._exit(99)
socket.socket.connect = socket.socket.connect_ex = socket.socket.sendto = socket.socket.bind = refuse
socket.create_connection = socket.getaddrinfo = socket.gethostbyname = refuse
from ctrplan.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


@cache
def calls() -> list[tuple[str, str, str]]:
    """(file, called name, source line) of every call in the package."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                found.append((path.name, name, text.splitlines()[node.lineno - 1]))
    return found


def test_no_code_is_made_from_text() -> None:
    used = {(file, name) for file, name, line in calls() if name in RUNS_ITS_INPUT and "re.compile" not in line}
    assert not used


PICKLING = {
    "walk.py",
    "search.py",
    "space.py",
    "study.py",
    "engine.py",
    "study_definition.py",
}


def test_pickles_come_from_the_process_itself_only() -> None:
    """Tasks of an executor are pickled; files and caches never are."""
    assert {path.name for path in PACKAGE.rglob("*.py") if "import pickle" in path.read_text("utf-8")} == PICKLING
    assert not [line for _, name, line in calls() if name == "load" and "np." in line]  # its archives may


@pytest.mark.parametrize("key", ["robot", "mesh"])
@pytest.mark.parametrize("way", ["above", "absolute", "link"])
def test_files_outside_the_scenarios_folder_need_permission(key: str, way: str, tmp_path: Path) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "case"
    outside.mkdir()
    (folder / "robots").mkdir(parents=True)
    (folder / "meshes").mkdir()
    names = {"robot": "robots/three_tube.toml", "mesh": "meshes/ribs.stl"}
    for name in names.values():
        (folder / name).write_bytes((SCENARIOS / name).read_bytes())
    moved = outside / Path(names[key]).name
    (folder / names[key]).rename(moved)
    named = {"above": f"../outside/{moved.name}", "absolute": str(moved), "link": "link"}[way]
    if way == "link":
        named = f"link{moved.suffix}"
        (folder / named).symlink_to(moved)
    text = (SCENARIOS / "ribs.toml").read_text().replace(names[key], named)
    (folder / "ribs.toml").write_text(text)
    with pytest.raises(InputError, match="must lie in the folder of this file or below"):
        load_scenario(folder / "ribs.toml")
    assert load_scenario(folder / "ribs.toml", allow_outside=True).anatomy
    target = ["ik", str(folder / "ribs.toml"), "--tip-mm", "34", "-47", "9000", "--starts", "1"]
    assert main(target) == 2 and main([*target, "--allow-outside"]) == 1  # read, and out of reach


def test_plan_and_its_report_need_no_network_and_show_hostile_names_as_text(tmp_path: Path) -> None:
    (tmp_path / "robots").mkdir()
    robot = (SCENARIOS / "robots" / "table_5_pair.toml").read_text()
    (tmp_path / "robots" / "table_5_pair.toml").write_text(f"name = '{HOSTILE}'\n" + without_name(robot))
    scenario = (SCENARIOS / "pair_free.toml").read_text()
    (tmp_path / "case.toml").write_text(f"name = '{HOSTILE}'\n" + without_name(scenario))
    done = offline("plan", str(tmp_path / "case.toml"), "--set", "planner.time_s=0.2", "-o", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["certificate"]["valid"]
    assert_harmless((tmp_path / "out" / "report.html").read_text())


def test_diagnose_and_its_report_need_no_network_and_show_hostile_names_as_text(tmp_path: Path) -> None:
    robot = pair_robot(name=HOSTILE)
    write_robot(tmp_path / "robot.toml", dict(robot.content))
    name = HOSTILE.replace("/", "").replace(">", "&gt;") + ".csv"
    write_csv(tmp_path / name, measured(robot, waypoints(robot, 16)))
    quick = [f"--without={effect}" for effect in CATALOGUE if effect not in ("backlash", "tip_load")]
    given = [str(tmp_path / "robot.toml"), str(tmp_path / name), "-o", str(tmp_path / "out"), *quick]
    done = offline("diagnose", *given)
    assert done.returncode == 0, done.stderr
    assert_harmless((tmp_path / "out" / "report.html").read_text())


def without_name(text: str) -> str:
    """The file without its name and the comments above it."""
    lines = text.splitlines()
    return "\n".join(line for k, line in enumerate(lines) if not (line.startswith("name") and k < 12))


def offline(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", OFFLINE, *arguments], capture_output=True, text=True, env=dict(os.environ)
    )


def assert_harmless(page: str) -> None:
    assert "<img" not in page and "<script>alert" not in page
    assert "alert(2)" in page, "the name is shown, as text"
