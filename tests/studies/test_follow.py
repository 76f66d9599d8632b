"""`ctrplan simulate --measured`: a log followed by an observer."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot
from ctrplan.robot.slow_states import SlowParameter
from ctrplan.studies.follow import follow, followed_csv

PAIR = str(ROBOTS / "table_5_pair.toml")
NOISE_MM = 0.1
NOISE = [f"measurement.position_sigma_mm={NOISE_MM}", "measurement.tangent_sigma_deg=1"]
HEADER = "sequence,theta_1_rad,theta_2_rad,l_1_m,l_2_m,x_m,y_m,z_m,tx,ty,tz"


def log(robot: Robot, folder: Path, start: float, shift: Array | None = None) -> str:
    """Two runs of small steps, the first of which begins loaded."""
    lines = [HEADER]
    for run, phi in enumerate((start, 0.0)):
        phase = np.linspace(0, 2 * np.pi, 25)
        theta = np.column_stack([np.zeros(25), 1.2 + 0.1 * np.sin(phase)])
        l_b = np.column_stack([np.zeros(25), -0.06 + 0.2e-3 * np.sin(2 * phase)])
        path = robot.history((phi,)).follow(theta, l_b)
        tips = path.position_m + (np.zeros(3) if shift is None else shift)
        table = np.column_stack([np.full(25, run), theta, l_b, tips, path.tangent])
        lines += [",".join(f"{value:.9g}" for value in row) for row in table]
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(folder / "log.csv")


def test_the_command_says_what_the_observer_gains(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log(load_robot(PAIR), tmp_path, 1.0)
    overrides = [word for key in NOISE for word in ("--set", key)]
    assert main(["simulate", PAIR, path, "-o", str(tmp_path / "out"), "--measured", *overrides]) == 0
    said = capsys.readouterr()
    rows = list(csv.DictReader((tmp_path / "out" / "followed.csv").open()))
    inside = [
        float(row[f"low_{axis}_m"]) <= float(row[f"measured_{axis}_m"]) <= float(row[f"high_{axis}_m"])
        for row in rows
        for axis in "xyz"
    ]  # of coordinates one by one, as the intervals are
    assert f"{100 * np.mean(inside):.0f} % of the measured coordinates" in said.out
    assert "50 measured tips followed" in said.out and "with the observer" in said.out and said.err == ""
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"SHA256SUMS", "followed.csv", "followed.png"}
    assert (tmp_path / "out" / "followed.png").read_bytes()[:4] == b"\x89PNG"
    with open(tmp_path / "out" / "followed.csv", encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    off, without = (np.array([float(row[key]) for row in table]) for key in ("error_mm", "error_without_mm"))
    first = np.arange(50) < 25
    assert off[first][1:].max() < 2 * NOISE_MM < 0.3 * without[first][0]  # one tip tells how the run began
    assert without[~first].max() < 1e-3  # the second one begins as the simulation has it
    assert off[~first][1:].max() < 2 * NOISE_MM


def test_rows_that_are_set_aside_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(log(load_robot(PAIR), tmp_path, 0.4))
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[12].split(",")
    cells[5] = f"{float(cells[5]) + 0.05:.9g}"
    lines[12] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    overrides = [word for key in NOISE for word in ("--set", key)]
    assert main(["simulate", PAIR, str(path), "-o", str(tmp_path / "out"), "--measured", *overrides]) == 0
    assert "1, farther off than noise and friction explain: row 12\n" in capsys.readouterr().out
    table = list(csv.DictReader((tmp_path / "out" / "followed.csv").open()))
    assert [k for k, row in enumerate(table, start=1) if row["set_aside"] == "1"] == [12]


def test_what_the_sensor_does_is_taken_off(tmp_path: Path) -> None:
    shift = np.array([2e-3, -1e-3, 0.5e-3])
    robot = load_robot(PAIR, [*NOISE, "effects.base_misalignment={shift_x_mm=2,shift_y_mm=-1,shift_z_mm=0.5}"])
    assert Chain.of(robot).of_stage("sensor")
    result = follow(robot, load_measurements(log(robot, tmp_path, 0.0, shift), robot))
    assert result.error_without_m.max() < 1e-5
    assert result.error_m[1:].max() < 2e-3 * NOISE_MM


def test_slow_parameters_are_columns_of_the_table(tmp_path: Path) -> None:
    robot = load_robot(PAIR, NOISE)
    name = "contact.1.friction_coefficient"
    result = follow(robot, load_measurements(log(robot, tmp_path, 0.0), robot), slow=[SlowParameter(name, 0.1)])
    table = list(csv.DictReader(followed_csv(result).splitlines()))
    assert float(table[24][f"{name}_sigma"]) < float(table[0][f"{name}_sigma"])
    assert abs(float(table[-1][name]) - 0.2) < 2.5 * float(table[-1][f"{name}_sigma"])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--start", "+1"], "--start = '+1': does not go with --measured"),
        (["--histories", "0"], "--histories = 0: must be a whole number from 1 to 1000"),
        (["--offset-mm", "-1"], "--offset-mm"),
        (["--slow", "mu"], "--slow = 'mu': must be NAME=SIGMA"),
        (["--slow", "mu=0"], "sigma = 0.0: must be a number above 0"),
        ([*(w for k in NOISE for w in ("--set", k)), "--slow", "mu=1"], "mu: no such parameter of the robot"),
        ([], "noise: must be given"),
    ],
)
def test_refusals_are_one_sentence(
    options: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = log(load_robot(PAIR), tmp_path, 0.0)
    assert main(["simulate", PAIR, path, "-o", str(tmp_path / "out"), "--measured", *options]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1
