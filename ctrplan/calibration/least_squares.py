"""Maximum a posteriori fit of a chain's parameters: damped Gauss-Newton with priors, bounds and robust weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.calibration.residuals import Noise, Residuals, residuals
from ctrplan.errors import InputError
from ctrplan.pipeline.parametric_chain import ParametricChain

MOST_STEPS = 25
ENOUGH = 0.05  # decrease of the loss (twice a log-likelihood), beside noise as large as what is left, that is vain
VAIN = 0.5  # decrease promised by a step that was refused below which shorter ones are not tried: 0.7 standard errors
FIRST_DAMPING, LARGEST_DAMPING = 1.0, 1e6  # of steps in units of the priors: valleys are curved and long in these
LONGEST_STEP = 2.0  # of a parameter in a step, in standard deviations of its prior


@shown
@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters (P,), SI, with residuals and derivatives there."""

    chain: ParametricChain
    noise: Noise
    group: NDArray[np.int_]
    p: Array
    residuals: Residuals
    converged: bool

    @property
    def precision(self) -> Array:
        """(P,) of the priors."""
        precision: Array = 1 / self.chain.prior**2
        return precision

    @property
    def loss(self) -> float:
        """Loss of the poses and of the priors."""
        return self.residuals.loss + float((self.precision * (self.p - self.chain.neutral) ** 2).sum())

    @property
    def information(self) -> Array:
        """(P, P) J^T W J plus the priors' precision."""
        return information(self.residuals) + np.diag(self.precision)

    @property
    def covariance(self) -> Array:
        """(P, P) of the parameters."""
        return inverse(self.information)

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(P,) parameters that would leave their range."""
        margin = 1e-6 * self.chain.prior
        at_bound: NDArray[np.bool_] = (self.p <= self.chain.lower + margin) | (self.p >= self.chain.upper - margin)
        return at_bound


def information(parts: Residuals) -> Array:
    """(P, P) J^T W J."""
    J = parts.J.reshape(-1, parts.J.shape[2])
    weighted: Array = J.T @ (np.repeat(parts.weight, parts.J.shape[1])[:, None] * J)
    return weighted


def inverse(matrix: Array) -> Array:
    """The inverse of a symmetric positive definite matrix whose rows may differ by many orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(matrix))
    inverted: Array = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return inverted


def fit(
    chain: ParametricChain, noise: Noise, group: Sequence[int] | NDArray[np.int_], start: Array | Fit | None = None
) -> Fit:
    """The most probable parameters near `start` (P,), or near what a fit would be there, of this chain and noise."""
    groups, known = np.asarray(group), start.p if isinstance(start, Fit) else start
    p = np.clip(chain.start if known is None else known, chain.lower, chain.upper)
    here = start if isinstance(start, Fit) and np.array_equal(p, start.p) else fit_at(chain, noise, groups, p)
    damping = 0.0
    for _ in range(MOST_STEPS):
        if not len(p):
            break
        target, promised, unbounded = _step(here, damping)
        left = max(1.0, here.residuals.loss / max(1, int(here.residuals.given.sum())))  # over what noise leaves
        if promised < ENOUGH * left:
            if unbounded < ENOUGH * left or damping > LARGEST_DAMPING:
                return replace(here, converged=True)
            damping = max(damping * 10, FIRST_DAMPING)  # a step that its bounds bend goes downhill where it is short
            continue
        try:
            there = fit_at(chain, noise, groups, target)
        except InputError:  # no robot has these values
            damping = max(damping * 10, FIRST_DAMPING)
            continue
        gain = here.loss - there.loss
        if gain > 0:
            if gain > promised / 2:  # what bends more than that, bends again where steps are longer
                damping = damping / 10 if damping > FIRST_DAMPING else 0.0
            here = there
        else:
            damping = max(damping * 10, FIRST_DAMPING)
        vain = gain <= 0 and promised < VAIN * left
        if vain or abs(gain) < ENOUGH * left or damping > LARGEST_DAMPING:  # a loss this near is the solver's own noise
            return replace(here, converged=True)
    return here


def fit_at(chain: ParametricChain, noise: Noise, group: NDArray[np.int_], p: Array) -> Fit:
    """What a fit would be if `p` (P,) were its result."""
    return Fit(chain, noise, group, p, residuals(chain.data, chain.predict(p), noise, group), False)


def _step(here: Fit, damping: float) -> tuple[Array, float, float]:
    """The next parameters, inside their bounds, and the decrease of the loss that the linear model promises; and
    without bounds.

    Parameters held by a bound stay out of the system.
    """
    chain, parts = here.chain, here.residuals
    gradient = np.einsum("kcp,kc->p", parts.J * parts.weight[:, None, None], parts.r)
    gradient -= here.precision * (here.p - chain.neutral)
    at_bound = ((here.p <= chain.lower) & (gradient < 0)) | ((here.p >= chain.upper) & (gradient > 0))
    free = np.flatnonzero(~at_bound)
    step = np.zeros_like(here.p)
    matrix = here.information[np.ix_(free, free)]
    matrix = matrix + damping * np.diag(here.precision[free])
    scale = 1 / np.sqrt(np.diag(matrix))
    step[free] = scale * np.linalg.lstsq(matrix * np.outer(scale, scale), scale * gradient[free], rcond=1e-13)[0]
    limit = LONGEST_STEP * chain.prior
    stepped: Array = np.clip(here.p + np.clip(step, -limit, limit), chain.lower, chain.upper)
    return stepped, float(gradient @ (stepped - here.p)), float(gradient @ step)


def error_beside(measured: Array, model: Array, turn: float, moves: Array, least: float, worth: int) -> float:
    """Size of the errors of what was measured (M, 3) beside a turn of the model and moves of it, none below `least`.

    The turn about the origin [rad] and `moves` (M, B, 3) are those of the size of their priors. What they take is held
    against them as an error that is as improbable, errors being worth so many numbers; what they may fit of errors is
    left out of their count.
    """
    by, turned, error = np.zeros(3), model, np.inf
    for _ in range(2):  # the second time from where the first one turned the model to
        turns = turn * np.cross(np.eye(3)[None], turned[:, None])
        J = np.concatenate([turns, moves], axis=1).transpose(0, 2, 1).reshape(measured.size, -1)
        off = (measured - turned).ravel()
        by, error = _explained(J, off + J[:, :3] @ by[:3], float(np.sqrt(3 * np.mean(off**2))), least, worth)
        turned = Rotation.from_rotvec(turn * by[:3]).apply(model)
    return error


def _explained(J: Array, off: Array, size: float, least: float, worth: int) -> tuple[Array, float]:
    """Parameters (P,) with priors of 1 by which J (3 M, P) explains `off`, and the size of errors beside them.

    Each time least squares beside errors of the size that the last ones left, taken as `size` first.
    """
    strength, axes = np.linalg.eigh(J.T @ J)
    strength, pull, count, error = np.maximum(strength, 0.0), axes.T @ (J.T @ off), len(off) / 3, np.inf
    while True:
        kept = strength + count * max(size, least) ** 2 / worth
        by, before = pull / kept, error
        left = max(float(off @ off - by @ (2 * pull - strength * by)), 0.0)
        size = max(float(np.sqrt(left / (count - (strength / kept).sum() / 3))), least)
        with np.errstate(over="ignore"):  # what is improbable beyond numbers
            error = size * float(np.exp(by @ by / 2 / worth))
        if not error < before or 2 * worth * np.log(before / error) < ENOUGH:
            return axes @ by, min(before, error)
