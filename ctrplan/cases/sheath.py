"""A straight sheath from an entry into a lumen: a lumen of its own, since tissue around it is none."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrplan.anatomy.parts import AnatomyPart, combined_clearance, surface_distance
from ctrplan.base.arrays import Array
from ctrplan.base.directions import unit
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError
from ctrplan.planning.scenario import Scenario

BEHIND_MM, LONGEST_MM, STEP_MM = 10.0, 150.0, 0.5


def sheath(scenario: Scenario, entry_m: Array, towards_m: Array, radius_mm: float) -> dict[str, Any]:
    """[[anatomy]] of a sheath that begins behind the entry (3,) and ends where the lumen is as wide as the sheath.

    Near the seam of two lumens less room is counted than there is, so it reaches to where the lumen's own counts as
    much. Raises InputError where the straight way meets no lumen, with how near it comes.
    """
    way = unit(towards_m - entry_m)
    along_mm = np.arange(0, LONGEST_MM + STEP_MM, STEP_MM)
    points = entry_m + along_mm[:, None] / MM_PER_M * way
    depth_mm = _depth(scenario, points) * MM_PER_M
    enough = np.flatnonzero(depth_mm >= radius_mm)
    if len(enough):
        end = along_mm[enough[0]]
    elif depth_mm.max() > 0:  # a lumen narrower than the sheath: to its middle
        end = along_mm[int(np.argmax(depth_mm))]
    else:
        apart = f"it passes {-depth_mm.max():.3g} mm by"
        rule = f"the straight way from the entry meets no lumen in {LONGEST_MM:g} mm, {apart}"
        raise InputError(rule, key="--sheath-mm", value=radius_mm)
    return {
        "kind": "capsule",
        "from_mm": _shown(entry_m * MM_PER_M - BEHIND_MM * way),
        "to_mm": _shown(entry_m * MM_PER_M + end * way),
        "radius_mm": radius_mm,
        "role": "inside",
        "margin_mm": 0.0,
    }


def _depth(scenario: Scenario, points_m: Array) -> Array:
    lumens = [part for part in scenario.anatomy if part.role == "inside"]
    if not lumens:
        raise InputError("leads into a lumen, and none was said: --lumen NAME", key="--sheath-mm")
    bare = [AnatomyPart(part.shape, part.role, 0.0) for part in lumens]
    return np.asarray(combined_clearance(bare, lambda part: surface_distance(part, points_m)))


def _shown(point_mm: Array) -> list[float]:
    return [float(x) for x in np.round(point_mm, 3) + 0.0]
