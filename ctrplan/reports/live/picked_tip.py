"""Joint values for a tip that somebody picked in the live view."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import InputError
from ctrplan.planning.reach import reach
from ctrplan.reports.live.standing import Standing
from ctrplan.scenario.tip_solver import TipTarget

NEAR_M = 0.2e-3  # of the frictionless tip from what was picked
STARTS = 60


def picked_tip(standing: Standing, joints: Array, tip_mm: list[float]) -> dict[str, Any]:
    """{"joints": (m,) in deg or mm} whose frictionless tip is there, valid ones first, then the nearest to `joints`.

    Else {"refusal": how near the tip comes}. Raises InputError unless `tip_mm` is three finite numbers.
    """
    if len(tip_mm) != 3 or not all(map(math.isfinite, tip_mm)):
        raise InputError("must be three finite numbers", key="tip", value=tip_mm, unit="mm")
    scenario, drive = standing.scenario, standing.scenario.robot.drive
    target = scenario.base_R.T @ (np.array(tip_mm) / MM_PER_M - scenario.base_position_m)
    found = reach(standing.checker, TipTarget(target), NEAR_M, np.random.default_rng(0), STARTS)
    if not found.configurations:
        return {"refusal": f"the tip comes no nearer to that point than {found.nearest.tip_error_m * 1e3:.1f} mm"}
    scale = np.where(drive.is_rotation, scenario.cost.mm_per_rad, MM_PER_M)
    chosen = min(found.configurations, key=lambda c: (not c.valid, float(np.linalg.norm((c.joints - joints) * scale))))
    units = [joint.si_per_unit for joint in drive.joints]
    return {"joints": [round(float(q) / unit, 6) for q, unit in zip(chosen.joints, units, strict=True)]}
