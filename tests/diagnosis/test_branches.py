"""Poses between two equilibria: those of a motion past opposed curvatures, until the robot snaps; none elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import pair_robot
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration import fit_warnings
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.usable_poses import on_one_branch
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


def curved(curvature_per_m: float) -> Robot:
    """A pair of equally curved tubes, 100 mm of each; it snaps where they are curved enough."""
    bend = {"length_mm": 100, "curvature_x_per_m": 0, "curvature_y_per_m": curvature_per_m}
    straight = {"length_mm": 60, "curvature_x_per_m": 0, "curvature_y_per_m": 0}
    outer, inner = pair_robot().content["tube"]
    return pair_robot(tube=[dict(outer) | {"section": [bend]}, dict(inner) | {"section": [straight, bend]}])


def turned(degrees: Array) -> Measurements:
    """A continuous motion of the inner tube; every waypoint is measured."""
    count, turn = len(degrees), np.radians(degrees)
    blank = np.zeros((count, 3))
    theta, l_m = np.column_stack([np.zeros(count), turn]), np.tile([0.0, -0.055], (count, 1))
    run = np.zeros(count, int)
    return Measurements(run, theta, l_m, np.arange(count), blank, blank, is_stream=True)


WAY = np.concatenate([np.arange(0.0, 150.0, 5.0), np.arange(150.0, 0.0, -5.0), np.arange(0.0, 340.0, 5.0)])


def asked(robot: Robot, data: Measurements) -> NDArray[np.bool_]:
    """(K,) where there is one branch, by the robot as it is."""
    number = np.arange(data.count) // 5
    bench = CorrelatedBench(robot, data, Noise(1e-4, 1e-2), number)
    there = bench.chain([])
    seen = there.predict(there.neutral, derivatives=False)
    own = replace(data, position_m=seen.position_m, tangent=seen.tangent)
    bench = CorrelatedBench(robot, own, Noise(1e-4, 1e-2), number)
    return on_one_branch(bench, bench.scored([]))


def test_a_robot_past_opposed_curvatures_stays_where_it_comes_from_until_it_snaps() -> None:
    between = WAY[~asked(curved(12.0), turned(WAY))]
    assert len(between) > 2 and between.min() > 180.0 and between.max() < 270.0
    assert np.all(np.diff(between) == 5.0)  # one stretch of the way


def test_coming_from_the_other_side_it_is_the_mirror_image() -> None:
    there, back = asked(curved(12.0), turned(WAY)), asked(curved(12.0), turned(-WAY))
    assert not there.all()
    np.testing.assert_array_equal(there, back)


def test_tubes_that_do_not_snap_and_poses_at_rest_have_one_branch() -> None:
    assert asked(curved(5.0), turned(WAY)).all()
    assert asked(curved(12.0), replace(turned(WAY), is_stream=False)).all()


def test_a_model_that_is_on_another_branch_in_many_places_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_warnings, "MOST_WRONG", 0.01)
    assert asked(curved(12.0), turned(WAY)).all()
