"""What share of the gap an effect closes, alone and last of all, on poses left out by blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.held_out import held_out_residuals
from ctrplan.diagnosis.holding import Evidence
from ctrplan.diagnosis.workbench import Scored, linear


@dataclass(frozen=True)
class Closing:
    """Rms errors [m] without an effect and with it; gap_m: what calibration alone leaves, beyond the noise."""

    without_m: float
    with_m: float
    gap_m: float

    @property
    def share(self) -> float:
        """Of the gap, in squares. Where effects hide one another, it may be below 0 or above 1."""
        return (self.without_m**2 - self.with_m**2) / max(self.gap_m**2, 1e-12)


@dataclass(frozen=True, eq=False)
class Part:
    """An effect of the verdict, with what it closes of the gap alone, and last of all."""

    evidence: Evidence
    alone: Closing
    last: Closing


def part_of(bench: CorrelatedBench, base: Scored, chosen: Scored, found: Evidence) -> Part:
    """Of an effect in a set, where `base` is calibrated without effects and without free frames."""
    whole = held_out_residuals(linear(base.fit), bench.fold)[:, :3] * bench.plain.position_m * bench.data.over_tip
    before, after = rms(whole), rms(bench.left_out_m(chosen))
    gap = float(np.sqrt(max(before**2 - bench.plain.floor_m**2, 0.0)))
    none = bench.scored([])
    if found.term.name in FRAMES:
        others = [t for t in none.fit.chain.terms if t.name in FRAMES and t.name != found.term.name]
        alone, last = rms(bench.left_out_m(none, *others)), rms(bench.left_out_m(chosen, found.term))
        return Part(found, Closing(before, alone, gap), Closing(last, after, gap))
    free, alone = rms(bench.left_out_m(none)), rms(bench.left_out_m(bench.scored([found.term], chosen.fit)))
    last = rms(bench.left_out_m(bench.scored([t for t in chosen.terms if t is not found.term], chosen.fit)))
    return Part(found, Closing(free, alone, gap), Closing(last, after, gap))


def rms(error_m: Array) -> float:
    """[m] of errors (K, 3)."""
    return float(np.sqrt(mean_square(error_m)))


def mean_square(error_m: Array) -> float:
    """[m^2] of errors (K, 3)."""
    return float((error_m**2).sum(axis=1).mean())
