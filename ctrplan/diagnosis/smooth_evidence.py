"""How probable poses are with a set of effects, beside an error that is smooth in the joints or in time.

Where what remains is smooth, blocks left out are predicted by their neighbours, and gains over blocks tell little. The
evidence has no blocks: all parameters of a set are integrated out over their priors, with the error in the covariance,
of the kind, size and smoothness that are most probable beside this set. What an effect takes away needs no error to
stand for it, and an effect that only follows a smooth error gains nothing, for the error is there anyway.

Chi-squares have no memory. A tracker that jumps by 1.6 mm is a drift to them: what a drift leaves of the jump is small
for every pose, and goes up and down with the time. So the poses are asked how probable they are beside an error that is
smooth in the joints or in time, or belongs to the configuration, and beside noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised
from ctrplan.diagnosis.block_evidence import LEAST_ODDS
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.remainder import SmoothError
from ctrplan.diagnosis.selection import PER_EFFECT
from ctrplan.diagnosis.workbench import Scored, Workbench
from ctrplan.pipeline.term import Term

FINALISTS = 8  # variants asked with covariances of their own
EQUAL = 5.0  # logarithm of the evidence: what is as probable but for odds of 150 to 1 is told as "or"
LEAST_OF_RIVAL = 2.0  # of the same, that a rival has to gain itself


@dataclass(frozen=True)
class Gain:
    """Logarithm of how much more probable the poses are with an effect added to a set."""

    term: Term
    gain: float


def best_of_each(gains: Sequence[Gain]) -> list[Gain]:
    """The best variant of every effect, of gains that have the best first."""
    best: dict[str, Gain] = {}
    for one in gains:
        best.setdefault(one.term.name, one)
    return list(best.values())


def rivals_of(gain: float, others: Sequence[Gain]) -> list[Gain]:
    """What may stand for an effect that gains so much."""
    return [one for one in others if one.gain > max(gain - EQUAL, LEAST_OF_RIVAL)]


@dataclass(frozen=True, eq=False)
class _Probable:
    """The most probable error beside a set, over the noise, and the logarithm of the evidence that it has."""

    evidence: float
    error: SmoothError
    position: float
    tangent: float


class SmoothEvidence:
    """The evidence of a set of effects as it stands, and of variants that may be added to it, to first order."""

    def __init__(self, bench: CorrelatedBench, here: Scored, variants: Sequence[Term] = ()) -> None:
        """here: a set as the bench has it, with the discrepancy that is there now; variants: to be asked beside it."""
        self._among = [*bench.basis(here.terms), *here.terms]
        self._errors = bench.smooth_errors(here)
        if not variants:
            self._fit = bench.over_noise_at_priors(here)
            self._keys = tuple((t.name, q.name) for t in here.fit.chain.terms for q in t.parameters)
            self._offset = here.fit.p - here.fit.chain.neutral
            return
        panel, solved = bench.panel(here, variants), ~here.failed[:, None]
        r, J = bench.coloured(panel.whole.r), bench.coloured(panel.whole.J)
        left = (r + J @ panel.whole.offset) * solved
        self._fit, self._keys = Linearised(left, J * solved[:, :, None], panel.whole.precision), panel.keys
        self._offset = panel.whole.offset

    def highest(self, without: str = "") -> float:
        """Logarithm of the evidence of the set itself, up to what is the same for every set of these poses.

        without: an effect of the set that is left out of it.
        """
        return float(self._highest([self._columns(self._rest(without))])[0])

    def beside_noise_alone(self) -> tuple[float, SmoothError]:
        """Logarithm of how much more probable the set is beside an error than beside noise alone, and that error."""
        some, result = self._only(self._columns(self._among)), []
        for error in self._errors:
            spectrum = error.spectrum(some)
            result.append((spectrum.highest()[0] - spectrum.without_error, error))
        value, error = max(result, key=lambda one: one[0])
        return value / 2, error

    def odds(self, names: Sequence[str]) -> list[float]:
        """Logarithms, of the set over the set without each of some of its effects."""
        whole, *less = self._highest([self._columns(self._rest(name)) for name in ("", *names)])
        return [float(whole - one) for one in less]

    def gains(self, variants: Sequence[Term], without: str = "") -> list[Gain]:
        """Gains of variants, best first: the best with the covariance of the set, each with a covariance of its own
        then.

        without: an effect of the set that is left out of it.
        """
        rest = self._rest(without)
        result = self._most_probable(self._columns(rest))
        first = sorted(self._beside(result, rest, variants), key=lambda one: -one.gain)
        finalists, count = list[Gain](), dict[str, int]()
        for one in first:
            count[one.term.name] = count.get(one.term.name, 0) + 1
            if count[one.term.name] <= PER_EFFECT and len(finalists) < FINALISTS:
                finalists.append(one)
        values = self._highest([self._columns([*rest, one.term]) for one in finalists])
        asked = [Gain(one.term, float(value - result.evidence)) for one, value in zip(finalists, values, strict=True)]
        return sorted(asked, key=lambda one: -one.gain)

    def moved(self, name: str) -> float:
        """How far an effect of the set moves positions, over noise and error: rms of what nothing else could do."""
        result = self._most_probable(self._columns(self._among))
        over = 1 / np.hypot(1, np.repeat([result.position, result.tangent], [3, 2]))
        mine = np.array([key[0] == name for key in self._keys])
        J = (self._fit.J * over[:, None]).reshape(-1, len(mine))
        alone, rest = J[:, mine] @ self._offset[mine], J[:, ~mine]
        by_rest = np.linalg.solve(rest.T @ rest + np.diag(self._fit.precision[~mine]), rest.T @ alone)
        own = (alone - rest @ by_rest).reshape(-1, 5)[:, :3]
        return float(np.sqrt(np.mean(own**2)))

    def _rest(self, without: str) -> list[Term]:
        return [t for t in self._among if t.name != without]

    def _columns(self, terms: Sequence[Term]) -> list[int]:
        wanted = {(t.name, q.name) for t in terms for q in t.parameters}
        return [k for k, key in enumerate(self._keys) if key in wanted]

    def _only(self, columns: Sequence[int]) -> Linearised:
        """The other parameters being where they do nothing."""
        return Linearised(self._fit.r, self._fit.J[:, :, columns], self._fit.precision[columns])

    def _highest(self, sets: Sequence[Sequence[int]]) -> list[float]:
        """(S,) of sets of columns, each with the covariance that is most probable beside it."""
        union = sorted({column for columns in sets for column in columns})
        some = self._only(union)
        places = [np.searchsorted(union, columns).tolist() for columns in sets]
        best = [-np.inf] * len(sets)
        for error in self._errors:
            spectrum = error.spectrum(some)
            best = [
                max(high, spectrum.of(columns).highest()[0] / 2) for high, columns in zip(best, places, strict=True)
            ]
        return best

    def _most_probable(self, columns: Sequence[int]) -> _Probable:
        """The error beside some columns."""
        some = self._only(columns)
        results = [(*error.spectrum(some).highest(), error) for error in self._errors]
        value, position, tangent, error = max(results, key=lambda one: one[0])
        return _Probable(value / 2, error, position, tangent)

    def _beside(self, probable: _Probable, rest: Sequence[Term], variants: Sequence[Term]) -> list[Gain]:
        """Gains of variants with one covariance."""
        at = probable.error.at(self._fit, probable.position, probable.tangent)
        scale = 1 / np.sqrt(self._fit.precision)
        H = (at.position.H[0] + at.tangent.H[0]) * np.outer(scale, scale) + np.eye(len(scale))
        g = (at.position.g[0] + at.tangent.g[0]) * scale
        plain = _evidence(H, g, self._columns(rest))
        return [Gain(t, _evidence(H, g, self._columns([*rest, t])) - plain) for t in variants]


def _evidence(H: Array, g: Array, columns: Sequence[int]) -> float:
    """Logarithm of it, up to a constant: gradients (P,) and precisions (P, P) over those of the priors."""
    factor = np.linalg.cholesky(H[np.ix_(columns, columns)])
    z = np.linalg.solve(factor, g[list(columns)])
    return float(z @ z / 2 - np.log(np.diag(factor)).sum())


IN_WORDS = {
    "configuration": "belongs to the configuration",
    "joints": "goes along with the joints",
    "time": "goes along with the time",
    "history": "goes along with the way poses were reached",
}


def remaining_error(bench: Workbench, chosen: Scored) -> str:
    """What is more than noise of what a set leaves, as a sentence; empty where noise alone is as probable.

    Priors are as wide as effects are large: an error would stand for what a prior draws in.
    """
    correlated = CorrelatedBench(bench.robot, bench.data, bench.noise, bench.group, bench.fold)
    odds, error = SmoothEvidence(correlated, bench.sized(chosen)).beside_noise_alone()
    if odds < LEAST_ODDS:
        return ""
    beside, along = " and ".join(chosen.names), IN_WORDS[error.along]
    return f"What {beside} leaves is no noise: an error that {along} is exp({odds:.0f}) times as probable."
