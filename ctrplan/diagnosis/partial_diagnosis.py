"""A part of the truth: effects that are supported although something else remains. docs/diagnosis.md, partial.

A built term takes out what hid them, and what is left is mostly smooth in the joints. So names are asked anew there, by
their evidence beside an error that is as smooth as is most probable, `smooth_evidence.py`, not by blocks left out.
What is nearly as probable in the place of a name is told with it. Blocks left out say little there, but what they speak
against is no name: it does again what the built term does. A frame is free in every fit, and a smooth error is partly a
frame, of the headings most of all: it is a name only where it moves positions as far as all that is left, and no effect
explains more. Effects that explain as much are told with it.

It begins where nothing in the catalogue leaves noise alone. What no effect explains gets a size and a memory, the
search is repeated beside it, and every effect found has to hold against every competitor, by blocks that were left out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import remainder
from ctrplan.diagnosis.adequacy import Adequacy, remains
from ctrplan.diagnosis.block_evidence import LEAST_ODDS, LIKELY, Evidence, Part, mean_square, part_of
from ctrplan.diagnosis.correlated_bench import FRAME, FRAME_MOVES, FRAMES, CorrelatedBench, frames_beside
from ctrplan.diagnosis.gap import localise
from ctrplan.diagnosis.partial_search import (
    MOST_PARTS,
    NamedSet,
    PartialSelector,
    evidence_for,
    is_built,
    named_set,
    with_zero,
)
from ctrplan.diagnosis.remainder import Remainder
from ctrplan.diagnosis.selection import Report, Selection, SelectionStep, step
from ctrplan.diagnosis.smooth_evidence import EQUAL, Gain, SmoothEvidence, best_of_each, rivals_of
from ctrplan.diagnosis.usable_poses import block_split, blocks, on_one_branch, thinned, thinning
from ctrplan.diagnosis.verdict import MOST_RIVALS, Alternative, Finding, Judgement, Verdict
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench
from ctrplan.measurement.measurements import Measurements, Split
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

LEAST_AGAIN = 4.0  # logarithm of the evidence, of a name that the terms were built beside: it is one, chosen before


def effects_beside_built_term(selector: PartialSelector, chosen: Scored) -> NamedSet:
    """The built terms of a set of poses at rest with the names that act beside them, instead of those in the set.

    It grows from the one built term that is most probable alone: what else was built may have stood for a name.
    """
    bench, path, result = selector.partial_bench, list[SelectionStep](), dict[str, tuple[Term, list[Gain]]]()
    alone = [_ProbableSet.of(bench, [t], chosen) for t in chosen.terms if is_built(t)]
    here = max(alone, key=lambda one: one.value)
    before = {t.name for t in chosen.terms if not is_built(t)}
    others = [t for t in chosen.terms if is_built(t) and t not in here.scored.terms]
    while True:
        selector.tell("asking what acts beside " + ", ".join(here.scored.names))
        bench.corrected(here.scored)
        told = {*result, *(one.term.name for _, rivals in result.values() for one in rivals)}
        ranked = _ranked(selector, here.scored, told) if len(result) < MOST_PARTS else []
        name = next((one for one in ranked if one.gain >= _least_gain(one.term.name, before)), None)
        more = [(t, _ProbableSet.of(bench, [*here.scored.terms, t], here.scored)) for t in others]
        built, there = max(more, key=lambda one: one[1].value, default=(None, here))
        if built is not None and there.value - here.value > (name.gain if name else 0.0):
            here, others = there, [t for t in others if t is not built]
            continue
        if name is None:
            break
        rivals, least = (
            rivals_of(name.gain, [one for one in ranked if one is not name]),
            _least_gain(name.term.name, before),
        )
        there = _ProbableSet.of(bench, [*here.scored.terms, name.term], here.scored)
        passes = there.value - here.value >= least and len(rivals) <= MOST_RIVALS
        path.append(step("add", name.term, there.value - here.value, 0.0, least, passes))
        if not passes:
            break
        here, result[name.term.name] = there, (name.term, rivals)
    here = _without_the_idle(bench, here, result, path, before)
    settled = bench.corrected(here.scored)
    while True:
        names = {**result, **_frame(selector, settled, here.value)}
        evidence = evidence_for(selector, settled, [t for t, _ in names.values()])
        against = min((e for e in evidence if e.term.name in result), key=lambda e: e.gain, default=None)
        if against is None or against.gain > 0:
            break
        path.append(step("drop", against.term, against.gain, against.error, 0.0, True))
        result.pop(against.term.name)
        here = _ProbableSet.of(bench, [t for t in settled.terms if t is not against.term], settled)
        settled = bench.corrected(here.scored)
    result = names
    findings = tuple(_finding(bench, settled, t, rivals) for t, rivals in result.values())
    compared = tuple(a for f in findings for a in f.alternatives)
    return NamedSet(settled, evidence, findings, compared, (), tuple(path))


def most_probable_alone(selector: PartialSelector) -> Scored | None:
    """The effect that is most probable beside a smooth error and nothing else, where it is likely; None if none is.

    It may be wrong: what no effect explains is no smooth error, and the effect that is most like it is most probable.
    """
    bench = selector.partial_bench
    nothing = _ProbableSet.of(bench, [], bench.begun())
    bench.corrected(nothing.scored)
    ranked = _ranked(selector, nothing.scored)
    if not ranked or ranked[0].gain < LIKELY:
        return None
    there = _ProbableSet.of(bench, [ranked[0].term], nothing.scored)
    return bench.corrected(there.scored) if there.value - nothing.value >= LIKELY else None


@dataclass(frozen=True, eq=False)
class _ProbableSet:
    """A set, and the logarithm of its evidence."""

    scored: Scored
    value: float

    @classmethod
    def of(cls, bench: CorrelatedBench, terms: Sequence[Term], near: Scored) -> _ProbableSet:
        scored = bench.corrected(bench.scored(terms, near.fit))
        return cls(scored, SmoothEvidence(bench, scored).highest())


def _least_gain(name: str, before: Collection[str]) -> float:
    """Gain that a name needs; before: names that the terms were built beside."""
    return LEAST_AGAIN if name in before else LEAST_ODDS


def _ranked(selector: PartialSelector, here: Scored, told: Collection[str] = ()) -> list[Gain]:
    """Best first, each effect in its best variant; told: names that are listed already, by themselves or as "or"."""
    variants = [t for t in _variants(selector, here) if t.name not in told]
    return best_of_each(SmoothEvidence(selector.partial_bench, here, variants).gains(variants)) if variants else []


def _variants(selector: PartialSelector, here: Scored) -> list[Term]:
    """Variants of effects that are not in a set and no frames; none with more parameters than there are blocks.

    On a pair, whose joints the place of the tip gives away, a distortion follows any smooth error better than an error
    of one length can.
    """
    most, known = len(np.unique(selector.bench.group)), {*FRAMES, *here.names}
    return [t for t in selector.candidates.beside(here.terms) if t.name not in known and len(t.parameters) <= most]


def _frame(selector: PartialSelector, settled: Scored, value: float) -> dict[str, tuple[Term, list[Gain]]]:
    """The frame of the base, where it is a name: it moves positions far, and few effects explain as much in its place.

    value: logarithm of the evidence of the set, with its free frame.
    """
    bench = selector.partial_bench
    mine = [t for t in frames_beside(bench.robot, bench.data, settled.terms) if t.name == FRAME]
    if not mine or SmoothEvidence(bench, _with_zeros(bench, settled)).moved(FRAME) < FRAME_MOVES:
        return {}
    others = _variants(selector, settled)
    if not others:
        return {FRAME: (mine[0], [])}
    asked = SmoothEvidence(bench, settled, others)
    gains = best_of_each(asked.gains(others, without=FRAME))
    own = value - asked.highest(without=FRAME)
    rivals = [one for one in rivals_of(own, gains) if one.gain > LEAST_ODDS]
    better = any(one.gain > own + EQUAL for one in rivals)
    return {} if better or len(rivals) > MOST_RIVALS else {FRAME: (mine[0], rivals)}


def _with_zeros(bench: CorrelatedBench, settled: Scored) -> Scored:
    """With the constants of the terms of sensor and plate, whose zero is arbitrary: they do what a frame does."""
    terms = [with_zero(bench, t) for t in settled.terms]
    return bench.scored(terms, settled.fit)


def _without_the_idle(
    bench: CorrelatedBench,
    here: _ProbableSet,
    results: dict[str, tuple[Term, list[Gain]]],
    path: list[SelectionStep],
    before: Collection[str],
) -> _ProbableSet:
    """Without the names whose place later ones have taken, the least probable first."""
    while len(results) > 1:
        without = {
            name: _ProbableSet.of(bench, [t for t in here.scored.terms if t.name != name], here.scored)
            for name in results
        }
        idle = max(without, key=lambda name: without[name].value)
        least = _least_gain(idle, before)
        if here.value - without[idle].value >= least:
            break
        path.append(step("drop", results.pop(idle)[0], here.value - without[idle].value, 0.0, least, True))
        here = without[idle]
    return here


def _finding(bench: CorrelatedBench, here: Scored, t: Term, rivals: Sequence[Gain]) -> Finding:
    others = [other for other in here.terms if other is not t]
    scored = [bench.scored([*others, one.term], here.fit) for one in rivals]
    alternatives = [Alternative(one.term, s, *bench.difference(here, s)) for one, s in zip(rivals, scored, strict=True)]
    return Finding(t, tuple(alternatives))


@dataclass(frozen=True, eq=False)
class PartialDiagnosis:
    """What was found beside a rest, on poses of the selection that stand apart."""

    bench: CorrelatedBench
    split: Split
    block: NDArray[np.int_]  # of all poses
    base: Scored  # calibrated without effects, and without a free frame
    chosen: Scored  # with those that hold
    judgement: Judgement
    parts: tuple[Part, ...]
    rest: Remainder
    path: tuple[SelectionStep, ...]
    known: Candidates  # that were asked
    doubted: tuple[Evidence, ...]  # effects that were found and do not hold

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
            "doubted": {e.term.name: e.doubts for e in self.doubted},
        }

    def evidence_json(self, t: Term) -> dict[str, Any]:
        """Why an effect holds, for diagnosis.json."""
        (part,) = (part for part in self.parts if part.evidence.term.key == t.key)
        e = part.evidence
        return {
            "share_of_gap_alone": round(part.alone.share, 3),
            "share_of_gap_last": round(part.last.share, 3),
            "alone_rms_mm": [round(x * 1e3, 4) for x in (part.alone.without_m, part.alone.with_m)],
            "last_rms_mm": [round(x * 1e3, 4) for x in (part.last.without_m, part.last.with_m)],
            "gain": round(e.gain, 2),
            "standard_error": round(e.error, 2),
            "surrogates_98": round(e.chance, 2),
            **({"odds_beside_a_smooth_error": round(e.odds, 1)} if np.isfinite(e.odds) else {}),
            "winning_blocks": round(e.winning, 3),
            "weakest_beside": {"effect": e.weakest, "z": round(e.weakest_z, 2)},
            "most_moved_by": {"effect": e.shifted_by, "standard_errors": round(e.shift, 2)},
        }

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise remains, so that the ordinary search would name all."""
        return not self.bench.noise.discrepancy or not self.bench.noise.discrepancy.is_there


def diagnose_partially(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, known: Candidates, tell: Report
) -> PartialDiagnosis:
    """Searches, asks what holds, and describes the rest; `usable` (K,) are the poses to go by."""
    tell("looking for what holds beside a rest")
    block = blocks(data, _memory(robot, data, usable, noise))
    parts = thinned(block_split(data, usable, block), data)
    if data.is_stream:
        first = _bench(robot, data, noise, parts, block)
        certain = on_one_branch(first, first.begun())
        parts = Split(parts.selection[certain], parts.held_out_set, parts.fold[certain])
    bench = _bench(robot, data, noise, parts, block)
    base = Workbench(robot, bench.data, noise, bench.group, bench.fold).scored([])
    selector = PartialSelector(bench, known, tell)
    return concluded(selector, selector.run(), known, parts, block, base)


def _bench(robot: Robot, data: Measurements, noise: Noise, parts: Split, block: NDArray[np.int_]) -> CorrelatedBench:
    """The bench of the poses that choose."""
    return CorrelatedBench(robot, data.subset(parts.selection), noise, block[parts.selection], parts.fold)


def concluded(
    selector: PartialSelector,
    searched: Selection,
    known: Candidates,
    parts: Split,
    block: NDArray[np.int_],
    base: Scored,
) -> PartialDiagnosis:
    """What a search ended with, as far as it holds, beside the built terms that are in it.

    What remains is what the catalogue leaves: a built term explains nothing.
    """
    bench = selector.partial_bench
    is_beside = any(is_built(t) for t in searched.chosen.terms) and not bench.data.is_stream
    result = (effects_beside_built_term if is_beside else named_set)(selector, searched.chosen)
    chosen = result.chosen
    beside, named = _by_name(bench, chosen)
    verdict: Verdict = "partial" if result.findings else "unexplained"
    judgement = Judgement(verdict, result.findings, left_by_names(beside, named), result.compared)
    shares = tuple(part_of(bench, base, chosen, e) for e in result.found)
    return PartialDiagnosis(
        bench,
        parts,
        block,
        base,
        chosen,
        judgement,
        shares,
        remainder_beside(beside, named, bench.plain),
        (*searched.path, *result.path),
        known,
        result.doubted,
    )


def left_by_names(bench: CorrelatedBench, chosen: Scored) -> Adequacy:
    """Whether noise alone is left without the built terms of a set, against the noise and not beside a rest."""
    beside, named = _by_name(bench, chosen)
    return remains(beside, beside.over_noise(named))


def _by_name(bench: CorrelatedBench, chosen: Scored) -> tuple[CorrelatedBench, Scored]:
    """The set without its built terms, on a bench whose discrepancy is all that these stand for."""
    names = [t for t in chosen.terms if not is_built(t)]
    if len(names) == len(chosen.terms):
        return bench, chosen
    beside = CorrelatedBench(bench.robot, bench.data, bench.plain, bench.group, bench.fold)
    return beside, beside.corrected(beside.scored(names, chosen.fit))


def _memory(robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise) -> float:
    """The memory of the calibrated model's errors on a continuous motion, in s, or in rows where there are no times."""
    if not data.is_stream:
        return 0.0
    some = np.flatnonzero(usable)
    some = some[:: thinning(len(some))]
    alone = np.arange(len(some))
    bench = CorrelatedBench(robot, data.subset(some), noise, alone, alone)
    return bench.estimated(bench.scored([])).memory


def remainder_beside(bench: CorrelatedBench, chosen: Scored, noise: Noise) -> Remainder:
    """What remains beside a set of effects."""
    data, result = bench.data, bench.noise.discrepancy
    error, floor = bench.left_out_m(chosen), noise.floor_m
    size = float(np.sqrt(max(mean_square(error) - floor**2, 0.0)))
    distance = np.linalg.norm(error, axis=1)
    place = localise(data, bench.coloured(chosen.fit.residuals.r), bench.group, distance, floor, "With these effects")
    if data.is_stream:
        shares = remainder.shares_of_motion(error, data, bench.group, floor)
        memory = result.memory if result else 0.0
        return Remainder(size, memory, *shares, place.sentence, memory_in_rows=data.time_s is None)
    of_time = remainder.share_of_time(error, data, bench.group, floor)
    shared = (result.memory if result else 0.0) * (1 - of_time)
    return Remainder(size, None, shared, 1 - of_time - shared, of_time, place.sentence)
