"""The search beside a discrepancy: one effect at a time, then what is not supported beside the others is dropped.

Effects that their evidence beside smooth errors tells come first: on a continuous motion those that act by the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.diagnosis.block_evidence import (
    LEAST_ODDS,
    TIMES_CHANCE,
    Evidence,
    Sides,
    evidence,
    in_its_place,
    telling_odds,
)
from ctrplan.diagnosis.correlated_bench import FRAME_MOVES, FRAMES, CorrelatedBench, SmoothBench
from ctrplan.diagnosis.cross_validation import Linear, null_threshold, null_thresholds
from ctrplan.diagnosis.selection import LEAST_SHARE_OF_GAIN, Report, Selection, SelectionStep, Selector, step
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence, best_of_each, rivals_of
from ctrplan.diagnosis.verdict import CLOSE, MOST_RIVALS, Alternative, Finding, is_close
from ctrplan.diagnosis.workbench import (
    CERTAIN,
    OVERWHELMING,
    SURE,
    Candidates,
    Linearisation,
    Scored,
    Screened,
    certainty,
    linear,
)
from ctrplan.effects.learned.learned import Learned, learned, named
from ctrplan.pipeline.term import Term

MOST_PARTS = 5  # effects named beside a rest that nothing explains
SMOOTH_COUNTS = 2 / 3  # of chance on surrogates as smooth as the residual: twice that has to be gained


class PartialSelector(Selector):
    """Searches a `CorrelatedBench`, where a residual never has to look like noise."""

    def __init__(
        self,
        bench: CorrelatedBench,
        candidates: Candidates,
        tell: Report,
        begun: Scored | None = None,
    ) -> None:
        """tell: called with a sentence before each round of fits; begun: a settled set, the base if not given."""
        super().__init__(bench, testable_beside(candidates, bench), tell, begun or bench.begun())
        self.partial_bench = bench
        self._blocks = len(np.unique(bench.group))

    def run(self) -> Selection:
        """Adds what passes, and nothing else: what holds beside the others is asked in the end."""
        while sum(not is_built(t) for t in self.found.chosen.terms) < MOST_PARTS and self._grow(self.found):
            pass
        return self.found

    def chance(self, chosen: Scored, panel: Linearisation, among: Sequence[Term]) -> float:
        """Gain of the best candidate beside a set that surrogates of its residual exceed in 2 % of draws.

        To first order, as the evidence is; `among` is all that is fitted.
        """
        beside = [panel.of([*among, other]) for other in panel.others(among)]
        return self._most(chosen, panel.of(among), beside) if beside else 0.0

    def _most(self, here: Scored, alone: Linear, beside: Sequence[Linear]) -> float:
        """The largest gain by chance on traded residuals and on surrogates as smooth as these, which leave less to
        doubt.
        """
        draws = self.partial_bench.traded_draws(here), self.partial_bench.null_draws(here)
        traded, smooth = null_thresholds(alone, beside, self.bench.null_scores, draws)
        return max(traded, SMOOTH_COUNTS * smooth)

    def _grow(self, selection: Selection) -> bool:
        """The first of the best candidates that is certain; another one may need it to become so.

        None with more parameters than there are blocks: like a distortion of the tracker on a pair, whose joints the
        place of the tip gives away, it would follow any smooth rest.
        """
        if self._grow_by_odds(selection):
            return True
        here = selection.chosen
        self.tell("trying effects beside " + (", ".join(here.names) or "a rest"))
        screened = self._screened(here)
        if not screened:
            return False
        beside = [one.linear for one in screened]
        selection.threshold = TIMES_CHANCE * self._most(here, linear(here.fit), beside)
        worth = [one for one in screened if self._passes(here, one, LEAST_SHARE_OF_GAIN)]
        if not worth:
            first = screened[0]
            selection.path.append(step("add", first.term, first.score - here.score, 0.0, selection.threshold, False))
            return False
        taken = None
        fitted = self.fitted(here, worth)
        for candidate in fitted:
            gain, error = self.bench.difference(candidate, here)
            passes = taken is None and self._passes(here, candidate) and self._is_probable(here, candidate)
            taken = candidate if passes else taken
            selection.path.append(step("add", candidate.terms[-1], gain, error, selection.threshold, passes))
        if taken is not None:
            selection.chosen = self.bench.corrected(taken)
        return taken is not None

    def _grow_by_odds(self, selection: Selection) -> bool:
        """The most probable effect whose odds beside a smooth error tell it, if there is one."""
        here, bench = selection.chosen, self.partial_bench
        by_odds = [(t, telling_odds(t, bench.data.is_stream)) for t in self._others(here)]
        least = {t.name: telling.first for t, telling in by_odds if telling}
        variants = [t for t, telling in by_odds if telling and len(t.parameters) <= self._blocks]
        if not variants:
            return False
        self.tell("asking what is probable beside " + (", ".join(here.names) or "a smooth error"))
        asked = SmoothEvidence(bench, here, variants)
        best = asked.gains(variants)[0]
        needed = least[best.term.name]
        if best.gain < needed:
            return False
        there = bench.corrected(bench.scored(self.candidates.completed(here.terms, best.term), here.fit))
        gain = SmoothEvidence(bench, there).highest() - asked.highest()
        taken = gain >= needed
        selection.path.append(step("add", best.term, gain, 0.0, needed, taken))
        selection.chosen = there if taken else bench.corrected(here)
        return taken

    def _is_probable(self, here: Scored, candidate: Scored) -> bool:
        """Whether a candidate of a continuous motion does more than a smooth error would."""
        if not self.bench.data.is_stream:
            return True
        before, after = (SmoothEvidence(self.partial_bench, one).highest() for one in (here, candidate))
        return after - before >= LEAST_ODDS

    def _screened(self, here: Scored) -> list[Screened]:
        screened = self.bench.screened(here, self._others(here), self.candidates.completed)
        return [one for one in screened if len(one.term.parameters) <= self._blocks]

    def _passes(self, here: Scored, candidate: Scored | Screened, share: float = 1.0) -> bool:
        """Whether a candidate beside a set has a share of the gain and of the certainty over blocks that are needed."""
        gains = self.bench.by_group((here.held_out - candidate.held_out) / 2)
        return float(gains.sum()) > share * self.found.threshold and certainty(gains) > share * SURE


def is_built(t: Term) -> bool:
    """Whether it was built of a rest, and is no name."""
    return isinstance(t.effect, Learned)


def testable_beside(known: Candidates, bench: CorrelatedBench) -> Candidates:
    """What may be missing beside free frames and, on a continuous motion, friction that follows its history."""
    always = {*FRAMES, "translation_release"} if bench.data.is_stream else {*FRAMES}
    return Candidates(tuple(t for t in known.terms if t.name not in always), known.not_testable)


STANDS_OUT = 4.0  # times chance that a frame gains beside an error as smooth as the rest; 3.2 were seen in a null


@dataclass(frozen=True, eq=False)
class SupportedSet:
    """A set all of whose effects hold, with the evidence for them and for what was dropped on the way."""

    chosen: Scored
    sides: dict[str, Sides]  # by the name of each effect that holds
    found: tuple[Evidence, ...]
    doubted: tuple[Evidence, ...]
    dropped: tuple[SelectionStep, ...]


@dataclass(frozen=True, eq=False)
class NamedSet:
    """A set all of whose effects are told, as findings with what may stand for them."""

    chosen: Scored
    found: tuple[Evidence, ...]  # for the effects of the findings
    findings: tuple[Finding, ...]
    compared: tuple[Alternative, ...]  # all that was tried in the place of some effect
    doubted: tuple[Evidence, ...]
    path: tuple[SelectionStep, ...]


def named_set(selector: PartialSelector, chosen: Scored) -> NamedSet:
    """What holds of a set, without what too many others may stand for."""
    result = supported_set(selector, chosen)
    tried = [(e, *finding(selector, result, e)) for e in result.found]
    kept = [(e, f) for e, f, _ in tried if len(f.alternatives) <= MOST_RIVALS]
    compared = tuple(a for _, _, others in tried for a in others)
    return NamedSet(
        result.chosen, tuple(e for e, _ in kept), tuple(f for _, f in kept), compared, result.doubted, result.dropped
    )


def evidence_for(selector: PartialSelector, chosen: Scored, terms: Sequence[Term]) -> tuple[Evidence, ...]:
    """On blocks left out, for some effects of a set."""
    if not terms:
        return ()
    bench = selector.partial_bench
    panel, chance, among = _panel(selector, chosen)
    return tuple(evidence(bench, _sides(selector, chosen, panel, among, t), t, chance) for t in terms)


def _panel(selector: PartialSelector, chosen: Scored) -> tuple[Linearisation, float, list[Term]]:
    """The linearisation of a set and its competitors, with what is chance there and all that is fitted."""
    bench = selector.partial_bench
    among = [*bench.basis(chosen.terms), *chosen.terms]
    free = [with_zero(bench, t) for t in chosen.terms]
    panel = bench.panel(chosen, [*selector.candidates.beside(chosen.terms), *free])
    return panel, selector.chance(chosen, panel, among), among


def supported_set(selector: PartialSelector, chosen: Scored) -> SupportedSet:
    """The set without what does not hold, the least certain dropped first and the rest asked again.

    Built terms stay: whether they hold is asked elsewhere.
    """
    bench, doubted, dropped = selector.partial_bench, list[Evidence](), list[SelectionStep]()
    while True:
        selector.tell(f"asking what holds of {', '.join(chosen.names)}" if chosen.terms else "asking what holds")
        panel, chance, among = _panel(selector, chosen)
        asked_of = [t for t in among if t.name in FRAMES or (t in chosen.terms and not is_built(t))]
        sides = {t.name: _sides(selector, chosen, panel, among, t) for t in asked_of}
        told = [evidence(bench, sides[t.name], t, chance) for t in asked_of]
        told = _beside_smooth_errors(selector, chosen, told)
        beside_built = any(is_built(t) for t in chosen.terms)
        holding = [e for e in told if e.holds or (beside_built and e.is_one_of_several)]
        failing = [e for e in told if e not in holding and e.term in chosen.terms]
        if not failing:
            result = tuple(e for e in holding if _is_name(selector, chosen, sides[e.term.name], e))
            return SupportedSet(chosen, sides, result, tuple(doubted), tuple(dropped))
        worst = min(failing, key=lambda e: e.z)
        doubted.append(worst)
        dropped.append(
            SelectionStep("drop", worst.term.name, (), round(worst.gain, 2), round(worst.error, 2), 0.0, True)
        )
        chosen = bench.corrected(bench.scored([t for t in chosen.terms if t is not worst.term], chosen.fit))


def _beside_smooth_errors(selector: PartialSelector, chosen: Scored, told: Sequence[Evidence]) -> list[Evidence]:
    """With the evidence that an error leaves which is smooth in the joints or in time.

    What is told by its odds alone may be another effect that is about as probable in its place.
    """
    is_stream = selector.bench.data.is_stream
    variants = [t for t in selector.candidates.beside(chosen.terms) if t.name not in chosen.names]
    asked, result = SmoothEvidence(selector.partial_bench, chosen, variants), list[Evidence]()
    names = [e.term.name for e in told]
    for bare, name, odds in zip(told, names, asked.odds(names), strict=True):
        if name in FRAMES and not is_stream:
            result.append(bare)
            continue
        e = replace(bare, odds=odds, telling=telling_odds(bare.term, is_stream))
        if e.is_told_by_odds:
            others = [t for t in variants if t.effect.needs != name]
            rivals = rivals_of(e.odds, best_of_each(asked.gains(others, without=name))) if others else []
            e = replace(e, imitators=tuple(one.term for one in rivals))
        result.append(e)
    return result


def finding(selector: PartialSelector, supported: SupportedSet, e: Evidence) -> tuple[Finding, list[Alternative]]:
    """An effect that holds with what may stand for it, refitted in its place; and all that was tried there.

    That is what does as well, and what leaves it little beside itself.
    """
    bench, chosen, t = selector.partial_bench, supported.chosen, e.term
    if t.name in FRAMES:
        rivals = [_beside_it(bench, chosen, one) for one in _rivals(selector, supported.sides[t.name], e)]
        return Finding(t, tuple(rivals)), rivals
    others, tried = [other for other in chosen.terms if other is not t], []
    imitators = {other.name for other in e.imitators}
    ranked = [] if e.is_told_by_odds else [one[0] for one in in_its_place(bench, supported.sides[t.name], t)]
    ranked = [other for other in ranked if other.name not in imitators]
    for other in [*e.imitators[: MOST_RIVALS + 1], *ranked[:MOST_RIVALS]]:
        scored = bench.scored([*others, other], chosen.fit)
        tried.append(Alternative(other, scored, *bench.difference(chosen, scored)))
    return Finding(t, tuple(a for a in tried if a.term.name in imitators or is_close(a, chosen))), tried


def with_zero(bench: CorrelatedBench, t: Term) -> Term:
    """A built term with its constant, where its zero is arbitrary: what that does is no evidence for a frame."""
    if not isinstance(t.effect, Learned) or t.effect.target.kind_name not in ("sensor", "plate"):
        return t
    on = t.effect.target
    names = [*t.effect.parts, *(name for name in named(on, "constant") if name not in t.effect.parts)]
    effect = learned(on, names, t.effect.ranges, bench.robot.n)
    return Term(effect, effect.parameters_of())


def _sides(selector: PartialSelector, chosen: Scored, panel: Linearisation, among: Sequence[Term], t: Term) -> Sides:
    """Without an effect the set is fitted again; a frame, which is in every fit, is taken out to first order.

    So is every effect of a continuous motion, where fits without friction leave what a lag takes: on a public run of
    three tubes neither could be named then, where both hold to first order.
    """
    bench = selector.partial_bench
    rest = [other for other in among if other.name != t.name]
    if t.name in FRAMES:
        return Sides(panel, among, panel.without(t), [with_zero(bench, other) for other in rest])
    if bench.data.is_stream:
        return Sides(panel, among, panel.without(t), rest)
    others = [other for other in chosen.terms if other.name != t.name]
    gone = bench.panel(bench.scored(others, chosen.fit), selector.candidates.beside(chosen.terms))
    return Sides(panel, among, gone, [*bench.basis(others), *others])


def _is_name(selector: PartialSelector, chosen: Scored, sides: Sides, e: Evidence) -> bool:
    """Whether what holds is told as a name: any effect, and a frame as far as it is more than a part of the rest.

    A frame is free in every fit, and where a smooth error is all there is, it takes a part of it: so it has to move
    positions as far as that. Where other effects do as well, it is told with them if it stands out beside an error that
    is as smooth, and if none does better.
    """
    if e.term.name not in FRAMES:
        return True
    if not _moves_far(selector.partial_bench, chosen, e.term):
        return False
    rivals = _rivals(selector, sides, e)
    if not rivals:
        return True
    better = any(behind < -max(CLOSE, CERTAIN * error) for _, behind, error in rivals)
    return not better and len(rivals) <= MOST_RIVALS and _stands_out(selector, chosen, e.term)


def _moves_far(bench: CorrelatedBench, chosen: Scored, t: Term) -> bool:
    """Whether a frame moves positions about as far as noise and a smooth error do; or at rest, whether odds tell it."""
    asked = SmoothEvidence(bench, chosen)
    far = asked.moved(t.name) >= FRAME_MOVES
    if bench.data.is_stream:
        return far
    (odds,) = asked.odds([t.name])
    return odds >= OVERWHELMING or (far and odds > 0)


def _rivals(selector: PartialSelector, sides: Sides, e: Evidence) -> list[tuple[Term, float, float]]:
    """What may stand for a frame, also effects with more parameters than can be named."""
    ranked, imitators = in_its_place(selector.bench, sides, e.term), {other.name for other in e.imitators}
    return [one for one in ranked if one[0].name in imitators or one[1] < max(CLOSE, one[2])]


def _stands_out(selector: PartialSelector, chosen: Scored, t: Term) -> bool:
    """Whether a frame gains enough beside an error that is as smooth in the joints as what remains."""
    bench = selector.partial_bench
    if bench.data.is_stream or not (bench.noise.discrepancy and bench.noise.discrepancy.is_there):
        return False
    smooth = SmoothBench(bench, chosen)
    here, among = smooth.at(chosen), [*bench.basis(chosen.terms), *chosen.terms]
    panel = smooth.panel(here, selector.candidates.beside(chosen.terms))
    without = panel.without(t).of([other for other in among if other.name != t.name])
    losses = [smooth.loss(system.refitted()) for system in (without, panel.of(among))]
    gain = float((losses[0] - losses[1]).sum() / 2)
    beside = [panel.of([*among, other]) for other in panel.others(among)]
    chance = null_threshold(panel.of(among), beside, smooth.null_scores, smooth.null_draws(here))
    return gain > STANDS_OUT * chance


def _beside_it(bench: CorrelatedBench, chosen: Scored, rival: tuple[Term, float, float]) -> Alternative:
    """What does as well in the place of a frame, fitted beside it: the frame stays free."""
    other, behind, error = rival
    return Alternative(other, bench.scored([*chosen.terms, other], chosen.fit), behind, error)
