"""How low do bounds at a target go? Goal states as found, after their descent, and after a long search for better ones.

python benchmarks/goal_descent.py [--count 16] [--only SCENARIO ...] [--plans FILE]

The long search descends from all configurations found from three seeds. It says what choosing among goals could give at
best, wherever a path leads. With the results of benchmarks/planning.py, that best over the bound at which blind plans
end, beside what the aware ones make of it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from own_cache import use_own_cache
from planning import in_turn, paired
from planning_queries import Query, queries

from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import descended, goal_states
from ctrplan.planning.reach import reach
from ctrplan.scenario.tip_solver import GoalState, tip_target

LONG_SEEDS = (1, 2, 3)


def lowest_mm(*sets: list[GoalState]) -> float:
    return min(state.bound_m for states in sets for state in states) * 1e3


def descent(checker: MotionChecker, goals: list[GoalState]) -> list[GoalState]:
    """The lowest state of each trail."""
    return [trail[-1] for trail in descended(checker, goals)]


def all_goals(checker: MotionChecker, seed: int) -> list[GoalState]:
    """Every valid configuration found from a seed."""
    found = reach(checker, tip_target(checker.scenario), checker.scenario.goal.tolerance_m, np.random.default_rng(seed))
    return [GoalState(c.joints, c.bound_m, c.tip_error_m) for c in found.configurations if c.valid]


def figures(query: Query) -> tuple[float, float, float, float, float]:
    """Lowest and highest bound [mm] of the goal states, lowest after descent, CPU seconds of it, lowest after all."""
    checker = MotionChecker(query.load([]))
    goals = goal_states(checker, np.random.default_rng(0))
    began = time.process_time()
    low = descent(checker, goals)
    took = time.process_time() - began
    more = [descent(checker, found) + found for seed in LONG_SEEDS if (found := all_goals(checker, seed))]
    highest = max(state.bound_m for state in goals) * 1e3
    return lowest_mm(goals), highest, lowest_mm(goals, low), took, lowest_mm(goals, low, *more)


def planned(file: Path) -> dict[str, tuple[float, float]]:
    """Bounds [mm] at which the first seed's aware and blind plans end, of queries with a choice."""
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    rows = [row for row in rows if row["solved"] and row["choice"] and row["seed"] == 0]
    return {aware["query"]: (aware["goal_mm"], blind["goal_mm"]) for aware, blind in paired(rows)}


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=16, help="queries, of all scenarios by turns")
    parser.add_argument("--only", nargs="+", metavar="SCENARIO", help="these scenarios' queries")
    parser.add_argument("--plans", type=Path, metavar="FILE", help="results of benchmarks/planning.py, seed 0")
    arguments = parser.parse_args()
    ends = planned(arguments.plans) if arguments.plans else {}
    chosen = [query for query in in_turn(queries()) if not arguments.only or query.scenario in arguments.only]
    rows, shares = [], []
    print("| query | goal states | descended | CPU time | long search | descent / found | long / descent |")
    print("|---|---|---|---|---|---|---|")
    for query in chosen[: arguments.count]:
        low, high, after, took, least = row = figures(query)
        rows.append(row)
        states, ratios = f"{low:.2f} to {high:.2f} mm", f"{after / low:.2f} | {least / after:.2f}"
        print(f"| {query.name} | {states} | {after:.2f} mm | {took:.1f} s | {least:.2f} mm | {ratios} |", flush=True)
        if query.name in ends:
            aware, blind = ends[query.name]
            shares.append((aware / blind, min(least, aware) / blind))
    found, _, after, took, least = np.array(rows).T
    print(
        f"\nDescent lowers the lowest bound by {100 * np.median(1 - after / found):.0f} % (median), "
        f"{100 * np.max(1 - after / found):.0f} % at most, in {np.median(took):.1f} s of CPU time (median); "
        f"the long search comes lower by {100 * np.median(1 - least / after):.0f} % (median), "
        f"{100 * np.max(1 - least / after):.0f} % at most."
    )
    if shares:
        did, best = np.median(shares, axis=0)
        print(f"{len(shares)} queries with a choice: aware / blind {did:.2f} x, best possible {best:.2f} x (medians).")


if __name__ == "__main__":
    main()
