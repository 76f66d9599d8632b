"""From the most probable set of effects to a verdict: named, ambiguous, unexplained, or nothing missing.

A name is given only where something unknown besides is less probable than not, and the held-out set agrees. Else the
best of the wrong names would be given with confidence.

How probable a verdict is, a posterior over sets of effects says.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.special import gammaln, logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import excused, is_strained, strained
from ctrplan.diagnosis.adequacy import Adequacy, remains
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench, linear
from ctrplan.pipeline.term import Term, term

Verdict = Literal["named", "no_missing_effect", "ambiguous", "partial", "unexplained"]

MOST_RIVALS = 3  # alternatives of one of several effects: with more of them the data ask for something else


@dataclass(frozen=True, eq=False)
class Alternative:
    """A set in which another effect stands in the place of a chosen one."""

    term: Term
    scored: Scored


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
    notes: tuple[str, ...] = ()
    together: tuple[Term, ...] = ()  # what these do is more probably done than not, whatever does it


def judge(
    bench: Workbench, chosen: Scored, known: Candidates, posterior: Posterior, sets: Sequence[Scored]
) -> Judgement:
    """The verdict by the posterior over all sets, before the held-out set is opened; `chosen` is the most probable of
    the `sets` that were fitted.

    One set may be the most probable of many that agree on something else: nothing is missing only where nothing acts
    is more probable than not.
    """
    left = remains(bench, chosen)
    if not chosen.terms and posterior.of_verdict("no_missing_effect", ()) > 1 / 2:
        return Judgement("no_missing_effect", (), left)
    findings = findings_of(bench, chosen, chosen.terms, known, posterior, sets)
    if posterior.of_unknown > 1 / 2:
        beside = f"Something unknown acts beside {' and '.join(chosen.names)}, {shown(posterior.of_unknown)}."
        return Judgement("unexplained", (), left, (beside,) if chosen.terms else ())
    if not findings or len(findings) < len(chosen.terms):
        return Judgement("unexplained", (), left, (_open(posterior),), done_by(chosen, chosen.terms, posterior))
    if _is_strained(bench, chosen):
        return Judgement("unexplained", (), left)
    findings, shared = without_shared(bench, chosen, findings)
    if shared:
        notes, done = tuple(map(_disbelieved, shared)), done_by(chosen, shared, posterior)
        return Judgement("unexplained", findings, left, notes, done)
    verdict: Verdict = "ambiguous" if any(f.alternatives for f in findings) else "named"
    return Judgement(verdict, findings, left)


def done_by(chosen: Scored, terms: Sequence[Term], posterior: Posterior, least: float = 1 / 2) -> tuple[Term, ...]:
    """Those of some effects of a set whose work is done, by them or by whatever stands for them, with more than the
    `least` probability.

    A name has to be certain. Tips are expected nearer as soon as what moves them is more probable than not.
    """
    whole = {t.name for t in chosen.fit.chain.terms}
    return tuple(t for t in terms if posterior.of_work(t.name, whole - {t.name}) > least)


def _open(posterior: Posterior) -> str:
    """What may act where nothing is certain enough for a name, the most probable first."""
    names = {name for hypothesis in posterior.hypotheses for name in hypothesis.names}
    ranked = sorted(names, key=lambda name: -posterior.of_effect(name))
    likely = [f"{name}, {shown(posterior.of_effect(name))}" for name in ranked[:MOST_RIVALS]]
    return f"No set of effects is certain. {'; '.join(likely)}; something unknown, {shown(posterior.of_unknown)}."


def findings_of(
    bench: Workbench,
    chosen: Scored,
    terms: Sequence[Term],
    known: Candidates,
    posterior: Posterior,
    sets: Sequence[Scored],
) -> tuple[Finding, ...]:
    """Those of some effects that act with the probability of a name, each with what may stand for it.

    A model without a solution in many poses explains nothing.
    """
    results = list[Finding]()
    if chosen.failed.any() and not excused(chosen.failed).any():
        return ()
    for t in terms:
        if (others := standing_for(posterior, t.name, chosen.names)) is not None:
            results.append(Finding(t, tuple(_instead(bench, chosen, t, name, known, sets) for name in others)))
    return tuple(results)


def standing_for(posterior: Posterior, name: str, beside: Collection[str] = ()) -> list[str] | None:
    """Effects of which one acts with 0.99 if another does not, the most probable first; None where these are many, or
    one is more probable than that other.

    Those that act `beside` it stand for nothing.
    """
    group = [name]
    known = {other for hypothesis in posterior.hypotheses for other in hypothesis.names}
    others = sorted(known - {name, *beside})
    while posterior.of_effect(*group) < NAMED:
        best = max(others, key=lambda other: posterior.of_effect(*group, other), default=None)
        if best is None or len(group) > MOST_RIVALS or posterior.of_effect(best) > posterior.of_effect(name):
            return None
        group.append(best)
        others.remove(best)
    return group[1:]


def _instead(
    bench: Workbench, chosen: Scored, t: Term, name: str, known: Candidates, sets: Sequence[Scored]
) -> Alternative:
    """The best set in which another effect stands for one of the chosen ones; a frame is free in it anyway."""
    rest = [other for other in chosen.terms if other is not t]
    free = next((t for t in chosen.fit.chain.terms if t.name == name and name not in chosen.names), None)
    if free:
        return Alternative(free, bench.scored(rest, chosen.fit))
    seen = [t for fitted in sets if name in fitted.names for t in fitted.terms if t.name == name]
    variants = seen[:1] or [variant for variant in known.terms if variant.name == name]
    fits = [bench.scored([*rest, variant], chosen.fit) for variant in variants]
    best = min(fits, key=lambda scored: scored.fit.loss)
    return Alternative(best.terms[-1], best)


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


def without_shared(
    bench: Workbench, chosen: Scored, findings: Sequence[Finding]
) -> tuple[tuple[Finding, ...], list[Term]]:
    """The findings, and effects of others that a part by which other causes act as well explains alone."""
    shared = [f for f in findings if not f.alternatives and _is_shared(bench, chosen, f.term)]
    return tuple(f for f in findings if f not in shared), [f.term for f in shared]


def _is_shared(bench: Workbench, chosen: Scored, t: Term) -> bool:
    """Whether a part of the effect by which other causes act as well is nearly as probable as all of it, or more."""
    names = t.effect.shared([parameter.name for parameter in t.parameters])
    if not names:
        return False
    part = term(t.effect, names, bench.robot)
    scored = bench.scored([part if other is t else other for other in chosen.terms], chosen.fit)
    weight = chosen.fit.residuals.weight
    whole, alone = (replace(linear(some.fit), weight=weight).evidence for some in (chosen, scored))
    return whole - alone < log_odds(NAMED)


def _disbelieved(t: Term) -> str:
    parameters = len(t.effect.shared([parameter.name for parameter in t.parameters]))
    return (
        f"{t.name} would explain the measurements, but {parameters} of its {len(t.parameters)} parameters do so alone, "
        f"and by these other causes act as well: it is not named."
    )


ACTS = 0.03  # prior probability that an effect of the catalogue acts: of some 20, one in every other robot
UNKNOWN_ACTS = 0.1  # the same of something that the catalogue lacks
DOES_ALIKE = 0.05  # prior probability that this does what effects of the catalogue do together: of twenty, one
NAMED = 0.99  # probability of what is named, or decided: one name in a hundred may be wrong


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, whether something unknown acts besides, and the logarithm of prior times likelihood."""

    names: frozenset[str]
    has_unknown: bool
    weight: float
    done: frozenset[str] = frozenset()  # effects whose work something unknown does


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probabilities of hypotheses that exclude each other."""

    hypotheses: tuple[Hypothesis, ...]
    along: Mapping[str, float] = field(default_factory=dict)  # what something unknown goes along with, if it acts

    @cached_property
    def probabilities(self) -> Array:
        """(H,) of the hypotheses; they sum to one."""
        weights = np.array([hypothesis.weight for hypothesis in self.hypotheses])
        probabilities: Array = np.exp(weights - logsumexp(weights))
        return probabilities

    def of_effect(self, *names: str) -> float:
        """That at least one of these effects acts."""
        return self._of(bool(hypothesis.names & set(names)) for hypothesis in self.hypotheses)

    def of_work(self, name: str, beside: Collection[str]) -> float:
        """That what an effect does is done, by it, by something unknown or by effects that are not `beside` it."""
        rest = {*beside} - {name}
        return self._of(not hypothesis.names | hypothesis.done <= rest for hypothesis in self.hypotheses)

    def of_one(self, name: str, among: Collection[str]) -> float:
        """That an effect acts and none of the others among some."""
        return self._of(hypothesis.names & set(among) == {name} for hypothesis in self.hypotheses)

    def without(self, names: Collection[str]) -> Posterior:
        """What is left of it where some effects are known not to act."""
        return Posterior(tuple(h for h in self.hypotheses if not h.names & set(names)), self.along)

    @property
    def of_unknown(self) -> float:
        """That something acts which the catalogue lacks."""
        return self._of(hypothesis.has_unknown for hypothesis in self.hypotheses)

    def of_verdict(self, verdict: Verdict, listed: Sequence[Collection[str]]) -> float:
        """That a verdict is true; listed: names of each finding, the effect and what may stand for it.

        "Named" and "ambiguous" say that one of each finding acts and nothing else does, "partial" that one of each
        acts, "unexplained" that something unknown does besides.
        """

        def holds(hypothesis: Hypothesis) -> bool:
            acts = all(hypothesis.names & set(names) for names in listed)
            if verdict == "partial":
                return acts
            if verdict == "unexplained":
                return acts and hypothesis.has_unknown
            return acts and len(hypothesis.names) == len(listed) and not hypothesis.has_unknown

        return self._of(holds(hypothesis) for hypothesis in self.hypotheses)

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json: that nothing acts, that something unknown does, and each effect that may."""
        names = sorted({name for hypothesis in self.hypotheses for name in hypothesis.names})
        effects = {name: round(self.of_effect(name), 3) for name in names}
        return {
            "nothing": round(self.of_verdict("no_missing_effect", ()), 4),
            "unknown": round(self.of_unknown, 4),
            "effects": {name: p for name, p in effects.items() if p > 0},
            "unknown_along": {name: round(p, 3) for name, p in self.along.items()},
            "sets_compared": len({hypothesis.names | hypothesis.done for hypothesis in self.hypotheses}),
        }

    def _of(self, hits: Iterable[bool]) -> float:
        return float(min(1.0, self.probabilities[np.fromiter(hits, bool, len(self.hypotheses))].sum()))


def names_of(findings: Sequence[Finding]) -> list[set[str]]:
    """Names of each finding: the effect and what may stand for it."""
    return [{f.term.name, *(a.term.name for a in f.alternatives)} for f in findings]


def shown(probability: float) -> str:
    """In words: two digits, never certain."""
    if probability > 0.995:
        return "probability above 0.99"
    return f"probability {probability:.2f}" if probability >= 0.005 else "probability below 0.01"


def normalised(
    evidence: Mapping[frozenset[str], tuple[float, float]],
    along: Mapping[str, float] | None = None,
    inputs: Mapping[str, str] | None = None,
) -> Posterior:
    """The posterior from log evidences of sets, without and with an unknown error; -inf where that was not asked.

    inputs: what each effect of the catalogue goes along with. What effects of like inputs do together a single cause
    may do that the catalogue lacks, whether more remains of it or not.
    """
    inputs, results = inputs or {}, list[Hypothesis]()
    otherwise = log_odds(UNKNOWN_ACTS) + (np.log1p(-DOES_ALIKE) if inputs else 0.0)
    for names, values in evidence.items():
        prior, either = len(names) * log_odds(ACTS), float(np.logaddexp(*values)) - np.log(2) + log_odds(UNKNOWN_ACTS)
        results += [Hypothesis(names, False, prior + values[0]), Hypothesis(names, True, prior + values[1] + otherwise)]
        for done in _alike(names, inputs):
            weight = either + _does_alike(len(done), len(inputs)) + prior - len(done) * log_odds(ACTS)
            results.append(Hypothesis(names - done, True, weight, done))
    return Posterior(tuple(results), along or {})


def _alike(names: Iterable[str], inputs: Mapping[str, str]) -> Iterator[frozenset[str]]:
    """Those of some effects, one or several in all ways, that go along with the same."""
    for kind in dict.fromkeys(inputs.values()):
        some = sorted(name for name in names if inputs.get(name) == kind)
        yield from (frozenset(few) for count in range(1, len(some) + 1) for few in combinations(some, count))


def _does_alike(count: int, of: int) -> float:
    """Logarithm of the prior probability that a cause, if it is unknown, does what `count` effects do, these `of` all.

    Any number of effects is as probable as any other, and so is any choice of as many.
    """
    return float(np.log(DOES_ALIKE / of) + gammaln(count + 1) + gammaln(of - count + 1) - gammaln(of + 1))


def log_odds(probability: float) -> float:
    """Natural logarithm of p / (1 - p)."""
    return float(np.log(probability / (1 - probability)))
