"""Noise that data show by themselves: by differences of a log, by standstills, by repeats."""

from __future__ import annotations

import numpy as np
import pytest
from measured_data import SIGMA_M, pair_robot

from ctrplan.calibration.observed_noise import noise_floor, observed_noises
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
SILENT = robot_from_dict({key: value for key, value in ROBOT.content.items() if key != "measurement"})
SIGMA_RAD = 0.01


def log(sigma_m: float, *, speed: float = 1.0, stops: bool = False, seed: int = 0) -> Measurements:
    """A minute at 10 Hz of a tip that circles, as fast as `speed` says; with `stops` it stands half of the time."""
    time_s = np.arange(600) / 10
    phase = speed * (np.clip(np.mod(time_s, 10) - 5, 0, None) + 5 * (time_s // 10) if stops else time_s)
    rng = np.random.default_rng(seed)
    position = 0.05 * np.column_stack([np.cos(phase), np.sin(phase), 2 + 0 * phase])
    tangent = np.column_stack([0.6 * np.cos(phase), 0.6 * np.sin(phase), 0.8 + 0 * phase])
    tangent += np.cross(SIGMA_RAD * rng.standard_normal(tangent.shape), tangent)
    theta = np.column_stack([0 * phase, phase])
    nothing = np.zeros(600, int)
    return Measurements(
        nothing,
        theta,
        np.tile([0.0, -0.02], (600, 1)),
        np.arange(600),
        position + sigma_m * rng.standard_normal(position.shape),
        tangent / np.linalg.norm(tangent, axis=1, keepdims=True),
        time_s,
        is_stream=True,
    )


@pytest.mark.parametrize("sigma_m", [2e-5, 2e-4, 1e-3])
def test_differences_of_a_log_show_its_noise(sigma_m: float) -> None:
    (found,) = observed_noises(log(sigma_m))
    assert found.noise.position_m == pytest.approx(sigma_m, rel=0.15)
    assert found.noise.tangent_rad == pytest.approx(SIGMA_RAD, rel=0.15)
    assert "third differences" in found.by


def test_standstills_and_differences_agree() -> None:
    still, differences = observed_noises(log(2e-4, stops=True))
    assert "standstills" in still.by
    assert still.noise.position_m == pytest.approx(2e-4, rel=0.15)
    assert still.noise.position_m == pytest.approx(differences.noise.position_m, rel=0.25)


def test_what_a_motion_leaves_of_differences_shrinks_with_its_cube() -> None:
    fast, slow = (next(iter(observed_noises(log(0.0, speed=s)))).noise.position_m for s in (2.0, 1.0))
    assert slow < fast / 8 * 1.5 and slow < 1e-5


def test_noise_is_never_less_than_stated_and_more_is_reported() -> None:
    stated, sentence = noise_floor(ROBOT, log(SIGMA_M / 10))
    assert stated.position_m == SIGMA_M and stated.tangent_rad == pytest.approx(SIGMA_RAD, rel=0.15)
    more, sentence = noise_floor(ROBOT, log(5 * SIGMA_M))
    assert more.position_m == pytest.approx(5 * SIGMA_M, rel=0.15)
    assert sentence.startswith("The noise is larger than stated: third differences of") and "0.1 mm" in sentence


def test_a_log_shows_the_noise_that_no_file_states() -> None:
    found, sentence = noise_floor(SILENT, log(2e-4))
    assert found.position_m == pytest.approx(2e-4, rel=0.15)
    assert "states no noise" in sentence and "third differences" in sentence
    held = log(0.0, speed=0.0)
    held.position_m[:] = held.position_m[0]
    with pytest.raises(InputError, match="measurement: is missing"):
        noise_floor(SILENT, held)
