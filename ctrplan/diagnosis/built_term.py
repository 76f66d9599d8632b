"""A term that is built of what remains: pieces that the evidence asks for, beside the names that hold with it.

What acts at a stage of the chain is more probable as a term of that stage than as an error of tips. So pieces are taken
one by one, each where it makes all poses more probable beside the most probable error of tips, by more than the choice
among all pieces costs. Then the catalogue is asked anew beside what was built, which may have hidden a name or stood
for one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.next_experiment import SEPARATING_LOG_ODDS
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis, mean_square, most_probable, remainder_beside
from ctrplan.diagnosis.posterior import MOST_EFFECTS
from ctrplan.diagnosis.remainder import Remainder
from ctrplan.diagnosis.term_pieces import TermPiece, WideLinearisation, is_built, pieces, wide_linearisation, with_piece
from ctrplan.diagnosis.unknown_errors import Peak, UnknownErrors
from ctrplan.diagnosis.workbench import Scored, SelectionStep, Teller, linear
from ctrplan.effects.learned.learned import Learned
from ctrplan.pipeline.term import Term

TRIED = 4  # pieces that are fitted in each round, of those that promise more than one has or as much as the first


@dataclass(frozen=True, eq=False)
class Round:
    """Pieces of a round with what they make the poses more probable by (logarithm), best first."""

    tried: tuple[tuple[TermPiece, float], ...]
    gain: float  # of the best when fitted for good, its choice paid
    taken: TermPiece | None


@dataclass(frozen=True, eq=False)
class Built:
    """A set of effects with built terms, and what they are worth on blocks that were left out."""

    scored: Scored  # named and built
    named: Scored  # without the built ones
    partial: PartialDiagnosis  # what holds of the catalogue beside the built ones, and what the catalogue leaves
    rounds: tuple[Round, ...]
    share: float  # of the rest's squares
    rest: Remainder  # what remains beside the built ones as well

    @property
    def terms(self) -> tuple[Term, ...]:
        """The built ones."""
        return tuple(t for t in self.scored.terms if is_built(t))

    @property
    def gain(self) -> float:
        """Logarithm of how much more probable the built terms make the poses, beside an error of tips."""
        return sum(turn.gain for turn in self.rounds if turn.taken)

    @property
    def path(self) -> tuple[SelectionStep, ...]:
        """The rounds, as steps of a search."""
        return tuple(_step(turn) for turn in self.rounds)

    @property
    def by_stage(self) -> dict[str, float]:
        """Gain of the best first piece of each stage: what decided which stage it is."""
        results: dict[str, float] = {}
        for piece, gain in self.rounds[0].tried:
            results.setdefault(piece.on.kind.stage, gain)
        return results

    def to_json(self, scored: Scored) -> dict[str, Any]:
        """For diagnosis.json, with the coefficients of a fit."""
        return {
            "terms": [_term_json(t, scored) for t in scored.terms if isinstance(t.effect, Learned)],
            "share_of_rest": round(self.share, 3),
            "log_bayes_factor": round(self.gain, 2),
            "best_gain_by_stage": {stage: round(gain, 1) for stage, gain in self.by_stage.items()},
            "rest_rms_mm": round(self.rest.rms_m * 1e3, 4),
        }


def build(partial: PartialDiagnosis, tell: Teller) -> Built | None:
    """A term of what remains, with the effects that hold beside it; None where none makes the poses more probable."""
    if partial.is_noise:
        return None
    in_time = partial.compared.posterior.along.get("time", 0.0) > 1 / 2
    bench, here, rounds = _grown(partial.bench, partial.chosen, partial.known.terms, in_time, tell)
    if not any(is_built(t) for t in here.terms):
        return None
    again = most_probable(bench, here, partial.known, partial.split, partial.block, partial.base, tell)
    bench, scored = again.bench, again.chosen
    if not any(is_built(t) for t in scored.terms):
        return None
    plain = bench.scored([t for t in scored.terms if not is_built(t)], scored.fit)
    before, after = mean_square(bench.left_out_m(plain)), mean_square(bench.left_out_m(scored))
    share = (before - after) / max(before - bench.plain.floor_m**2, 1e-12)
    rest = remainder_beside(bench, scored, bench.plain)
    return Built(_with_sizes(scored), plain, again, tuple(rounds), share, rest)


def _grown(
    bench: CorrelatedBench, chosen: Scored, named: Sequence[Term], in_time: bool, tell: Teller
) -> tuple[CorrelatedBench, Scored, list[Round]]:
    """The set with pieces beside it, its bench, and the rounds that were asked.

    named: effects that no piece stands for; in_time: whether pieces may change with time.
    """
    here, rounds = chosen, list[Round]()
    every = pieces(bench.robot, bench.data, named, in_time=in_time)
    known = [piece for piece in every if piece.on.effect_name not in bench.robot.effects]
    choice = float(np.log(max(len(known), 1)))
    while len(rounds) < MOST_EFFECTS and known:
        tell("building a term beside " + (", ".join(here.names) or "the calibrated robot"))
        root = np.sqrt(np.where(here.failed, 0.0, here.fit.residuals.weight))
        of_here = linear(here.fit).centred(bench.noise, root)
        errors = UnknownErrors(bench, here, here, [of_here], root, with_stages=False)
        before, peak = errors.evidence(of_here)
        table = wide_linearisation(bench, here, known)
        ranked = _ranked(table, table.whole.centred(bench.noise, root), peak, choice)
        best: tuple[float, TermPiece, Scored] | None = None
        for piece, promised in ranked[:TRIED]:
            if best is not None and promised <= min(best[0], ranked[0][1] - SEPARATING_LOG_ODDS):
                break
            there = bench.scored(with_piece(here.terms, piece, table.ranges[piece], bench), here.fit)
            after, _ = errors.evidence(linear(there.fit).centred(bench.noise, root))
            gain = after - before - choice
            if best is None or gain > best[0]:
                best = gain, piece, there
        assert best is not None
        taken = best[1] if best[0] > 0 else None
        rounds.append(Round(tuple(ranked), best[0], taken))
        if taken is None:
            break
        bench, here = bench.corrected(best[2], is_followed=False)
        known = [piece for piece in known if piece != taken]
    if here is not chosen:  # friction states follow when all is built
        bench, here = bench.corrected(here)
    return bench, here, rounds


def _ranked(table: WideLinearisation, whole: Linearised, peak: Peak, choice: float) -> list[tuple[TermPiece, float]]:
    """Pieces by what they gain to first order beside the most probable error of tips, best first."""
    spectrum, own = peak.error.at(whole, peak.position, peak.tangent), list(range(table.own))

    def evidence(columns: list[int]) -> float:
        return float(spectrum.of(columns).evidences(0, 0)) / 2

    plain = evidence(own)
    gains = [(piece, evidence([*own, *places]) - plain - choice) for piece, places in table.places.items()]
    return sorted(gains, key=lambda entry: -entry[1])


def _step(turn: Round) -> SelectionStep:
    piece, gain = turn.tried[0] if turn.taken is None else (turn.taken, turn.gain)
    return SelectionStep("build", piece.on.effect_name, piece.parts, round(gain, 2), turn.taken is not None)


def _term_json(t: Term, scored: Scored) -> dict[str, Any]:
    assert isinstance(t.effect, Learned)
    place = [term.key for term in scored.fit.chain.terms].index(t.key)
    stated = t.effect.stated(scored.fit.chain.values(scored.fit.p)[place])
    coefficients = {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in estimates(scored.fit, t).items()}
    return {"name": t.name, **stated, "coefficients": coefficients}


def _with_sizes(scored: Scored) -> Scored:
    """The set with how far terms of the mechanics move a tip of the data, which margins allow for."""
    chain, p, noted = scored.fit.chain, scored.fit.p, dict[str, Term]()
    here = chain.predict(p, derivatives=False).position_m
    for t, place in zip(chain.terms, chain.slices(), strict=True):
        if isinstance(t.effect, Learned) and t.effect.stage == "mechanics" and t.effect.target.kind_name != "plate":
            without = p.copy()
            without[place] = 0.0
            moved = np.linalg.norm(chain.predict(without, derivatives=False).position_m - here, axis=1)
            largest_mm = float(f"{1e3 * moved.max():.3g}")
            noted[t.key] = Term(t.effect.with_largest(largest_mm, chain.robot.n), t.parameters)
    if not noted:
        return scored
    terms = [noted.get(t.key, t) for t in chain.terms]
    own = tuple(noted.get(t.key, t) for t in scored.terms)
    return Scored(own, replace(scored.fit, chain=chain.with_terms(terms)))
