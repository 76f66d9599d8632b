"""Zeros of joints that differ by homing: constants of the runs of each, and none for runs of the first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import chain_of, pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.effects.drive.homing_shift import MOST_HOMINGS
from ctrplan.effects.effect import CATALOGUE
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain

EFFECT = CATALOGUE["homing_shift"]
ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 3)
VALUES = {"theta_2_2_deg": 0.2, "l_2_2_mm": -1e-3, "theta_2_3_deg": -0.1}  # SI


def homed(count: int) -> Measurements:
    """The runs of PLAN, one homing after the other."""
    return replace(PLAN, homing=1 + PLAN.sequence % count)


def at(data: Measurements, effects: dict[str, dict[str, float]]) -> tuple[ParametricChain, Array]:
    """A chain with effects at values [SI]."""
    chain = chain_of(ROBOT, data, {name: list(values) for name, values in effects.items()})
    given = [value for values in effects.values() for value in values.values()]
    return chain, np.concatenate([chain.neutral[: len(chain.neutral) - len(given)], given])


def test_collars_stand_elsewhere_in_the_runs_of_a_later_homing_and_nowhere_else() -> None:
    data = homed(3)
    chain, p = at(data, {"homing_shift": VALUES})
    found, homing = chain.collars(p), data.homing[data.rows] if data.homing is not None else PLAN.rows
    turned = np.choose(homing - 1, [0.0, VALUES["theta_2_2_deg"], VALUES["theta_2_3_deg"]])
    moved = np.choose(homing - 1, [0.0, VALUES["l_2_2_mm"], 0.0])
    np.testing.assert_allclose(found.theta - data.theta_commanded[data.rows], np.outer(turned, [0, 1]), atol=1e-15)
    np.testing.assert_allclose(found.l - data.l_commanded[data.rows], np.outer(moved, [0, 1]), atol=1e-15)


def test_one_zero_of_every_homing_is_a_wrong_zero() -> None:
    data = replace(PLAN, homing=np.full(len(PLAN.sequence), 2))
    shifted, p = at(data, {"homing_shift": {"theta_2_2_deg": 0.1, "l_2_2_mm": 1e-3}})
    offset, q = at(PLAN, {"homing_offset": {"theta_2_deg": 0.1, "l_2_mm": 1e-3}})
    there, here = shifted.predict(p), offset.predict(q)
    np.testing.assert_allclose(there.position_m, here.position_m, atol=1e-12)
    np.testing.assert_allclose(there.position_by, here.position_by, atol=1e-9)


def test_derivatives_are_those_of_the_zeros_of_each_homing() -> None:
    data = homed(3)
    chain, p = at(data, {"homing_shift": VALUES})
    here = chain.predict(p)
    for j in range(len(p) - len(VALUES), len(p)):
        h = 1e-4 if chain.parameters[j].name.startswith("theta") else 1e-6
        up, down = (p + sign * h * np.eye(len(p))[j] for sign in (1, -1))
        there, back = (chain.predict(q, derivatives=False).position_m for q in (up, down))
        slope = (there - back) / (2 * h)
        np.testing.assert_allclose(here.position_by[:, :, j], slope, atol=1e-3 * np.abs(slope).max())
        number = int(chain.parameters[j].name.split("_")[2])
        assert np.array_equal(np.abs(slope).max(axis=1) > 1e-9, data.homings[data.rows] == number)


def test_only_homings_and_joints_that_were_used_are_asked() -> None:
    (names,) = EFFECT.variants(ROBOT, homed(3))
    joints = [("theta_2", "deg"), ("l_2", "mm")]  # the outer tube never moves
    assert set(names) == {f"{joint}_{k}_{unit}" for k in (2, 3) for joint, unit in joints}
    assert not EFFECT.untestable(ROBOT, homed(3))
    assert EFFECT.untestable(ROBOT, PLAN) == "all runs are of one homing of the robot"
    more = waypoints(ROBOT, MOST_HOMINGS)
    many = replace(more, homing=1 + more.sequence)
    assert f"at most {MOST_HOMINGS} can be told" in EFFECT.untestable(ROBOT, many)


@pytest.mark.parametrize("homing", [1, 2])
def test_a_homing_that_no_pose_is_of_changes_nothing(homing: int) -> None:
    data = replace(PLAN, homing=np.full(len(PLAN.sequence), homing))
    chain, p = at(data, {"homing_shift": {"theta_2_3_deg": 0.3}})
    np.testing.assert_array_equal(chain.collars(p).theta, PLAN.theta_commanded[PLAN.rows])


def test_a_robot_that_no_log_is_of_stands_as_after_the_first_homing() -> None:
    shifted = pair_robot(effects={"homing_shift": {"theta_2_2_deg": 20.0}})
    theta, l_m = PLAN.theta_commanded[:5], PLAN.l_commanded[:5]
    for moved, plain in zip(shifted.collars(theta, l_m), ROBOT.collars(theta, l_m), strict=True):
        np.testing.assert_array_equal(moved, plain)
