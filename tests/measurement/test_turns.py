"""Rotations that were logged within one turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints, write_csv

from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements
from ctrplan.measurement.joint_path import TURN, looks_wrapped, unwrapped

ROBOT = pair_robot()
ONE_RUN = np.zeros(400, int)


@pytest.mark.parametrize("lowest", [-np.pi, 0.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrapped_log_is_unwrapped_to_what_it_was(lowest: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = np.cumsum(np.repeat(rng.normal(0.0, 0.2, 40), 10))
    wrapped = np.mod(true - lowest, TURN) + lowest
    assert looks_wrapped(wrapped, ONE_RUN) and not looks_wrapped(true, ONE_RUN)
    whole = unwrapped(wrapped, ONE_RUN)
    np.testing.assert_allclose(whole - true, whole[0] - true[0], atol=1e-9)


def test_waypoints_far_apart_are_taken_as_they_are_or_asked_about() -> None:
    run = np.zeros(4, int)
    assert looks_wrapped(np.array([0.0, TURN, 0.0, TURN]), run) is False  # whole turns, commanded
    assert looks_wrapped(np.array([0.1, 3.0, -3.0, 0.0]), run) is None  # 344 deg: nobody knows
    assert looks_wrapped(np.array([0.1, 3.0, -3.0, 0.0]), np.array([0, 0, 1, 1])) is False  # another run
    assert looks_wrapped(np.array([0.1, 3.0, 30.0, 0.0]), run) is False  # turns that no wrapped angle makes


def test_a_file_is_unwrapped_with_a_note_or_refused_in_a_sentence(tmp_path: Path) -> None:
    turn = np.linspace(0, 12, 120)
    log = np.mod(turn + np.pi, TURN) - np.pi
    rows = "\n".join(f"0,0,{angle!r},0,-0.002" for angle in log.tolist())
    (tmp_path / "log.csv").write_text(f"sequence,theta_1_rad,theta_2_rad,l_1_m,l_2_m\n{rows}")
    path = load_joint_path(tmp_path / "log.csv", ROBOT)
    np.testing.assert_allclose(path.theta_commanded[:, 1], turn, atol=1e-9)
    assert path.notes[0].endswith("theta_2_rad is wrapped: 2 steps of nearly a turn were taken out.")
    data = measured(ROBOT, waypoints(ROBOT, 2))
    data.theta_commanded[1, 1] = data.theta_commanded[0, 1] + 5.5
    write_csv(tmp_path / "bad.csv", data)
    with pytest.raises(InputError, match="row 2, theta_2_rad .*turns by 315 deg at once: is it wrapped"):
        load_measurements(tmp_path / "bad.csv", ROBOT)


@pytest.mark.parametrize("digits", [3, 6, 9])
def test_an_approach_by_a_quarter_turn_that_was_wrapped_is_asked_about(digits: int) -> None:
    """The guide has configurations approached like this: three quarters of a turn, by whatever a file rounds."""
    rng = np.random.default_rng(0)
    true = rng.uniform(-np.pi, np.pi, 20)
    for side in (-np.pi / 2, np.pi / 2):
        wrapped = np.round(np.mod(np.column_stack([true + side, true]) + np.pi, TURN) - np.pi, digits)
        for before, after in wrapped[np.abs(np.diff(wrapped, axis=1)[:, 0]) > np.pi]:
            assert looks_wrapped(np.array([before, after]), np.zeros(2, int)) is None
