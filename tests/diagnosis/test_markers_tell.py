"""A ring on the body names what the tip alone can't tell: precurvature that changes along a tube."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import SIGMA_M, chain_of, pair_robot, waypoints

from ctrplan.diagnosis import CATALOGUE, diagnose

RING = [{"name": "ring", "tube": 2, "from_tip_mm": 30}]
ASKED = ("varying_precurvature", "homing_offset", "base_misalignment")  # quick to ask


@pytest.mark.parametrize(
    ("points", "verdict", "named"), [((0,), "no_missing_effect", []), ((0, 1), "named", ["varying_precurvature"])]
)
def test_a_ring_names_what_the_tip_alone_takes_for_calibration(
    points: tuple[int, ...], verdict: str, named: list[str]
) -> None:
    robot = pair_robot(marker=RING, measurement={"position_sigma_mm": SIGMA_M * 1e3})
    plan, count = waypoints(robot, 18, seed=4), len(points)
    data = replace(
        plan,
        rows=np.tile(plan.rows, count),
        position_m=np.zeros((count * plan.count, 3)),
        tangent=np.full((count * plan.count, 3), np.nan),
        marker=np.repeat(points, plan.count),
    )
    chain = chain_of(robot, data, {"varying_precurvature": None})
    p = chain.neutral.copy()
    p[-1] = 0.25  # along the curved part of tube 2
    noise = SIGMA_M * np.random.default_rng(8).standard_normal(data.position_m.shape)
    measured = replace(data, position_m=chain.predict(p, derivatives=False).position_m + noise, file="made up")
    found = diagnose(robot, measured, without=[name for name in CATALOGUE if name not in ASKED])
    assert found.verdict == verdict
    assert [t.name for t in found.listed] == named
