"""A whole grid of clearances, which fields of the program are put together of, brick by brick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.anatomy import clearance_grid
from ctrplan.anatomy.clearance_grid import COARSEST, SignedDistanceField, content_key
from ctrplan.anatomy.parts import AnatomyPart, combined_clearance
from ctrplan.base.long_work import Progress, part_of
from ctrplan.storage import cache


def whole_grid(
    parts: Sequence[AnatomyPart],
    lower_m: ArrayLike,
    upper_m: ArrayLike,
    spacing_m: float,
    progress: Progress | None = None,
) -> SignedDistanceField:
    """Clearance on a grid that starts at lower_m (3,) [m] and ends up to 4 nodes beyond upper_m (3,); kept on disk."""
    lower, upper = np.array(lower_m, dtype=np.float64), np.array(upper_m, dtype=np.float64)
    cells = np.ceil(np.maximum((upper - lower) / (COARSEST * spacing_m) - 1e-9, 1.0)) * COARSEST
    nx, ny, nz = (int(count) + 1 for count in cells)
    shape = nx, ny, nz
    key = content_key(parts, lower, spacing_m, shape)
    values = cache.load(key, shape)
    if values is None:
        shares = iter(part_of(progress, k, len(parts)) for k in range(len(parts)))
        made = combined_clearance(
            parts, lambda part: clearance_grid.grid_distance(part, lower, spacing_m, shape, next(shares))
        )
        values = made.astype(np.float32, copy=False)
        cache.store_all({key: values})
    if progress:
        progress(1.0)
    return SignedDistanceField(lower, spacing_m, values, tuple(parts))
