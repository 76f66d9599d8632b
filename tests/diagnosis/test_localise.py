"""Where model and measurement disagree: what residuals go along with, whatever the unit of the quantity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.conclusion import HELD_OUT_SHARE, Teller
from ctrplan.diagnosis.gap import localise, quantities
from ctrplan.measurement.measurements import Measurements

DATA = waypoints(pair_robot(), 18)


def measured_with(more: dict[str, Array]) -> Measurements:
    """The plan with further columns."""
    count = len(DATA.sequence)
    nothing = np.zeros((DATA.count, 3))
    return replace(DATA, position_m=nothing, tangent=nothing, more={k: np.resize(v, count) for k, v in more.items()})


def share(data: Measurements, quantity: str, size: Array) -> float:
    """Share of residuals of sizes (K,) that the quantity explains."""
    r = np.repeat(size[:, None], 5, axis=1)
    found = localise(data, r, np.arange(data.count), np.abs(size), 1e-4)
    return next(trend.share for trend in found.trends if trend.quantity == quantity)


@pytest.mark.parametrize("travel", [2e-5, 2e-4, 0.2, 2e3])
def test_a_trend_is_seen_in_any_unit(travel: float) -> None:
    ramp = np.linspace(0, travel, len(DATA.sequence))
    data = measured_with({"travel": 5 * travel + ramp})
    size = ramp[data.rows] / travel - 0.5
    assert share(data, "travel", size) > 0.8


def test_few_levels_are_classes_of_their_own_however_near() -> None:
    levels = np.array([0.1, 0.1002, 0.1003])[np.arange(len(DATA.sequence)) % 3]
    data = measured_with({"stage": levels})
    size = np.array([1.0, -2.0, 1.0])[(np.arange(len(DATA.sequence)) % 3)[data.rows]]
    assert share(data, "stage", size) == pytest.approx(1.0)


def test_an_angle_rounded_below_zero_is_no_full_turn() -> None:
    theta_commanded = np.zeros_like(DATA.theta_commanded)
    theta_commanded[::2, 1] = -1e-12
    data = replace(measured_with({}), theta_commanded=theta_commanded)
    assert "angle of tube 2 against tube 1" not in quantities(data)


def test_progress_of_many_steps_stays_below_that_of_the_last_one() -> None:
    told: list[float] = []
    teller = Teller(lambda _, share: told.append(share), None)
    for _ in range(40):
        teller("trying backlash")
    assert np.all(np.diff(told) >= 0) and told[-1] <= HELD_OUT_SHARE
