"""`ctrplan bound` says beforehand how long it takes, and takes no longer, whatever robot a file may hold."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest
from hard_robots import content
from made_up_input import FUZZ

from ctrplan.__main__ import main
from ctrplan.commands.bound import FEWEST_TUBES, HARD_S, LONG_S, states_visited
from ctrplan.files.robot_file import write_robot

TUBES = 8
RATIO = 4.0  # of the time said and taken: the machine is not ours alone
ROBOTS = 400 if FUZZ else 4


def command(file: Path, n: int, random: np.random.Generator) -> list[str]:
    angles = [f"{angle:.3f}" for angle in random.uniform(-180, 180, n)]
    places = [f"{place:.3f}" for place in -np.concatenate([[0.0], np.cumsum(random.uniform(1, 15, n - 1))])]
    return ["bound", str(file), "--theta-deg", *angles, "--l-mm", *places, "--accuracy", "search"]


def said_s(error: str) -> float:
    """What the command said before it started."""
    said = re.search(r"about (\d+) s", error)
    return float(said.group(1)) if said else LONG_S


def test_the_time_is_said_before_it_is_taken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However fast the machine: how long is long enough to be told is set to nothing."""
    monkeypatch.setattr("ctrplan.commands.bound.LONG_S", 0.0)
    tubes = [
        {
            "outer_diameter_mm": 1.0 + 0.5 * (TUBES - 1 - i),
            "inner_diameter_mm": 0.7 + 0.5 * (TUBES - 1 - i),
            "bending_stiffness_Nm2": 0.01 * 1.6 ** (TUBES - 1 - i),
            "poisson_ratio": 0.3,
            "section": [{"length_mm": 60 + 15 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 3.0 + i}],
        }
        for i in range(TUBES)
    ]
    write_robot(tmp_path / "eight.toml", {"tube": tubes, "contact": [{"friction_coefficient": 0.2}] * (TUBES - 1)})
    places = [str(-6 * i) for i in range(TUBES)]
    begun = time.process_time()
    code = main(
        ["bound", str(tmp_path / "eight.toml"), "--theta-deg", *map(str, range(0, 40 * TUBES, 40)), "--l-mm", *places]
    )
    took_s, error = time.process_time() - begun, capsys.readouterr().err
    assert code == 0 and f"{2 ** (TUBES - 1)} corners of {TUBES} tubes: about" in error
    assert took_s / RATIO < said_s(error) < RATIO * took_s + LONG_S


def test_what_is_soon_done_says_nothing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    write_robot(tmp_path / "robot.toml", content(2, random))
    assert main(command(tmp_path / "robot.toml", 2, random)) in (0, 1)
    assert " corners of " not in capsys.readouterr().err


def test_extremes_ask_for_fewer_states_from_some_number_of_tubes_on() -> None:
    assert all(states_visited(n, "extreme") < states_visited(n, "all") for n in range(7, 13))
    for corners in ("all", "extreme"):
        counts = [states_visited(n, corners) for n in range(2, 13)]
        assert counts == sorted(counts)


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_no_robot_keeps_the_command_longer_than_it_said(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An answer or one sentence; frictionless and corner solves that are hard to reach are given up in time."""
    random = np.random.default_rng(seed)
    n = 3 + seed % (FEWEST_TUBES - 2)
    write_robot(tmp_path / "robot.toml", content(n, random))
    begun = time.process_time()
    code = main(command(tmp_path / "robot.toml", n, random))
    took_s, error = time.process_time() - begun, capsys.readouterr().err
    assert code in (0, 1), error
    assert took_s < RATIO * said_s(error) + 2 * HARD_S
