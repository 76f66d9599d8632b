"""What is left after a fit, over its degrees of freedom: never fewer than numbers less parameters."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.diagnosis.adequacy import adequacy
from ctrplan.diagnosis.linear_fit import Linear


@pytest.mark.parametrize("weight", [1.0, 1e-2, 1e-6])
def test_robust_weights_take_no_degrees_of_freedom(weight: float) -> None:
    rng = np.random.default_rng(1)
    r, J = 30 * rng.standard_normal((80, 5)), rng.standard_normal((80, 5, 12))
    fit = Linear(r, J, np.full(80, weight), np.full(12, 1e-4), np.zeros(12), np.ones((80, 5), bool))
    left = adequacy(fit, np.arange(80) // 4, np.zeros(80, bool))
    assert left.total.dof >= 400 - 12 and left.between.dof >= 100 - 12
    assert left.total.ratio == pytest.approx(900, rel=0.2)
