"""The robust loss: a square of norms up to the limit, a straight line of the same value and slope beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.calibration.residuals import ROBUST_LIMIT, robust_square

NORM = np.linspace(0.0, 5 * ROBUST_LIMIT, 401)


def test_it_is_the_square_up_to_the_limit() -> None:
    below = NORM[NORM <= ROBUST_LIMIT]
    np.testing.assert_array_equal(robust_square(below), below**2)


def test_beyond_the_limit_it_goes_on_straight_with_the_slope_of_the_square() -> None:
    step = 1e-6
    value, further = robust_square(np.array([ROBUST_LIMIT, ROBUST_LIMIT + step]))
    assert further - value == pytest.approx(2 * ROBUST_LIMIT * step, rel=1e-5)
    beyond = robust_square(NORM[NORM > ROBUST_LIMIT])
    np.testing.assert_allclose(np.diff(beyond), 2 * ROBUST_LIMIT * (NORM[1] - NORM[0]), rtol=1e-9)
    assert (beyond < NORM[NORM > ROBUST_LIMIT] ** 2).all()
