"""The search beside a discrepancy: one effect at a time, each far above what surrogates of the residual reach.

Effects that their evidence beside smooth errors tells come first: on a continuous motion those that act by the motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.diagnosis.candidates import Candidates
from ctrplan.diagnosis.chance import null_thresholds
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.held_out import Linear
from ctrplan.diagnosis.holding import LEAST_ODDS, TIMES_CHANCE, telling_odds
from ctrplan.diagnosis.selection import Report, Selection, Selector, step
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence
from ctrplan.diagnosis.workbench import Panel, Scored, Screened, certainty, linear
from ctrplan.effects.learned.learned import Learned
from ctrplan.pipeline.term import Term

MOST_PARTS = 5  # effects named beside a rest that nothing explains
SMOOTH_COUNTS = 2 / 3  # of chance on surrogates as smooth as the residual: twice that has to be gained
CERTAIN_AT_FIRST = 3.0  # standard errors over blocks, while what is still missing is part of the discrepancy
WORTH_A_FIT = 0.5  # of the gain and of the certainty that are needed, to first order: a fit would not make up for less


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

    def chance(self, chosen: Scored, panel: Panel, among: Sequence[Term]) -> float:
        """Gain of the best candidate beside a set that surrogates of its residual exceed in 2 % of draws.

        To first order, as the evidence is; `among` is all that is fitted.
        """
        beside = [panel.of([*among, other]) for other in panel.others(among)]
        return self._most(chosen, panel.of(among), beside) if beside else 0.0

    def _most(self, here: Scored, alone: Linear, beside: Sequence[Linear]) -> float:
        """Of chance on traded residuals and on surrogates as smooth as these, which leave less to doubt."""
        draws = self.partial_bench.traded_draws(here), self.partial_bench.null_draws(here)
        traded, smooth = null_thresholds(alone, beside, self.bench.null_scores, draws)
        return max(traded, SMOOTH_COUNTS * smooth)

    def _grow(self, found: Selection) -> bool:
        """The first of the best candidates that is certain; another one may need it to become so.

        None with more parameters than there are blocks: like a distortion of the tracker on a pair, whose joints the
        place of the tip gives away, it would follow any smooth rest.
        """
        if self._grow_by_odds(found):
            return True
        here = found.chosen
        self.tell("trying effects beside " + (", ".join(here.names) or "a rest"))
        screened = self._screened(here)
        if not screened:
            return False
        beside = [one.linear for one in screened]
        found.threshold = TIMES_CHANCE * self._most(here, linear(here.fit), beside)
        worth = [one for one in screened if self._passes(here, one, WORTH_A_FIT)]
        if not worth:
            first = screened[0]
            found.path.append(step("add", first.term, first.score - here.score, 0.0, found.threshold, False))
            return False
        taken = None
        fitted = self.fitted(here, worth)
        for candidate in fitted:
            gain, error = self.bench.difference(candidate, here)
            passes = taken is None and self._passes(here, candidate) and self._is_probable(here, candidate)
            taken = candidate if passes else taken
            found.path.append(step("add", candidate.terms[-1], gain, error, found.threshold, passes))
        if taken is not None:
            found.chosen = self.bench.corrected(taken)
        return taken is not None

    def _grow_by_odds(self, found: Selection) -> bool:
        """The most probable effect whose odds beside a smooth error tell it, if there is one."""
        here, bench = found.chosen, self.partial_bench
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
        found.path.append(step("add", best.term, gain, 0.0, needed, taken))
        found.chosen = there if taken else bench.corrected(here)
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
        return float(gains.sum()) > share * self.found.threshold and certainty(gains) > share * CERTAIN_AT_FIRST


def is_built(t: Term) -> bool:
    """Whether it was built of a rest, and is no name."""
    return isinstance(t.effect, Learned)


def testable_beside(known: Candidates, bench: CorrelatedBench) -> Candidates:
    """What may be missing beside free frames and, on a continuous motion, friction that follows its history."""
    always = {*FRAMES, "translation_release"} if bench.data.is_stream else {*FRAMES}
    return Candidates(tuple(t for t in known.terms if t.name not in always), known.not_testable)
