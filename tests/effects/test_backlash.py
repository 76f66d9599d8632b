"""Play of the drive: a collar stands behind the joint that pushed it, by half the play, on the side it came from."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import CATALOGUE

PLAY = {"theta_2_deg": np.radians(4.0), "l_1_mm": 0.6e-3}  # full widths, rad and m


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_a_collar_stands_behind_the_joint_that_pushed_it(direction: float) -> None:
    collars = Collars(np.array([[0.1, 0.4]]), np.array([[-0.01, -0.03]]))
    stood = CATALOGUE["backlash"].drive(PLAY, collars, np.full((1, 4), direction))
    turned, slid = stood.theta - collars.theta, stood.l - collars.l
    np.testing.assert_allclose(turned, [[0.0, -direction * np.radians(2.0)]], atol=1e-15)
    np.testing.assert_allclose(slid, [[-direction * 0.3e-3, 0.0]], atol=1e-15)


def test_a_joint_that_never_moved_stands_in_the_middle_of_its_play() -> None:
    collars = Collars(np.array([[0.1, 0.4]]), np.array([[-0.01, -0.03]]))
    stood = CATALOGUE["backlash"].drive(PLAY, collars, np.zeros((1, 4)))
    np.testing.assert_array_equal(stood.theta, collars.theta)
    np.testing.assert_array_equal(stood.l, collars.l)
