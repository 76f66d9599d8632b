"""From a selected set of effects to a verdict: named, ambiguous, unexplained, or nothing missing; partial: `partly.py`.

A name is given only when what remains looks like noise, on the poses of the selection and in the held-out set. Where
it does not, the best of the wrong names would be given with confidence; then only effects stay listed whose evidence
lies in a part of the data that they explain completely.

How probable a verdict is, a posterior over sets of effects says.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import is_strained, strained
from ctrplan.diagnosis.adequacy import Adequacy, remains
from ctrplan.diagnosis.selection import Selection, Selector
from ctrplan.diagnosis.workbench import OVERWHELMING, SURE, Scored, Workbench
from ctrplan.pipeline.term import Term, term

Verdict = Literal["named", "no_missing_effect", "ambiguous", "partial", "unexplained"]

CLOSE = 3.0  # log-likelihood, or a standard error: an alternative that predicts nearly as well
MOST_RIVALS = 3  # alternatives of one of several effects: with more of them the data ask for something else


@dataclass(frozen=True, eq=False)
class Alternative:
    """A set in which another effect stands in the place of a chosen one."""

    term: Term
    scored: Scored
    behind: float  # log-likelihood, of the chosen set over this one
    error: float  # standard error of that


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect of the verdict with what can't be told from it."""

    term: Term
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True, eq=False)
class Judgement:
    """The verdict on the selection's poses, and why."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    adequacy: Adequacy
    compared: tuple[Alternative, ...]  # everything that was tried in the place of something chosen
    notes: tuple[str, ...] = ()


def judge(selector: Selector, selection: Selection) -> Judgement:
    """The verdict before the held-out set is opened."""
    bench, chosen = selector.bench, selection.chosen
    left = remains(bench, chosen)
    if not chosen.terms:
        return Judgement("no_missing_effect" if left.is_adequate else "unexplained", (), left, ())
    compared = [a for t in chosen.terms for a in _compared(selector, selection, t)]
    findings = tuple(_finding(bench, chosen, t, compared, left) for t in chosen.terms)
    if not left.is_adequate or _is_strained(bench, chosen):
        kept = () if _is_enlarged(bench) else specific(bench, chosen, findings, left)
        return Judgement("unexplained", kept, left, tuple(compared))
    clear = tuple(f for f in findings if len(f.alternatives) <= MOST_RIVALS)
    if len(findings) > 1 and len(clear) < len(findings):  # beside others, what anything can stand in for is nothing
        return Judgement("unexplained", clear, left, tuple(compared))
    shared = [f for f in findings if not f.alternatives and _is_shared(bench, chosen, f.term)]
    if shared:
        rest = tuple(f for f in findings if f not in shared)
        return Judgement("unexplained", rest, left, tuple(compared), tuple(_disbelieved(f.term) for f in shared))
    verdict: Verdict = "ambiguous" if any(f.alternatives for f in findings) else "named"
    return Judgement(verdict, findings, left, tuple(compared))


def _is_strained(bench: Workbench, chosen: Scored) -> bool:
    """Whether a set needs what is hardly possible: such a fit proves nothing.

    It is asked with priors as wide as its effects are large: an effect that its prior draws in strains all else. Beside
    noise that was enlarged, and may hide a misfit, no effect may be larger than is plausible.
    """
    fit = bench.sized(chosen).fit
    return is_strained(fit) or (_is_enlarged(bench) and bool(strained(fit, chosen.names)))


def _is_enlarged(bench: Workbench) -> bool:
    """Whether the noise was taken for larger than stated, so that it may hide what an effect does not explain."""
    stated = bench.robot.measurement
    return stated is not None and bench.noise.position_m > stated.position_sigma_m


def _compared(selector: Selector, selection: Selection, t: Term) -> list[Alternative]:
    """Other effects in the place of `t`, refitted together with the rest."""
    bench, chosen = selector.bench, selection.chosen
    selector.tell(f"looking for what imitates {t.name}")
    others = [s for s in selector.replacements(chosen, t) if s.terms[-1].name != t.name]
    return [Alternative(s.terms[-1], s, *bench.difference(chosen, s)) for s in others]


def _finding(bench: Workbench, chosen: Scored, t: Term, compared: Sequence[Alternative], left: Adequacy) -> Finding:
    rest = {other.key for other in chosen.terms if other is not t}
    rivals: dict[str, Alternative] = {}
    for a in sorted(compared, key=lambda a: a.behind):
        same_place = {other.key for other in a.scored.terms[:-1]} == rest
        if same_place and a.term.name not in rivals and is_close(a, chosen):
            after = remains(bench, a.scored)
            if after.is_adequate or not left.is_adequate:
                rivals[a.term.name] = a
    return Finding(t, tuple(rivals.values()))


def is_close(a: Alternative, chosen: Scored) -> bool:
    """Whether it predicts or fits as well; badly determined parameters predict badly, true or not."""
    worse_fit = (a.scored.fit.residuals.loss - chosen.fit.residuals.loss) / 2
    return min(a.behind, worse_fit) < max(CLOSE, a.error)


def _is_shared(bench: Workbench, chosen: Scored, t: Term) -> bool:
    """Whether a part of the effect by which other causes act as well explains as much as all of it."""
    names = t.effect.shared([parameter.name for parameter in t.parameters])
    if not names:
        return False
    part = term(t.effect, names, bench.robot)
    scored = bench.scored([part if other is t else other for other in chosen.terms], chosen.fit)
    alone = Alternative(part, scored, *bench.difference(chosen, scored))
    return is_close(alone, chosen) and remains(bench, scored).is_adequate


def _disbelieved(t: Term) -> str:
    parameters = len(t.effect.shared([parameter.name for parameter in t.parameters]))
    return (
        f"{t.name} would explain the measurements, but {parameters} of its {len(t.parameters)} parameters do so alone, "
        f"and by these other causes act as well: it is not named."
    )


def specific(bench: Workbench, chosen: Scored, findings: Sequence[Finding], left: Adequacy) -> tuple[Finding, ...]:
    """Findings that explain all of the differences between approaches, or all between configurations, alone."""
    kept = []
    for finding in findings:
        history = finding.term.effect.depends_on_history
        explained = left.within.is_noise if history else left.between.is_noise
        others = [t for t in chosen.terms if t is not finding.term]
        gain, error = bench.difference(chosen, bench.scored(others, chosen.fit))
        if explained and gain > max(OVERWHELMING, SURE * error):
            kept.append(finding)
    return tuple(kept)


ACTS = 0.03  # prior probability that an effect of the catalogue acts: of some 20, one in every other robot
UNKNOWN_ACTS = 0.1  # the same of something that the catalogue lacks
NAMED = 0.99  # probability of what is named, or decided: one name in a hundred may be wrong


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, whether something unknown acts besides, and the logarithm of prior times likelihood."""

    names: frozenset[str]
    has_unknown: bool
    weight: float


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probabilities of hypotheses that exclude each other."""

    hypotheses: tuple[Hypothesis, ...]
    along: Mapping[str, float] = field(default_factory=dict)  # what something unknown goes along with, if it acts

    @cached_property
    def probabilities(self) -> Array:
        """(H,) of the hypotheses; they sum to one."""
        weights = np.array([one.weight for one in self.hypotheses])
        probabilities: Array = np.exp(weights - logsumexp(weights))
        return probabilities

    def of_effect(self, *names: str) -> float:
        """That at least one of these effects acts."""
        return self._of(bool(one.names & set(names)) for one in self.hypotheses)

    @property
    def of_unknown(self) -> float:
        """That something acts which the catalogue lacks."""
        return self._of(one.has_unknown for one in self.hypotheses)

    def of_verdict(self, verdict: Verdict, listed: Sequence[Collection[str]]) -> float:
        """That a verdict is true; listed: names of each finding, the effect and what may stand for it.

        "Named" and "ambiguous" say that one of each finding acts and nothing else does, "partial" that one of each
        acts, "unexplained" that something unknown does besides.
        """

        def holds(one: Hypothesis) -> bool:
            acts = all(one.names & set(names) for names in listed)
            if verdict == "partial":
                return acts
            if verdict == "unexplained":
                return acts and one.has_unknown
            return acts and len(one.names) == len(listed) and not one.has_unknown

        return self._of(holds(one) for one in self.hypotheses)

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json: that nothing acts, that something unknown does, and each effect that may."""
        names = sorted({name for one in self.hypotheses for name in one.names})
        effects = {name: round(self.of_effect(name), 3) for name in names}
        return {
            "nothing": round(self.of_verdict("no_missing_effect", ()), 4),
            "unknown": round(self.of_unknown, 4),
            "effects": {name: p for name, p in effects.items() if p > 0},
            "unknown_along": {name: round(p, 3) for name, p in self.along.items()},
            "sets_compared": len(self.hypotheses),
        }

    def _of(self, hits: Iterable[bool]) -> float:
        return float(min(1.0, self.probabilities[np.fromiter(hits, bool, len(self.hypotheses))].sum()))


def names_of(judgement: Judgement) -> list[set[str]]:
    """Names of each finding: the effect and what may stand for it."""
    return [{f.term.name, *(a.term.name for a in f.alternatives)} for f in judgement.findings]


def shown(probability: float) -> str:
    """In words: two digits, never certain."""
    if probability > 0.995:
        return "probability above 0.99"
    return f"probability {probability:.2f}" if probability >= 0.005 else "probability below 0.01"


def normalised(
    evidence: Mapping[frozenset[str], tuple[float, float]], along: Mapping[str, float] | None = None
) -> Posterior:
    """The posterior from log evidences of sets, without and with an unknown error; -inf where that was not asked."""
    results = []
    for names, values in evidence.items():
        for has_unknown, value in enumerate(values):
            prior = len(names) * log_odds(ACTS) + has_unknown * log_odds(UNKNOWN_ACTS)
            results.append(Hypothesis(names, bool(has_unknown), prior + value))
    return Posterior(tuple(results), along or {})


def log_odds(probability: float) -> float:
    """Natural logarithm of p / (1 - p)."""
    return float(np.log(probability / (1 - probability)))
