"""The robust loss: a square of norms up to the limit, a straight line of the same value and slope beyond it; and fits
that end where it is least.
"""

from __future__ import annotations

import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import SIGMA_M, SIGMA_RAD, chain_of, measured, pair_robot, waypoints

from ctrplan.calibration.least_squares import fit
from ctrplan.calibration.residuals import ROBUST_LIMIT, Noise, robust_square

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


@pytest.mark.parametrize("seed", range(40 if FUZZ else 6))
def test_a_fit_whose_first_step_is_bent_by_a_bound_ends_no_higher_than_without_its_effect(seed: int) -> None:
    """Softening of tubes that are not soft: its fraction of the stiffness, at most 1, starts at 0.8."""
    robot, noise = pair_robot(), Noise(SIGMA_M, SIGMA_RAD)
    data = measured(robot, waypoints(robot, 12, seed=seed), seed=seed)
    base = fit(chain_of(robot, data, {}), noise, data.configuration)
    soft = chain_of(robot, data, {"nonlinear_elasticity": None})
    for strain in (0.004, 0.008, 0.012):
        one = fit(soft, noise, data.configuration, np.concatenate([base.p, [strain, 0.8]]))
        assert one.loss < base.loss + 1
