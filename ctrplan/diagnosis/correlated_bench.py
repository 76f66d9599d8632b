"""Fits beside a discrepancy: what no effect explains has a size and a memory, and the frames of the robot are always
free.

A robot that is held in a hand, or registered anew, stands elsewhere in every run. Nothing else can be told before that.
So it is with the zeros of its joints where it was homed anew: they are free beside those of the first homing.

Of a continuous motion phases are drawn anew, the same for all five numbers of a pose. Of poses at rest, configurations
trade their residuals, turned over at random, and so do the approaches of one. What near configurations have
in common is taken out before they trade and put back afterwards: an error that is smooth in the joints has surrogates
that are smooth.

With it in the covariance, poses count for as much as they say, and everything that holds on white noise holds again.
On a continuous motion, friction follows the simulated history from the first comparison on.

Whatever is smooth in the joints follows such an error half way. Beside it in the covariance only what does better than
an error of that smoothness gains. Here whitened residuals of configurations may trade places as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration import discrepancy
from ctrplan.calibration.discrepancy import Discrepancy, Linearised
from ctrplan.calibration.fit_warnings import PHYSICAL_POISSON
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.calibration.residuals import Noise, compared
from ctrplan.diagnosis import correlated_bench, remainder
from ctrplan.diagnosis.cross_validation import DRAWS, Linear, left_out_residuals, nested_null_scores, predictive_loss
from ctrplan.diagnosis.remainder import JointMemory, SmoothError, joint_memory
from ctrplan.diagnosis.workbench import Scored, Workbench, linear
from ctrplan.effects.effect import CATALOGUE
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import SEED, Measurements
from ctrplan.pipeline.followed_runs import followed
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

FRAME, SHIFT = "base_misalignment", "frame_shift"  # of the first set-up, and of the others beside it
HOMED = "homing_shift"  # zeros after every further homing
FRAMES = (FRAME, SHIFT, HOMED)
FRAME_MOVES = 0.9  # of the size of noise and smooth error, that a frame has to move positions by: a part of any smooth
# error is a frame; wrong ones had up to 0.8, true ones 0.97 and more


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


HELD = 1e-4  # of a prior, which holds a parameter
USUAL_FRICTION = 0.2  # coefficient at which states are simulated while nobody knows any


class CorrelatedBench(Workbench):
    """A workbench whose noise has a discrepancy besides. `plain` is the noise alone."""

    def __init__(
        self, robot: Robot, data: Measurements, noise: Noise, block: NDArray[np.int_], fold: NDArray[np.int_]
    ) -> None:
        """block, fold (K,): poses that count as one where gains are compared, and those left out together."""
        super().__init__(robot, data, noise, block, fold)
        self.plain, self.restarts = noise, 0
        self._phi: Array | None = None
        self._handed: dict[Scored, Fit] = {}
        self._axes: Array | None = None  # (K, 2, 3) of rotations that are the numbers of tangents
        self._errors: dict[float, Sequence[SmoothError]] = {}  # by the share that approaches of a configuration have

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

    def begun(self) -> Scored:
        """The base, its discrepancy estimated."""
        return self._settled(self.scored([]))

    def corrected(self, scored: Scored) -> Scored:
        """The set with the friction states of its own path and the discrepancy that it leaves."""
        return self._settled(scored)

    def loss(self, system: Linear) -> Array:
        """(K,) of poses whose fold had not been fitted; of poses at rest their prediction is as vague as it is."""
        if self.data.is_stream:
            return super().loss(system)
        return predictive_loss(system, self.fold, self.group)

    def null_scores(self, systems: Sequence[Linear], noise: Array) -> list[Array]:
        """(D,) of each system the same of draws (5 K, D)."""
        if self.data.is_stream:
            return super().null_scores(systems, noise)
        return nested_null_scores(systems, self.fold, self.group, noise)

    def null_draws(self, here: Scored) -> Array:
        """(5 K, D) surrogates of what remains of a fit, as smooth as that is, whitened as that is."""
        return self._drawn(here, None if self.data.is_stream else self._joint_memory(here))

    def traded_draws(self, here: Scored) -> Array:
        """(5 K, D) the same, of poses at rest without what configurations that are near each other have in common."""
        return self._drawn(here, None)

    def _drawn(self, here: Scored, memory: JointMemory | None) -> Array:
        left = self.coloured(here.fit.residuals.r)
        if self.data.is_stream:
            drawn = correlated_bench.of_motion(left, self._run, DRAWS)
        else:
            drawn = correlated_bench.of_configurations(left, self.data.configuration, DRAWS, memory)
        whitened = self._discrepancy.whitened(drawn) if self._discrepancy else drawn
        flat: Array = whitened.reshape(-1, DRAWS)
        return flat

    def handed_over(self, scored: Scored) -> Scored:
        """The set with its effects as they are and all else calibrated anew, every pose counting alike.

        Beside a discrepancy, differences between poses count most, and tell an effect from others. For predictions the
        rest is an error as any other. The uncertainty stays the one beside the discrepancy.
        """
        chain, alike = scored.fit.chain, self._alike(scored)
        fit = fit_at(chain, self.noise, self.whitening_group, np.clip(alike.p, chain.lower, chain.upper))
        return replace(scored, fit=fit)

    def over_noise(self, scored: Scored) -> Scored:
        """The set as it stands against the noise alone, so that what remains shows."""
        return replace(scored, fit=fit_at(scored.fit.chain, self.plain, self.whitening_group, scored.fit.p))

    def left_out_m(self, scored: Scored, *lacking: Term) -> Array:
        """(K, 3) [m] errors of the position when a pose's fold had not been fitted, of what is handed over.

        To first order without the terms that are `lacking`.
        """
        alike = self._alike(scored)
        system, chain = linear(alike), alike.chain
        if lacking:
            names = {t.name for t in lacking}
            mine = [t.name in names for t in chain.terms for _ in t.parameters]
            system = system.without(np.array(mine)).refitted()
        sigma_m = alike.noise.position_m * self.data.over_tip
        errors: Array = left_out_residuals(system, self.fold)[:, :3] * sigma_m
        return errors

    def _alike(self, scored: Scored) -> Fit:
        if scored not in self._handed:
            chain, p = scored.fit.chain, scored.fit.p
            terms = [
                fixed(t, p[place]) if t.name in scored.names else t
                for t, place in zip(chain.terms, chain.slices(), strict=True)
            ]
            self._handed[scored] = fit(chain.with_terms(terms), self.noise_alike, self.whitening_group, p)
        return self._handed[scored]

    @property
    def noise_alike(self) -> Noise:
        """Noise as large as the discrepancy, every pose counting alike."""
        result = self._discrepancy
        sizes = (np.hypot(1, result.position), np.hypot(1, result.tangent)) if result else (1.0, 1.0)
        return Noise(self.plain.position_m * sizes[0], self.plain.tangent_rad * sizes[1])

    @property
    def _discrepancy(self) -> Discrepancy | None:
        return self.noise.discrepancy

    @property
    def _run(self) -> NDArray[np.int_]:
        return self.data.run

    def coloured(self, values: Array) -> Array:
        """Whitened numbers (K, 5, ...) as they are over the noise alone."""
        return self._discrepancy.coloured(values) if self._discrepancy else values

    def _settled(self, scored: Scored) -> Scored:
        """States and discrepancy as a fit has them, and the set fitted again with both."""
        if self.data.is_stream and self.robot.n > 1:
            self._phi = self._followed(scored)
        self.noise = replace(self.plain, discrepancy=self.estimated(scored))
        self._done.clear()
        self._tried.clear()
        self._screened.clear()
        return self.scored(scored.terms, scored.fit)

    def _joint_memory(self, scored: Scored) -> JointMemory | None:
        """The memory in the joints of what remains of a fit of poses at rest."""
        result = self._discrepancy
        return (
            joint_memory(self.over_noise_at_priors(scored), self.data, result) if result and result.is_there else None
        )

    def over_noise_at_priors(self, scored: Scored) -> Linearised:
        """A fit at the centres of its priors, residuals and derivatives over the noise alone."""
        parts, solved = scored.fit.residuals, ~scored.failed[:, None]
        r, J = self.coloured(parts.r) * solved, self.coloured(parts.J) * solved[:, :, None]
        return Linearised(r + J @ (scored.fit.p - scored.fit.chain.neutral), J, scored.fit.precision)

    def estimated(self, scored: Scored) -> Discrepancy:
        """The most probable discrepancy beside a fit."""
        left = self.over_noise_at_priors(scored)
        if not self.data.is_stream:
            return discrepancy.of_configurations(left, self.data.configuration)
        time = clock(self.data)
        result = discrepancy.of_motion(left, time, self._run, float(np.ptp(time)))
        stretch = np.unique(np.column_stack([self.group, self._run]), axis=0, return_inverse=True)[1].ravel()
        poses = [np.flatnonzero(stretch == number) for number in np.unique(stretch)]
        return discrepancy.within(result, poses, lambda rows, memory: discrepancy.decay(time[rows], memory))

    def smooth_errors(self, here: Scored) -> Sequence[SmoothError]:
        """That these poses may have besides; tangents are as in the first set that was asked."""
        if self._axes is None:
            tangent = here.fit.chain.predict(here.fit.p, derivatives=False).tangent
            self._axes = np.cross(tangent[:, None], compared(tangent, self.data.tangent)[1])
        key = 0.0 if self.data.is_stream else self.estimated(here).memory
        if key not in self._errors:
            if self.data.is_stream:
                self._errors[key] = remainder.of_motion(self.data, self._axes)
            else:
                self._errors[key] = remainder.at_rest(self.data, key, self._axes)
        return self._errors[key]

    def chain(self, terms: Sequence[Term]) -> ParametricChain:
        """The chain of terms, with friction as it is known by now."""
        chain = super().chain(terms)
        chain.correction = None
        if self._has_friction(terms):
            chain.followed_phi = self._phi
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

    def _followed(self, scored: Scored) -> Array:
        """(K, n - 1) friction states along the path at a fit, with usual friction where it has none."""
        chain, p = self.rubbing(scored)
        path = followed(chain, p)
        self.restarts = path.restarts
        rule = ParametricChain(self.robot, self.data, chain.terms).friction_state(p)
        return np.where(np.isfinite(path.phi), path.phi, rule)


def fixed(t: Term, p: Array) -> Term:
    """With priors that leave its parameters (P,) where they are."""
    held = [
        replace(q, prior=HELD * q.prior, neutral=float(value) / q.si) for q, value in zip(t.parameters, p, strict=True)
    ]
    return Term(t.effect, tuple(held))


class SmoothBench(CorrelatedBench):
    """A bench of poses at rest, with the most probable discrepancy beside one of another bench's sets."""

    def __init__(self, bench: CorrelatedBench, here: Scored) -> None:
        """here: a set of the bench, which has a discrepancy."""
        super().__init__(bench.robot, bench.data, bench.plain, bench.group, bench.fold)
        self._correction = bench._correction
        left, result = bench.over_noise_at_priors(here), bench.estimated(here)
        along = joint_memory(left, bench.data, result)
        self.noise = replace(self.plain, discrepancy=discrepancy.over_joints(left, result.memory, along.correlation))

    def at(self, scored: Scored) -> Scored:
        """A set of the other bench as it stands here."""
        fit = fit_at(scored.fit.chain, self.noise, self.whitening_group, scored.fit.p)
        return Scored(scored.terms, fit, self.loss(linear(fit).refitted()))

    def null_draws(self, here: Scored) -> Array:
        """(5 K, D) whitened residuals of a fit, configurations having traded theirs."""
        drawn = correlated_bench.of_configurations(here.fit.residuals.r, self.data.configuration, DRAWS)
        flat: Array = drawn.reshape(-1, DRAWS)
        return flat
