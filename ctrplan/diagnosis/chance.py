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

Scores = Callable[[Sequence[Linear], Array], Sequence[Array]]


def white(count: int) -> Array:
    """(5 K, D) pure noise of `count` = 5 K numbers."""
    noise: Array = np.random.default_rng(SEED).standard_normal((count, DRAWS))
    return noise


def null_threshold(here: Linear, beside: Sequence[Linear], scores: Scores, draws: Array | None = None) -> float:
    """Gain in held-out log-likelihood that the best of all candidates exceeds in 2 % of draws (5 K, D) of noise.

    scores: of systems and draws, (D,) of each. Without any draws they are white.
    """
    return null_thresholds(here, beside, scores, [white(here.r.size) if draws is None else draws])[0]


def null_thresholds(here: Linear, beside: Sequence[Linear], scores: Scores, draws: Sequence[Array]) -> list[float]:
    """The same for several kinds of draws (5 K, D) at once: what they share of every system is found once."""
    noise = np.hstack(draws)
    plain, *others = scores([here, *beside], noise)
    best = np.max(others, axis=0) - plain
    ends = np.cumsum([one.shape[1] for one in draws])[:-1]
    return [max(LEAST_THRESHOLD, float(np.quantile(part, 1 - ALARM_RATE))) for part in np.split(best, ends)]
