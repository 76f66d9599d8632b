"""What was found on the poses that choose, as one value: of the ordinary search, of one beside a rest, and with a term
built of the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.correlated_bench import FRAMES, CorrelatedBench
from ctrplan.diagnosis.linear_fit import left_out_residuals
from ctrplan.diagnosis.posterior import Compared
from ctrplan.diagnosis.remainder import Remainder
from ctrplan.diagnosis.term_pieces import TermPiece
from ctrplan.diagnosis.verdict import Judgement
from ctrplan.diagnosis.workbench import Candidates, Scored, SelectionStep, Workbench, linear
from ctrplan.effects.learned.learned import Learned
from ctrplan.measurement.measurements import Split
from ctrplan.pipeline.term import Term


@dataclass(frozen=True)
class Closing:
    """Rms errors [m] without an effect and with it; gap_m: what calibration alone leaves, beyond the noise."""

    without_m: float
    with_m: float
    gap_m: float

    @property
    def share(self) -> float:
        """The share of the gap, in squares. Where effects hide one another, it may be below 0 or above 1."""
        return (self.without_m**2 - self.with_m**2) / max(self.gap_m**2, 1e-12)


@dataclass(frozen=True, eq=False)
class Part:
    """An effect of the verdict, with what it closes of the gap alone, and last of all."""

    term: Term
    alone: Closing
    last: Closing


@dataclass(frozen=True, eq=False)
class Round:
    """Pieces of a round with what they make the poses more probable by (logarithm), best first."""

    tried: tuple[tuple[TermPiece, float], ...]
    gain: float  # of the best when fitted for good, its choice paid
    taken: TermPiece | None

    @property
    def step(self) -> SelectionStep:
        """The round as a step of a search."""
        piece, gain = self.tried[0] if self.taken is None else (self.taken, self.gain)
        return SelectionStep("build", piece.on.effect_name, piece.parts, round(gain, 2), self.taken is not None)


@dataclass(frozen=True, eq=False)
class Built:
    """How terms were built of a rest, and what they are worth on blocks that were left out."""

    named: Scored  # the set without the built ones
    rounds: tuple[Round, ...]
    share: float  # of the rest's squares
    rest: Remainder  # what remains beside the built ones as well

    @property
    def gain(self) -> float:
        """Logarithm of how much more probable the built terms make the poses, beside an error of tips."""
        return sum(turn.gain for turn in self.rounds if turn.taken)

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
            "terms": list(_stated(scored)),
            "share_of_rest": round(self.share, 3),
            "log_bayes_factor": round(self.gain, 2),
            "best_gain_by_stage": {stage: round(gain, 1) for stage, gain in self.by_stage.items()},
            "rest_rms_mm": round(self.rest.rms_m * 1e3, 4),
        }


def _stated(scored: Scored) -> Iterator[dict[str, Any]]:
    """Every built term with its coefficients."""
    chain, p = scored.fit.chain, scored.fit.p
    for t, values in zip(chain.terms, chain.values(p), strict=True):
        if isinstance(t.effect, Learned):
            found = estimates(scored.fit, t).items()
            coefficients = {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in found}
            yield {"name": t.name, **t.effect.stated(values), "coefficients": coefficients}


@dataclass(frozen=True, eq=False)
class Conclusion:
    """What was found on the poses that choose; the arrays are over all poses (K,) of the data."""

    bench: Workbench
    known: Candidates  # that were asked
    split: Split
    group: NDArray[np.int_]  # (K,) poses that count as one
    wrong: NDArray[np.bool_]  # (K,) poses that went wrong
    noise: Noise
    base: Scored  # calibrated without effects, and without a free frame
    chosen: Scored  # the most probable set
    judgement: Judgement
    path: tuple[SelectionStep, ...] = ()
    notes: tuple[str, ...] = ()
    is_rescaled: bool = False  # whether the noise is smaller than stated
    interrupted: bool = False
    compared: Compared | None = None  # sets of effects
    rest: Remainder | None = None  # beside the effects that the catalogue has, where the search was beside one
    built: Built | None = None  # terms of the rest, among those chosen
    before: Conclusion | None = None  # what was concluded before this was asked

    @property
    def is_told(self) -> bool:
        """Whether it says more than that something is unexplained."""
        return self.interrupted or bool(self.built or self.judgement.findings or self.judgement.together)

    @property
    def told(self) -> Conclusion:
        """This, or what came before where this says nothing more."""
        return self if self.is_told or self.before is None else self.before

    @property
    def ordinary(self) -> Conclusion:
        """The search for what leaves noise alone, where that came first."""
        return self.before.ordinary if self.before else self

    @cached_property
    def handed_over(self) -> Scored:
        """The most probable set as a robot file has it."""
        return self.bench.handed_over(self.chosen)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """What the listed effects close beside a rest: some thirty fits, which a built term may make vain."""
        return tuple(self._part(f.term) for f in self.judgement.findings)

    def _part(self, t: Term) -> Part:
        """The part of an effect; the gap is that of the base, which has no free frames."""
        bench, base, chosen = self.bench, self.base, self.chosen
        assert isinstance(bench, CorrelatedBench) and self.compared is not None
        whole = left_out_residuals(linear(base.fit), bench.group)[:, :3] * bench.plain.position_m * bench.data.over_tip
        before, after, none = _rms(whole), _rms(bench.left_out_m(chosen)), self.compared.base
        gap = float(np.sqrt(max(before**2 - bench.plain.floor_m**2, 0.0)))
        if t.name in FRAMES:
            others = [frame for frame in none.fit.chain.terms if frame.name in FRAMES and frame.name != t.name]
            alone, last = _rms(bench.left_out_m(none, *others)), _rms(bench.left_out_m(chosen, t))
            return Part(t, Closing(before, alone, gap), Closing(last, after, gap))
        free, alone = _rms(bench.left_out_m(none)), _rms(bench.left_out_m(bench.scored([t], chosen.fit)))
        last = _rms(bench.left_out_m(bench.scored([other for other in chosen.terms if other is not t], chosen.fit)))
        return Part(t, Closing(free, alone, gap), Closing(last, after, gap))

    def shares_json(self, t: Term) -> dict[str, Any]:
        """What an effect closes of the gap beside a rest, for diagnosis.json."""
        (part,) = (part for part in self.parts if part.term.key == t.key)
        return {
            "share_of_gap_alone": round(part.alone.share, 3),
            "share_of_gap_last": round(part.last.share, 3),
            "alone_rms_mm": [round(x * 1e3, 4) for x in (part.alone.without_m, part.alone.with_m)],
            "last_rms_mm": [round(x * 1e3, 4) for x in (part.last.without_m, part.last.with_m)],
        }

    def rest_json(self) -> dict[str, Any] | None:
        """What remains, for diagnosis.json."""
        rest, bench = self.rest, self.bench
        if rest is None or not isinstance(bench, CorrelatedBench):
            return None
        blocks = {"blocks": len(np.unique(bench.group)), "poses_compared": bench.data.count, "restarts": bench.restarts}
        return rest.to_json() | blocks


def _rms(error_m: Array) -> float:
    """[m] of errors (K, 3)."""
    return float(np.sqrt(mean_square(error_m)))


def mean_square(error_m: Array) -> float:
    """[m^2] of errors (K, 3)."""
    return float((error_m**2).sum(axis=1).mean())
