"""Of a set found beside a rest: what does not hold is dropped, and for what holds it is said what does as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ctrplan.diagnosis.chance import null_threshold
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.holding import TIMES_CHANCE, Evidence, Sides, evidence, in_its_place
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.selection import Step
from ctrplan.diagnosis.smooth_bench import SmoothBench
from ctrplan.diagnosis.verdict import CLOSE, CLOSE_ERRORS, MOST_RIVALS, Alternative, Finding, is_close
from ctrplan.diagnosis.workbench import Panel, Scored
from ctrplan.effects.learned.learned import Learned
from ctrplan.pipeline.term import Term

CLEARLY = 2.0  # standard errors by which a rival has to do better than a frame to take its place
TRIED = 3  # effects that are fitted in the place of one that holds


@dataclass(frozen=True, eq=False)
class Held:
    """A set all of whose effects hold, with the evidence for them and for what was dropped on the way."""

    chosen: Scored
    sides: dict[str, Sides]  # by the name of each effect that holds
    found: tuple[Evidence, ...]
    doubted: tuple[Evidence, ...]
    dropped: tuple[Step, ...]


def held(selector: PartialSelector, chosen: Scored) -> Held:
    """The set without what does not hold, the least certain dropped first and the rest asked again.

    Built terms stay: whether they hold is asked elsewhere.
    """
    bench, doubted, dropped = selector.partial_bench, list[Evidence](), list[Step]()
    while True:
        selector.tell(f"asking what holds of {', '.join(chosen.names)}" if chosen.terms else "asking what holds")
        among = [*bench.basis(chosen.terms), *chosen.terms]
        panel = bench.panel(chosen, selector.candidates.beside(chosen.terms))
        chance = selector.chance(chosen, panel, among)
        asks_frames = not any(_is_beside_frames(t) for t in chosen.terms)
        named = [t for t in among if (t.name in FRAMES and asks_frames) or (t in chosen.terms and not is_built(t))]
        sides = {t.name: _sides(selector, chosen, panel, among, t) for t in named}
        asked = [evidence(bench, sides[t.name], t, chance) for t in named]
        failing = [e for e in asked if not e.holds and e.term in chosen.terms]
        if not failing:
            found = tuple(e for e in asked if e.holds and _is_name(selector, chosen, sides[e.term.name], e.term))
            return Held(chosen, sides, found, tuple(doubted), tuple(dropped))
        worst = min(failing, key=lambda e: e.z)
        doubted.append(worst)
        dropped.append(Step("drop", worst.term.name, (), round(worst.gain, 2), round(worst.error, 2), 0.0, True))
        chosen = bench.corrected(bench.scored([t for t in chosen.terms if t is not worst.term], chosen.fit))


def finding(selector: PartialSelector, found: Held, t: Term) -> tuple[Finding, list[Alternative]]:
    """An effect that holds with what does as well in its place, refitted; and all that was tried there."""
    bench, chosen = selector.partial_bench, found.chosen
    if t.name in FRAMES:
        rivals = [_beside_it(bench, chosen, one) for one in _rivals(selector, found.sides[t.name], t)]
        return Finding(t, tuple(rivals)), rivals
    others, tried = [other for other in chosen.terms if other is not t], []
    for other, _, _ in in_its_place(bench, found.sides[t.name], t)[:TRIED]:
        scored = bench.scored([*others, other], chosen.fit)
        tried.append(Alternative(other, scored, *bench.difference(chosen, scored)))
    return Finding(t, tuple(a for a in tried if is_close(a, chosen))), tried


def _is_beside_frames(t: Term) -> bool:
    """Whether it is a built term whose zero is arbitrary, so that a frame is no name beside it but its constant."""
    return isinstance(t.effect, Learned) and t.effect.target.kind_name in ("sensor", "plate")


def _sides(selector: PartialSelector, chosen: Scored, panel: Panel, among: Sequence[Term], t: Term) -> Sides:
    """Without an effect the set is fitted again; a frame, which is in every fit, is taken out to first order.

    So is every effect of a continuous motion, where fits without friction leave what a lag takes: on a public run of
    three tubes neither could be named then, where both hold to first order.
    """
    bench = selector.partial_bench
    rest = [other for other in among if other.name != t.name]
    if t.name not in chosen.names or bench.data.is_stream:
        return Sides(panel, among, panel.without(t), rest)
    others = [other for other in chosen.terms if other.name != t.name]
    gone = bench.panel(bench.scored(others, chosen.fit), selector.candidates.beside(chosen.terms))
    return Sides(panel, among, gone, [*bench.basis(others), *others])


def _is_name(selector: PartialSelector, chosen: Scored, sides: Sides, t: Term) -> bool:
    """Whether what holds is told as a name: any effect, and a frame as far as it is more than a part of the rest.

    A frame is free in every fit, and where a smooth error is all there is, it takes a part of it. Where other effects
    do as well, it is told with them if it stands out beside an error that is as smooth, and if none does better.
    """
    if t.name not in FRAMES:
        return True
    rivals = _rivals(selector, sides, t)
    if not rivals:
        return True
    better = any(behind < -max(CLOSE, CLEARLY * error) for _, behind, error in rivals)
    return not better and len(rivals) <= MOST_RIVALS and _stands_out(selector, chosen, t)


def _rivals(selector: PartialSelector, sides: Sides, t: Term) -> list[tuple[Term, float, float]]:
    """Effects that do as well in the place of a frame, also such with more parameters than can be named."""
    ranked = in_its_place(selector.bench, sides, t)
    return [one for one in ranked if one[1] < max(CLOSE, CLOSE_ERRORS * one[2])]


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
    return gain > TIMES_CHANCE * chance


def _beside_it(bench: CorrelatedBench, chosen: Scored, rival: tuple[Term, float, float]) -> Alternative:
    """What does as well in the place of a frame, fitted beside it: the frame stays free."""
    other, behind, error = rival
    return Alternative(other, bench.scored([*chosen.terms, other], chosen.fit), behind, error)
