"""The search beside a discrepancy: one effect at a time, each far above what surrogates of the residual reach."""

from __future__ import annotations

from ctrplan.diagnosis.candidates import Candidates
from ctrplan.diagnosis.correlated_bench import FRAME, CorrelatedBench
from ctrplan.diagnosis.selection import Report, Selection, Selector
from ctrplan.diagnosis.workbench import Scored

MOST_PARTS = 5  # effects named beside a rest that nothing explains
TIMES_CHANCE = 3.0  # the gain that surrogates of the residual exceed in 2 % of draws
LEAST_Z = 4.0  # standard errors over blocks


class PartialSelector(Selector):
    """Searches a `CorrelatedBench`, where a residual never has to look like noise."""

    def __init__(self, bench: CorrelatedBench, candidates: Candidates, tell: Report = lambda _: None) -> None:
        super().__init__(bench, testable_beside(candidates, bench), tell)
        self.found.chosen = bench.begun()

    def run(self) -> Selection:
        """Adds what passes, and nothing else: what holds beside the others is asked in the end."""
        while len(self.found.chosen.terms) < MOST_PARTS and self._grow(self.found):
            pass
        return self.found

    def _needed(self, here: Scored, threshold: float) -> float:
        return TIMES_CHANCE * threshold

    def _is_certain(self, candidate: Scored, gain: float, error: float) -> bool:
        return gain > LEAST_Z * error

    def _grow_by_two(self, found: Selection, tried: object) -> bool:
        """No pairs: where a rest remains in any case, two that need each other stand in for something else."""
        return False


def testable_beside(known: Candidates, bench: CorrelatedBench) -> Candidates:
    """What may be missing beside a free frame and, on a continuous motion, friction that follows its history."""
    always = {FRAME, "translation_release"} if bench.data.is_stream else {FRAME}
    return Candidates(tuple(t for t in known.terms if t.name not in always), known.not_testable)
