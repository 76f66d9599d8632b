"""`ctrplan bound` ends in time, whatever robot a file may hold, and says which corners it leaves out."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hard_robots import content
from made_up_input import FUZZ

from ctrplan.__main__ import main
from ctrplan.files.robot_file import write_robot
from ctrplan.mechanics.core import MOST_TUBES_OF_ALL_CORNERS

LONGEST_S = 30.0  # of a processor: a bound of some seconds, and what corners that are hard to reach are granted
ROBOTS = 400 if FUZZ else 4


def command(file: Path, n: int, random: np.random.Generator) -> list[str]:
    angles = [f"{angle:.3f}" for angle in random.uniform(-180, 180, n)]
    places = [f"{place:.3f}" for place in -np.concatenate([[0.0], np.cumsum(random.uniform(1, 15, n - 1))])]
    return ["bound", str(file), "--theta-deg", *angles, "--l-mm", *places, "--accuracy", "search"]


def slender(tubes: int) -> dict[str, object]:
    """A robot of many tubes, each within the one before."""
    made = [
        {
            "outer_diameter_mm": 1.0 + 0.5 * (tubes - 1 - i),
            "inner_diameter_mm": 0.7 + 0.5 * (tubes - 1 - i),
            "bending_stiffness_Nm2": 0.01 * 1.6 ** (tubes - 1 - i),
            "poisson_ratio": 0.3,
            "section": [{"length_mm": 60 + 15 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 3.0 + i}],
        }
        for i in range(tubes)
    ]
    return {"tube": made, "contact": [{"friction_coefficient": 0.2}] * (tubes - 1)}


@pytest.mark.parametrize("tubes", [2, MOST_TUBES_OF_ALL_CORNERS + 1])
def test_corners_that_are_left_out_are_said(tubes: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_robot(tmp_path / "robot.toml", slender(tubes))
    places = [str(-6 * i) for i in range(tubes)]
    turns = [str(40 * i) for i in range(tubes)]
    given = ["bound", str(tmp_path / "robot.toml"), "--theta-deg", *turns, "--l-mm", *places, "--accuracy", "search"]
    assert main(given) in (0, 1)
    said = f"the extreme ones of {2 ** (tubes - 1)} corners" in capsys.readouterr().err
    assert said == (tubes > MOST_TUBES_OF_ALL_CORNERS)


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_no_robot_keeps_the_command(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An answer or one sentence; frictionless and corner solves that are hard to reach are given up in time."""
    random = np.random.default_rng(seed)
    n = 3 + seed % 4
    write_robot(tmp_path / "robot.toml", content(n, random))
    begun = time.process_time()
    code = main(command(tmp_path / "robot.toml", n, random))
    assert code in (0, 1), capsys.readouterr().err
    assert time.process_time() - begun < LONGEST_S
