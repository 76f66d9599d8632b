"""Improve a path from any planner: rotations first, fewer stops, never at a higher cost."""

from pathlib import Path

import numpy as np

import ctrplan

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"

scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
zigzag = np.array(  # rotate outer [deg], rotate inner [deg], translate inner [mm]
    [[0, 0, -30], [20, 0, -30], [20, 0, 0], [20, 120, 0], [20, 120, 10], [60, 200, 10], [60, 200, 25]]
) * [np.pi / 180, np.pi / 180, 1e-3]

plan = ctrplan.reorder(zigzag, scenario)

print("legs:", ", ".join(leg.kind for leg in plan.legs))
print(f"stops: {plan.reorder.stops_before} before, {plan.reorder.stops_after} after")
print(f"cost: {plan.reorder.cost_before_mm:.1f} mm before, {plan.reorder.cost_after_mm:.1f} mm after")
