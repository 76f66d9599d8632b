"""Blocks are longer than the memory, hold kin together, and are left out and kept aside whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from measured_data import pair_robot, waypoints

from ctrplan.diagnosis.usable_poses import blocks
from ctrplan.measurement.measurements import Measurements, split

PLAN = waypoints(pair_robot(), 18)


def streamed(theta: np.ndarray) -> Measurements:
    """A continuous motion at 10 Hz with rotations (K,) of the inner tube."""
    count = len(theta)
    nothing, rows = np.zeros((count, 3)), np.arange(count)
    joints = np.column_stack([np.zeros(count), theta])
    slides = np.tile([0.0, -0.02], (count, 1))
    runs = np.zeros(count, dtype=int)
    return Measurements(runs, joints, slides, rows, nothing, nothing, 0.1 * rows, is_stream=True)


def test_a_block_lasts_at_least_two_memories() -> None:
    data = streamed(np.linspace(0.1, 3.0, 1200))
    found = blocks(data, memory=3.0)
    lasts = [np.ptp(data.time_s[found == number]) for number in np.unique(found)]
    assert min(lasts) > 5.8 and len(lasts) == 19


def test_a_log_without_times_counts_its_rows() -> None:
    data = streamed(np.linspace(0.1, 3.0, 1200))
    np.testing.assert_array_equal(blocks(replace(data, time_s=None), memory=30.0), blocks(data, memory=3.0))


def test_a_motion_that_comes_back_is_one_block_with_itself() -> None:
    there = np.linspace(0.0, 3.0, 600)
    found = blocks(streamed(np.concatenate([there, there[::-1]])), memory=3.0)
    np.testing.assert_array_equal(found[:600], found[600:][::-1])
    assert len(np.unique(found)) > 5


def test_mirrored_and_turned_configurations_are_kin_and_never_parted() -> None:
    theta = PLAN.theta_commanded.copy()
    count = len(np.unique(PLAN.configuration))
    plain = blocks(PLAN, 0.0)
    assert len(np.unique(plain)) == count
    rows = {k: PLAN.rows[PLAN.configuration == k] for k in range(4)}
    l_commanded = PLAN.l_commanded.copy()
    for other, sign, turns in ((1, 1.0, 2 * np.pi), (2, -1.0, 0.0)):
        theta[rows[other]] = sign * theta[rows[0][:1]] + [0.3, 0.3 + turns]
        l_commanded[rows[other]] = l_commanded[rows[0][:1]]
    data = replace(PLAN, theta_commanded=theta, l_commanded=l_commanded)
    found = blocks(data, 0.0)
    assert len(np.unique(found)) == count - 2
    parts = split(np.ones(data.count, bool), found)
    assert not set(found[parts.selection]) & set(found[parts.held_out_set])
