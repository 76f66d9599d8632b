"""How soon is there a certified path? Every scenario with one target, CPU seconds of all threads and by the clock.

python benchmarks/first_paths.py [--seeds 1] [--queries] [SCENARIO ...]

With --queries, of every query of `planning.py`. Counted from the call on, robot and anatomy loaded, until the first
path is certified; at the end the median and 95th percentile of all.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from own_cache import use_own_cache
from planning_queries import queries

import ctrplan
from ctrplan.errors import CtrplanError
from ctrplan.planning.scenario import Scenario
from ctrplan.planning.search.stage_search import Progress

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"


def first_path(scenario: Scenario, seed: int) -> tuple[float, float, float]:
    """CPU seconds, seconds by the clock until certified, cost [mm]; the search is interrupted after its first path."""
    interrupted, cpu, costs = threading.Event(), list[float](), list[float]()
    began = time.process_time()

    def progress(told: Progress) -> None:
        if told.stage == "search" and told.best_cost_mm is not None and not interrupted.is_set():
            cpu.append(time.process_time() - began)
            costs.append(told.best_cost_mm)
            interrupted.set()

    plan = ctrplan.plan(scenario, seed=seed, progress=progress, interrupted=interrupted)
    return cpu[0], plan.first_certified_s, costs[0]


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", help="names of scenarios; default: all")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--queries", action="store_true", help="of planning.py")
    arguments = parser.parse_args()
    print("| query | seed | CPU time | by the clock | cost |\n|---|---|---|---|---|")
    taken: list[tuple[float, float]] = []
    for name, scenario in asked(arguments.queries):
        if arguments.scenarios and name.split()[0] not in arguments.scenarios:
            continue
        for seed in range(arguments.seeds):
            try:
                *times, cost_mm = first_path(scenario, seed)
                taken.append((times[0], times[1]))
                print(f"| {name} | {seed} | {times[0]:.1f} s | {times[1]:.1f} s | {cost_mm:.0f} mm |", flush=True)
            except CtrplanError as error:
                print(f"| {name} | {seed} | {error} | | |", flush=True)
    for share, label in ((50, "median"), (95, "95 %")):
        cpu_s, clock_s = np.percentile(np.array(taken), share, axis=0)
        print(f"| {label} of {len(taken)} | | {cpu_s:.2f} s | {clock_s:.2f} s | |")


def asked(of_queries: bool) -> Iterator[tuple[str, Scenario]]:
    """Names and scenarios."""
    if of_queries:
        for query in queries():
            yield query.name, query.load([])
        return
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = ctrplan.load_scenario(path)
        if not scenario.via:
            yield path.stem, scenario


if __name__ == "__main__":
    main()
