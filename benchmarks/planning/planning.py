"""Does the bound pay? Queries known to be feasible, planned with the bound in the cost and blind to it, several seeds.

    python benchmarks/run.py planning [SCENARIO ...] [--seeds 5] [--count S]

A search ends by work counted, about what takes the scenario's planner.time_s, or the one given with --count, so that
plans do not depend on the load of the machine. For each certified plan one random history, friction at a random corner
at its start, is simulated against the bound and the anatomy.
"""

import itertools
import resource
from collections.abc import Iterator
from typing import Any

import common
import numpy as np
from common import distance_mm, table
from first_paths import Query, queries

import ctrplan
from ctrplan import CtrplanError, MotionChecker, Plan
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.planning.goal_states import goal_states

BLIND = ["cost.error_along=0", "cost.error_goal=0"]
AWARE = ["cost.error_along=10", "cost.error_goal=100"]  # ten times the defaults: errors matter most here
MODES: dict[str, list[str]] = {"aware": AWARE, "blind": BLIND}
CHOICE = 1.5  # ratio between bounds of goal configurations from which a query has a choice
HISTORY_STEPS = 8  # a leg


def run(query: Query, mode: str, seed: int, count_s: float | None) -> dict[str, Any]:
    """A plan's figures, or why there is none."""
    row: dict[str, Any] = {"query": query.name, "mode": mode, "seed": seed}
    overrides = MODES[mode] + ([] if count_s is None else [f"planner.time_s={count_s}"])
    try:
        plan = ctrplan.plan(query.load(overrides), seed=seed)
    except CtrplanError as error:
        return row | {"solved": False, "why": str(error)}
    c = plan.certificate
    start = np.random.default_rng(seed).choice([-1.0, 1.0], plan.scenario.robot.n - 1).tolist()  # friction fully loaded
    return row | {
        "solved": c.valid,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,  # of the process so far
        "goal_mm": c.goal_bound_m * 1e3,
        "arrival_mm": c.arrival.error_m * 1e3 if c.arrival else np.nan,
        "realised_mm": realised_mm(plan, start),
        "integral_mm": c.error_integral_mm,
        "length_mm": c.length_mm,
        **history_excess(plan, start),
    }


def realised_mm(plan: Plan, start: list[float]) -> float:
    """How far from the target a history ends that starts in a friction state."""
    scenario, robot = plan.scenario, plan.scenario.robot
    tip = robot.history(start).follow(*robot.drive.collars(plan.waypoints)).position_m[-1]
    return distance_mm(tip, scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m))


def history_excess(plan: Plan, start: list[float]) -> dict[str, float]:
    """By how much such a history exceeds the bound, and its clearance beyond the anatomy's margins [mm]."""
    scenario, robot = plan.scenario, plan.scenario.robot
    history, excess, clearance = robot.history(start), -np.inf, np.inf
    history.advance(*robot.drive.collars(plan.legs[0].start))
    for leg in plan.legs:
        for q in np.linspace(leg.start, leg.end, HISTORY_STEPS + 1)[1:]:
            step = history.advance(*robot.drive.collars(q))
            excess = max(excess, step.deviation_m - robot.bound(*robot.drive.collars(q)).position_m)
            ahead = step.shape.s_m >= 0
            points = step.shape.centreline_m[ahead] @ scenario.base_R.T + scenario.base_position_m
            if scenario.anatomy and len(points):
                room = exact_clearance(scenario.anatomy, points) - step.shape.radius_m[ahead]
                clearance = min(clearance, float(room.min()))
    return {"history_excess_mm": excess * 1e3, "history_clearance_mm": clearance * 1e3}


def has_choice(query: Query) -> bool:
    """Whether goal configurations differ enough in their bounds."""
    try:
        goals = goal_states(MotionChecker(query.load([])), np.random.default_rng(0))
    except CtrplanError:
        return False
    bounds = [goal.bound_m for goal in goals]
    return len(bounds) > 1 and max(bounds) >= CHOICE * min(bounds)


def results(chosen: list[Query], seeds: int, count_s: float | None) -> Iterator[dict[str, Any]]:
    """Every query in both modes with every seed."""
    for query in chosen:
        choice = has_choice(query)
        for seed, mode in itertools.product(range(seeds), MODES):
            yield run(query, mode, seed, count_s) | {"choice": choice}


def print_table(rows: list[dict[str, Any]]) -> None:
    """What the rows say, beside what is wanted."""
    solved = [row for row in rows if row["solved"]]
    pairs, names = paired([row for row in solved if row["choice"]]), {row["query"] for row in rows}
    beyond = sum(row["history_excess_mm"] > 0.05 for row in solved)
    touching = sum(row["history_clearance_mm"] < 0 for row in solved)
    lines = [
        ("queries", len(names), ">= 40"),
        ("of them with a choice", len({row["query"] for row in rows if row["choice"]}), ""),
        ("plans solved and certified", f"{len(solved)} of {len(rows)}", "all"),
        ("worst-case error at the goal, aware / blind, median with a choice", ratio(pairs, "goal_mm"), "<= 0.4 x"),
        ("arrival, median, aware / blind", medians(pairs, "arrival_mm"), ""),
        ("from the target after a random corner of friction, median, aware / blind", medians(pairs, "realised_mm"), ""),
        ("integral of the bound along the path", ratio(pairs, "integral_mm"), "<= 0.6 x"),
        ("joint path length", ratio(pairs, "length_mm"), "<= 1.5 x"),
        ("histories beyond the bound by more than 0.05 mm", beyond, "0"),
        ("histories that touch the anatomy's margins", touching, "0"),
        ("peak memory", f"{max((row['peak_mb'] for row in solved), default=np.nan):.0f} MB", "<= 1000 MB"),
    ]
    table("what was found", ("", "found", "wanted"), lines)


def paired(rows: list[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Aware and blind plans of the same query and seed."""
    aware, blind = ({(row["query"], row["seed"]): row for row in rows if row["mode"] == mode} for mode in MODES)
    return [(aware[key], blind[key]) for key in aware if key in blind]


def ratio(pairs: list[tuple[dict[str, Any], dict[str, Any]]], key: str) -> str:
    """Median of aware over blind."""
    return f"{np.median([a[key] / max(b[key], 1e-9) for a, b in pairs]):.2f} x" if pairs else "none"


def medians(pairs: list[tuple[dict[str, Any], dict[str, Any]]], key: str) -> str:
    """Medians of the aware plans and of the blind ones."""
    return " / ".join(f"{np.median([pair[k][key] for pair in pairs]):.3f} mm" for k in (0, 1)) if pairs else "none"


def main() -> None:
    scenarios = list(dict.fromkeys(query.scenario for query in queries()))
    given = common.arguments(__doc__, ("scenarios*", scenarios), seeds=5, count=float)
    chosen = [query for query in queries() if query.scenario in (given.scenarios or scenarios)]
    print_table(list(results(chosen, given.seeds, given.count)))
