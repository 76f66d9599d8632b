"""Fits of poses at rest beside a discrepancy that configurations share the more, the nearer they are in the joints.

Whatever is smooth in the joints follows such an error half way. Beside it in the covariance only what does better than
an error of that smoothness gains. Here whitened residuals of configurations may trade places as they are.
"""

from __future__ import annotations

from dataclasses import replace

from ctrplan.base.arrays import Array
from ctrplan.calibration import discrepancy
from ctrplan.calibration.least_squares import fit_at
from ctrplan.diagnosis import surrogates
from ctrplan.diagnosis.chance import DRAWS
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.joint_memory import joint_memory
from ctrplan.diagnosis.workbench import Scored, linear


class SmoothBench(CorrelatedBench):
    """Of another bench of poses at rest, with the most probable discrepancy beside one of its sets."""

    def __init__(self, bench: CorrelatedBench, here: Scored) -> None:
        """here: a set of the bench, which has a discrepancy."""
        super().__init__(bench.robot, bench.data, bench.plain, bench.group, bench.fold)
        self._correction = bench._correction
        left, found = bench.over_noise_at_priors(here), bench.estimated(here)
        along = joint_memory(left, bench.data, found)
        self.noise = replace(self.plain, discrepancy=discrepancy.over_joints(left, found.memory, along.correlation))

    def at(self, scored: Scored) -> Scored:
        """A set of the other bench as it stands here."""
        fit = fit_at(scored.fit.chain, self.noise, self.whitening_group, scored.fit.p)
        return Scored(scored.terms, fit, self.loss(linear(fit).refitted()))

    def null_draws(self, here: Scored) -> Array:
        """(5 K, D) whitened residuals of a fit, configurations having traded theirs."""
        drawn = surrogates.of_configurations(here.fit.residuals.r, self.data.configuration, DRAWS)
        flat: Array = drawn.reshape(-1, DRAWS)
        return flat
