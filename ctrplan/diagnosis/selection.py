"""Forward, backward and swap over the catalogue: which effects the held-out poses ask for, and the path taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ctrplan.calibration.least_squares import Fit
from ctrplan.diagnosis.adequacy import remains
from ctrplan.diagnosis.cross_validation import null_threshold
from ctrplan.diagnosis.workbench import CERTAIN, Candidates, Scored, Screened, Workbench, linear
from ctrplan.pipeline.term import Term

MOST_EFFECTS = 4
CAUTION = 2.0  # times the threshold, for an effect that the residuals do not ask for: they look like noise already
REFITTED = 5  # variants of different effects that are fitted for good after the screening
LEAST_SHARE_OF_GAIN = 0.5  # share of the best gain of the screening that makes a variant worth fitting
PER_EFFECT = 2  # variants of one effect among them

Report = Callable[[str], None]


@dataclass(frozen=True)
class SelectionStep:
    """One comparison of the path: gain in held-out log-likelihood, its standard error, what chance can give.

    A set that is taken as the most probable of all, "compare", gains in the logarithm of its probability.
    """

    action: str  # "add", "drop", "swap", "compare", "stop"
    effect: str
    parameters: tuple[str, ...]
    gain: float
    error: float
    threshold: float
    taken: bool


@dataclass(eq=False)
class Selection:
    """The chosen set and how it was found."""

    chosen: Scored
    path: list[SelectionStep] = field(default_factory=list)
    threshold: float = 0.0


class Selector:
    """Searches sets of effects on a workbench."""

    def __init__(
        self, bench: Workbench, candidates: Candidates, tell: Report = lambda _: None, begun: Scored | None = None
    ) -> None:
        """tell: called with a sentence before each round of fits; begun: the set to grow, nothing if not given."""
        self.bench, self.candidates, self.tell = bench, candidates, tell
        self.found = Selection(begun or bench.scored([]))  # so far

    def run(self) -> Selection:
        """Adds what passes the threshold, drops what no longer does, swaps what another effect does better."""
        result = self.found
        while len(result.chosen.terms) < MOST_EFFECTS and self._grow(result):
            self._prune(result)
            self._swap(result)
        return result

    def _grow(self, selection: Selection) -> bool:
        here = selection.chosen
        self.tell("trying effects" if not here.terms else f"trying effects beside {', '.join(here.names)}")
        screened = self.bench.screened(here, self._others(here), self.candidates.completed)
        if not screened:
            return False
        selection.threshold = self._threshold(here, screened)
        needed = self._needed(here, selection.threshold)
        tried = self.fitted(here, screened)
        if not tried:
            first = screened[0]
            selection.path.append(step("add", first.term, first.score - here.score, 0.0, needed, False))
        for candidate in tried:
            gain, error = self.bench.difference(candidate, here)
            best = candidate is tried[0] and gain > needed and self._is_certain(here, candidate, gain, error)
            selection.path.append(step("add", candidate.terms[-1], gain, error, needed, best))
        if not tried or not selection.path[-len(tried)].taken:
            return False
        selection.chosen = self.bench.corrected(tried[0])
        return True

    def _needed(self, here: Scored, threshold: float) -> float:
        return threshold * (CAUTION if remains(self.bench, here).is_adequate else 1.0)

    def _threshold(self, here: Scored, screened: Sequence[Screened]) -> float:
        beside = [s.linear for s in screened]
        return null_threshold(linear(here.fit), beside, self.bench.null_scores, self.bench.null_draws(here))

    def _is_certain(self, here: Scored, candidate: Scored, gain: float, error: float) -> bool:
        """Whether a gain is no matter of a few configurations, or leaves noise alone where there was more before."""
        if gain > CERTAIN * error:
            return True
        return remains(self.bench, candidate).is_adequate and not remains(self.bench, here).is_adequate

    def _others(self, here: Scored) -> list[Term]:
        names = set(here.names)
        return [t for t in self.candidates.beside(here.terms) if t.name not in names]

    def fitted(self, here: Scored, screened: Sequence[Screened], *near: Fit) -> list[Scored]:
        """The most promising variants fitted beside `here`, from there or from fits in `near`, best first."""
        worth = here.score + LEAST_SHARE_OF_GAIN * max(screened[0].score - here.score, 0.0)
        tried = [
            self.bench.scored(self.candidates.completed(here.terms, s.term), here.fit, *near)
            for s in promising(screened)
            if s.score > worth
        ]
        return sorted(tried, key=lambda scored: -scored.score)

    def _prune(self, selection: Selection) -> None:
        """Drops effects whose absence costs no more than chance gives."""
        dropped = True
        while dropped and len(selection.chosen.terms) > 1:
            dropped = False
            for t in selection.chosen.terms:
                rest = self.without(selection.chosen, t)
                gain, error = self.bench.difference(rest, selection.chosen)
                if gain > -selection.threshold:
                    selection.path.append(step("drop", t, gain, error, -selection.threshold, True))
                    selection.chosen, dropped = rest, True
                    break

    def _swap(self, selection: Selection) -> None:
        """Replaces an effect where another one in its place predicts better."""
        for t in selection.chosen.terms:
            for candidate in self.replacements(selection.chosen, t):
                gain, error = self.bench.difference(candidate, selection.chosen)
                if gain > 0:
                    selection.path.append(step("swap", candidate.terms[-1], gain, error, 0.0, True))
                    selection.chosen = candidate
                    return

    def without(self, chosen: Scored, t: Term) -> Scored:
        """The chosen set less one of its effects; what remains may fit best far from where it stood."""
        return self.bench.scored([other for other in chosen.terms if other is not t], chosen.fit, None)

    def replacements(self, chosen: Scored, t: Term) -> list[Scored]:
        """What stands best in the place of `t`, variants of the chosen effects included, the chosen ones not."""
        rest = self.without(chosen, t)
        keys, names = {other.key for other in chosen.terms}, set(rest.names)
        others = [o for o in self.candidates.beside(rest.terms) if o.name not in names and o.key not in keys]
        if not others:
            return []
        return self.fitted(rest, self.bench.screened(rest, others, self.candidates.completed), chosen.fit)


def promising(screened: Sequence[Screened]) -> list[Screened]:
    """The best of the screening, at most two variants of an effect."""
    taken: list[Screened] = []
    for s in screened:
        alike = sum(other.term.name == s.term.name for other in taken)
        effects = {other.term.name for other in taken}
        if alike < PER_EFFECT and (alike or len(effects) < REFITTED):
            taken.append(s)
    return taken


def step(action: str, t: Term, gain: float, error: float, threshold: float, taken: bool) -> SelectionStep:
    """A step of the path: what was done with an effect."""
    names = tuple(parameter.name for parameter in t.parameters)
    return SelectionStep(action, t.name, names, round(gain, 2), round(error, 2), round(threshold, 2), taken)
