"""How probable poses at rest are with a set of effects, beside an error that goes along with the joints.

Where what remains is smooth in the joints, blocks left out are predicted by their neighbours, and gains over blocks
tell little. The evidence has no blocks: all parameters of a set are integrated out over their priors, with the error in
the covariance, as large and as smooth as is most probable beside this set. What an effect takes away needs no error to
stand for it, and an effect that only follows a smooth error gains nothing, for the error is there anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Block, Discrepancy, Linearised, Spectrum, block_of
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.joint_memory import square_distances
from ctrplan.diagnosis.workbench import Scored
from ctrplan.pipeline.term import Term

LENGTHS = (0.6, 1.0, 1.5, 2.5)  # [rad] of joints
SMOOTH = (0.7, 1.0)  # share of what configurations differ by that goes along with the joints
FINALISTS, PER_EFFECT = 8, 2  # variants asked with covariances of their own, and of one effect among them


@dataclass(frozen=True)
class Gain:
    """Logarithm of how much more probable the poses are with an effect added to a set."""

    term: Term
    gain: float


class SmoothEvidence:
    """Of a set of effects as it stands, and of variants that may be added to it, to first order."""

    def __init__(self, bench: CorrelatedBench, here: Scored, variants: Sequence[Term] = ()) -> None:
        """here: a set as the bench has it, with the discrepancy that is there now; variants: to be asked beside it."""
        self._among = [*bench.basis(here.terms), *here.terms]
        self._share, self._correlations = bench.estimated(here).memory, _correlations(bench)
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

    def highest(self) -> float:
        """Logarithm of the evidence of the set itself, up to what is the same for every set of these poses."""
        return self._highest([self._columns()])[0]

    def gains(self, variants: Sequence[Term], without: str = "") -> list[Gain]:
        """Of variants, best first: the best with the covariance of the set, each with a covariance of its own then.

        without: an effect of the set that is left out of it.
        """
        self._among = [t for t in self._among if t.name != without]
        own = self._columns()
        plain, found = self._most_probable(own)
        first = sorted(self._beside(found, own, variants), key=lambda one: -one.gain)
        finalists, count = list[Gain](), dict[str, int]()
        for one in first:
            count[one.term.name] = count.get(one.term.name, 0) + 1
            if count[one.term.name] <= PER_EFFECT and len(finalists) < FINALISTS:
                finalists.append(one)
        values = self._highest([self._columns(one.term) for one in finalists])
        asked = [Gain(one.term, float(value - plain)) for one, value in zip(finalists, values, strict=True)]
        return sorted(asked, key=lambda one: -one.gain)

    def moved(self, name: str) -> float:
        """How far an effect of the set moves positions, over noise and error: rms of what nothing else could do."""
        found = self._most_probable(self._columns())[1]
        over = 1 / np.hypot(1, np.repeat([found.position, found.tangent], [3, 2]))
        mine = np.array([key[0] == name for key in self._keys])
        J = (self._fit.J * over[:, None]).reshape(-1, len(mine))
        alone, rest = J[:, mine] @ self._offset[mine], J[:, ~mine]
        by_rest = np.linalg.solve(rest.T @ rest + np.diag(self._fit.precision[~mine]), rest.T @ alone)
        own = (alone - rest @ by_rest).reshape(-1, 5)[:, :3]
        return float(np.sqrt(np.mean(own**2)))

    def _columns(self, *more: Term) -> list[int]:
        wanted = {(t.name, q.name) for t in (*self._among, *more) for q in t.parameters}
        return [k for k, key in enumerate(self._keys) if key in wanted]

    def _highest(self, sets: Sequence[Sequence[int]]) -> list[float]:
        """(S,) of sets of columns, each with the covariance that is most probable beside it."""
        union = sorted({column for columns in sets for column in columns})
        some = Linearised(self._fit.r, self._fit.J[:, :, union], self._fit.precision[union])
        places = [np.searchsorted(union, columns).tolist() for columns in sets]
        best = [-np.inf] * len(sets)
        for blocks in self._blocks():
            spectrum = Spectrum.at(some, blocks)
            best = [
                max(high, spectrum.of(columns).highest()[0] / 2) for high, columns in zip(best, places, strict=True)
            ]
        return best

    def _most_probable(self, columns: Sequence[int]) -> tuple[float, Discrepancy]:
        """Evidence of some columns, and the covariance that it has."""
        some = Linearised(self._fit.r, self._fit.J[:, :, columns], self._fit.precision[columns])
        found = [(*Spectrum.at(some, blocks).highest(), blocks) for blocks in self._blocks()]
        value, position, tangent, blocks = max(found, key=lambda one: one[0])
        return value / 2, Discrepancy(position, tangent, self._share, blocks)

    def _blocks(self) -> list[tuple[Block, ...]]:
        share = self._share
        own = np.eye(len(self._fit.r))
        every = np.arange(len(own))
        return [(block_of(every, share * one + (1 - share) * own),) for one in self._correlations]

    def _beside(self, found: Discrepancy, own: Sequence[int], variants: Sequence[Term]) -> list[Gain]:
        """Gains of variants with one covariance."""
        J, scale = found.whitened(self._fit.J), 1 / np.sqrt(self._fit.precision)
        flat = J.reshape(-1, J.shape[2]) * scale
        H, g = flat.T @ flat + np.eye(len(scale)), flat.T @ found.whitened(self._fit.r).ravel()
        plain = _evidence(H, g, own)
        return [Gain(t, _evidence(H, g, self._columns(t)) - plain) for t in variants]


def _evidence(H: Array, g: Array, columns: Sequence[int]) -> float:
    """Logarithm of it, up to a constant: gradients (P,) and precisions (P, P) over those of the priors."""
    factor = np.linalg.cholesky(H[np.ix_(columns, columns)])
    z = np.linalg.solve(factor, g[list(columns)])
    return float(z @ z / 2 - np.log(np.diag(factor)).sum())


def _correlations(bench: CorrelatedBench) -> list[Array]:
    """(K, K) of poses, of every smoothness that is tried, first of configurations that have nothing in common."""
    number, first, which = np.unique(bench.data.configuration, return_index=True, return_inverse=True)
    square, own = square_distances(bench.data, first.tolist()), np.eye(len(number))
    found = [own]
    found += [(1 - q) * own + q * np.exp(-square / (2 * length**2)) for q, length in product(SMOOTH, LENGTHS)]
    pairs = np.ix_(which.ravel(), which.ravel())
    return [one[pairs] for one in found]
