"""Where model and measurement disagree: what residuals go along with, whatever the unit of the quantity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.remainder import localise, most_probable_variances, quantities
from ctrplan.diagnosis.workbench import HELD_OUT_SHARE, Teller
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
    assert share(data, "stage", size) > 0.999


@pytest.mark.parametrize("shared", [0.0, 1.0])
def test_noise_goes_along_with_nothing(shared: float) -> None:
    """Whether or not approaches of a configuration have a part of it in common, and whatever its size."""
    data, named = measured_with({"temperature_C": np.linspace(20.0, 21.0, len(DATA.sequence))}), 0
    for seed in range(20):
        rng, group = np.random.default_rng(seed), data.configuration
        r = rng.standard_normal((data.count, 5)) + shared * rng.standard_normal((group.max() + 1, 5))[group]
        found = localise(data, 3.0 * r, group, np.ones(data.count), 1e-4)
        named += "goes along with none" not in found.sentence
        assert sum(trend.probability for trend in found.trends) <= 1.0
    assert named <= 1


def test_an_angle_that_residuals_go_along_with_is_told_and_that_configurations_share_them() -> None:
    data, rng = measured_with({}), np.random.default_rng(2)
    turn = np.diff(data.theta_commanded[data.rows])[:, 0]
    r = rng.standard_normal((data.count, 5)) + 4 * np.cos(turn - 1.0)[:, None] * np.array([1.0, -1.0, 0.5, 0.0, 0.0])
    found = localise(data, r, data.configuration, np.linalg.norm(r, axis=1), 1e-4)
    same = [trend for trend in found.trends if trend.quantity.endswith(("tube 2 against tube 1", "rotation of tube 2"))]
    assert sum(trend.probability for trend in same) > 0.5  # tube 1 stands still
    assert same[0].probability == pytest.approx(same[1].probability, rel=1e-3)
    assert "shared by all approaches" in found.sentence


@pytest.mark.parametrize("periods", [0.4, 1.2, 1.84, 2.5])
def test_waves_of_the_whole_experiment_go_along_with_the_time(periods: float) -> None:
    """A long wave and a short one alike: over how much of its range a process changes is not known before."""
    ramp = np.linspace(0, 1, len(DATA.sequence))
    data, rng = measured_with({}), np.random.default_rng(4)
    wave = 3 * np.sin(2 * np.pi * periods * ramp[data.rows])
    r = rng.standard_normal((data.count, 5)) + wave[:, None] * np.array([1.0, -0.7, 0.5, 0.0, 0.0])
    result = localise(data, r, data.configuration, np.linalg.norm(r, axis=1), 1e-4)
    assert result.trends[0].quantity == "time" and result.trends[0].probability > 0.9


def test_variances_of_processes_are_found_again() -> None:
    rng, count = np.random.default_rng(5), 90
    place, group = rng.uniform(0, 6, count), np.repeat(np.arange(30), 3)
    smooth = np.exp(-((place[:, None] - place) ** 2) / 2)
    alike, alone = (group[:, None] == group).astype(float), np.eye(count)
    roots = [np.linalg.cholesky(one + 1e-9 * alone) for one in (smooth, alike)]
    drawn = [root @ rng.standard_normal((count, 60)) for root in roots]
    r = 2.0 * drawn[0] + drawn[1] + rng.standard_normal((count, 60))
    assert most_probable_variances(r, [smooth, alike]) == pytest.approx([4.0, 1.0], rel=0.25)
    nothing = most_probable_variances(rng.standard_normal((count, 60)), [smooth, alike])
    assert nothing.max() < 0.1


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
