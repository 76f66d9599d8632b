"""What each effect of a verdict does to the measured tips, solved once before a diagnosis is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.localise import quantities
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.pipeline.term import Term

PARTS = 8  # of a quantity's range, by rank
LEAST_M = 1e-9  # a shift that has a direction


@dataclass(frozen=True, eq=False)
class Signature:
    """An effect alone, on the poses of the selection; everything else stays as it was fitted with it."""

    term: Term
    shift_m: Array  # (K,) by which the effect moves the tip; NaN without a solution
    measured_m: Array  # (K,) of the tip beyond the model without the effect, along that shift
    quantity: str  # what the shift goes along with most
    values: Array  # (K,) of it, as `quantities` has them


def signatures(found: Diagnosis) -> tuple[Signature, ...]:
    """Of the effects that the verdict lists; predicts every pose once more for each of them."""
    known = quantities(found.base.fit.chain.data)
    return tuple(_signature(found, term, known) for term in found.listed)


def _signature(found: Diagnosis, term: Term, known: Mapping[str, Array]) -> Signature:
    """The chosen model with and without the effect, which is at its neutral values then."""
    chain, p = found.chosen.fit.chain, found.chosen.fit.p
    place = next(s for t, s in zip(chain.terms, chain.slices(), strict=True) if t.key == term.key)
    without = p.copy()
    without[place] = chain.neutral[place]
    ends = [chain.predict(at, derivatives=False) for at in (p, without)]
    solved = ~(ends[0].failed | ends[1].failed)
    shift = np.where(solved[:, None], ends[0].position_m - ends[1].position_m, np.nan)
    size = np.linalg.norm(shift, axis=1)
    direction = shift / np.maximum(size, LEAST_M)[:, None]
    measured = np.sum((chain.data.position_m - ends[1].position_m) * direction, axis=1)
    shares = {name: _explained(size, values) for name, values in known.items()}
    quantity = max(shares, key=lambda name: shares[name])
    return Signature(term, size, measured, quantity, known[quantity])


def _explained(size: Array, values: Array) -> float:
    """Share of the variance of sizes (K,) that means over parts of a quantity (K,) explain."""
    good = np.isfinite(size) & np.isfinite(values)
    total = float(np.var(size[good])) if good.any() else 0.0
    if total == 0.0:
        return 0.0
    edges = np.quantile(values[good], np.linspace(0, 1, PARTS + 1)[1:-1])
    part, kept = np.searchsorted(edges, values[good], side="right"), size[good]
    means = [(np.sum(part == k), kept[part == k].mean()) for k in np.unique(part)]
    return float(sum(n * (mean - kept.mean()) ** 2 for n, mean in means) / good.sum() / total)
