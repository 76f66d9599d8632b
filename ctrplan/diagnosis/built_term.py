"""A term that was built of what remains: searched from more than one start, passed by blocks left out, worse
nowhere.

Pieces may stand for a name, and a name for a piece: beside a bent guide a load was the first of all effects, and once
the plate's term was built it had little left. So of poses at rest a term is sought beside what holds by blocks left
out, and once more beside the one effect that is most probable alone. Both sets are compared as a whole, by their
evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.fit_warnings import strained
from ctrplan.diagnosis.block_evidence import SAYS_SOMETHING, mean_square, summed
from ctrplan.diagnosis.correlated_bench import FRAME_MOVES, CorrelatedBench
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis, concluded, most_probable_alone, remainder_beside
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.remainder import Remainder
from ctrplan.diagnosis.selection import Selection, SelectionStep
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence
from ctrplan.diagnosis.term_dictionary import pieces
from ctrplan.diagnosis.term_search import Round, Tried, grown
from ctrplan.diagnosis.workbench import Scored, certainty
from ctrplan.effects.learned.learned import Learned
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term

LEAST_Z = 5.0  # standard errors over blocks
TIMES_CHANCE = 4.0  # the gain that the first piece reaches in 2 % of smooth surrogates, of all pieces together
LEAST_EVIDENCE = 20.0  # logarithm, beside a smooth error: what four choices among 150 pieces may gain, 4 log 150
LEAST_WINNING = 0.85  # of the blocks that say something
LEAST_SHARE = 0.6  # of the squares that remain beyond noise, closed on blocks left out; to first order before any fit
LEAST_SHARE_ASIDE = 0.4  # of the same, closed on the poses kept aside
MOST_WORSE = 1.05  # of the rms error of any region, with the term over without
LEAST_POSES = 8  # of a region that is asked


@dataclass(frozen=True, eq=False)
class Built:
    """A set of effects with built terms, and their evidence on blocks that were left out."""

    scored: Scored  # named and built
    named: Scored  # without the built ones
    partly: PartialDiagnosis  # what holds of the catalogue beside the built ones, and what the catalogue leaves
    rounds: tuple[Round, ...]
    gain: float
    error: float  # standard error over blocks
    z: float
    winning: float  # share of the blocks that say something
    share: float  # of the rest's squares
    rest: Remainder  # what remains beside the built ones as well
    odds: float  # logarithm, of the terms beside an error as smooth as is probable
    evidence: float  # logarithm of that of the whole set there
    is_shown: bool = False  # whether a less probable set passes, so that there is more than a smooth error

    @property
    def terms(self) -> tuple[Term, ...]:
        """The built ones."""
        return tuple(t for t in self.scored.terms if is_built(t))

    @property
    def is_chance(self) -> bool:
        """Whether an error that is smooth in the joints might have let pieces gain as much."""
        if self.is_shown:
            return False
        return self.gain < TIMES_CHANCE * self.rounds[0].smooth_chance or self.odds < LEAST_EVIDENCE

    @property
    def path(self) -> tuple[SelectionStep, ...]:
        """The rounds, as steps of a search."""
        return tuple(_step(one) for one in self.rounds)

    @property
    def by_stage(self) -> dict[str, float]:
        """Gain of the best first piece of each stage: what decided which stage it is."""
        results: dict[str, float] = {}
        for one in self.rounds[0].tried:
            results.setdefault(one.piece.on.kind.stage, one.gain)
        return results

    def to_json(self, scored: Scored) -> dict[str, Any]:
        """For diagnosis.json, with the coefficients of a fit."""
        return {
            "terms": [_term_json(t, scored) for t in scored.terms if isinstance(t.effect, Learned)],
            "share_of_rest": round(self.share, 3),
            "gain": round(self.gain, 2),
            "standard_error": round(self.error, 2),
            "z": round(self.z, 2),
            "winning_blocks": round(self.winning, 3),
            "surrogates_98": round(self.rounds[0].smooth_chance, 2),
            "best_gain_by_stage": {stage: round(gain, 1) for stage, gain in self.by_stage.items()},
            "rest_rms_mm": round(self.rest.rms_m * 1e3, 4),
        }


def built_of(partial: PartialDiagnosis, rounds: Sequence[Round]) -> Built:
    """What a search ended with, with its evidence."""
    bench, scored = partial.bench, partial.chosen
    plain = bench.scored([t for t in scored.terms if not is_built(t)], scored.fit)  # beside what is left now
    gains = bench.by_group((plain.held_out - scored.held_out) / 2)
    telling = gains[np.abs(gains) > SAYS_SOMETHING]
    winning = float((telling > 0).mean()) if len(telling) else 0.0
    before, after = mean_square(bench.left_out_m(plain)), mean_square(bench.left_out_m(scored))
    share = (before - after) / max(before - bench.plain.floor_m**2, 1e-12)
    rest = remainder_beside(bench, scored, bench.plain)
    probable = SmoothEvidence(bench, scored).highest()
    odds = probable - SmoothEvidence(bench, plain).highest()
    return Built(
        scored, plain, partial, tuple(rounds), *summed(gains), certainty(gains), winning, share, rest, odds, probable
    )


def refusals(bench: CorrelatedBench, built: Built) -> list[str]:
    """Why a term is not handed over; empty if it is."""
    errors = [np.linalg.norm(bench.left_out_m(scored), axis=1) for scored in (built.named, built.scored)]
    worse = worse_in(bench.data, errors[0], errors[1])
    said = {
        f"its gain is {built.z:.1f} standard errors above zero over blocks": built.z < LEAST_Z,
        f"its gain of {built.gain:.0f} is what chance may give beside a smooth error": built.is_chance,
        f"only {100 * built.winning:.0f} % of the blocks speak for it": built.winning < LEAST_WINNING,
        f"it closes {100 * built.share:.0f} % of what remains": built.share < LEAST_SHARE,
        f"it is worse on {worse}": bool(worse),
    }
    return [reason for reason, is_one in said.items() if is_one]


def worse_in(data: Measurements, before: Array, after: Array) -> str:
    """The first region in which errors (K,) have grown by more than 5 %, in words; empty if none."""
    for name, inside in regions(data).items():
        if inside.sum() >= LEAST_POSES and _rms(after[inside]) > MOST_WORSE * _rms(before[inside]):
            return name
    return ""


def regions(data: Measurements) -> dict[str, NDArray[np.bool_]]:
    """Masks (K,) of all poses, and of the thirds of each joint's range that changes, rotations modulo a turn."""
    results = {"all poses": np.ones(data.count, bool)}
    theta, l = np.mod(data.theta_commanded[data.rows], 2 * np.pi), data.l_commanded[data.rows]  # noqa: E741
    for kind, columns in (("rotation", theta), ("translation", l)):
        for i, values in enumerate(columns.T, start=1):
            if np.ptp(values) > 1e-3:
                third = np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values, side="right")
                words = ("lowest", "middle", "highest")
                results |= {f"the {words[k]} third of the {kind} of tube {i}": third == k for k in range(3)}
    return results


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _step(one: Round) -> SelectionStep:
    best: Tried = one.tried[0]
    shown = best if one.taken is None else next(tried for tried in one.tried if tried.piece == one.taken)
    name, parts = shown.piece.on.effect_name, shown.piece.parts
    return SelectionStep("build", name, parts, round(shown.gain, 2), 0.0, round(one.chance, 2), one.taken is not None)


def _term_json(t: Term, scored: Scored) -> dict[str, Any]:
    assert isinstance(t.effect, Learned)
    place = [term.key for term in scored.fit.chain.terms].index(t.key)
    stated = t.effect.stated(scored.fit.chain.values(scored.fit.p)[place])
    coefficients = {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in estimates(scored.fit, t).items()}
    return {"name": t.name, **stated, "coefficients": coefficients}


MOST_TIMES = 2  # that a term is built anew beside other names
LIKE_SMOOTH = ("sensor_offset",)  # names that a smooth error is partly
WORTH = 0.5  # of the noise: what remains has to be larger for a term to be sought


def build(partial: PartialDiagnosis, tell: Callable[[str], None]) -> Built | None:
    """A term of what remains beside the effects that hold; None where nothing passes."""
    built = tried(partial, tell)
    if built is None:
        return None
    if refusals(partial.bench, built):
        partial.bench.corrected(partial.chosen)
        return None
    _note_sizes(built)
    return built


def tried(partial: PartialDiagnosis, tell: Callable[[str], None]) -> Built | None:
    """What a search for a term ends with, before it is asked whether it holds."""
    bench = partial.bench
    if partial.is_noise or partial.rest.rms_m < WORTH * bench.plain.floor_m:
        return None
    built = _settled(partial, partial.chosen, tell)
    if bench.data.is_stream:
        strange = strained(partial.chosen.fit, partial.chosen.names)
        return _instead_of_names(partial, built, tell) if strange else built
    likely = most_probable_alone(_selector(partial, partial.chosen, tell))
    if likely is not None and not {*likely.names} <= _named(partial, built):
        built = _better(partial, built, _settled(partial, likely, tell))
    if built is not None and built.partly.judgement.findings and refusals(bench, built):
        built = _of_smaller_pieces(partial, tell) or built
    built = built and _without_faint(partial, built, tell)
    bench.corrected(built.scored if built else partial.chosen)  # the discrepancy beside what is handed over
    return built


def _instead_of_names(partial: PartialDiagnosis, beside: Built | None, tell: Callable[[str], None]) -> Built | None:
    """A term of a continuous motion that names stand for, built beside nothing, where blocks left out are nearer so.

    It is where a name has a parameter that is not plausible: friction at the plate was called play in the drive and a
    delay as long as delays can be, which left a third of it. Names that hold beside such a term are told with it.
    """
    bench = partial.bench
    passes = beside is not None and not refusals(bench, beside)
    here = bench.corrected(beside.scored if beside and passes else partial.chosen)
    error = mean_square(bench.left_out_m(here))
    nothing = bench.corrected(bench.scored([], partial.chosen.fit))
    instead = _settled(partial, nothing, tell)
    is_good = instead is not None and not refusals(bench, instead)
    if instead is not None and is_good and mean_square(bench.left_out_m(instead.scored)) < error:
        return instead
    bench.corrected(here)
    return beside


def _of_smaller_pieces(partial: PartialDiagnosis, tell: Callable[[str], None]) -> Built | None:
    """What passes of pieces that need not beat smooth surrogates: where something is known, also beside the term."""
    bench = partial.bench
    begun = bench.corrected(bench.scored(partial.chosen.terms, partial.chosen.fit))
    built = _settled(partial, begun, tell, smooth_counts=False)
    passes = built is not None and built.partly.judgement.findings and not refusals(bench, built)
    return built if passes else None


def _without_faint(partial: PartialDiagnosis, built: Built, tell: Callable[[str], None]) -> Built:
    """Asked again without names that a smooth error looks like, that gain little and move little, if there are any.

    They may stay while terms are built: beside shifted headings an offset went from 7 to 32.
    """
    bench, listed = partial.bench, [finding.term.name for finding in built.partly.judgement.findings]
    gains = {one.effect: one.gain for one in built.partly.path if one.action == "add" and one.taken}
    faint = {name for name in LIKE_SMOOTH if name in listed and gains.get(name, np.inf) < LEAST_EVIDENCE}
    if faint:
        evidence = SmoothEvidence(bench, bench.corrected(built.scored))
        faint = {name for name in faint if evidence.moved(name) < FRAME_MOVES}
    if not faint:
        return built
    known = replace(partial.known, terms=tuple(t for t in partial.known.terms if t.name not in faint))
    terms = [t for t in built.scored.terms if t.name not in faint]
    selector = PartialSelector(bench, known, tell, bench.corrected(bench.scored(terms, built.scored.fit)))
    again = concluded(
        selector, Selection(selector.found.chosen, []), partial.known, partial.split, partial.block, partial.base
    )
    return replace(built_of(again, built.rounds), is_shown=built.is_shown)


def _named(partial: PartialDiagnosis, built: Built | None) -> set[str]:
    """Names that a term was sought beside, or that hold beside it."""
    return {*partial.chosen.names} if built is None else {*partial.chosen.names, *built.named.names}


def _better(partial: PartialDiagnosis, one: Built | None, other: Built | None) -> Built | None:
    """The more probable of those that pass.

    Where one passes, something is there that a smooth error does not explain, and what is more probable as a whole is
    not asked that again.
    """
    both = [built for built in (one, other) if built is not None]
    passing = [built for built in both if not refusals(partial.bench, built)]
    if not passing:
        return max(both, key=lambda built: built.evidence, default=None)
    best = max(passing, key=lambda built: built.evidence)
    more = [replace(built, is_shown=True) for built in both if built.evidence > best.evidence]
    return next((built for built in more if not refusals(partial.bench, built)), best)


def _settled(
    partial: PartialDiagnosis, named: Scored, tell: Callable[[str], None], smooth_counts: bool = True
) -> Built | None:
    """Built beside a set, and once more where other names act beside the term: pieces may have stood for them.

    The new one is taken where it passes, and the old one does not or is less probable.
    """
    bench, built = partial.bench, _tried_beside(partial, named, tell, smooth_counts)
    asked = {frozenset(t.key for t in named.terms)}
    while built is not None and not bench.data.is_stream and len(asked) <= MOST_TIMES:
        names = [t for t in built.scored.terms if not is_built(t)]
        key = frozenset(t.key for t in names)
        if not names or key in asked:
            break
        asked.add(key)
        again = _tried_beside(partial, bench.corrected(bench.scored(names, built.scored.fit)), tell, smooth_counts)
        if again is None or refusals(bench, again):
            break
        if not refusals(bench, built) and again.evidence < built.evidence:
            break
        built = again
    if built is not None:
        bench.corrected(built.scored)
    return built


def _tried_beside(
    partial: PartialDiagnosis, named: Scored, tell: Callable[[str], None], smooth_counts: bool = True
) -> Built | None:
    """Beside a set: of the effects that hold, or with such besides as may hold beside a term.

    On a continuous motion the catalogue is asked after each piece. Of poses at rest it is asked of all pieces in the
    end, and what it has there may take the place of some.
    """
    bench = partial.bench
    path = list[SelectionStep]()

    def with_names(here: Scored) -> Scored:
        if not bench.data.is_stream:
            return here
        searched = _selector(partial, here, tell).run()
        path.extend(searched.path)
        return searched.chosen

    known = pieces(bench.robot, bench.data, partial.known.terms)
    scored, rounds = grown(bench, named, known, tell, with_names, LEAST_SHARE, smooth_counts)
    if scored is named:
        return None
    selector = _selector(partial, scored, tell)
    again = concluded(selector, Selection(scored, path), partial.known, partial.split, partial.block, partial.base)
    if not any(is_built(t) for t in again.chosen.terms):
        return None
    return built_of(again, rounds)


def _selector(partial: PartialDiagnosis, here: Scored, tell: Callable[[str], None]) -> PartialSelector:
    return PartialSelector(partial.bench, partial.known, tell, here)


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
