"""Residuals that might have been: what remains of a fit, with the same spectrum and nothing that any cause put there.

Of a continuous motion phases are drawn anew, the same for all five numbers of a pose. Of poses at rest, configurations
trade their residuals, turned over at random, and so do the approaches of one. What near configurations have
in common is taken out before they trade and put back afterwards: an error that is smooth in the joints has surrogates
that are smooth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.joint_memory import JointMemory

SEED = 11


def of_motion(r: Array, run: NDArray[np.int_], count: int) -> Array:
    """(K, 5, D) of residuals (K, 5) in the order of runs (K,), D = count of them."""
    rng = np.random.default_rng(SEED)
    drawn = np.empty((*r.shape, count))
    for number in np.unique(run):
        inside = np.flatnonzero(run == number)
        mean = r[inside].mean(axis=0)
        spectrum = np.fft.rfft(r[inside] - mean, axis=0)
        phase = np.exp(1j * rng.uniform(-np.pi, np.pi, (len(spectrum), 1, count)))
        again = np.fft.irfft(spectrum[:, :, None] * phase, n=len(inside), axis=0)
        drawn[inside] = again + mean[:, None] * rng.choice([-1.0, 1.0], count)
    return drawn


def of_configurations(
    r: Array, configuration: NDArray[np.int_], count: int, memory: JointMemory | None = None
) -> Array:
    """(K, 5, D) of residuals (K, 5) of poses at rest, by number of their configurations (K,)."""
    rng = np.random.default_rng(SEED)
    members = [np.flatnonzero(configuration == number) for number in np.unique(configuration)]
    means = np.array([r[rows].mean(axis=0) for rows in members])
    own = np.concatenate([r[rows] - mean for rows, mean in zip(members, means, strict=True)])
    traders = memory.whitened(means) if memory else means
    rows, which = np.concatenate(members), np.repeat(np.arange(len(members)), [len(some) for some in members])
    drawn = np.empty((count, *r.shape))
    for d in range(count):
        traded, left = rng.permutation(len(members)), rng.permutation(len(own))
        signs = rng.choice([-1.0, 1.0], (len(members), 1))
        again = signs * traders[traded]
        of_configuration = memory.coloured(again) if memory else again
        drawn[d, rows] = of_configuration[which] + rng.choice([-1.0, 1.0], (len(own), 1)) * own[left]
    moved: Array = np.ascontiguousarray(np.moveaxis(drawn, 0, -1))
    return moved
