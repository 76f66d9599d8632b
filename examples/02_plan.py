"""Plan a certified motion that keeps the friction error small."""

from pathlib import Path

import ctrplan

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"

scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
plan = ctrplan.plan(scenario, seed=0, time_s=1)

for leg in plan.legs:
    print(f"{leg.kind}: {leg.start.round(4)} -> {leg.end.round(4)} rad, m")
print(f"{plan.trajectory.duration_s:.1f} s for the drive, valid: {plan.certificate.valid}")
print(f"bound at the goal: {plan.certificate.goal_bound_m * 1e3:.2f} mm")
