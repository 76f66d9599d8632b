"""Does the bound pay? Every scenario, the same seed and time, with the bound in the cost and with its weights at zero.

python benchmarks/planning_scenarios.py [--seed N] [--write]     --write puts the table into docs/results.md
"""

from __future__ import annotations

import argparse
import resource
import sys
from pathlib import Path

from own_cache import use_own_cache
from page_table import put_into_page

import ctrplan
from ctrplan.errors import CtrplanError
from ctrplan.planning import Plan
from ctrplan.scenario.scenario import Cost, path_cost_mm

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- planning table -->\n", "<!-- end of planning table -->"
BLIND = ["cost.error_along=0", "cost.error_goal=0"]
HEADER = (
    "| scenario | bound in the cost | first certified path | cost | joint length | worst bound | bound at the goal "
    "| less what is released | predicted | stops |\n"
    "|---|---|---|---|---|---|---|---|---|---|\n"
)


def cost_mm(plan: Plan, weights: Cost) -> float:
    """What the plan costs with the scenario's own weights, whatever the planner was told."""
    c = plan.certificate
    return path_cost_mm(
        weights,
        length_mm=c.length_mm,
        legs=len(plan.trajectory.leg_end_s),
        integral_mm=c.released_integral_mm,
        left_m=sum(target.bound_m + target.released_m for target in c.targets),
    )


def row(name: str, label: str, plan: Plan, weights: Cost) -> str:
    c = plan.certificate
    return (
        f"| {name} | {label} | {plan.first_certified_s:.1f} s | {cost_mm(plan, weights):.0f} mm "
        f"| {c.length_mm:.0f} mm | {c.worst_bound_m * 1e3:.2f} mm "
        f"| {c.goal_bound_m * 1e3:.2f} mm | {c.samples.released_m[-1] * 1e3:.2f} mm "
        f"| {c.goal_predicted_m * 1e3:.2f} mm | {c.stops} |\n"
    )


def table(seed: int) -> str:
    text = HEADER
    for path in sorted((ROOT / "scenarios").glob("*.toml")):
        for label, overrides in (("yes", []), ("no", BLIND)):
            try:
                plan = ctrplan.plan(ctrplan.load_scenario(path, overrides), seed=seed)
                line = row(plan.scenario.name, label, plan, ctrplan.load_scenario(path).cost)
            except CtrplanError as error:
                line = f"| {path.stem} | {label} | {str(error).rsplit(': ', 1)[-1]} | | | | | | | |\n"
            print(line, end="", file=sys.stderr, flush=True)
            text += line
    return text


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="put the table into docs/results.md")
    arguments = parser.parse_args()
    text = table(arguments.seed)
    print(text)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    if arguments.write:
        put_into_page(ROOT / "docs" / "results.md", BEGIN, text, END)


if __name__ == "__main__":
    main()
