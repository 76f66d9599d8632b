"""What real contacts keep after slip: told from poses that the model says do not depend on the way there."""

from __future__ import annotations

import numpy as np
import pytest
from counted_calls import count_calls
from made_up_input import FUZZ
from places import SCENARIOS

import ctrplan
from ctrplan.calibration.robot_content import LEAST_PAIRS, friction_memory
from ctrplan.measurement.measurements import Measurements

ROBOT = ctrplan.load_robot(SCENARIOS / "robots" / "table_5_pair.toml")


def two_ways(angles_deg: np.ndarray, kept: float, sigma_m: float, *, sliding: bool = True) -> Measurements:
    """Every configuration turned to from both sides, and slid to at the end; tips keep a share of the bound."""
    theta, l, sequence, tips, rng = [], [], [], [], np.random.default_rng(0)  # noqa: E741
    for k, angle in enumerate(np.radians(angles_deg)):
        bound = ROBOT.bound([0, angle], [0, -0.06]).position_m
        for side in (1, -1):
            turns = [[0, angle - 2 * side], [0, angle], [0, angle]]
            slides = [[0, -0.08 if sliding else -0.06]] * 2 + [[0, -0.06]]
            tip = ROBOT.history().follow(turns, slides).position_m[-1]
            tips.append(tip + side * kept * bound * np.array([0.6, 0.8, 0.0]) + rng.normal(scale=sigma_m, size=3))
            theta, l = theta + turns, l + slides  # noqa: E741
            sequence += [2 * k + (side < 0)] * 3
    rows = np.arange(2, len(theta), 3)
    tangent = np.full((len(rows), 3), np.nan)
    return Measurements(np.array(sequence), np.array(theta), np.array(l), rows, np.array(tips), tangent)


ANGLES = np.linspace(30, 170, 12)


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.3] if FUZZ else [0.1])
def test_the_share_comes_out_again(kept: float) -> None:
    assert friction_memory(ROBOT, two_ways(ANGLES, kept, 0.0), 0.0) == pytest.approx(kept, abs=0.01)
    noisy = friction_memory(ROBOT, two_ways(ANGLES, kept, 0.1e-3), 0.1e-3)
    assert noisy is not None and abs(noisy - kept) < 0.05


def test_nothing_is_said_where_the_model_does_not_erase_or_data_are_few() -> None:
    assert friction_memory(ROBOT, two_ways(ANGLES, 0.2, 0.0, sliding=False), 0.0) is None
    assert friction_memory(ROBOT, two_ways(ANGLES[: LEAST_PAIRS - 1], 0.2, 0.0), 0.0) is None


def test_runs_that_tell_nothing_are_not_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where friction's bound is within the noise, or the rule of approaches says that the model erases nothing."""
    slid, turned = two_ways(ANGLES, 0.2, 0.0), two_ways(ANGLES, 0.2, 0.0, sliding=False)
    called = count_calls(monkeypatch)
    assert friction_memory(ROBOT, slid, 0.1) is None and friction_memory(ROBOT, turned, 0.0) is None
    assert "follow" not in called
    assert friction_memory(ROBOT, slid, 0.0) is not None and "follow" in called
