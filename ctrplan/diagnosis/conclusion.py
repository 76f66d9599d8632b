"""One rule from posterior probabilities to a verdict.

A name is given where its posterior probability is at least CERTAIN; several share a place, "A or B", where only their
sum is. What nobody has named counts where it is larger than half the noise, and certain as well. A calibration that had
to go where the file's tubes are not is told as that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.diagnosis.hypotheses import Bench, Hypothesis
from ctrplan.diagnosis.posterior_search import Answer
from ctrplan.pipeline.term import Term

Verdict = Literal["named", "no_missing_effect", "ambiguous", "partial", "unexplained", "wrong_tube"]

CERTAIN = 0.99  # posterior probability of what is said: one wrong name in a hundred
HALF_NOISE = 0.5  # of the noise's deviation: unnamed errors below it change no plan
IMPLAUSIBLE = 3.0  # deviations of the prior that a tube of the file is not off by: one of 370
MOST_ALTERNATIVES = 3  # beside a name: a sentence with more says nothing
WORTH_TELLING = 0.02  # posterior probability of an effect that is told as possible


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another effect in the place of one that is listed."""

    term: Term
    probability: float


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect of the verdict with its posterior probability, and what cannot be told from it."""

    term: Term
    probability: float
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class TubeFault:
    """A tube that is not the tube of the file: a calibrated factor that no such tube has."""

    tube: int  # from 1
    what: str  # "as curved", "as stiff"
    factor: float
    deviations: float  # of the prior

    @property
    def sentence(self) -> str:
        """In words."""
        return f"tube {self.tube} is not the tube of the file: it is {self.factor:.2f} times {self.what}"

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "tube": self.tube,
            "what": self.what,
            "factor": round(self.factor, 4),
            "deviations_of_prior": round(self.deviations, 2),
        }


@dataclass(frozen=True)
class Unnamed:
    """Errors that nobody has named, beside the effects of a hypothesis."""

    over_noise: float  # deviation of all together over the noise's
    log_odds: float  # evidence with them over that of noise alone
    parts: Mapping[
        str, float
    ]  # process -> rms distance [m] by which it moves positions most probably, the largest first
    noise: tuple[float, float]  # deviations over the stated ones, of position and tangent

    @property
    def is_large(self) -> bool:
        """Whether there is more than half the noise, with certainty."""
        return self.over_noise > HALF_NOISE and self.log_odds > math.log(CERTAIN / (1 - CERTAIN))

    @property
    def rms_m(self) -> float:
        """Of all together."""
        return float(np.sqrt(sum(value**2 for value in self.parts.values())))

    @property
    def sentence(self) -> str:
        """How large, and where it acts."""
        if not self.is_large:
            return "What nobody has named is below half the noise."
        told = [f"{name} ({rms_m * MM_PER_M:.2f} mm)" for name, rms_m in list(self.parts.items())[:2]]
        size = f"What nobody has named is {self.over_noise:.1f} times the noise"
        return f"{size}; most probably it acts as {' and '.join(told)}." if told else f"{size}."

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "over_noise": round(self.over_noise, 3),
            "log_odds": round(self.log_odds, 2),
            "rms_mm": round(self.rms_m * MM_PER_M, 4),
            "parts_rms_mm": {name: round(rms_m * MM_PER_M, 4) for name, rms_m in self.parts.items()},
            "noise_over_stated": [round(x, 3) for x in self.noise],
        }


@dataclass(frozen=True, eq=False)
class Judgement:
    """The verdict, and the probabilities behind it."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    possible: Mapping[str, float]  # other effects with their posterior probabilities
    none: float  # posterior probability that no effect of the catalogue acts
    tubes: tuple[TubeFault, ...]
    unnamed: Unnamed
    chosen: Hypothesis  # with the listed effects alone
    notes: tuple[str, ...] = ()

    @property
    def probability(self) -> float:
        """Posterior probability of all that is listed, or that nothing is to be."""
        return (
            float(np.prod([f.probability + sum(a.probability for a in f.alternatives) for f in self.findings]))
            if (self.findings)
            else self.none
        )


def judge(answer: Answer) -> Judgement:
    """The verdict on the poses that choose."""
    findings = _findings(answer)
    terms = [f.term for f in findings]
    chosen = _with(answer, terms)
    unnamed = unnamed_beside(answer.bench, chosen)
    tubes = _tube_faults(chosen)
    told = {f.term.name for f in findings} | {a.term.name for f in findings for a in f.alternatives}
    possible = {n: p for n, p in answer.of_effects.items() if n not in told and p > WORTH_TELLING}
    verdict = _verdict(findings, unnamed, tubes, answer.of_none)
    return Judgement(verdict, findings, possible, answer.of_none, tubes, unnamed, chosen)


def _verdict(findings: Sequence[Finding], unnamed: Unnamed, tubes: Sequence[TubeFault], none: float) -> Verdict:
    if findings:
        if unnamed.is_large:
            return "partial"
        return "ambiguous" if any(f.alternatives for f in findings) else "named"
    if unnamed.is_large:
        return "unexplained"
    if none < 1 - none:
        return "ambiguous"
    return "wrong_tube" if tubes else "no_missing_effect"


def _findings(answer: Answer) -> tuple[Finding, ...]:
    """Effects of the most probable set that are certain, alone or with others in their place."""
    shares, best = answer.of_effects, answer.best
    sure = {name for name, share in shares.items() if share >= CERTAIN}
    results, taken = [], set(sure)
    for t in best.terms:
        if t.name in sure:
            results.append(Finding(t, shares[t.name]))
            continue
        names = [t.name]
        for name in shares:
            if name not in taken and name not in names and len(names) <= MOST_ALTERNATIVES:
                names.append(name)
                if answer.of_any(names) >= CERTAIN:
                    break
        if answer.of_any(names) < CERTAIN:
            continue
        taken |= set(names)
        others = [Alternative(_variant(answer, name), shares[name]) for name in names[1:] if shares[name] > 1 - CERTAIN]
        results.append(Finding(t, shares[t.name], tuple(others)))
    return tuple(results)


def _variant(answer: Answer, name: str) -> Term:
    """The most probable variant of an effect."""
    return next(t for h in answer.hypotheses for t in h.terms if t.name == name)


def _with(answer: Answer, terms: Sequence[Term]) -> Hypothesis:
    """The hypothesis of these terms alone, as large as the data say."""
    key = frozenset(t.key for t in terms)
    known = next((h for h in answer.hypotheses if h.key == key), None)
    return answer.bench.sized(known or answer.bench.fitted(terms, answer.best.values, answer.best.sizes))


def unnamed_beside(bench: Bench, h: Hypothesis) -> Unnamed:
    """How large the errors of each process most probably are beside a hypothesis."""
    y, scaled = at_mode(bench, h)
    model = bench.model
    alone, noise = model.only(np.zeros(len(model.names), bool), h.sizes)
    gain = model.posterior(y, scaled, h.sizes, steps=0).evidence - alone.posterior(y, scaled, noise).evidence
    position = model.given[:, :3].any(axis=1)
    of = {
        name: float(np.sqrt(np.mean(np.sum(error[position, :3] ** 2, axis=1)))) * bench.noise.position_m
        for name, error in model.explained(y, scaled, h.sizes).items()
    }
    parts = dict(sorted(((n, v) for n, v in of.items() if v > 1e-7), key=lambda pair: -pair[1]))
    deviations = np.sqrt(1 + h.sizes.noise)
    size = float(np.sqrt(model.mean_variance(h.sizes) / model.mean_variance_of_noise(h.sizes)))
    return Unnamed(size, gain, parts, (float(deviations[0]), float(deviations[1])))


def at_mode(bench: Bench, h: Hypothesis) -> tuple[Array, Array]:
    """Residuals (K, 5) at the priors' centres, linearised at a hypothesis, and columns over the priors."""
    r, J = bench.linearised(h.chain, h.p)
    scaled = J * h.chain.prior
    return r + scaled @ ((h.p - h.chain.neutral) / h.chain.prior), scaled


def _tube_faults(h: Hypothesis) -> tuple[TubeFault, ...]:
    results = []
    words = {"precurvature_factor": "as curved", "stiffness_factor": "as stiff"}
    for j, q in enumerate(h.chain.terms[0].parameters):
        away = (h.p[j] / q.si - q.neutral) / q.prior
        stem = next((stem for stem in words if q.name.startswith(stem)), "")
        if stem and abs(away) > IMPLAUSIBLE:
            tube = int(q.name.removeprefix(f"{stem}_").split("_")[0])
            results.append(TubeFault(tube, words[stem], float(h.p[j] / q.si), float(away)))
    return tuple(results)
