"""A configuration that is kept for its friction states answers as if it were asked anew, whatever was asked before."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from places import ROBOTS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Accuracy, FrictionBodies
from ctrplan.mechanics.tube import Loads

ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")
LOADED = Mechanics(ROBOT.tubes, ROBOT.clearance_m, [0.17, 0.2], Loads(tip_force_N=(0.05, 0.02, -0.03)))
HERE = np.array([0.0, 0.4, -0.9]), np.array([0.0, -0.017, -0.0628])
ELSEWHERE = np.array([0.5, -0.4, 1.9]), np.array([0.0, -0.017, -0.06])
STATES = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, -0.5], [-1.0, 0.2], [0.1, 0.9], [0.0, -1.0]])
ENOUGH_SOLVES = 4


def assert_same(a: FrictionBodies, b: FrictionBodies) -> None:
    """To the last bit."""
    for name in ("point_m", "radius_m", "solved", "max_strain", "stability"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("mechanics", [ROBOT.mechanics, LOADED], ids=["unloaded", "loaded"])
@pytest.mark.parametrize("accuracy", ["search", "certificate", "exact"])
def test_what_is_kept_answers_as_what_is_solved_anew(mechanics: Mechanics, accuracy: Accuracy) -> None:
    kept = mechanics.friction_states(*HERE, accuracy=accuracy)
    first = kept.bodies(STATES)
    assert first.solved.all()
    mechanics.friction_states(*ELSEWHERE, accuracy="search").bodies(STATES[:2])
    assert_same(kept.bodies(STATES), first)
    assert_same(mechanics.friction_bodies(*HERE, STATES, accuracy=accuracy), first)


def test_a_state_does_not_depend_on_those_beside_it_beyond_rounding() -> None:
    kept = ROBOT.mechanics.friction_states(*HERE)
    together = kept.bodies(STATES)
    for k, state in enumerate(STATES):
        alone = kept.bodies(state[None])
        np.testing.assert_allclose(alone.point_m[0], together.point_m[k], rtol=0, atol=1e-8)
        assert alone.stability[0] == pytest.approx(together.stability[k], rel=1e-4)


def test_threads_share_one_configuration() -> None:
    kept = ROBOT.mechanics.friction_states(*HERE)
    expected = [kept.bodies(STATES[k : k + 2]) for k in range(ENOUGH_SOLVES)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: kept.bodies(STATES[k : k + 2]), list(range(ENOUGH_SOLVES)) * 4))
    for k, one in enumerate(found):
        assert_same(one, expected[k % ENOUGH_SOLVES])


def test_what_is_kept_needs_nobody_who_holds_the_robot() -> None:
    kept = ctrplan.load_robot(ROBOTS / "three_tube.toml").mechanics.friction_states(
        *HERE
    )  # whose robot nobody else holds
    assert_same(kept.bodies(STATES), ROBOT.mechanics.friction_bodies(*HERE, STATES))


def test_states_of_another_shape_are_refused() -> None:
    kept = ROBOT.mechanics.friction_states(*HERE)
    for states in ([[0.0]], [[0.0, 1.1]], np.zeros((1, 0, 2)), [[np.nan, 0.0]]):
        with pytest.raises(InputError, match="phi"):
            kept.bodies(states)
