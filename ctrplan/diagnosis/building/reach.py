"""How much of a rest pieces could close: greedily and to first order, before anything is fitted.

A search for a term takes minutes on a continuous motion. One that can't reach what a term needs is not begun.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.diagnosis.building.dictionary import Piece
from ctrplan.diagnosis.building.probes import Wide
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.held_out import held_out_residuals
from ctrplan.diagnosis.shares import mean_square


def reach(bench: CorrelatedBench, table: Wide, known: Sequence[Piece], most: int) -> float:
    """Share of the squares beyond noise that the `most` best pieces close of blocks left out; all poses count alike.

    Each piece is the one that closes most beside those before it.
    """
    columns, left = list(range(table.own)), [_left(bench, table, list(range(table.own)))]
    others = list(known)
    for _ in range(min(most, len(others))):
        tried = [_left(bench, table, [*columns, *table.places[piece]]) for piece in others]
        best = int(np.argmin(tried))
        if tried[best] >= left[-1]:
            break
        left.append(tried[best])
        columns += table.places[others.pop(best)]
    rest = left[0] - bench.plain.floor_m**2
    return (left[0] - left[-1]) / max(rest, 1e-12)


def _left(bench: CorrelatedBench, table: Wide, columns: list[int]) -> float:
    """Mean square [m^2] of positions on blocks left out, with some of the columns fitted."""
    system = table.alike.columns(columns).refitted()
    sigma_m = bench.noise_alike.position_m * bench.data.over_tip
    return mean_square(held_out_residuals(system, bench.fold)[:, :3] * sigma_m)
