"""How probable it is that each effect acts, that something acts which the catalogue lacks, and that a verdict is true.

A hypothesis is a set of effects, with or without an unknown error besides. Its likelihood is the density of all poses
that choose, with every parameter integrated out over its prior around the set's own fit (Laplace). An unknown error
belongs to the configuration, goes along with the joints, or with the time; its kind and its sizes, alike in their
logarithm, are integrated out as well. An effect acts with a probability that is stated once, shared among its variants;
so does an unknown error. Posterior probabilities sum to one over what the search compared: nothing, every effect alone,
every set that was fitted, and each of these with one effect more or less than the chosen one.

Priors of parameters say where to look. How wide they have to be is itself uncertain: a width w times the stated one has
the density 1 / w^2 for w > 1, of which the best is taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.term_dictionary import pieces
from ctrplan.diagnosis.unknown_errors import Peak, UnknownErrors, without_error
from ctrplan.diagnosis.verdict import Verdict
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench
from ctrplan.pipeline.term import Term

ACTS = 0.03  # prior probability that an effect of the catalogue acts: of some 20, one in every other robot
UNKNOWN_ACTS = 0.1  # the same of something that the catalogue lacks


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
            "sets_compared": len(self.hypotheses),
        }

    def _of(self, hits: Iterable[bool]) -> float:
        return float(min(1.0, self.probabilities[np.fromiter(hits, bool, len(self.hypotheses))].sum()))


def shown(probability: float) -> str:
    """In words: two digits, never certain."""
    if probability > 0.995:
        return "probability above 0.99"
    return f"probability {probability:.2f}" if probability >= 0.005 else "probability below 0.01"


def normalised(evidence: Mapping[frozenset[str], tuple[float, float]]) -> Posterior:
    """The posterior from log evidences of sets, without and with an unknown error; -inf where that was not asked."""
    results = []
    for names, values in evidence.items():
        for has_unknown, value in enumerate(values):
            prior = len(names) * _log_odds(ACTS) + has_unknown * _log_odds(UNKNOWN_ACTS)
            results.append(Hypothesis(names, bool(has_unknown), prior + value))
    return Posterior(tuple(results))


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def posterior(bench: Workbench, chosen: Scored, known: Candidates, more: Sequence[Scored] = ()) -> Posterior:
    """The posterior over the sets that a search on a bench has compared; more: sets that it no longer has.

    Built terms are no effects: what they do is done by something unknown.
    """
    base = bench.scored([])
    less = [bench.scored([t for t in chosen.terms if t is not gone], chosen.fit) for gone in chosen.terms]
    among = [one for one in (base, *bench.visited, *more, *less, chosen) if _is_alike(one.fit, chosen.fit)]
    asking = _Asking(bench, known, base, chosen)
    fitted = {frozenset(t.key for t in one.terms): one for one in among}.values()
    sets = [asking.whole(one) for one in fitted]
    sets += [asking.whole(one, without=name) for one in fitted for name in asking.free(one)]
    results = asking.evidences(sets)
    for here in (base, chosen) if chosen.terms else (base,):
        results += asking.one_more(here)
    evidence: dict[frozenset[str], tuple[float, float]] = {}
    refitted = {names for names, _ in results[: len(sets)]}
    for k, (names, values) in enumerate(results):
        if k < len(sets) or names not in refitted:  # a fit says more than a first step
            before = evidence.get(names, (-np.inf, -np.inf))
            evidence[names] = (float(np.logaddexp(before[0], values[0])), float(np.logaddexp(before[1], values[1])))
    return normalised(evidence)


def _is_alike(fit: Fit, other: Fit) -> bool:
    """Whether two fits are of the same poses over the same noise, so that their evidences compare."""
    return fit.chain.data is other.chain.data and fit.noise.position_m == other.noise.position_m


@dataclass(frozen=True, eq=False)
class _Set:
    """A set, linearised at its own fit over the noise alone."""

    names: frozenset[str]
    fit: Linearised
    cost: float  # logarithm, of widened priors and of the choice among variants
    has_built: bool

    @cached_property
    def alone(self) -> float:
        """Logarithm of the evidence beside noise alone, up to what is the same for every set of these poses."""
        return -np.inf if self.has_built else without_error(self.fit) - self.cost

    def beside(self, errors: UnknownErrors) -> tuple[float, Peak]:
        """The same beside something unknown, and the most probable smooth error."""
        value, peak = errors.evidence(self.fit)
        return value - self.cost, peak


Evidences = tuple[frozenset[str], tuple[float, float]]  # of a set: beside noise alone, and beside an unknown error


class _Asking:
    """What is the same for all sets of a search: poses, how much each counts, errors, and variants of effects."""

    def __init__(self, bench: Workbench, known: Candidates, base: Scored, chosen: Scored) -> None:
        self.bench, self.known = bench, known
        self.variants = Counter(t.name for t in known.terms)
        self.of_piece = float(np.log(len(pieces(bench.robot, bench.data, known.terms))))  # of which a term is built
        self.root = np.sqrt(np.where(base.failed | chosen.failed, 0.0, chosen.fit.residuals.weight))[:, None]
        ends = {scored: self.whole(scored) for scored in (base, chosen)}
        self.errors = UnknownErrors(bench, base, chosen, [one.fit for one in ends.values()], self.root[:, 0])
        self.beside = {scored: (one, *one.beside(self.errors)) for scored, one in ends.items()}

    def free(self, scored: Scored) -> list[str]:
        """Effects that are in a fit although they are not in its set: frames of a bench where these are always free."""
        return [t.name for t in scored.fit.chain.terms if t.name in self.variants and t.name not in scored.names]

    def whole(self, scored: Scored, without: str = "") -> _Set:
        """A set as it is fitted; to first order without an effect of the fit."""
        fit, own, widths = scored.fit, self._named(scored) - {without}, self._widths(scored)
        owners = [t.name for t in fit.chain.terms for _ in t.parameters]
        kept = [k for k, name in enumerate(owners) if name != without]
        r, J = self._linear(fit.residuals.r, fit.residuals.J, fit.p - fit.chain.neutral, fit.noise)
        precision = fit.precision / np.square([widths.get(name, 1.0) for name in owners])
        cost = sum(np.log(widths[name]) for name in widths if name != without) + self._choice(own)
        built = sum(len(t.parameters) for t in scored.terms if is_built(t))
        return _Set(own, Linearised(r, J[:, :, kept], precision[kept]), float(cost + built * self.of_piece), built > 0)

    def _named(self, scored: Scored) -> frozenset[str]:
        return frozenset({t.name for t in scored.fit.chain.terms} & set(self.variants))

    def _widths(self, scored: Scored) -> dict[str, float]:
        """By effect of a fit, how much wider than stated its prior is most probably."""
        chain, named = scored.fit.chain, {*self._named(scored), *scored.names}
        over = np.abs(scored.fit.p - chain.neutral) / chain.prior
        places = zip(chain.terms, chain.slices(), strict=True)
        return {t.name: float(max(1.0, over[place].max())) for t, place in places if t.name in named}

    def evidences(self, sets: Sequence[_Set]) -> list[Evidences]:
        """Of whole sets."""
        return [(one.names, (one.alone, one.beside(self.errors)[0])) for one in sets]

    def one_more(self, here: Scored) -> list[Evidences]:
        """Of a set with any effect that acts in proportion added to it, to first order."""
        beside, unknown, peak = self.beside[here]
        names, variants = {*self._named(here), *here.names}, self.known.beside(here.terms)
        others = [t for t in variants if t.name not in names and t.effect.is_linear and t.effect.needs in ("", *names)]
        if not others:
            return []
        panel = self.bench.panel(here, others)
        r, J = self._linear(panel.whole.r, panel.whole.J, panel.whole.offset, self.bench.noise)
        widths = self._widths(here)
        precision = panel.whole.precision / np.square([widths.get(name, 1.0) for name, _ in panel.keys])

        def part(*more: Term) -> Linearised:
            wanted = {(t.name, q.name) for t in self._all([*here.terms, *more]) for q in t.parameters}
            columns = [k for k, key in enumerate(panel.keys) if key in wanted]
            return Linearised(r, J[:, :, columns], precision[columns])

        own = part()
        plain = without_error(own), peak.evidence(own)
        results = []
        for other in others:
            wider, choice = part(other), self._choice([other.name])
            gains = without_error(wider) - plain[0] - choice, peak.evidence(wider) - plain[1] - choice
            results.append((beside.names | {other.name}, (beside.alone + gains[0], unknown + gains[1])))
        return results

    def _all(self, terms: Sequence[Term]) -> list[Term]:
        return [*self.bench.basis(terms), *terms]

    def _linear(self, r: Array, J: Array, offset: Array, noise: Noise) -> tuple[Array, Array]:
        """Residuals (K, 5) at the priors' centres and derivatives (K, 5, P) over the noise alone, as poses count."""
        if noise.discrepancy is not None:
            r, J = noise.discrepancy.coloured(r), noise.discrepancy.coloured(J)
        return self.root * (r + J @ offset), self.root[:, :, None] * J

    def _choice(self, names: Iterable[str]) -> float:
        """Logarithm of what the choice of one variant of each effect costs."""
        return float(sum(np.log(max(self.variants[name], 1)) for name in names))
