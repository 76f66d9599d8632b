"""What share of the gap an effect closes, alone and last of all, on poses left out by blocks."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.held_out import held_out_residuals
from ctrplan.diagnosis.holding import Evidence
from ctrplan.diagnosis.workbench import Scored, linear


@dataclass(frozen=True, eq=False)
class Part:
    """An effect of the verdict, with the share of the gap (in squares) that it closes alone, and last of all."""

    evidence: Evidence
    alone: float
    last: float


def part_of(bench: CorrelatedBench, base: Scored, chosen: Scored, found: Evidence) -> Part:
    """Of an effect in a set, where `base` is calibrated without effects and without free frames."""
    whole = held_out_residuals(linear(base.fit), bench.fold)[:, :3] * bench.plain.position_m * bench.data.over_tip
    before, after = mean_square(whole), mean_square(bench.left_out_m(chosen))
    none = bench.scored([])
    free, gap = mean_square(bench.left_out_m(none)), max(before - bench.plain.floor_m**2, 1e-12)
    if found.term.name in FRAMES:
        others = [t for t in none.fit.chain.terms if t.name in FRAMES and t.name != found.term.name]
        alone = mean_square(bench.left_out_m(none, *others))
        last = mean_square(bench.left_out_m(chosen, found.term))
        return Part(found, (before - alone) / gap, (last - after) / gap)
    alone = mean_square(bench.left_out_m(bench.scored([found.term], chosen.fit)))
    rest_of = [t for t in chosen.terms if t is not found.term]
    last = mean_square(bench.left_out_m(bench.scored(rest_of, chosen.fit)))
    return Part(found, (free - alone) / gap, (last - after) / gap)


def mean_square(error_m: Array) -> float:
    """[m^2] of errors (K, 3)."""
    return float((error_m**2).sum(axis=1).mean())
