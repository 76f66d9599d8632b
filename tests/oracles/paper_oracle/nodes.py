"""One list of nodes for all tubes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from paper_oracle.se3 import Array
from paper_oracle.tubes import Tube


def mesh(tubes: Sequence[Tube], l_b: ArrayLike, spacing_m: float, fine_m: float = 0.0, reach_m: float = 0.0) -> Array:
    """Nodes (N,) [m] at every collar, section joint, tip and the plate, at most `spacing_m` apart.

    `fine_m`, the paper has no such thing: least spacing, kept for `reach_m` before and after tube tips and section
    joints where contact forces gather, then growing by 1.4 a node up to `spacing_m`.
    """
    bases = np.asarray(l_b, dtype=float)
    marks = {0.0}
    for tube, base in zip(tubes, bases, strict=True):
        marks |= {base + sum(s.length_m for s in tube.sections[:k]) for k in range(len(tube.sections) + 1)}
    corners = np.array(sorted(marks))
    corners = corners[np.append(True, np.diff(corners) > 1e-9)]
    nodes = [corners[:1]]
    for start, end in zip(corners[:-1], corners[1:], strict=True):
        if fine_m:
            nodes.append(start + _graded(end - start, spacing_m, fine_m, reach_m))
        else:
            nodes.append(np.linspace(start, end, int(np.ceil((end - start) / spacing_m - 1e-9)) + 1)[1:])
    return np.concatenate(nodes)


def _graded(length: float, spacing: float, fine: float, reach: float) -> Array:
    """Positions in (0, length], fine at both ends."""
    places, at = [0.0], 0.0
    while at < length / 2:
        step = fine if at < reach else min(spacing, fine * 1.4 ** (1 + (at - reach) / (3 * fine)))
        at += step
        places.append(at)
    half = np.array(places) * (length / 2) / at
    return np.concatenate([half, length - half[-2::-1]])[1:]
