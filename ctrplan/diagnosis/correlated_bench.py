"""Fits beside a discrepancy: what no effect explains has a size and a memory, and the frames of the robot are always
free.

A robot that is held in a hand, or registered anew, stands elsewhere in every run. Nothing else can be told before that.
So it is with the zeros of its joints where it was homed anew: they are free beside those of the first homing.

With it in the covariance, poses count for as much as they say, and everything that holds on white noise holds again.
On a continuous motion, friction follows the simulated history from the first comparison on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration import discrepancy
from ctrplan.calibration.discrepancy import Discrepancy
from ctrplan.calibration.fit_warnings import PHYSICAL_POISSON
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.linear_fit import left_out_residuals
from ctrplan.diagnosis.workbench import Scored, Workbench, linear
from ctrplan.effects.effect import CATALOGUE
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import followed
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.pipeline.tip_table import FrictionCorrection
from ctrplan.robot.robot import Robot

FRAME, SHIFT = "base_misalignment", "frame_shift"  # of the first set-up, and of the others beside it
HOMED = "homing_shift"  # zeros after every further homing
FRAMES = (FRAME, SHIFT, HOMED)


def frames(robot: Robot, data: Measurements) -> list[Term]:
    """One rigid motion, one more for every further frame that the poses are in, and zeros for every further homing."""
    effect = CATALOGUE[FRAME]
    results = [term(effect, [parameter.name for parameter in effect.parameters(robot)], robot)]
    for shift in (CATALOGUE[SHIFT], CATALOGUE[HOMED]):
        if not shift.untestable(robot, data) and not (data.of_collars and shift.stage == "drive"):
            (names,) = shift.variants(robot, data)
            results.append(term(shift, names, robot))
    return results


def frames_beside(robot: Robot, data: Measurements, terms: Sequence[Term]) -> list[Term]:
    """Those that are neither among the terms nor in the robot file."""
    known = {*robot.effects, *(t.name for t in terms)}
    return [t for t in frames(robot, data) if t.name not in known]


HELD = 1e-4  # of a prior, which holds a parameter
USUAL_FRICTION = 0.2  # coefficient at which states are simulated while nobody knows any


@dataclass(frozen=True, eq=False)
class CorrelatedBench(Workbench):
    """A workbench whose noise has a discrepancy besides."""

    phi: Array | None = None  # (K, n - 1) friction states along the path, on a continuous motion
    restarts: int = 0  # how often the path was begun again for them

    @property
    def plain(self) -> Noise:
        """The noise alone."""
        return replace(self.noise, discrepancy=None)

    def base(self, terms: Sequence[Term]) -> Term:
        """Ordinary calibration with Poisson's ratios that tubes have: nothing unexplained may hide in others."""
        whole = super().base(terms)
        low, high = PHYSICAL_POISSON
        bounded = [
            replace(p, lower=low, upper=high) if p.name.startswith("poisson_ratio") else p for p in whole.parameters
        ]
        return Term(whole.effect, tuple(bounded))

    def basis(self, terms: Sequence[Term]) -> list[Term]:
        """Ordinary calibration and the frames, but those that are among the terms or in the robot file."""
        return [self.base(terms), *frames_beside(self.robot, self.data, terms)]

    def corrected(self, scored: Scored, *, is_followed: bool = True) -> tuple[CorrelatedBench, Scored]:
        """A bench that has the friction states of a set's own path and the discrepancy that it leaves, and the set
        fitted there; not `is_followed`: with the states as they are.
        """
        phi, restarts = self.phi, self.restarts
        if is_followed and self.data.is_stream and self.robot.n > 1:
            phi, restarts = self._followed(scored)
        noise = replace(self.noise, discrepancy=self.estimated(scored))
        bench = replace(self, noise=noise, phi=phi, restarts=restarts)
        return bench, bench.scored(scored.terms, scored.fit)

    @property
    def is_noise_alone(self) -> bool:
        """Whether nothing remains besides, so that the ordinary search would name all."""
        return not self.noise.discrepancy or not self.noise.discrepancy.is_there

    def handed_over(self, scored: Scored) -> Scored:
        """The set with its effects as large as is most probable, all else calibrated anew, every pose counting alike.

        Beside a discrepancy, differences between poses count most, and tell an effect from others. For predictions the
        rest is an error as any other. The uncertainty stays the one beside the discrepancy.
        """
        scored = self.sized(scored)
        chain, alike = scored.fit.chain, self._alike(scored)
        fit = fit_at(chain, self.noise, self.whitening_group, np.clip(alike.p, chain.lower, chain.upper))
        return replace(scored, fit=fit)

    def over_noise(self, scored: Scored) -> Scored:
        """The set as it stands against the noise alone, so that what remains shows."""
        return replace(scored, fit=fit_at(scored.fit.chain, self.plain, self.whitening_group, scored.fit.p))

    def left_out_m(self, scored: Scored, *lacking: Term) -> Array:
        """(K, 3) [m] errors of the position when a pose's group had not been fitted, of what is handed over.

        To first order without the terms that are `lacking`.
        """
        alike = self._alike(scored)
        system = linear(alike)
        if lacking:
            system = system.without(np.isin(alike.chain.owners, [t.name for t in lacking])).refitted()
        sigma_m = alike.noise.position_m * self.data.over_tip
        errors: Array = left_out_residuals(system, self.group)[:, :3] * sigma_m
        return errors

    def _alike(self, scored: Scored) -> Fit:
        chain, p = scored.fit.chain, scored.fit.p
        places = zip(chain.terms, chain.slices(), strict=True)
        terms = [fixed(t, p[place]) if t.name in scored.names else t for t, place in places]
        fitted = chain.with_terms(terms)
        return self._once(("alike", scored), lambda: fit(fitted, self.noise_alike, self.whitening_group, p))

    @property
    def noise_alike(self) -> Noise:
        """Noise as large as the discrepancy, every pose counting alike."""
        result = self.noise.discrepancy
        sizes = (np.hypot(1, result.position), np.hypot(1, result.tangent)) if result else (1.0, 1.0)
        return Noise(self.plain.position_m * sizes[0], self.plain.tangent_rad * sizes[1])

    def estimated(self, scored: Scored) -> Discrepancy:
        """The most probable discrepancy beside a fit."""
        left = linear(scored.fit).centred(self.noise, (~scored.failed).astype(float))
        if not self.data.is_stream:
            return discrepancy.of_configurations(left, self.data.configuration)
        time = clock(self.data)
        result = discrepancy.of_motion(left, time, self.data.run, float(np.ptp(time)))
        stretch = np.unique(np.column_stack([self.group, self.data.run]), axis=0, return_inverse=True)[1].ravel()
        poses = [np.flatnonzero(stretch == number) for number in np.unique(stretch)]
        return discrepancy.within(result, poses, lambda rows, memory: discrepancy.decay(time[rows], memory))

    def chain(self, terms: Sequence[Term]) -> ParametricChain:
        """The chain of terms, with friction as it is known by now."""
        chain = super().chain(terms)
        if self._has_friction(terms) and self.phi is not None:
            chain.correction = FrictionCorrection(self.phi)
        return chain

    def rubbing(self, scored: Scored) -> tuple[ParametricChain, Array]:
        """Chain and parameters of a fit, with usual friction where it has none."""
        chain, p = scored.fit.chain, scored.fit.p
        if self._has_friction(scored.terms):
            return chain, p
        friction = CATALOGUE["friction"]
        extra = term(friction, [q.name for q in friction.parameters(self.robot)], self.robot)
        rubs = ParametricChain(self.robot, self.data, [*chain.terms, extra])
        return rubs, np.concatenate([p, np.full(len(extra.parameters), USUAL_FRICTION)])

    def _followed(self, scored: Scored) -> tuple[Array, int]:
        """(K, n - 1) friction states along the path at a fit, with usual friction where it has none, and how often it
        was begun again.
        """
        chain, p = self.rubbing(scored)
        path = followed(chain, p)
        rule = ParametricChain(self.robot, self.data, chain.terms).friction_state(p)
        return np.where(np.isfinite(path.phi), path.phi, rule), path.restarts


def fixed(t: Term, p: Array) -> Term:
    """With priors that leave its parameters (P,) where they are."""
    fixed = [
        replace(q, prior=HELD * q.prior, neutral=float(value) / q.si) for q, value in zip(t.parameters, p, strict=True)
    ]
    return Term(t.effect, tuple(fixed))
