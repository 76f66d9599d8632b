"""Poses that went wrong are left out of a calibration's fits and errors, and named by row; clean data lose none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import SIGMA_M, measured, pair_robot, waypoints, write_csv
from numpy.typing import NDArray

from ctrplan.__main__ import main
from ctrplan.calibration.calibrate import Calibration, calibrate
from ctrplan.files.robot_file import write_robot
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
TRUE = {"calibration": {"precurvature_factor_1_1": 1.1, "stiffness_factor_2": 1.1, "poisson_ratio_2": 0.2}}
CLEAN = measured(ROBOT, waypoints(ROBOT, 12), TRUE)
LEFT_OUT = "Left out of all fits and figures"


def spoilt(poses: NDArray[np.int_], by_m: list[float]) -> Measurements:
    position = CLEAN.position_m.copy()
    position[poses] += by_m
    return replace(CLEAN, position_m=position)


def remarks(found: Calibration) -> list[str]:
    return [note for note in found.notes if note.startswith(LEFT_OUT)]


def test_poses_that_are_right_all_count() -> None:
    found = calibrate(ROBOT, CLEAN)
    assert not remarks(found) and found.held_out is not None
    assert found.training.poses + found.held_out.poses == found.nominal.poses == CLEAN.count


@pytest.mark.parametrize("by_m", [[0.0, 0.0, -0.15], [0.02, 0.0, 0.0]])
def test_poses_that_went_wrong_are_named_and_count_nowhere(by_m: list[float]) -> None:
    """A fit without them is the fit of data in which they do not exist."""
    poses = np.arange(4, CLEAN.count, 12)
    found = calibrate(ROBOT, spoilt(poses, by_m))
    assert found.held_out is not None
    assert found.training.poses + found.held_out.poses == found.nominal.poses == CLEAN.count - len(poses)
    assert max(found.training.max_m, found.held_out.max_m) < 8 * SIGMA_M and found.model_error_m < 4 * SIGMA_M
    for name, value in TRUE["calibration"].items():
        low, high = found.estimates[name].ci95
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low)  # 4 standard deviations
    (remark,) = remarks(found)
    rows = ", ".join(map(str, (CLEAN.rows[poses] + 1).tolist()))
    assert f"{len(poses)} of {CLEAN.count} poses (row {rows})" in remark
    furthest_mm = float(remark.split("up to ")[1].split(" mm")[0])
    assert furthest_mm == pytest.approx(np.linalg.norm(by_m) * 1e3, abs=10 * SIGMA_M * 1e3)


def test_where_many_are_far_off_the_model_is_wrong_and_not_they() -> None:
    found = calibrate(ROBOT, spoilt(np.arange(0, CLEAN.count, 5), [0.0, 0.0, -0.15]))
    assert not remarks(found) and found.training.max_m > 0.1


def test_the_command_says_which(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_robot(tmp_path / "pair.toml", dict(ROBOT.content))
    write_csv(tmp_path / "poses.csv", spoilt(np.array([7]), [0.1, 0.0, 0.0]))
    code = main(["calibrate", str(tmp_path / "pair.toml"), str(tmp_path / "poses.csv"), "-o", str(tmp_path / "out")])
    row = CLEAN.rows[7] + 1
    assert code == 0 and f"1 of {CLEAN.count} poses (row {row})" in capsys.readouterr().err


def test_what_both_approaches_show_is_the_models_and_not_the_poses() -> None:
    """Either of two approaches to a configuration, as the guide has them, is the other's companion."""
    data = CLEAN.subset(np.flatnonzero(np.arange(CLEAN.count) % 3 != 2))  # from both sides, without the oscillation
    both = np.flatnonzero(data.configuration == 7)
    position = data.position_m.copy()
    position[both] += [0.0, 0.006, 0.0]
    found = calibrate(ROBOT, replace(data, position_m=position))
    assert len(both) == 2 and not remarks(found)
    position[both[0]] = data.position_m[both[0]]  # one of them alone has no such excuse
    assert str(data.rows[both[1]] + 1) in remarks(calibrate(ROBOT, replace(data, position_m=position)))[0]
