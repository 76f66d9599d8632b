"""Forward selection of pieces: each above what traded residuals of configurations reach, by blocks that were left out.

After each piece the catalogue is asked again. What it has may have been small beside the rest before, and has a name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ctrplan.diagnosis.building.dictionary import Piece
from ctrplan.diagnosis.building.probes import Wide, wide
from ctrplan.diagnosis.building.reach import reach
from ctrplan.diagnosis.chance import null_thresholds
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.shares import mean_square
from ctrplan.diagnosis.workbench import Scored, certainty
from ctrplan.effects.learned.learned import Learned, learned, named
from ctrplan.effects.learned.ranges import Range
from ctrplan.effects.learned.targets import Target
from ctrplan.pipeline.term import Term

MOST_PIECES = 4
DRAWS = 200  # surrogates
TIMES_CHANCE = 1.2  # the gain that traded residuals exceed in 2 % of draws; beside a piece that passed, smooth ones too
CERTAIN = 2.0  # standard errors over blocks, of a piece while others are missing
LEAST_SHARE = 0.1  # of the squares that remain beyond noise, which a piece has to close of blocks left out
WORTH_MORE = 3.0  # log-likelihood that a piece with more coefficients has to gain besides
TRIED = 4  # pieces that are refitted for good in each round


@dataclass(frozen=True)
class Tried:
    """A piece of a round: gain in held-out log-likelihood, to first order."""

    piece: Piece
    gain: float
    certainty: float


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried, best first, and what the best of all pieces reaches by chance."""

    tried: tuple[Tried, ...]
    chance: float
    smooth_chance: float  # the same on surrogates that are as smooth in the joints as what remains
    taken: Piece | None


def grown(
    bench: CorrelatedBench,
    chosen: Scored,
    known: Sequence[Piece],
    tell: Callable[[str], None],
    with_names: Callable[[Scored], Scored],
    least: float,
    smooth_counts: bool = True,
) -> tuple[Scored, list[Round]]:
    """The set with what was built beside it, if anything, and the rounds that were asked.

    known: pieces that may be built; with_names: adds what the catalogue has beside a set; least: share of the rest that
    pieces must be able to close; smooth_counts: whether pieces beside others have to beat smooth surrogates as well.
    """
    rounds, here = list[Round](), chosen
    known = [piece for piece in known if piece.on.effect_name not in bench.robot.effects]
    while len(rounds) < MOST_PIECES:
        tell("building a term beside " + (", ".join(here.names) or "the calibrated robot"))
        table = wide(bench, here, known)
        if not rounds and reach(bench, table, known, MOST_PIECES) < least:
            break
        taken, there = _round(bench, here, table, known, bool(rounds), smooth_counts)
        rounds.append(taken)
        if there is None:
            return here, rounds
        here = _needed(bench, with_names(there), taken.chance, known=there)
        known = [piece for piece in known if piece != taken.taken]
    return here, rounds


def _round(
    bench: CorrelatedBench, here: Scored, table: Wide, known: Sequence[Piece], is_more: bool, smooth_counts: bool
) -> tuple[Round, Scored | None]:
    """is_more: whether a piece was taken before."""
    tried = _tried(bench, table, known)
    beside = [table.beside(one.piece) for one in tried]
    draws = [drawn(here)[:, :DRAWS] for drawn in (bench.traded_draws, bench.null_draws)]
    chance, smooth = null_thresholds(table.here(), beside, bench.null_scores, draws)
    needed = TIMES_CHANCE * chance
    if is_more:
        needed = TIMES_CHANCE * max(chance, smooth) if smooth_counts else chance
    worth = [one for one in tried if one.gain > needed and one.certainty > CERTAIN]
    best: tuple[Piece, Scored] | None = None
    for one in sorted(worth[:TRIED], key=lambda one: (len(one.piece.names), known.index(one.piece))):
        there = bench.scored(_with_piece(here.terms, one.piece, table.ranges[one.piece], bench), here.fit)
        if best is None or there.score > best[1].score + WORTH_MORE:  # the simplest of those that do as well
            best = one.piece, there
    if best is None or not _is_worth(bench, here, best[1], needed):
        return Round(tuple(tried), chance, smooth, None), None
    return Round(tuple(tried), chance, smooth, best[0]), bench.corrected(best[1])


def _needed(bench: CorrelatedBench, here: Scored, least: float, known: Scored) -> Scored:
    """Without built terms whose place the names that came besides have taken; the `known` set had none of these."""
    if here is known:
        return here
    for t in (t for t in here.terms if is_built(t)):
        without = bench.scored([other for other in here.terms if other is not t], here.fit)
        if bench.difference(here, without)[0] < least:
            return _needed(bench, bench.corrected(without), least, known)
    return here


def _tried(bench: CorrelatedBench, table: Wide, known: Sequence[Piece]) -> list[Tried]:
    plain = bench.loss(table.here().refitted())
    found = []
    for piece in known:
        gains = bench.by_group((plain - bench.loss(table.beside(piece).refitted())) / 2)
        found.append(Tried(piece, float(gains.sum()), certainty(gains)))
    return sorted(found, key=lambda one: -one.gain)


def _is_worth(bench: CorrelatedBench, here: Scored, there: Scored, needed: float) -> bool:
    """Whether a refitted piece holds, and closes enough of what remains."""
    gain, _ = bench.difference(there, here)
    before, after = mean_square(bench.left_out_m(here)), mean_square(bench.left_out_m(there))
    rest = max(before - bench.plain.floor_m**2, 1e-12)
    return gain > needed and before - after > LEAST_SHARE * rest


def _with_piece(terms: Sequence[Term], piece: Piece, ranges: dict[str, Range], bench: CorrelatedBench) -> list[Term]:
    """The terms with a piece in the built term of its target."""
    old = next((t for t in terms if t.name == piece.on.effect_name), None)
    names, spans = list[str](), dict(ranges)
    if old is not None:
        assert isinstance(old.effect, Learned)
        names, spans = list(old.effect.parts), {**ranges, **old.effect.ranges}
    names += [name for name in (*piece.names, *_zero(piece)) if name not in names]
    return [*(t for t in terms if t is not old), built_term(piece.on, names, spans, bench.robot.n)]


def _zero(piece: Piece) -> list[str]:
    """The constant that goes with a slope whose zero is arbitrary: else that would be a wrong zero of a joint.

    A slope of the drive, and of a precurvature across its plane, which turns a tube as a joint does.
    """
    is_slope = any(part.startswith("slope_") for part in piece.parts)
    is_of_turn = piece.on.kind_name == "bend" or (piece.on.kind.stage == "drive" and not piece.on.of_way)
    return named(piece.on, "constant") if is_slope and is_of_turn else []


def built_term(on: Target, names: Sequence[str], ranges: dict[str, Range], n: int) -> Term:
    """With all its parameters at work."""
    effect = learned(on, names, ranges, n)
    return Term(effect, effect.parameters_of())
