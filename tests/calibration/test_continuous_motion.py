"""A fit to a log of a continuous motion is that of its simulated history: it finds what made the log, and no more."""

from __future__ import annotations

import numpy as np
from measured_data import SIGMA_M, pair_robot

from ctrplan.calibration.calibrate import Calibration, calibrate
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

SCALE, FRICTION = 0.04, 0.3
BESIDE = ("effects.joint_scale.theta_2", "effects.lag.tau_s")


def logged(robot: Robot) -> Measurements:
    """Tips of the history of a robot that turns and slides without a stop, twenty times a second, and their noise."""
    time_s = 0.05 * np.arange(600)
    theta = np.column_stack([1.2 * np.sin(0.45 * time_s), 2.6 * np.sin(0.71 * time_s + 1)])
    slides = np.column_stack([0 * time_s, -0.025 - 0.003 * np.sin(0.3 * time_s)])
    path = robot.history().follow(*robot.collars(theta, slides))
    assert not path.snaps.any()
    noise = SIGMA_M * np.random.default_rng(3).standard_normal((len(theta), 3))
    rows, none = np.arange(len(theta)), np.full((len(theta), 3), np.nan)
    return Measurements(0 * rows, theta, slides, rows, path.position_m + noise, none, time_s, is_stream=True)


def found(believed: Robot) -> Calibration:
    stiff = {"tube.1.section.1.curvature_y_per_m=8", "tube.2.section.2.curvature_y_per_m=14"}
    true = believed.with_(f"effects.joint_scale.theta_2={SCALE}", f"contact.1.friction_coefficient={FRICTION}", *stiff)
    return calibrate(believed.with_(*stiff), logged(true), ["friction_coefficient_1", *BESIDE])


def test_intervals_of_a_log_contain_what_made_it() -> None:
    result = found(pair_robot(contact=[{"friction_coefficient": 0.2, "clearance_mm": 0.05}]))
    for name, true in (("theta_2", SCALE), ("tau_s", 0.0), ("friction_coefficient_1", FRICTION)):
        low, high = result.estimates[name].ci95
        half = (high - low) / 2
        assert low - half < true < high + half, (name, result.estimates[name])  # 4 standard errors


def test_what_a_log_leaves_is_its_noise() -> None:
    result = found(pair_robot(contact=[{"friction_coefficient": 0.2, "clearance_mm": 0.05}]))
    assert result.training.rms_m < 1.1 * 3**0.5 * SIGMA_M
    assert result.model_error_m < SIGMA_M
