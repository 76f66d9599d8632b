"""Blocks hold kin together and are kept aside whole; of many poses some stand for the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import pair_robot, waypoints

from ctrplan.diagnosis.usable_poses import BLOCKS, MOST_POSES, blocks, split, thinned
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements

PLAN = waypoints(pair_robot(), 18)


def streamed(theta: np.ndarray) -> Measurements:
    """A continuous motion at 10 Hz with rotations (K,) of the inner tube."""
    count = len(theta)
    nothing, rows = np.zeros((count, 3)), np.arange(count)
    joints = np.column_stack([np.zeros(count), theta])
    slides = np.tile([0.0, -0.02], (count, 1))
    runs = np.zeros(count, dtype=int)
    return Measurements(runs, joints, slides, rows, nothing, nothing, 0.1 * rows, is_stream=True)


def test_blocks_are_as_long_as_each_other() -> None:
    data = streamed(np.linspace(0.1, 3.0, 1200))
    found = blocks(data)
    lasts = [np.ptp(data.time_s[found == number]) for number in np.unique(found)]
    assert len(lasts) == BLOCKS and max(lasts) < 1.1 * min(lasts)
    np.testing.assert_array_equal(blocks(replace(data, time_s=None)), found)  # a log without times counts its rows


def test_a_motion_that_comes_back_is_one_block_with_itself() -> None:
    there = np.linspace(0.0, 3.0, 600)
    found = blocks(streamed(np.concatenate([there, there[::-1]])))
    np.testing.assert_array_equal(found[:600], found[600:][::-1])
    assert len(np.unique(found)) >= 5


def test_mirrored_and_turned_configurations_are_kin_and_never_parted() -> None:
    theta = PLAN.theta_commanded.copy()
    count = len(np.unique(PLAN.configuration))
    plain = blocks(PLAN)
    assert len(np.unique(plain)) == count
    rows = {k: PLAN.rows[PLAN.configuration == k] for k in range(4)}
    l_commanded = PLAN.l_commanded.copy()
    for other, sign, turns in ((1, 1.0, 2 * np.pi), (2, -1.0, 0.0)):
        theta[rows[other]] = sign * theta[rows[0][:1]] + [0.3, 0.3 + turns]
        l_commanded[rows[other]] = l_commanded[rows[0][:1]]
    data = replace(PLAN, theta_commanded=theta, l_commanded=l_commanded)
    found = blocks(data)
    assert len(np.unique(found)) == count - 2
    chosen, aside, block = split(data, np.ones(data.count, bool))
    np.testing.assert_array_equal(block, found)
    assert len(aside) and not set(found[chosen]) & set(found[aside])


def test_of_many_poses_whole_configurations_are_compared() -> None:
    plan = waypoints(pair_robot(), 120)
    some = thinned(plan, np.arange(plan.count))
    assert plan.count > MOST_POSES >= len(some) > 0.9 * MOST_POSES
    for number in np.unique(plan.configuration[some]):
        assert np.sum(plan.configuration[some] == number) == np.sum(plan.configuration == number)


def test_with_few_configurations_none_is_kept_aside_and_with_fewer_poses_nothing_is_asked() -> None:
    few = waypoints(pair_robot(), 6)
    chosen, aside, _ = split(few, np.ones(few.count, bool))
    assert len(chosen) == few.count and not len(aside)
    with pytest.raises(InputError, match="5 usable poses.*no effect can be told"):
        split(few, np.arange(few.count) < 5)
