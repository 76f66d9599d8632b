"""Nothing of the core outlives Python, whatever was asked of it, and memory does not grow."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from measured_data import measured, pair_robot, waypoints, write_csv
from places import ROOT
from small_scenarios import NEAR

from ctrplan.diagnosis import CATALOGUE
from ctrplan.files.robot_file import write_robot

SCENARIOS = ROOT / "scenarios"
PAIR, SCENARIO = str(SCENARIOS / "robots" / "table_5_pair.toml"), str(SCENARIOS / "pair_free.toml")
LEFT_OUT = sorted(set(CATALOGUE) - {"backlash", "tip_load", "friction"})
COMMANDS = {
    "bound": ["bound", PAIR, "--theta-deg", "0", "90", "--l-mm", "0", "-30"],
    "sweep": [
        "bound",
        PAIR,
        "--theta-deg",
        "0",
        "90",
        "--l-mm",
        "0",
        "-30",
        "--sweep",
        "theta_2=0:360:5",
        "-o",
        "sweep",
    ],
    "ik": ["ik", str(SCENARIOS / "robots" / "three_tube.toml"), "--tip-mm", "34", "-47", "200"],
    "simulate": ["simulate", PAIR, "path.csv", "-o", "simulate"],
    "plan": ["plan", SCENARIO, "--set", "planner.time_s=0.2", "--set", NEAR, "-o", "plan"],
    "calibrate": ["calibrate", "robot.toml", "data.csv", "-o", "calibrate", "--parameters", "tube.2.poisson_ratio"],
    "diagnose": ["diagnose", "robot.toml", "data.csv", "-o", "diagnose", *(f"--without={name}" for name in LEFT_OUT)],
    "refused": ["plan", SCENARIO, "--set", "goal.tip_mm=1"],
    "no answer": ["plan", SCENARIO, "--set", "goal.tip_mm=[900,0,0]"],
}
RUN = """
import json, sys
from ctrplan.__main__ import main
for arguments in json.loads(sys.argv[1]):
    main(arguments)
"""
HELD = """
import ctypes, ctrplan, sys
mechanics = ctrplan.load_robot(sys.argv[1]).mechanics
ctypes.pythonapi.Py_IncRef(ctypes.py_object(mechanics._model))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a robot, measurements of it and a joint path."""
    place = tmp_path_factory.mktemp("leaks")
    robot = pair_robot()
    write_robot(place / "robot.toml", dict(robot.content))
    write_csv(place / "data.csv", measured(robot, waypoints(robot, 18)))
    (place / "path.csv").write_text("theta_1_rad,theta_2_rad,l_1_m,l_2_m\n0,0,0,-0.03\n0,0.5,0,-0.03\n")
    return place


def messages(folder: Path, *command: str, asked: bool = True) -> str:
    """What a Python process says on stderr."""
    environment = {**os.environ} | ({"CTRPLAN_LEAK_WARNINGS": "1"} if asked else {})
    done = subprocess.run([sys.executable, "-c", *command], capture_output=True, text=True, cwd=folder, env=environment)
    return done.stderr


@pytest.mark.parametrize("is_answered", [True, False])
def test_commands_end_without_leaks(is_answered: bool, folder: Path) -> None:
    """One process for all that have an answer: what any of them leaks is told at its end."""
    refused = {"refused", "no answer"}
    names = COMMANDS.keys() - refused if is_answered else refused
    found = messages(folder, RUN, json.dumps([COMMANDS[name] for name in sorted(names)]))
    assert "leaked" not in found and "Traceback" not in found
    assert not found if is_answered else found.count("ctrplan: ") == len(refused)


def test_what_is_held_beyond_the_end_is_reported_to_those_who_ask(folder: Path) -> None:
    told = messages(folder, HELD, PAIR)
    assert "leaked 1 instances" in told and '"ctrplan._model.Model"' in told  # from 3.12 on no line of its own
    assert not messages(folder, HELD, PAIR, asked=False)


def test_memory_stays_flat(folder: Path) -> None:
    """The short form of benchmarks/run.py memory runs: half as many, of which half as much growth is allowed.

    What is allocated and not freed is counted, to the byte, Python's own objects among it: resident memory wanders by
    5 % with what an allocator keeps for later, which says nothing of leaks.
    """
    runner = [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--bare", "memory", "runs"]
    command = [*runner, "--plans", "6", "--bounds", "1000", "--growth", "0.025"]
    counted = {**os.environ, "PYTHONMALLOC": "malloc"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=counted)
    assert done.returncode == 0, done.stdout + done.stderr
