"""No robot that a file may hold keeps a command longer than docs/performance.md states.

Robots lie at the ends of what can be made, inputs are small; a few here, with CTRPLAN_FUZZ set
200 of each command and 10 of diagnose.
Whatever else is on the terminal than an answer or one sentence is a fault too: warnings are errors.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hard_robots import content
from made_up_input import FUZZ
from measured_data import waypoints, write_csv
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.files.scenario_file import load_robot_or_scenario
from ctrplan.reports.live_state import LiveState
from ctrplan.robot.robot import Robot

PAGE = SCENARIOS.parent / "docs" / "performance.md"
STATED = {
    name: (float(beforehand), float(each))
    for name, beforehand, each in re.findall(r"^\| `ctrplan ([a-z -]+)` \| (\d+) \| ([\d.]+) ", PAGE.read_text(), re.M)
}
STARTS, STEPS, ROWS, POSES, FITTED = 50, 5, 2, 3, 12
NOISE = {"measurement": {"position_sigma_mm": 0.5, "tangent_sigma_deg": 0.5}}
MOST_TUBES = {
    "calibrate": 4,
    "diagnose": 4,
}  # of others six; larger grids are refused
MANY = {"diagnose": 10}  # a minute each
SEEDS = {"ik": 2, "bound --sweep": 2, "simulate": 1, "calibrate": 1, "diagnose": 0, "view": 2}


def joints(robot: Robot, random: np.random.Generator) -> tuple[Array, Array]:
    """Angles [deg] and translations [mm] that nest."""
    places = -np.concatenate([[0.0], np.cumsum(random.uniform(1, 15, robot.n - 1))])
    return random.uniform(-180, 180, robot.n), places


def texts(values: Array) -> list[str]:
    return [f"{value:.4f}" for value in values]


def ik(file: Path, robot: Robot, random: np.random.Generator) -> float:
    point = texts(random.uniform([-60, -60, 10], [60, 60, 200]))
    told("ik", str(file), "--tip-mm", *point, "--starts", str(STARTS))
    return STARTS


def sweep(file: Path, robot: Robot, random: np.random.Generator) -> float:
    angles, places = map(texts, joints(robot, random))
    axis = f"theta_{robot.n}=-180:180:{STEPS}"
    results = ["-o", str(file.parent / "sweep")]
    told("bound", str(file), "--theta-deg", *angles, "--l-mm", *places, "--sweep", axis, *results)
    return STEPS


def simulate(file: Path, robot: Robot, random: np.random.Generator) -> float:
    names = [f"{kind}_{i + 1}_{unit}" for kind, unit in (("theta", "rad"), ("l", "m")) for i in range(robot.n)]
    rows = [joints(robot, random) for _ in range(ROWS)]
    lines = [",".join(texts(np.concatenate([np.radians(angles), places * 1e-3]))) for angles, places in rows]
    path = file.with_suffix(".csv")
    path.write_text("\n".join([",".join(names), *lines]) + "\n")
    told("simulate", str(file), str(path), "-o", str(file.parent / "simulation"))
    return ROWS


def fit(command: str) -> Callable[[Path, Robot, np.random.Generator], float]:
    """Measurements that no robot made: poses anywhere."""

    def measured(file: Path, robot: Robot, random: np.random.Generator) -> float:
        data = waypoints(robot, FITTED, seed=int(random.integers(1000)))
        reach_m, size = robot.tubes[-1].length_m, (len(data.rows), 3)
        towards = random.normal(size=size)
        anywhere = replace(
            data,
            position_m=random.uniform(-0.3, 0.3, size) * reach_m + [0, 0, 0.5 * reach_m],
            tangent=towards / np.linalg.norm(towards, axis=1, keepdims=True),
        )
        write_csv(file.with_suffix(".csv"), anywhere)
        told(command, str(file), str(file.with_suffix(".csv")), "-o", str(file.parent / command))
        return float(len(data.sequence))

    return measured


def view(file: Path, robot: Robot, random: np.random.Generator) -> float:
    state = LiveState(load_robot_or_scenario(file))
    low, high = np.array([[row["min"], row["max"]] for row in state.sliders()]).T
    for _ in range(POSES):
        state.at(random.uniform(low, high).tolist())
    return POSES


COMMANDS = {
    "ik": ik,
    "bound --sweep": sweep,
    "simulate": simulate,
    "calibrate": fit("calibrate"),
    "diagnose": fit("diagnose"),
    "view": view,
}
CASES = [(name, seed) for name in COMMANDS for seed in range(MANY.get(name, 200) if FUZZ else SEEDS[name])]


def told(*arguments: str) -> None:
    """An answer, or one sentence why there is none."""
    assert main(list(arguments)) in (0, 1, 2)


def test_every_command_has_a_stated_time() -> None:
    assert set(STATED) == set(COMMANDS)


@pytest.mark.parametrize(("command", "seed"), CASES)
def test_no_robot_keeps_a_command_longer_than_stated(
    command: str, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path / "cache"))
    random = np.random.default_rng(seed)
    write_robot(tmp_path / "robot.toml", content(2 + (seed + 4) % (MOST_TUBES.get(command, 6) - 1), random) | NOISE)
    robot = load_robot(tmp_path / "robot.toml")
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        size = COMMANDS[command](tmp_path / "robot.toml", robot, random)
    beforehand_s, each_s = STATED[command]
    assert time.process_time() - begun < beforehand_s + each_s * size
