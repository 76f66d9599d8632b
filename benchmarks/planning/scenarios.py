"""Does the bound pay? Every scenario, the same seed and work, with the bound in the cost and with its weights at zero.

    python benchmarks/run.py --write scenarios plans [SCENARIO ...] [--seed N]     # the table of docs/results.md
    python benchmarks/run.py scenarios choice
    python benchmarks/run.py scenarios costs [SCENARIO ...] [--time 1] [--seeds 5] [--against CHECKOUT]
    python benchmarks/run.py scenarios success [SCENARIO ...] [--time 1] [--seeds 20] [--seed FIRST]
    python benchmarks/run.py scenarios cage [--time 2] [--seeds 5]

costs: what plans of a search of so many seconds cost, how many seeds have one, and what all of it takes of a processor;
with --against, in alternation with another checkout.
success: how many seeds have a plan after a search of so many counted seconds, which ends with its first certified path.
cage: the same of a robot whose inner tube stands in a cage of bars with three gaps, to three tips outside.
choice: how much choice the scenarios' goals leave: goal configurations, their bounds, and the ratio between them.
"""

import itertools
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import common
import numpy as np
from arrival import driven, pasts
from common import ROOT, SCENARIOS, again, table

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.base import long_work
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning import Plan
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.search.stage_search import Progress
from ctrplan.scenario.scenario import Cost, Scenario, path_cost_mm

BLIND = ["cost.error_along=0", "cost.error_goal=0"]
COLUMNS = ("scenario", "bound in the cost", "first certified path", "cost", "joint length", "worst bound")
COLUMNS += ("bound at the goal", "less what is released", "predicted", "arrival", "driven after random pasts", "stops")
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


def plans(paths: list[Path], seed: int) -> None:
    rows = []
    for path in paths:
        for label, overrides in (("yes", []), ("no", BLIND)):
            scenario = ctrplan.load_scenario(path, overrides)
            try:
                found = cells(ctrplan.plan(scenario, seed=seed), ctrplan.load_scenario(path).cost)
            except ctrplan.CtrplanError as error:
                found = [str(error).rsplit(": ", 1)[-1], *[""] * (len(COLUMNS) - 3)]
            rows.append((scenario.name, label, *found))
            print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    table("plans", COLUMNS, rows)


def choice(path: Path) -> tuple[int, float, float] | None:
    """Number of valid goal configurations, lowest and highest bound [mm]; None for joint goals and tours."""
    scenario = load_scenario(path)
    first = scenario.targets[0]
    if first.tip_m is None or len(scenario.targets) > 2:
        return None
    stage = replace(scenario, goal=first, via=())
    bounds = [goal.bound_m * 1e3 for goal in goal_states(MotionChecker(stage), np.random.default_rng(0))]
    return len(bounds), min(bounds), max(bounds)


def print_choice(paths: list[Path]) -> None:
    rows = []
    for path in paths:
        if found := choice(path):
            count, low, high = found
            rows.append((path.stem, count, f"{low:.2f} to {high:.2f} mm", f"{high / low:.1f} x"))
    table("choice", ("scenario", "goal configurations", "bounds", "choice"), rows)


def plan_once(path: Path, seed: int, time_s: float) -> tuple[float, float, float]:
    """Cost [mm] and bound at the goal [mm] of a plan, NaN where there is none, and seconds of a processor."""
    began = time.process_time()
    scenario = ctrplan.load_scenario(path, [f"planner.time_s={time_s}"])
    try:
        plan = ctrplan.plan(scenario, seed=seed)
    except ctrplan.CtrplanError as error:
        print(path.stem, seed, error, file=sys.stderr, flush=True)
        return np.nan, np.nan, time.process_time() - began
    took = time.process_time() - began
    return cost_mm(plan, scenario.cost), 1e3 * plan.certificate.goal_bound_m, took


def costs(paths: list[Path], time_s: float, seeds: int, against: Path | None) -> None:
    """A row for each scenario, medians over the seeds; each plan in a process of its own, checkouts in alternation."""
    trees, rows = [ROOT] + ([against.resolve()] if against else []), list[tuple[str, ...]]()
    for path in paths:
        values = np.full((len(trees), seeds, 3), np.nan)
        for seed in range(seeds):
            for k in range(len(trees)) if seed % 2 else reversed(range(len(trees))):
                line = again("scenarios", "--once", str(path), str(seed), str(time_s))
                environment = os.environ | {"PYTHONPATH": str(trees[k])}
                done = subprocess.run(line, env=environment, stdout=subprocess.PIPE, text=True, check=True)
                values[k, seed] = [float(x) for x in done.stdout.split()]
        cells = [path.stem]
        for solved in values:
            there = np.isfinite(solved[:, 0])
            cost, bound = (np.median(solved[there, c]) if there.any() else np.nan for c in (0, 1))
            least = np.nanmin(solved[:, 0], initial=np.inf)
            cells += [f"{there.sum()} of {seeds}", f"{cost:.1f} mm", f"{least:.1f} mm", f"{bound:.2f} mm"]
            cells += [f"{np.median(solved[:, 2]):.1f} s"]
        rows.append(tuple(cells))
        print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    heads = [f"{name}{where}" for where in ("", ", there")[: len(trees)] for name in COST_COLUMNS]
    table("costs", ("scenario", *heads), rows)


COST_COLUMNS = ("planned", "cost, median", "least", "bound at the goal", "processor")


def ended_by_a_path(progress: Progress) -> None:
    """Raises StopIteration once a path is certified."""
    if progress.stage == "search" and progress.best_cost_mm is not None:
        raise StopIteration


def success(scenarios: dict[str, list[Scenario]], time_s: float, seeds: range, title: str) -> None:
    """A row for each name; searches end by their count alone, so that a busy machine has the same rows."""
    long_work.LEAST_REAL_S = np.inf
    rows = list[tuple[str, ...]]()
    for name, several in scenarios.items():
        took, planned = list[float](), 0
        for scenario, seed in itertools.product(several, seeds):
            told = None if scenario.via else ended_by_a_path  # a tour is planned to its end
            began = time.process_time()
            try:
                planned += ctrplan.plan(scenario, seed=seed, progress=told).certificate.valid
            except StopIteration:
                planned += 1
            except ctrplan.CtrplanError as error:
                print(name, seed, error, file=sys.stderr, flush=True)
            took.append(time.process_time() - began)
        rows.append((name, f"{planned} of {len(took)}", f"{np.median(took):.1f} s", f"{max(took):.1f} s"))
        print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    heads = ("scenario", f"planned in {time_s:g} s", "median time of a processor", "longest")
    table(title, heads, rows)


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
    if "--once" in sys.argv:
        path, seed, time_s = sys.argv[sys.argv.index("--once") + 1 :][:3]
        print(*plan_once(Path(path), int(seed), float(time_s)))
        return
    parser = common.parser(__doc__)
    parser.add_argument("section", choices=["plans", "choice", "costs", "success", "cage"])
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--time", type=float, default=1.0)
    parser.add_argument("--against", type=Path, help="another checkout")
    given = parser.parse_args()
    every = sorted(SCENARIOS.glob("*.toml"))
    paths = [path for path in every if not given.scenarios or path.stem in given.scenarios]
    seeds = range(given.seed, given.seed + given.seeds)
    if given.section == "plans":
        plans(paths, given.seed)
    elif given.section == "costs":
        costs(paths, given.time, given.seeds, given.against)
    elif given.section == "success":
        shipped = {path.stem: [ctrplan.load_scenario(path, [f"planner.time_s={given.time}"])] for path in paths}
        success(shipped, given.time, seeds, "success")
    elif given.section == "cage":
        cages = {f"gaps of {wide} deg": caged(wide, given.time) for wide in WIDE_DEG}
        success(cages, given.time, seeds, "cage")
    else:
        print_choice(paths)
