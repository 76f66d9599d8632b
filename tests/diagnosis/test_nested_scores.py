"""Scores of pure noise of many sets at once are those of each set alone."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import PER_POSE
from ctrplan.diagnosis.cross_validation import Linear, nested_null_scores, predictive_null_scores

POSES, COMMON = 47, 6
GROUP = np.arange(POSES) // 4  # the last block is smaller
FOLD = GROUP % 5


def system(J: Array, precision: Array) -> Linear:
    return Linear(np.zeros(J.shape[:2]), J, np.ones(POSES), precision, np.zeros(len(precision)), GIVEN)


GIVEN = np.ones((POSES, PER_POSE), bool)
GIVEN[::7, 3:] = False


def systems() -> list[Linear]:
    rng = np.random.default_rng(3)
    shared = rng.standard_normal((POSES, PER_POSE, COMMON)) * GIVEN[:, :, None]
    precision = np.logspace(-4, 2, COMMON)
    found = [system(shared, precision)]
    for more in (1, 2, 5, 12):
        J = np.concatenate([rng.standard_normal((POSES, PER_POSE, more)) * GIVEN[:, :, None], shared], axis=2)
        found.append(system(J, np.concatenate([np.full(more, 0.1), precision])))
    found[2] = found[2].columns(np.random.default_rng(4).permutation(COMMON + 2).tolist())  # in another order
    found.append(system(shared[:, :, 1:], precision[1:]))  # has not all that the others have
    other = shared.copy()
    other[:, :, 0] *= 1 + 1e-9
    found.append(system(other, precision))  # nearly the same is not the same
    return found


@pytest.mark.parametrize("count", [2, 7])
def test_each_set_scores_as_it_does_alone(count: int) -> None:
    noise = np.random.default_rng(8).standard_normal((POSES * PER_POSE, 30))
    among = systems()[:count]
    together = nested_null_scores(among, FOLD, GROUP, noise)
    for one, scores in zip(among, together, strict=True):
        alone = predictive_null_scores(one, FOLD, GROUP, noise)
        np.testing.assert_allclose(scores, alone, rtol=1e-9, atol=1e-7)
