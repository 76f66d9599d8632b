"""Frames of the tracker that differ by run: one rigid motion each, and none for runs of the first frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import chain_of, pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import CATALOGUE
from ctrplan.effects.sensor.frame_shift import MOST_FRAMES
from ctrplan.measurement.measurements import Measurements, Poses, rotation

EFFECT = CATALOGUE["frame_shift"]
ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 3)
VALUES = {"rotation_x_2_deg": 0.2, "shift_y_2_mm": 4e-3, "rotation_z_3_deg": -0.3, "shift_x_3_mm": 1e-3}  # SI


def in_frames(count: int) -> Measurements:
    """The runs of PLAN, one frame after the other."""
    return replace(PLAN, frame=1 + PLAN.sequence % count)


def some_poses(count: int) -> Poses:
    rng = np.random.default_rng(0)
    return Poses(rng.normal(0, 0.05, (count, 3)), np.linalg.qr(rng.standard_normal((count, 3, 3)))[0])


def distances(position: Array) -> Array:
    return np.asarray(np.linalg.norm(position[:, None] - position, axis=2))


def test_poses_of_the_first_frame_stay_and_those_of_another_move_as_one_body() -> None:
    data, poses = in_frames(3), some_poses(PLAN.count)
    seen, frame = EFFECT.sensor(VALUES, poses, data), data.frames[data.rows]
    for number in (1, 2, 3):
        mine = frame == number
        np.testing.assert_allclose(distances(seen.position[mine]), distances(poses.position[mine]), atol=1e-15)
        R = rotation([VALUES.get(f"rotation_{axis}_{number}_deg", 0.0) for axis in "xyz"])
        shift = [VALUES.get(f"shift_{axis}_{number}_mm", 0.0) for axis in "xyz"]
        np.testing.assert_allclose(seen.position[mine], poses.position[mine] @ R.T + shift, atol=1e-15)
        np.testing.assert_allclose(seen.frame[mine], R @ poses.frame[mine], atol=1e-15)


def test_one_motion_of_every_frame_is_a_misaligned_base() -> None:
    data, poses = replace(PLAN, frame=np.full(len(PLAN.sequence), 2)), some_poses(PLAN.count)
    moved = EFFECT.sensor({"rotation_y_2_deg": 0.1, "shift_z_2_mm": 2e-3}, poses, data)
    base = CATALOGUE["base_misalignment"].sensor({"rotation_y_deg": 0.1, "shift_z_mm": 2e-3}, poses, data)
    np.testing.assert_allclose(moved.position, base.position, atol=1e-15)
    np.testing.assert_allclose(moved.frame, base.frame, atol=1e-15)


def test_only_the_frames_that_were_used_are_asked_and_neither_one_nor_too_many_can_be() -> None:
    (names,) = EFFECT.variants(ROBOT, in_frames(3))
    assert {name.split("_")[2] for name in names} == {"2", "3"} and len(names) == 12
    assert not EFFECT.untestable(ROBOT, in_frames(3))
    assert EFFECT.untestable(ROBOT, PLAN) == "all runs are of one frame of the tracker"
    more = waypoints(ROBOT, MOST_FRAMES)
    many = replace(more, frame=1 + more.sequence)
    assert f"at most {MOST_FRAMES} can be told" in EFFECT.untestable(ROBOT, many)


def test_derivatives_are_those_of_the_motion_of_each_frame() -> None:
    data = in_frames(3)
    chain = chain_of(ROBOT, data, {"frame_shift": list(VALUES)})
    p = np.concatenate([chain.neutral[: -len(VALUES)], [*VALUES.values()]])
    here = chain.predict(p)
    for j in range(len(p) - len(VALUES), len(p)):
        up, down = (p + sign * 1e-6 * np.eye(len(p))[j] for sign in (1, -1))
        there, back = (chain.predict(q, derivatives=False).position_m for q in (up, down))
        np.testing.assert_allclose(here.position_by[:, :, j], (there - back) / 2e-6, atol=1e-6)
        number = int(chain.parameters[j].name.split("_")[2])
        moves = np.linalg.norm(here.position_by[:, :, j], axis=1) > 1e-9
        assert np.array_equal(moves, data.frames[data.rows] == number)


@pytest.mark.parametrize("frame", [1, 2])
def test_a_frame_that_no_pose_is_in_changes_nothing(frame: int) -> None:
    data, poses = replace(PLAN, frame=np.full(len(PLAN.sequence), frame)), some_poses(PLAN.count)
    seen = EFFECT.sensor({"shift_x_3_mm": 5e-3}, poses, data)
    np.testing.assert_array_equal(seen.position, poses.position)
