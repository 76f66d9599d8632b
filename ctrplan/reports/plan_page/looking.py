"""Places from which the report's scene is looked at, for looking.js."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.plan_timing import place_time_s
from ctrplan.reports.framing import side_azimuth_rad
from ctrplan.reports.plan_scene import goal_tip
from ctrplan.reports.scene_traces import TILT

if TYPE_CHECKING:
    from ctrplan.reports.plan_scene import PlanScene


def looking_places(scene: PlanScene) -> dict[str, Any]:
    """Points in mm and unit vectors, anatomy's frame."""
    scenario = scene.plan.scenario
    points = np.concatenate([step.envelope.centreline_m for step in scene.path])
    azimuth = side_azimuth_rad(points)
    side = np.array([np.cos(TILT) * np.cos(azimuth), np.cos(TILT) * np.sin(azimuth), np.sin(TILT)])
    return {
        "overview": dict(zip("xyz", side.tolist(), strict=True)),
        "side": side.tolist(),
        "base": _mm(scenario.base_position_m),
        "axis": scenario.base_R[:, 2].tolist(),
        "goal": _mm(goal_tip(scene.plan)),
        "tips": [_mm(step.tip_m) for step in scene.path],
        "along": [np.round(step.tubes[-1].tangent[-1], 4).tolist() for step in scene.path],
        **_closest(scene, side),
    }


def _closest(scene: PlanScene, side: Array) -> dict[str, Any]:
    """Across the gap where the robot comes closest, and the frame at which it does; nothing in free space."""
    if scene.narrowest is None:
        return {}
    gap = scene.narrowest.gap_m
    along = (gap[1] - gap[0]) / max(float(np.linalg.norm(gap[1] - gap[0])), 1e-12)
    beside = side - (side @ along) * along
    times = [step.time_s for step in scene.path]
    at = int(np.argmin(np.abs(np.array(times) - place_time_s(scene.plan, scene.narrowest.place))))
    return {
        "closest": _mm(gap.mean(axis=0)),
        "closest_side": (beside / max(float(np.linalg.norm(beside)), 1e-12)).tolist(),
        "closest_frame": at,
    }


def _mm(point_m: Array) -> list[float]:
    found: list[float] = np.round(point_m * 1e3, 3).tolist()
    return found
