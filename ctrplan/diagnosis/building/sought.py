"""A search for a term of what remains, from more than one start; what passes and is most probable is handed over.

Pieces may stand for a name, and a name for a piece: beside a bent guide a load was the first of all effects, and once
the plate's term was built it had little left. So of poses at rest a term is sought beside what holds by blocks left
out, and once more beside the one effect that is most probable alone. Both sets are compared as a whole, by their
evidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ctrplan.calibration.symptoms import strained
from ctrplan.diagnosis.building.built import Built, built_of, refusals
from ctrplan.diagnosis.building.dictionary import pieces
from ctrplan.diagnosis.building.search import grown
from ctrplan.diagnosis.frames import FRAME_MOVES
from ctrplan.diagnosis.named_beside import most_probable_alone
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.partly import Partly, concluded
from ctrplan.diagnosis.selection import Selection, Step
from ctrplan.diagnosis.shares import mean_square
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence
from ctrplan.diagnosis.workbench import Scored
from ctrplan.effects.learned.learned import Learned

WITHIN_REACH = 0.6  # of the squares that remain, to first order before anything is fitted; else no search is begun
MOST_TIMES = 2  # that a term is built anew beside other names
LIKE_SMOOTH = ("sensor_offset",)  # names that a smooth error is partly
LEAST_LIKE_SMOOTH = 20.0  # logarithm of evidence, if they move positions no further than a frame has to; wrong had 12
WORTH = 0.5  # of the noise: what remains has to be larger for a term to be sought


def build(found: Partly, tell: Callable[[str], None]) -> Built | None:
    """A term of what remains beside the effects that hold; None where nothing passes."""
    built = tried(found, tell)
    if built is None:
        return None
    if refusals(found.bench, built):
        found.bench.corrected(found.chosen)
        return None
    _note_sizes(built)
    return built


def tried(found: Partly, tell: Callable[[str], None]) -> Built | None:
    """What a search for a term ends with, before it is asked whether it holds."""
    bench = found.bench
    if found.is_noise or found.rest.rms_m < WORTH * bench.plain.floor_m:
        return None
    built = _settled(found, found.chosen, tell)
    if bench.data.is_stream:
        strange = strained(found.chosen.fit, found.chosen.names)
        return _instead_of_names(found, built, tell) if strange else built
    likely = most_probable_alone(_selector(found, found.chosen, tell))
    if likely is not None and not {*likely.names} <= _named(found, built):
        built = _better(found, built, _settled(found, likely, tell))
    if built is not None and built.partly.judgement.findings and refusals(bench, built):
        built = _of_smaller_pieces(found, tell) or built
    built = built and _without_faint(found, built, tell)
    bench.corrected(built.scored if built else found.chosen)  # the discrepancy beside what is handed over
    return built


def _instead_of_names(found: Partly, beside: Built | None, tell: Callable[[str], None]) -> Built | None:
    """Of a continuous motion: a term that names stand for, sought beside nothing, where blocks left out are nearer so.

    It is where a name has a parameter that is not plausible: friction at the plate was called play in the drive and a
    delay as long as delays can be, which left a third of it. Names that hold beside such a term are told with it.
    """
    bench = found.bench
    passes = beside is not None and not refusals(bench, beside)
    here = bench.corrected(beside.scored if beside and passes else found.chosen)
    error = mean_square(bench.left_out_m(here))
    nothing = bench.corrected(bench.scored([], found.chosen.fit))
    instead = _settled(found, nothing, tell)
    is_good = instead is not None and not refusals(bench, instead)
    if instead is not None and is_good and mean_square(bench.left_out_m(instead.scored)) < error:
        return instead
    bench.corrected(here)
    return beside


def _of_smaller_pieces(found: Partly, tell: Callable[[str], None]) -> Built | None:
    """What passes of pieces that need not beat smooth surrogates: where something is known, also beside the term."""
    bench = found.bench
    begun = bench.corrected(bench.scored(found.chosen.terms, found.chosen.fit))
    built = _settled(found, begun, tell, smooth_counts=False)
    passes = built is not None and built.partly.judgement.findings and not refusals(bench, built)
    return built if passes else None


def _without_faint(found: Partly, built: Built, tell: Callable[[str], None]) -> Built:
    """Asked again without names that a smooth error looks like, that gain little and move little, if there are any.

    They may stay while terms are built: beside shifted headings an offset went from 7 to 32.
    """
    bench, listed = found.bench, [finding.term.name for finding in built.partly.judgement.findings]
    gains = {one.effect: one.gain for one in built.partly.path if one.action == "add" and one.taken}
    faint = {name for name in LIKE_SMOOTH if name in listed and gains.get(name, np.inf) < LEAST_LIKE_SMOOTH}
    if faint:
        evidence = SmoothEvidence(bench, bench.corrected(built.scored))
        faint = {name for name in faint if evidence.moved(name) < FRAME_MOVES}
    if not faint:
        return built
    known = replace(found.known, terms=tuple(t for t in found.known.terms if t.name not in faint))
    terms = [t for t in built.scored.terms if t.name not in faint]
    selector = PartialSelector(bench, known, tell, bench.corrected(bench.scored(terms, built.scored.fit)))
    again = concluded(selector, Selection(selector.found.chosen, []), found.known, found.split, found.block, found.base)
    return replace(built_of(again, built.rounds), is_shown=built.is_shown)


def _named(found: Partly, built: Built | None) -> set[str]:
    """Names that a term was sought beside, or that hold beside it."""
    return {*found.chosen.names} if built is None else {*found.chosen.names, *built.named.names}


def _better(found: Partly, one: Built | None, other: Built | None) -> Built | None:
    """The more probable of those that pass.

    Where one passes, something is there that a smooth error does not explain, and what is more probable as a whole is
    not asked that again.
    """
    both = [built for built in (one, other) if built is not None]
    passing = [built for built in both if not refusals(found.bench, built)]
    if not passing:
        return max(both, key=lambda built: built.evidence, default=None)
    best = max(passing, key=lambda built: built.evidence)
    more = [replace(built, is_shown=True) for built in both if built.evidence > best.evidence]
    return next((built for built in more if not refusals(found.bench, built)), best)


def _settled(found: Partly, named: Scored, tell: Callable[[str], None], smooth_counts: bool = True) -> Built | None:
    """Built beside a set, and once more where other names act beside the term: pieces may have stood for them.

    The new one is taken where it passes, and the old one does not or is less probable.
    """
    bench, built = found.bench, _tried_beside(found, named, tell, smooth_counts)
    asked = {frozenset(t.key for t in named.terms)}
    while built is not None and not bench.data.is_stream and len(asked) <= MOST_TIMES:
        names = [t for t in built.scored.terms if not is_built(t)]
        key = frozenset(t.key for t in names)
        if not names or key in asked:
            break
        asked.add(key)
        again = _tried_beside(found, bench.corrected(bench.scored(names, built.scored.fit)), tell, smooth_counts)
        if again is None or refusals(bench, again):
            break
        if not refusals(bench, built) and again.evidence < built.evidence:
            break
        built = again
    if built is not None:
        bench.corrected(built.scored)
    return built


def _tried_beside(
    found: Partly, named: Scored, tell: Callable[[str], None], smooth_counts: bool = True
) -> Built | None:
    """Beside a set: of the effects that hold, or with such besides as may hold beside a term.

    On a continuous motion the catalogue is asked after each piece. Of poses at rest it is asked of all pieces in the
    end, and what it has there may take the place of some.
    """
    bench = found.bench
    path = list[Step]()

    def with_names(here: Scored) -> Scored:
        if not bench.data.is_stream:
            return here
        searched = _selector(found, here, tell).run()
        path.extend(searched.path)
        return searched.chosen

    known = pieces(bench.robot, bench.data, found.known.terms)
    scored, rounds = grown(bench, named, known, tell, with_names, WITHIN_REACH, smooth_counts)
    if scored is named:
        return None
    selector = _selector(found, scored, tell)
    again = concluded(selector, Selection(scored, path), found.known, found.split, found.block, found.base)
    if not any(is_built(t) for t in again.chosen.terms):
        return None
    return built_of(again, rounds)


def _selector(found: Partly, here: Scored, tell: Callable[[str], None]) -> PartialSelector:
    return PartialSelector(found.bench, found.known, tell, here)


def _note_sizes(built: Built) -> None:
    """How far terms of the mechanics move a tip of the data, which margins allow for."""
    chain, p = built.scored.fit.chain, built.scored.fit.p
    here = chain.predict(p, derivatives=False).position_m
    for t, place in zip(chain.terms, chain.slices(), strict=True):
        if isinstance(t.effect, Learned) and t.effect.stage == "mechanics" and t.effect.target.kind_name != "plate":
            without = p.copy()
            without[place] = 0.0
            moved = np.linalg.norm(chain.predict(without, derivatives=False).position_m - here, axis=1)
            t.effect.largest_mm = float(f"{1e3 * moved.max():.3g}")
