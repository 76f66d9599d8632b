"""Runs are followed on every waypoint; where a simulation stops, it goes on behind the waypoint that it can't solve."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_data import chain_of, pair_robot

from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.history import History, HistoryPath
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.followed_runs import followed

COUNT, LOST = 40, 12


def swept() -> Measurements:
    """The inner tube turns on and on; every third waypoint is measured."""
    rows = np.arange(0, COUNT, 3)
    nothing, turns = np.zeros((len(rows), 3)), np.linspace(0.0, 2.5, COUNT)
    theta = np.column_stack([np.zeros(COUNT), turns])
    slides = np.tile([0.0, -0.02], (COUNT, 1))
    return Measurements(np.zeros(COUNT, dtype=int), theta, slides, rows, nothing, nothing, 0.1 * np.arange(COUNT), True)


def test_a_waypoint_without_a_solution_is_gone_round(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, data = pair_robot(contact=[{"friction_coefficient": 0.2}]), swept()
    chain = chain_of(robot, data, {})
    whole = followed(chain, chain.neutral)
    assert whole.restarts == 0 and np.isfinite(whole.position_m).all() and whole.phi[-1] > 0.8
    follow = History.follow

    def failing(self: History, theta_b: Any, l_b: Any) -> HistoryPath:
        lost = np.flatnonzero(np.isclose(theta_b[:, 1], data.theta_commanded[LOST, 1]))
        path = follow(self, theta_b, l_b)
        if not len(lost):
            return path
        status, position = path.status.copy(), path.position_m.copy()
        status[lost[0] :], position[lost[0] :] = Status.FAILED, np.nan
        return replace(path, status=status, position_m=position)

    monkeypatch.setattr(History, "follow", failing)
    found = followed(chain, chain.neutral)
    missing = np.flatnonzero(np.isnan(found.position_m).any(axis=1))
    np.testing.assert_array_equal(missing, [LOST // 3])
    assert found.restarts == 1
    behind = slice(LOST // 3 + 1, None)
    np.testing.assert_allclose(found.phi[behind], whole.phi[behind], atol=0.2)  # loaded as it was, not released
    np.testing.assert_allclose(found.position_m[behind], whole.position_m[behind], atol=5e-4)
