"""Of a set found beside a rest: what does not hold is dropped, and for what holds it is said what does as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ctrplan.diagnosis.chance import null_threshold
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAME_MOVES, FRAMES
from ctrplan.diagnosis.holding import Evidence, Sides, evidence, in_its_place, telling_odds
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.selection import Step
from ctrplan.diagnosis.smooth_bench import SmoothBench
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence, best_of_each, rivals_of
from ctrplan.diagnosis.verdict import CLOSE, CLOSE_ERRORS, MOST_RIVALS, Alternative, Finding, is_close
from ctrplan.diagnosis.workbench import Panel, Scored
from ctrplan.effects.learned.learned import Learned, learned, named
from ctrplan.pipeline.term import Term

CLEARLY = 2.0  # standard errors by which a rival has to do better than a frame to take its place
LEAST_ODDS_OF_FRAME = 30.0  # logarithm, with which it need not move far; without any it is no name
STANDS_OUT = 4.0  # times chance that a frame gains beside an error as smooth as the rest; 3.2 were seen in a null
TRIED = 3  # effects that are fitted in the place of one that holds


@dataclass(frozen=True, eq=False)
class Held:
    """A set all of whose effects hold, with the evidence for them and for what was dropped on the way."""

    chosen: Scored
    sides: dict[str, Sides]  # by the name of each effect that holds
    found: tuple[Evidence, ...]
    doubted: tuple[Evidence, ...]
    dropped: tuple[Step, ...]


@dataclass(frozen=True, eq=False)
class Asked:
    """A set all of whose effects are told, as findings with what may stand for them."""

    chosen: Scored
    found: tuple[Evidence, ...]  # for the effects of the findings
    findings: tuple[Finding, ...]
    compared: tuple[Alternative, ...]  # all that was tried in the place of some effect
    doubted: tuple[Evidence, ...]
    path: tuple[Step, ...]


def asked(selector: PartialSelector, chosen: Scored) -> Asked:
    """What holds of a set, without what too many others may stand for."""
    found = held(selector, chosen)
    tried = [(e, *finding(selector, found, e)) for e in found.found]
    kept = [(e, f) for e, f, _ in tried if len(f.alternatives) <= MOST_RIVALS]
    compared = tuple(a for _, _, others in tried for a in others)
    return Asked(
        found.chosen, tuple(e for e, _ in kept), tuple(f for _, f in kept), compared, found.doubted, found.dropped
    )


def asked_evidence(selector: PartialSelector, chosen: Scored, terms: Sequence[Term]) -> tuple[Evidence, ...]:
    """On blocks left out, for some effects of a set."""
    if not terms:
        return ()
    bench = selector.partial_bench
    panel, chance, among = _panel(selector, chosen)
    return tuple(evidence(bench, _sides(selector, chosen, panel, among, t), t, chance) for t in terms)


def _panel(selector: PartialSelector, chosen: Scored) -> tuple[Panel, float, list[Term]]:
    """Of a set and its competitors, with what is chance there and all that is fitted."""
    bench = selector.partial_bench
    among = [*bench.basis(chosen.terms), *chosen.terms]
    free = [with_zero(bench, t) for t in chosen.terms]
    panel = bench.panel(chosen, [*selector.candidates.beside(chosen.terms), *free])
    return panel, selector.chance(chosen, panel, among), among


def held(selector: PartialSelector, chosen: Scored) -> Held:
    """The set without what does not hold, the least certain dropped first and the rest asked again.

    Built terms stay: whether they hold is asked elsewhere.
    """
    bench, doubted, dropped = selector.partial_bench, list[Evidence](), list[Step]()
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
            found = tuple(e for e in holding if _is_name(selector, chosen, sides[e.term.name], e))
            return Held(chosen, sides, found, tuple(doubted), tuple(dropped))
        worst = min(failing, key=lambda e: e.z)
        doubted.append(worst)
        dropped.append(Step("drop", worst.term.name, (), round(worst.gain, 2), round(worst.error, 2), 0.0, True))
        chosen = bench.corrected(bench.scored([t for t in chosen.terms if t is not worst.term], chosen.fit))


def _beside_smooth_errors(selector: PartialSelector, chosen: Scored, told: Sequence[Evidence]) -> list[Evidence]:
    """With the evidence that an error leaves which is smooth in the joints or in time.

    What is told by its odds alone may be another effect that is about as probable in its place.
    """
    is_stream = selector.bench.data.is_stream
    variants = [t for t in selector.candidates.beside(chosen.terms) if t.name not in chosen.names]
    asked, found = SmoothEvidence(selector.partial_bench, chosen, variants), list[Evidence]()
    names = [e.term.name for e in told]
    for bare, name, odds in zip(told, names, asked.odds(names), strict=True):
        if name in FRAMES and not is_stream:
            found.append(bare)
            continue
        e = replace(bare, odds=odds, telling=telling_odds(bare.term, is_stream))
        if e.is_told_by_odds:
            others = [t for t in variants if t.effect.needs != name]
            rivals = rivals_of(e.odds, best_of_each(asked.gains(others, without=name))) if others else []
            e = replace(e, imitators=tuple(one.term for one in rivals))
        found.append(e)
    return found


def finding(selector: PartialSelector, found: Held, e: Evidence) -> tuple[Finding, list[Alternative]]:
    """An effect that holds with what may stand for it, refitted in its place; and all that was tried there.

    That is what does as well, and what leaves it little beside itself.
    """
    bench, chosen, t = selector.partial_bench, found.chosen, e.term
    if t.name in FRAMES:
        rivals = [_beside_it(bench, chosen, one) for one in _rivals(selector, found.sides[t.name], e)]
        return Finding(t, tuple(rivals)), rivals
    others, tried = [other for other in chosen.terms if other is not t], []
    imitators = {other.name for other in e.imitators}
    ranked = [] if e.is_told_by_odds else [one[0] for one in in_its_place(bench, found.sides[t.name], t)]
    ranked = [other for other in ranked if other.name not in imitators]
    for other in [*e.imitators[: MOST_RIVALS + 1], *ranked[:TRIED]]:
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


def _sides(selector: PartialSelector, chosen: Scored, panel: Panel, among: Sequence[Term], t: Term) -> Sides:
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
    better = any(behind < -max(CLOSE, CLEARLY * error) for _, behind, error in rivals)
    return not better and len(rivals) <= MOST_RIVALS and _stands_out(selector, chosen, e.term)


def _moves_far(bench: CorrelatedBench, chosen: Scored, t: Term) -> bool:
    """Whether a frame moves positions about as far as noise and a smooth error do; or at rest, whether odds tell it."""
    asked = SmoothEvidence(bench, chosen)
    far = asked.moved(t.name) >= FRAME_MOVES
    if bench.data.is_stream:
        return far
    (odds,) = asked.odds([t.name])
    return odds >= LEAST_ODDS_OF_FRAME or (far and odds > 0)


def _rivals(selector: PartialSelector, sides: Sides, e: Evidence) -> list[tuple[Term, float, float]]:
    """What may stand for a frame, also effects with more parameters than can be named."""
    ranked, imitators = in_its_place(selector.bench, sides, e.term), {other.name for other in e.imitators}
    return [one for one in ranked if one[0].name in imitators or one[1] < max(CLOSE, CLOSE_ERRORS * one[2])]


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
