"""How large the best gain of all candidates becomes when nothing is missing: simulated, so that looks are paid for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.held_out import Linear

DRAWS = 400
ALARM_RATE = 0.02  # of pure noise that makes some candidate pass
SEED = 1
LEAST_THRESHOLD = 3.0  # log-likelihood: what a single pair of odds of 20 to 1 weighs


def white(count: int) -> Array:
    """(5 K, D) pure noise of `count` = 5 K numbers."""
    noise: Array = np.random.default_rng(SEED).standard_normal((count, DRAWS))
    return noise


def null_threshold(
    here: Linear, beside: Sequence[Linear], scores: Callable[[Linear, Array], Array], draws: Array | None = None
) -> float:
    """Gain in held-out log-likelihood that the best of all candidates exceeds in 2 % of draws (5 K, D) of noise.

    scores: (D,) of a system and draws. Without any draws they are white.
    """
    noise = white(here.r.size) if draws is None else draws
    plain = scores(here, noise)
    best = np.max([scores(candidate, noise) for candidate in beside], axis=0) - plain
    return max(LEAST_THRESHOLD, float(np.quantile(best, 1 - ALARM_RATE)))
