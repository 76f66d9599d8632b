"""Friction states and directions of approach: the rules of Ha et al. 2019, Section V, as laws."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.measurement.approach import friction_state, last_directions
from ctrplan.measurement.measurements import Measurements, is_streamed


def along(theta_2: list[float], l_2: list[float] | None = None) -> Measurements:
    """Two tubes, the inner one turned through angles [deg] and moved through places [mm], all measured."""
    count = len(theta_2)
    theta = np.column_stack([np.zeros(count), np.radians(theta_2)])
    l = np.column_stack([np.zeros(count), np.zeros(count) if l_2 is None else np.array(l_2) * 1e-3])  # noqa: E741
    nothing = np.zeros((count, 3))
    return Measurements(np.zeros(count, int), theta, l, np.arange(count), nothing, nothing)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_quarter_turn_saturates_in_its_direction(sign: int) -> None:
    assert friction_state(along([0, 90 * sign]))[-1] == pytest.approx([sign])


def test_a_common_rotation_loads_nothing() -> None:
    data = along([0, 90])
    turned = Measurements(
        data.sequence, data.theta_commanded[:, [1, 1]], data.l_commanded, data.rows, data.position_m, data.tangent
    )
    assert friction_state(turned)[-1] == pytest.approx([0])


def test_a_decreasing_oscillation_releases_whatever_came_before() -> None:
    swings = [sign * angle for angle, sign in zip(range(40, 0, -2), [1, -1] * 10, strict=True)]
    for start in (-90, 90):
        data = along([start, 0, *swings, 0])
        assert abs(friction_state(data)[-1, 0]) < 0.1
        assert last_directions(data)[-1, 1] == 0


def test_states_are_odd_in_the_path() -> None:
    path = np.cumsum(np.random.default_rng(0).uniform(-50, 50, 30)).tolist()
    there, mirrored = friction_state(along(path)), friction_state(along([-x for x in path]))
    np.testing.assert_allclose(there, -mirrored)
    assert np.abs(there).max() <= 1


def test_translation_releases_by_the_share_it_says() -> None:
    data = along([0, 90, 90], [0, 0, 2])
    assert friction_state(data, release_m=2e-3)[-1] == pytest.approx([np.exp(-1)])
    assert friction_state(data)[-1] == pytest.approx([1])


def test_directions_are_those_of_the_last_motion_and_forget_nothing() -> None:
    directions = last_directions(along([0, 30, 30, 10], [0, 0, 5, 5]))
    assert directions[:, 1].tolist() == [0, 1, 1, -1]  # rotation of tube 2
    assert directions[:, 3].tolist() == [0, 0, 1, 1]  # its translation


def test_a_stream_is_told_from_waypoints() -> None:
    run, moving = np.zeros(20, int), np.arange(20.0)[:, None]
    assert is_streamed(run, np.arange(20), moving)
    assert not is_streamed(np.repeat(np.arange(10), 2), np.arange(1, 20, 2), moving)
    assert not is_streamed(run, np.arange(20), np.repeat(moving[:4], 5, axis=0))  # measured again and again at rest
    paused = np.repeat(moving, np.where(np.arange(20) % 7 == 3, 40, 1), axis=0)  # a log with long standstills
    assert is_streamed(np.zeros(len(paused), int), np.arange(len(paused)), paused)
