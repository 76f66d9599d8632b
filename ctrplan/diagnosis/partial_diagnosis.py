"""A part of the truth: effects that act although something else remains. docs/diagnosis.md, partial.

It begins where nothing in the catalogue leaves noise alone. What no effect explains gets a size and a memory, so that
poses count for as much as they say, and sets of effects are compared beside everything unknown, `posterior.py`. An
effect of the most probable set is told where it acts with 0.99, alone or together with what may stand for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import Adequacy, remains
from ctrplan.diagnosis.correlated_bench import FRAMES, HOMED, SHIFT, CorrelatedBench, frames_beside
from ctrplan.diagnosis.linear_fit import left_out_residuals
from ctrplan.diagnosis.posterior import Compared, settled
from ctrplan.diagnosis.remainder import Remainder, localise, shares
from ctrplan.diagnosis.term_pieces import is_built
from ctrplan.diagnosis.usable_poses import block_split, blocks, on_one_branch, thinned, thinning
from ctrplan.diagnosis.verdict import NAMED, Judgement, Verdict, done_by, findings_of, without_shared
from ctrplan.diagnosis.workbench import Candidates, Scored, SelectionStep, Teller, Workbench, linear
from ctrplan.measurement.measurements import Measurements, Split
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot


@dataclass(frozen=True)
class Closing:
    """Rms errors [m] without an effect and with it; gap_m: what calibration alone leaves, beyond the noise."""

    without_m: float
    with_m: float
    gap_m: float

    @property
    def share(self) -> float:
        """The share of the gap, in squares. Where effects hide one another, it may be below 0 or above 1."""
        return (self.without_m**2 - self.with_m**2) / max(self.gap_m**2, 1e-12)


@dataclass(frozen=True, eq=False)
class Part:
    """An effect of the verdict, with what it closes of the gap alone, and last of all."""

    term: Term
    alone: Closing
    last: Closing


@dataclass(frozen=True, eq=False)
class PartialDiagnosis:
    """What was found beside a rest, on poses of the selection that stand apart."""

    bench: CorrelatedBench
    split: Split
    block: NDArray[np.int_]  # of all poses
    base: Scored  # calibrated without effects, and without a free frame
    chosen: Scored  # the most probable set
    judgement: Judgement
    rest: Remainder
    path: tuple[SelectionStep, ...]
    known: Candidates  # that were asked
    compared: Compared

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """What the listed effects close: some thirty fits, which a term that is built of the rest may make vain."""
        ends = self.base, self.compared.base, self.chosen
        return tuple(_part(self.bench, *ends, f.term) for f in self.judgement.findings)

    def to_json(self) -> dict[str, Any]:
        """What remains, for diagnosis.json."""
        result = self.rest
        return {
            "rms_mm": round(result.rms_m * 1e3, 4),
            **({"memory_rows" if result.memory_in_rows else "memory_s": result.memory and round(result.memory, 3)}),
            "of_configuration": round(result.of_configuration, 3),
            "of_history": round(result.of_history, 3),
            "of_time": round(result.of_time, 3),
            "where": result.place,
            "blocks": len(np.unique(self.bench.group)),
            "poses_compared": self.bench.data.count,
            "restarts": self.bench.restarts,
        }

    def shares_json(self, t: Term) -> dict[str, Any]:
        """What an effect closes of the gap, for diagnosis.json."""
        (part,) = (part for part in self.parts if part.term.key == t.key)
        return {
            "share_of_gap_alone": round(part.alone.share, 3),
            "share_of_gap_last": round(part.last.share, 3),
            "alone_rms_mm": [round(x * 1e3, 4) for x in (part.alone.without_m, part.alone.with_m)],
            "last_rms_mm": [round(x * 1e3, 4) for x in (part.last.without_m, part.last.with_m)],
        }

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise remains, so that the ordinary search would name all."""
        return not self.bench.noise.discrepancy or not self.bench.noise.discrepancy.is_there


def diagnose_partially(
    robot: Robot,
    data: Measurements,
    usable: NDArray[np.bool_],
    noise: Noise,
    known: Candidates,
    tell: Teller,
    begun: Fit | None = None,
) -> PartialDiagnosis:
    """Searches, asks what holds, and describes the rest; `usable` (K,) are the poses to go by.

    begun: a calibration of like poses, near which these are calibrated.
    """
    tell("looking for what holds beside a rest")
    block = blocks(data, _memory(robot, data, usable, noise, begun))
    parts = thinned(block_split(data, usable, block), data)
    near = begun
    if data.is_stream:
        first = _bench(robot, data, noise, parts, block)
        framed = first.scored([], begun)
        certain = on_one_branch(*first.corrected(framed))
        parts, near = Split(parts.selection[certain], parts.held_out_set), framed.fit
    bench = _bench(robot, data, noise, parts, block)
    base = Workbench(robot, bench.data, noise, bench.group).scored([], begun)
    return most_probable(*bench.corrected(bench.scored([], near)), known, parts, block, base, tell)


def _bench(robot: Robot, data: Measurements, noise: Noise, parts: Split, block: NDArray[np.int_]) -> CorrelatedBench:
    """The bench of the poses that choose."""
    return CorrelatedBench(robot, data.subset(parts.selection), noise, block[parts.selection])


def most_probable(
    bench: CorrelatedBench,
    begun: Scored,
    known: Candidates,
    parts: Split,
    block: NDArray[np.int_],
    base: Scored,
    tell: Teller,
) -> PartialDiagnosis:
    """The most probable set from a settled one on, and what is told of it.

    What remains is what the catalogue leaves: a built term explains nothing.
    """
    bench, compared, here, path = settled(bench, begun, testable_beside(known, bench), tell)
    testable = {SHIFT, HOMED, *(t.name for t in known.terms)}  # set-ups and homings are no matter of the catalogue
    free = [t for t in frames_beside(bench.robot, bench.data, here.terms) if t.name in testable]
    listed = [*free, *(t for t in here.terms if not is_built(t))]
    every = findings_of(bench, here, listed, known, compared.posterior, compared.sets)
    findings, _ = without_shared(bench, here, every)
    beside, named = _by_name(bench, here)
    verdict: Verdict = "partial" if findings else "unexplained"
    told = {f.term.key for f in findings}
    unnamed = [t for t in here.terms if t.key not in told and not is_built(t)]
    together = done_by(here, unnamed, compared.posterior, NAMED)  # beside names, which their figures may not save
    judgement = Judgement(verdict, findings, left_by_names(beside, named), together=together)
    rest = remainder_beside(beside, named, bench.plain)
    return PartialDiagnosis(bench, parts, block, base, here, judgement, rest, path, known, compared)


def testable_beside(known: Candidates, bench: CorrelatedBench) -> Candidates:
    """What may be missing beside a rest, free frames and, on a continuous motion, friction that follows its history."""
    always = {*FRAMES, "translation_release"} if bench.data.is_stream else {*FRAMES}
    return replace(known, terms=tuple(t for t in known.terms if t.name not in always and not t.effect.is_alone))


def _part(bench: CorrelatedBench, base: Scored, none: Scored, chosen: Scored, t: Term) -> Part:
    """The part of an effect in a set; `base` is without effects and without free frames, `none` with free frames."""
    whole = left_out_residuals(linear(base.fit), bench.group)[:, :3] * bench.plain.position_m * bench.data.over_tip
    before, after = _rms(whole), _rms(bench.left_out_m(chosen))
    gap = float(np.sqrt(max(before**2 - bench.plain.floor_m**2, 0.0)))
    if t.name in FRAMES:
        others = [frame for frame in none.fit.chain.terms if frame.name in FRAMES and frame.name != t.name]
        alone, last = _rms(bench.left_out_m(none, *others)), _rms(bench.left_out_m(chosen, t))
        return Part(t, Closing(before, alone, gap), Closing(last, after, gap))
    free, alone = _rms(bench.left_out_m(none)), _rms(bench.left_out_m(bench.scored([t], chosen.fit)))
    last = _rms(bench.left_out_m(bench.scored([other for other in chosen.terms if other is not t], chosen.fit)))
    return Part(t, Closing(free, alone, gap), Closing(last, after, gap))


def _rms(error_m: Array) -> float:
    """[m] of errors (K, 3)."""
    return float(np.sqrt(mean_square(error_m)))


def mean_square(error_m: Array) -> float:
    """[m^2] of errors (K, 3)."""
    return float((error_m**2).sum(axis=1).mean())


def left_by_names(bench: CorrelatedBench, chosen: Scored) -> Adequacy:
    """Whether noise alone is left without the built terms of a set, against the noise and not beside a rest."""
    beside, named = _by_name(bench, chosen)
    return remains(beside, beside.over_noise(named))


def _by_name(bench: CorrelatedBench, chosen: Scored) -> tuple[CorrelatedBench, Scored]:
    """The set without its built terms, on a bench whose discrepancy is all that these stand for, friction states as
    the terms leave them.
    """
    names = [t for t in chosen.terms if not is_built(t)]
    if len(names) == len(chosen.terms):
        return bench, chosen
    return bench.corrected(bench.scored(names, chosen.fit), is_followed=False)


def _memory(robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, begun: Fit | None) -> float:
    """The memory of the calibrated model's errors on a continuous motion, in s, or in rows where there are no times."""
    if not data.is_stream:
        return 0.0
    some = np.flatnonzero(usable)
    some = some[:: thinning(len(some))]
    alone = np.arange(len(some))
    bench = CorrelatedBench(robot, data.subset(some), noise, alone)
    return bench.estimated(bench.scored([], begun)).memory


def remainder_beside(bench: CorrelatedBench, chosen: Scored, noise: Noise) -> Remainder:
    """What remains beside a set of effects."""
    data, result = bench.data, bench.noise.discrepancy
    error, floor = bench.left_out_m(chosen), noise.floor_m
    size = float(np.sqrt(max(mean_square(error) - floor**2, 0.0)))
    distance = np.linalg.norm(error, axis=1)
    r = linear(chosen.fit).coloured(bench.noise).r
    place = localise(data, r, bench.group, distance, floor, "With these effects")
    if data.is_stream:
        memory = result.memory if result else 0.0
        parts = shares(error, data, floor, memory)
        return Remainder(size, memory, *parts, place.sentence, memory_in_rows=data.time_s is None)
    return Remainder(size, None, *shares(error, data, floor, 0.0), place.sentence)
