"""Of a set found beside a rest: what does not hold is dropped, and for what holds it is said what does as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.holding import Evidence, evidence, in_its_place
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.selection import Step
from ctrplan.diagnosis.verdict import CLOSE, CLOSE_ERRORS, Alternative, Finding, is_close
from ctrplan.diagnosis.workbench import Panel, Scored
from ctrplan.effects.learned.learned import Learned
from ctrplan.pipeline.term import Term

TRIED = 3  # effects that are fitted in the place of one that holds


@dataclass(frozen=True, eq=False)
class Held:
    """A set all of whose effects hold, with the evidence for them and for what was dropped on the way."""

    chosen: Scored
    among: tuple[Term, ...]  # all that is fitted
    panel: Panel
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
        asked = [evidence(bench, panel, among, t, chance) for t in named]
        failing = [e for e in asked if not e.holds and e.term in chosen.terms]
        if not failing:
            found = tuple(e for e in asked if e.holds and not _is_replaceable(selector, panel, among, e.term))
            return Held(chosen, tuple(among), panel, found, tuple(doubted), tuple(dropped))
        worst = min(failing, key=lambda e: e.z)
        doubted.append(worst)
        dropped.append(Step("drop", worst.term.name, (), round(worst.gain, 2), round(worst.error, 2), 0.0, True))
        chosen = bench.corrected(bench.scored([t for t in chosen.terms if t is not worst.term], chosen.fit))


def finding(selector: PartialSelector, found: Held, t: Term) -> tuple[Finding, list[Alternative]]:
    """An effect that holds with what does as well in its place, refitted; and all that was tried there."""
    bench, chosen = selector.partial_bench, found.chosen
    if t.name in FRAMES:
        return Finding(t), []
    others, tried = [other for other in chosen.terms if other is not t], []
    for other, _, _ in in_its_place(bench, found.panel, found.among, t)[:TRIED]:
        scored = bench.scored([*others, other], chosen.fit)
        tried.append(Alternative(other, scored, *bench.difference(chosen, scored)))
    return Finding(t, tuple(a for a in tried if is_close(a, chosen))), tried


def _is_beside_frames(t: Term) -> bool:
    """Whether it is a built term whose zero is arbitrary, so that a frame is no name beside it but its constant."""
    return isinstance(t.effect, Learned) and t.effect.target.kind_name in ("sensor", "plate")


def _is_replaceable(selector: PartialSelector, panel: Panel, among: Sequence[Term], t: Term) -> bool:
    """Whether another effect does as well in the place of a frame, which is free in every fit.

    Also one with more parameters than can be named: where a smooth error is all there is, a frame takes part of it.
    """
    if t.name not in FRAMES:
        return False
    ranked = in_its_place(selector.bench, panel, among, t)
    return any(behind < max(CLOSE, CLOSE_ERRORS * error) for _, behind, error in ranked)
