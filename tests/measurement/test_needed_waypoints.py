"""Waypoints that a simulation needs: those asked for and those where the motion bends, and no path but the same."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.measurement.approach import STRAIGHT_M, STRAIGHT_RAD, needed_waypoints


def wandering(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A log (R, 2) of two tubes that turn and slide between corners, standing still now and then."""
    rng = np.random.default_rng(seed)
    corners, at = rng.uniform(-2, 2, (9, 4)), np.sort(rng.uniform(0, 8, count))
    at[count // 3 : count // 2] = at[count // 3]
    joints = np.column_stack([np.interp(at, np.arange(9), column) for column in corners.T])
    return joints[:, :2], 0.01 * joints[:, 2:]


@pytest.mark.parametrize("seed", range(4))
def test_the_path_through_what_is_kept_is_the_whole_path(seed: int) -> None:
    theta, slides = wandering(800, seed)
    asked = np.arange(0, 800, 37)
    kept = needed_waypoints(theta, slides, asked)
    assert set(asked) <= set(kept) and len(kept) < 120 and list(kept) == sorted(set(kept))
    for a, b in zip(kept[:-1], kept[1:], strict=True):
        start, end = (np.concatenate([theta[k] / STRAIGHT_RAD, slides[k] / STRAIGHT_M]) for k in (a, b))
        share = np.linspace(0, 1, 2000)[:, None]
        line = start + share * (end - start)
        for k in range(a, b):
            away = np.abs(line - np.concatenate([theta[k] / STRAIGHT_RAD, slides[k] / STRAIGHT_M])).max(axis=1)
            assert away.min() < 1.2


def test_a_turn_back_is_kept() -> None:
    theta = np.column_stack([np.zeros(201), np.concatenate([np.linspace(0, 1, 100), np.linspace(1, 0, 101)])])
    kept = needed_waypoints(theta, np.zeros((201, 2)), np.array([200]))
    assert theta[kept, 1].max() > 1 - STRAIGHT_RAD and len(kept) == 3


def test_one_waypoint_is_enough_where_nothing_moves() -> None:
    np.testing.assert_array_equal(needed_waypoints(np.zeros((9, 2)), np.zeros((9, 2)), np.array([0, 5])), [0, 5])
