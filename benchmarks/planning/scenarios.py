"""Does the bound pay? Every scenario, the same seed and work, with the bound in the cost and with its weights at zero.

    python benchmarks/run.py --write scenarios plans [SCENARIO ...] [--seed N]     # the table of docs/results.md
    python benchmarks/run.py scenarios choice
    python benchmarks/run.py scenarios costs [SCENARIO ...] [--time 1] [--seeds 5] [--against CHECKOUT]
    python benchmarks/run.py scenarios success [SCENARIO ...] [--time 1] [--seeds 20] [--seed FIRST]
    python benchmarks/run.py scenarios cage [--time 2] [--seeds 5]

costs: what plans of a search of so many counted seconds cost, how many seeds have one, how far from their targets they
may arrive, and what all of it takes of a processor; with --against, in alternation with another checkout. Plans are
kept in build/scenario_plans.jsonl, where another run goes on; without it they are made anew.
success: how many seeds have a plan after a search of so many counted seconds, which ends with its first certified path.
cage: the same of a robot whose inner tube stands in a cage of bars with three gaps, to three tips outside.
choice: how much choice the scenarios' goals leave: goal configurations, their bounds, and the ratio between them.
"""

import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from arrival import driven, pasts
from common import ROOT, SCENARIOS, SHIPPED, elsewhere, table

import ctrplan
from ctrplan import Capsule, Cost, MotionChecker, Plan, Scenario, load_scenario
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.search.stage_search import Progress
from ctrplan.scenario.scenario import path_cost_mm

BLIND = ["cost.error_along=0", "cost.error_goal=0"]
COLUMNS = "scenario | bound in the cost | first certified path | cost | joint length | worst bound | bound at the goal"
COLUMNS += " | less what is released | predicted | arrival | driven after random pasts | stops"
PLANS = ROOT / "build" / "scenario_plans.jsonl"
PASTS = 20  # from which each plan is simulated


def cost_mm(plan: Plan, weights: Cost) -> float:
    """What the plan costs with the scenario's own weights, whatever the planner was told."""
    c = plan.certificate
    return path_cost_mm(
        weights,
        length_mm=c.length_mm,
        legs=len(plan.trajectory.leg_end_s),
        integral_mm=c.released_integral_mm,
        left_m=sum(target.bound_m + target.unknown_m for target in c.targets),
    )


def cells(plan: Plan, weights: Cost) -> list[str]:
    c = plan.certificate
    errors = c.worst_bound_m, c.goal_bound_m, c.samples.released_m[-1], c.goal_predicted_m
    errors += (c.arrival.error_m if c.arrival else np.nan,)
    lengths = [f"{cost_mm(plan, weights):.0f} mm", f"{c.length_mm:.0f} mm", *(f"{1e3 * x:.2f} mm" for x in errors)]
    return [f"{plan.first_certified_s:.1f} s", *lengths, driven_mm(plan), str(c.stops)]


def driven_mm(plan: Plan) -> str:
    """Median and largest distance from the target, or from the frictionless tip at joint values, after random pasts."""
    scenario, rng = plan.scenario, np.random.default_rng(0)
    robot, goal = scenario.robot, scenario.goal
    states, _ = pasts(robot, plan.waypoints[0], PASTS, np.inf, rng)
    tips, _ = driven(robot, states, plan.waypoints)
    target = robot.solve(*robot.drive.collars(plan.waypoints[-1])).tip_m
    if goal.tip_m is not None:
        target = scenario.base_R.T @ (goal.tip_m - scenario.base_position_m)
    off = 1e3 * np.linalg.norm(tips - target, axis=1)
    return f"{np.median(off):.2f}, {off.max():.2f} mm"


def plans(paths: list[Path], seed: int) -> Iterator[tuple[str, ...]]:
    for path, (label, overrides) in itertools.product(paths, (("yes", []), ("no", BLIND))):
        scenario = ctrplan.load_scenario(path, overrides)
        try:
            found = cells(ctrplan.plan(scenario, seed=seed), ctrplan.load_scenario(path).cost)
        except ctrplan.CtrplanError as error:
            found = [str(error).rsplit(": ", 1)[-1], *[""] * (COLUMNS.count("|") - 2)]
        yield scenario.name, label, *found


def choice(paths: list[Path]) -> Iterator[tuple[object, ...]]:
    """Number of valid goal configurations, lowest and highest bound [mm]; not for joint goals and tours."""
    for path in paths:
        scenario = load_scenario(path)
        first = scenario.targets[0]
        if first.tip_m is None or len(scenario.targets) > 2:
            continue
        stage = replace(scenario, goal=first, via=())
        bounds = [goal.bound_m * 1e3 for goal in goal_states(MotionChecker(stage), np.random.default_rng(0))]
        low, high = min(bounds), max(bounds)
        yield path.stem, len(bounds), f"{low:.2f} to {high:.2f} mm", f"{high / low:.1f} x"


def plan_once(path: Path, seed: int, time_s: float) -> tuple[float, float, float, float]:
    """Cost, bound at the goal and arrival [mm] of a plan, NaN where there is none, and seconds of a processor."""
    began = time.process_time()
    scenario = ctrplan.load_scenario(path, [f"planner.time_s={time_s}"])
    try:
        plan = ctrplan.plan(scenario, seed=seed)
    except ctrplan.CtrplanError as error:
        print(path.stem, seed, error, file=sys.stderr, flush=True)
        return np.nan, np.nan, np.nan, time.process_time() - began
    took = time.process_time() - began
    c = plan.certificate
    return cost_mm(plan, scenario.cost), 1e3 * c.goal_bound_m, 1e3 * c.arrival.error_m if c.arrival else np.nan, took


def costs(paths: list[Path], given: Any) -> None:
    """A row for each scenario, medians over the seeds; each plan in a process of its own, checkouts in alternation."""
    trees = [ROOT] + ([given.against.resolve()] if given.against else [])
    planned = {tuple(row["of"]): row["plan"] for row in common.kept(PLANS)}
    for seed, path, k in itertools.product(range(given.seeds), paths, range(len(trees))):
        tree = trees[(k + seed) % len(trees)]
        arguments = ("once", path.stem, "--seed", str(seed), "--time", str(given.time))
        if (of := (str(tree), path.stem, seed, given.time)) not in planned:
            planned[of] = elsewhere(tree, "scenarios", *arguments)
            common.keep(PLANS, {"of": of, "plan": planned[of]})

    def cells(tree: Path, path: Path) -> Iterator[str]:
        solved = np.array([planned[str(tree), path.stem, seed, given.time] for seed in range(given.seeds)])
        there = np.isfinite(solved[:, 0])
        cost, bound = (np.median(solved[there, c]) if there.any() else np.nan for c in (0, 1))
        least, most = (f(solved[there, 0]) if there.any() else np.nan for f in (np.min, np.max))
        arrival = np.nanmax(solved[:, 2], initial=0.0)
        yield from (f"{there.sum()} of {given.seeds}", f"{cost:.1f} mm", f"{least:.1f} to {most:.1f}")
        yield from (f"{bound:.2f} mm", f"{arrival:.2f} mm", f"{np.median(solved[:, 3]):.1f} s")

    names = ("planned", "cost, median", "all", "bound at the goal", "largest arrival error", "processor")
    heads = [f"{name}{where}" for where in ("", ", there")[: len(trees)] for name in names]
    rows = ([path.stem, *itertools.chain(*(cells(tree, path) for tree in trees))] for path in paths)
    table(f"costs after {given.time:g} s", ("scenario", *heads), rows)


def ended_by_a_path(progress: Progress) -> None:
    """Raises StopIteration once a path is certified."""
    if progress.stage == "search" and progress.best_cost_mm is not None:
        raise StopIteration


def success(scenarios: dict[str, list[Scenario]], given: Any) -> Iterator[tuple[str, ...]]:
    """A row for each name."""
    for name, several in scenarios.items():
        took, planned = list[float](), 0
        for scenario, seed in itertools.product(several, range(given.seed, given.seed + given.seeds)):
            told = None if scenario.via else ended_by_a_path  # a tour is planned to its end
            began = time.process_time()
            try:
                planned += ctrplan.plan(scenario, seed=seed, progress=told).certificate.valid
            except StopIteration:
                planned += 1
            except ctrplan.CtrplanError as error:
                print(name, seed, error, file=sys.stderr, flush=True)
            took.append(time.process_time() - began)
        yield name, f"{planned} of {len(took)}", f"{np.median(took):.1f} s", f"{max(took):.1f} s"


CAGE_M, BAR_M, FROM_M, TO_M, EVERY_DEG = (18e-3, 0.8e-3, 130e-3, 260e-3, 6)  # of bars; outer tubes reach 150
GAPS_DEG, WIDE_DEG = (50.0, 170.0, 290.0), (60, 50, 40, 30)
OUTSIDE_M, TIPS = 12e-3, 3  # of tips beyond the bars


def caged(wide_deg: float, time_s: float) -> list[Scenario]:
    """The three tubes of `ribs` in a cage with gaps so many degrees wide, to the tips of valid states outside."""
    base = load_scenario(SCENARIOS / "ribs.toml", [f"planner.time_s={time_s}"])
    around = np.arange(0.0, 360.0, EVERY_DEG)
    away = np.abs((around[:, None] - GAPS_DEG + 180) % 360 - 180).min(axis=1)
    at = CAGE_M * np.array([np.cos(np.radians(around)), np.sin(np.radians(around))]).T[away >= wide_deg / 2]
    bars = [Capsule(np.append(xy, FROM_M), np.append(xy, TO_M), BAR_M) for xy in at]
    parts = tuple(AnatomyPart(bar, "avoid", 0.5e-3) for bar in bars)
    inside = replace(base, anatomy=parts, start=np.array([0.0, np.pi, 0.0, -75e-3]))
    checker, results = MotionChecker(inside), list[Scenario]()
    for joints in checker.space.sample(np.random.default_rng(0), 2000):
        tip = inside.robot.solve(*inside.robot.drive.collars(joints)).tip_m
        is_outside = np.hypot(*tip[:2]) > CAGE_M + OUTSIDE_M and tip[2] < TO_M
        if is_outside and checker.state(joints).valid:
            results.append(replace(inside, goal=replace(base.goal, tip_m=tip, joints=None)))
        if len(results) == TIPS:
            break
    return results


def main() -> None:
    known, options = ("plans", "choice", "costs", "success", "cage", "once"), {"seed": 0, "seeds": 5, "time": 1.0}
    given = common.arguments(__doc__, ("section", known), ("scenarios*", SHIPPED), against=Path, **options)
    paths = [SCENARIOS / f"{name}.toml" for name in given.scenarios or SHIPPED]
    common.end_searches_by_count()
    if given.section == "once":
        print(*plan_once(paths[0], given.seed, given.time))
    elif given.section == "plans":
        table("plans", COLUMNS, plans(paths, given.seed))
    elif given.section == "choice":
        table("choice", "scenario | goal configurations | bounds | choice", choice(paths))
    elif given.section == "costs":
        costs(paths, given)
    else:
        if given.section == "cage":
            chosen = {f"gaps of {wide} deg": caged(wide, given.time) for wide in WIDE_DEG}
        else:
            chosen = {path.stem: [ctrplan.load_scenario(path, [f"planner.time_s={given.time}"])] for path in paths}
        head = f"scenario | planned in {given.time:g} s | median time of a processor | longest"
        table(given.section, head, success(chosen, given))
