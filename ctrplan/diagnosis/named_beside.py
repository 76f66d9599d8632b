"""Which effects of the catalogue act beside a built term: those without which the poses are far less probable.

A built term takes out what hid them, and what is left is mostly smooth in the joints. So names are asked anew there, by
their evidence beside an error that is as smooth as is most probable, `smooth_evidence.py`, not by blocks left out.
What is nearly as probable in the place of a name is told with it. Blocks left out say little there, but what they speak
against is no name: it does again what the built term does. A frame is free in every fit, and a smooth error is partly a
frame, of the headings most of all: it is a name only where it moves positions as far as all that is left, and no effect
explains more. Effects that explain as much are told with it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAME, FRAME_MOVES, FRAMES, frames_beside
from ctrplan.diagnosis.held import Asked, asked_evidence, with_zero
from ctrplan.diagnosis.holding import LEAST_ODDS, LIKELY
from ctrplan.diagnosis.partial_search import MOST_PARTS, PartialSelector, is_built
from ctrplan.diagnosis.selection import Step, step
from ctrplan.diagnosis.smooth_evidence import EQUAL, Gain, SmoothEvidence, best_of_each, rivals_of
from ctrplan.diagnosis.verdict import MOST_RIVALS, Alternative, Finding
from ctrplan.diagnosis.workbench import Scored
from ctrplan.pipeline.term import Term

LEAST_AGAIN = 4.0  # logarithm of the evidence, of a name that the terms were built beside: it is one, chosen before


def named_beside(selector: PartialSelector, chosen: Scored) -> Asked:
    """The built terms of a set of poses at rest with the names that act beside them, instead of those in the set.

    It grows from the one built term that is most probable alone: what else was built may have stood for a name.
    """
    bench, path, found = selector.partial_bench, list[Step](), dict[str, tuple[Term, list[Gain]]]()
    alone = [_Probable.of(bench, [t], chosen) for t in chosen.terms if is_built(t)]
    here = max(alone, key=lambda one: one.value)
    before = {t.name for t in chosen.terms if not is_built(t)}
    others = [t for t in chosen.terms if is_built(t) and t not in here.scored.terms]
    while True:
        selector.tell("asking what acts beside " + ", ".join(here.scored.names))
        bench.corrected(here.scored)
        told = {*found, *(one.term.name for _, rivals in found.values() for one in rivals)}
        ranked = _ranked(selector, here.scored, told) if len(found) < MOST_PARTS else []
        name = next((one for one in ranked if one.gain >= _least(one.term.name, before)), None)
        more = [(t, _Probable.of(bench, [*here.scored.terms, t], here.scored)) for t in others]
        built, there = max(more, key=lambda one: one[1].value, default=(None, here))
        if built is not None and there.value - here.value > (name.gain if name else 0.0):
            here, others = there, [t for t in others if t is not built]
            continue
        if name is None:
            break
        rivals, least = rivals_of(name.gain, [one for one in ranked if one is not name]), _least(name.term.name, before)
        there = _Probable.of(bench, [*here.scored.terms, name.term], here.scored)
        passes = there.value - here.value >= least and len(rivals) <= MOST_RIVALS
        path.append(step("add", name.term, there.value - here.value, 0.0, least, passes))
        if not passes:
            break
        here, found[name.term.name] = there, (name.term, rivals)
    here = _without_the_idle(bench, here, found, path, before)
    settled = bench.corrected(here.scored)
    while True:
        names = {**found, **_frame(selector, settled, here.value)}
        evidence = asked_evidence(selector, settled, [t for t, _ in names.values()])
        against = min((e for e in evidence if e.term.name in found), key=lambda e: e.gain, default=None)
        if against is None or against.gain > 0:
            break
        path.append(step("drop", against.term, against.gain, against.error, 0.0, True))
        found.pop(against.term.name)
        here = _Probable.of(bench, [t for t in settled.terms if t is not against.term], settled)
        settled = bench.corrected(here.scored)
    found = names
    findings = tuple(_finding(bench, settled, t, rivals) for t, rivals in found.values())
    compared = tuple(a for f in findings for a in f.alternatives)
    return Asked(settled, evidence, findings, compared, (), tuple(path))


def most_probable_alone(selector: PartialSelector) -> Scored | None:
    """The effect that is most probable beside a smooth error and nothing else, where it is likely; None if none is.

    It may be wrong: what no effect explains is no smooth error, and the effect that is most like it is most probable.
    """
    bench = selector.partial_bench
    nothing = _Probable.of(bench, [], bench.begun())
    bench.corrected(nothing.scored)
    ranked = _ranked(selector, nothing.scored)
    if not ranked or ranked[0].gain < LIKELY:
        return None
    there = _Probable.of(bench, [ranked[0].term], nothing.scored)
    return bench.corrected(there.scored) if there.value - nothing.value >= LIKELY else None


@dataclass(frozen=True, eq=False)
class _Probable:
    """A set, and the logarithm of its evidence."""

    scored: Scored
    value: float

    @classmethod
    def of(cls, bench: CorrelatedBench, terms: Sequence[Term], near: Scored) -> _Probable:
        scored = bench.corrected(bench.scored(terms, near.fit))
        return cls(scored, SmoothEvidence(bench, scored).highest())


def _least(name: str, before: Collection[str]) -> float:
    """Gain that a name needs; before: names that the terms were built beside."""
    return LEAST_AGAIN if name in before else LEAST_ODDS


def _ranked(selector: PartialSelector, here: Scored, told: Collection[str] = ()) -> list[Gain]:
    """Best first, each effect in its best variant; told: names that are listed already, by themselves or as "or"."""
    variants = [t for t in _variants(selector, here) if t.name not in told]
    return best_of_each(SmoothEvidence(selector.partial_bench, here, variants).gains(variants)) if variants else []


def _variants(selector: PartialSelector, here: Scored) -> list[Term]:
    """Of effects that are not in a set and no frames; none with more parameters than there are blocks.

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
    here: _Probable,
    found: dict[str, tuple[Term, list[Gain]]],
    path: list[Step],
    before: Collection[str],
) -> _Probable:
    """Without the names whose place later ones have taken, the least probable first."""
    while len(found) > 1:
        without = {
            name: _Probable.of(bench, [t for t in here.scored.terms if t.name != name], here.scored) for name in found
        }
        idle = max(without, key=lambda name: without[name].value)
        least = _least(idle, before)
        if here.value - without[idle].value >= least:
            break
        path.append(step("drop", found.pop(idle)[0], here.value - without[idle].value, 0.0, least, True))
        here = without[idle]
    return here


def _finding(bench: CorrelatedBench, here: Scored, t: Term, rivals: Sequence[Gain]) -> Finding:
    others = [other for other in here.terms if other is not t]
    scored = [bench.scored([*others, one.term], here.fit) for one in rivals]
    alternatives = [Alternative(one.term, s, *bench.difference(here, s)) for one, s in zip(rivals, scored, strict=True)]
    return Finding(t, tuple(alternatives))
