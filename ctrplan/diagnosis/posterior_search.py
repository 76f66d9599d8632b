"""Which sets of effects are probable: forward, backward and swap moves among hypotheses, and posterior probabilities.

Every variant is screened beside the best set so far, by one linear step under its covariance. The most promising sets
are fitted. The posterior of an effect is its share of the probability of all sets that were fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.hypotheses import Bench, Hypothesis, Key, Slip, base_term, slipped, started
from ctrplan.diagnosis.mixed_model import Sizes
from ctrplan.errors import InputError
from ctrplan.pipeline.term import Term, term

MOST_EFFECTS = 5
ASKED = 6  # sets that are fitted after each screening
PAIRS = 3  # of effects that hide one another, at first
WINDOW = 8.0  # log-units behind the best that a set may be to be asked: e^-8 of its probability
WORTH_ANOTHER = 2.0  # log-units that another fit of a set has to promise
TIE = 4  # decimals of a log posterior, beyond which it is the arithmetic's
WIDEST_OF_PAIR = 70  # parameters of a pair that is screened

Tell = Callable[[str], None]  # a step begins; may raise Interrupted


class Interrupted(Exception):
    """Ctrl-C between two fits."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Hypotheses, the most probable first, with their posterior probabilities."""

    bench: Bench
    hypotheses: tuple[Hypothesis, ...]
    posterior: Array  # (H,) sums to 1
    interrupted: bool = False

    @property
    def best(self) -> Hypothesis:
        """The most probable set."""
        return self.hypotheses[0]

    @property
    def base(self) -> Hypothesis:
        """Without effects."""
        return next(h for h in self.hypotheses if not h.terms)

    @property
    def of_effects(self) -> dict[str, float]:
        """Posterior probability of each effect, the largest first."""
        shares: dict[str, float] = {}
        for h, share in zip(self.hypotheses, self.posterior.tolist(), strict=True):
            for name in h.names:
                shares[name] = shares.get(name, 0.0) + share
        return dict(sorted(shares.items(), key=lambda pair: -pair[1]))

    @property
    def of_none(self) -> float:
        """Posterior probability that no effect of the catalogue acts."""
        return float(sum(share for h, share in zip(self.hypotheses, self.posterior, strict=True) if not h.terms))

    def of_any(self, names: Sequence[str]) -> float:
        """Posterior probability that at least one of some effects acts."""
        asked = set(names)
        return float(sum(w for h, w in zip(self.hypotheses, self.posterior, strict=True) if asked & h.names))


def answer(bench: Bench, hypotheses: Sequence[Hypothesis]) -> Answer:
    """Posterior probabilities of hypotheses about the same data."""
    ordered = sorted(hypotheses, key=lambda h: -round(h.score, TIE))
    weights = np.exp(np.array([h.score for h in ordered]) - ordered[0].score)
    return Answer(bench, tuple(ordered), weights / weights.sum())


class _Search:
    """Hypotheses that were asked so far."""

    def __init__(self, bench: Bench, tell: Tell) -> None:
        self.bench, self.tell = bench, tell
        self.asked: dict[frozenset[str], Hypothesis | None] = {}

    def ask(self, terms: Sequence[Term], near: Mapping[Key, float], sizes: Sizes) -> Hypothesis | None:
        """The fit of a set; once more from another place where that promises more, for fits end in valleys."""
        key = frozenset(t.key for t in terms)
        known = self.asked.get(key)
        if key not in self.asked or (known is not None and self._promises_more(known, near)):
            self.tell(" and ".join(t.name for t in terms) or "calibration")
            try:
                again = self.bench.fitted(terms, near, sizes)
            except (InputError, np.linalg.LinAlgError):  # no robot has these values
                again = None
            if known is None or (again is not None and again.score > known.score):
                self.asked[key] = again
        return self.asked[key]

    def _promises_more(self, known: Hypothesis, near: Mapping[Key, float]) -> bool:
        """Whether one step from another place leads higher than a fit has come."""
        chain = known.chain
        p = np.clip(started(chain, near), chain.lower, chain.upper)
        if np.all(np.abs(p - known.p) < 0.5 * np.sqrt(np.diag(known.covariance))):
            return False
        try:
            r, J = self.bench.linearised(chain, p)
        except InputError:
            return False
        scaled = J * chain.prior
        y = r + scaled @ ((p - chain.neutral) / chain.prior)
        return self.bench.model.posterior(y, scaled, known.sizes, steps=0).evidence > known.evidence + WORTH_ANOTHER

    @property
    def known(self) -> list[Hypothesis]:
        """Those that have a fit."""
        return [h for h in self.asked.values() if h is not None]


@dataclass(frozen=True, eq=False)
class _Promise:
    """What a linear step promises of a set: log posterior, and where its fit starts."""

    score: float
    terms: tuple[Term, ...]
    near: Mapping[Key, float]


def search(bench: Bench, tell: Tell = lambda _: None) -> Answer:
    """Posterior probabilities over sets of the bench's variants; what was asked until then where it is interrupted."""
    asked = _Search(bench, tell)
    base = bench.fitted([], {}, bench.model.start(), (14, 4))
    asked.asked[frozenset()] = base
    try:
        _climbed(asked, base)
    except Interrupted:
        return replace(answer(bench, asked.known), interrupted=True)
    return answer(bench, asked.known)


def _climbed(asked: _Search, here: Hypothesis) -> None:
    """Asks sets along the way to the most probable one, and those with another effect in the place of each of its."""
    bench = asked.bench
    for level in range(MOST_EFFECTS):
        for one in _varied(screened(bench, here, pairs=level == 0), here.score if level else -np.inf):
            asked.ask(one.terms, one.near, here.sizes)
        for t in here.terms:
            asked.ask([s for s in here.terms if s is not t], here.values, here.sizes)
        best = max(asked.known, key=lambda h: round(h.score, TIE))
        if best is here:
            break
        here = best
    for t in here.terms if len(here.terms) > 1 else ():
        rest = asked.ask([s for s in here.terms if s is not t], here.values, here.sizes)
        for one in screened(bench, rest, pairs=False)[:ASKED] if rest is not None else ():
            if one.score > here.score - WINDOW:
                asked.ask(one.terms, one.near, here.sizes)


def _varied(promised: Sequence[_Promise], least: float) -> list[_Promise]:
    """The most promising, at most three variants of the same effects among them before others come."""
    seen: dict[frozenset[str], int] = {}
    chosen: list[_Promise] = []
    pairs = 0
    for one in promised:
        names = frozenset(t.name for t in one.terms)
        is_pair = len(one.terms) > 1 and least == -np.inf
        if one.score < least - WINDOW or seen.get(names, 0) >= (1 if len(chosen) > 2 else 3):
            continue
        if (is_pair and pairs >= PAIRS) or (not is_pair and len(chosen) - pairs >= ASKED):
            continue
        pairs += is_pair
        seen[names] = seen.get(names, 0) + 1
        chosen.append(one)
    return chosen


def screened(bench: Bench, here: Hypothesis, *, pairs: bool) -> list[_Promise]:
    """Every set that differs from `here` by one variant more, or another variant of an effect; the best first.

    pairs: also two variants at once, beside calibration alone.
    """
    linear = [t for t in bench.variants if t.effect.is_linear and not isinstance(t.effect, Slip)]
    slips = [t for t in bench.variants if isinstance(t.effect, Slip)]
    merged = _merged([*here.terms, *linear], bench)
    chain = bench.chain(merged)
    keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
    known = here.values
    neutral = [_vanishing(q.start, q.neutral) * q.si for q in chain.parameters]
    p = np.array([known.get(key, value) for key, value in zip(keys, neutral, strict=True)])
    r, J = bench.linearised(chain, p)
    scaled = J * chain.prior
    y = r + scaled @ ((p - chain.neutral) / chain.prior)
    columns = [scaled]
    for t in slips:
        kind, tube, row = slipped(t.parameters[0].name)
        by = bench.unnamed.by_joint[kind, tube] * (bench.data.rows >= row)[:, None]
        columns.append((by * t.parameters[0].prior * t.parameters[0].si)[:, :, None])
        keys.append((t.name, t.parameters[0].name))
    said = bench.model.information(y, np.concatenate(columns, axis=2), here.sizes)
    place = {key: k for k, key in enumerate(keys)}

    def score(terms: Sequence[Term]) -> float:
        base = base_term(bench.robot, terms)
        which = [place[t.name, q.name] for t in (base, *terms) for q in t.parameters]
        return said.evidence(which) + bench.log_prior(terms)

    results = []
    offset = here.score - score(here.terms)
    mine = {t.key for t in here.terms}
    for t in (*linear, *slips):
        if t.key in mine or (isinstance(t.effect, Slip) and t.name in here.names):
            continue
        terms = (*(s for s in here.terms if s.name != t.name), t)
        if _complete(terms):
            results.append(_Promise(score(terms) + offset, terms, known))
    if pairs:
        results += [
            _Promise(score((a, b)) + offset, (a, b), known)
            for i, a in enumerate(linear)
            for b in linear[i + 1 :]
            if a.name != b.name and len(a.parameters) + len(b.parameters) < WIDEST_OF_PAIR and _complete((a, b))
        ]
    for t in bench.variants:
        if not t.effect.is_linear and t.name not in here.names and _complete((*here.terms, t)):
            results += _tried(bench, here, t)
    return sorted(results, key=lambda one: -round(one.score, TIE))  # of equals the first, as of slips the earliest


def _tried(bench: Bench, here: Hypothesis, t: Term) -> list[_Promise]:
    """A variant that does not act in proportion, from the best of its starts."""
    best: _Promise | None = None
    terms = (*here.terms, t)
    chain = bench.chain(terms)
    keys = [(s.name, q.name) for s in chain.terms for q in s.parameters]
    for values in t.effect.starts([q.name for q in t.parameters]) or [{}]:
        p = started(chain, here.values)
        for name, value in values.items():
            j = keys.index((t.name, name))
            p[j] = value * chain.si[j]
        try:
            r, J = bench.linearised(chain, np.clip(p, chain.lower, chain.upper))
        except InputError:
            continue
        scaled = J * chain.prior
        y = r + scaled @ ((p - chain.neutral) / chain.prior)
        value = bench.model.posterior(y, scaled, here.sizes, steps=0).evidence + bench.log_prior(terms)
        if best is None or value > best.score:
            best = _Promise(value, terms, {**here.values, **dict(zip(keys, p.tolist(), strict=True))})
    return [] if best is None else [best]


def _complete(terms: Sequence[Term]) -> bool:
    """Whether every effect has what it needs."""
    names = {t.name for t in terms}
    return all(not t.effect.needs or t.effect.needs in names for t in terms)


def _merged(terms: Sequence[Term], bench: Bench) -> list[Term]:
    """One term per effect with the parameters of all its variants."""
    wanted: dict[str, dict[str, None]] = {}
    effects = {t.name: t.effect for t in terms}
    for t in terms:
        wanted.setdefault(t.name, {}).update(dict.fromkeys(q.name for q in t.parameters))
    return [term(effects[name], list(names), bench.robot) for name, names in wanted.items()]


def _vanishing(start: float | None, neutral: float) -> float:
    """Where a variant is linearised: where it vanishes, or as near as its derivative exists."""
    return start if start is not None and 0 < abs(start - neutral) <= 1e-2 else neutral
