"""Which combinations of parameters the data can't tell: singular values of the Jacobian scaled by the priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.calibration.least_squares import Fit

UNKNOWN = 0.7  # of the prior's standard deviation that data leave: they say little about this combination
SHOWN = 0.3  # of a unit vector's component that makes a parameter part of a combination


@dataclass(frozen=True)
class Combination:
    """A direction in the space of parameters over their priors, and what the data leave of its uncertainty."""

    parameters: dict[str, float]  # components of a unit vector, the largest ones
    posterior_share: float  # standard deviation after the data over the one before, 0 to 1

    @property
    def is_known(self) -> bool:
        """Whether the data say more of it than the prior did."""
        return self.posterior_share < UNKNOWN


def combinations(fit: Fit) -> list[Combination]:
    """All of them, the least known first."""
    J = fit.residuals.J * np.sqrt(fit.residuals.weight)[:, None, None]
    scaled = J.reshape(-1, J.shape[2]) * fit.chain.prior
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    names = [parameter.name for parameter in fit.chain.parameters]
    found = []
    for value, direction in sorted(zip(singular.tolist(), directions, strict=True), key=lambda pair: pair[0]):
        parts = {n: round(float(x), 3) for n, x in zip(names, direction, strict=True) if abs(x) > SHOWN}
        found.append(Combination(parts, float(1 / np.sqrt(1 + value**2))))
    return found
