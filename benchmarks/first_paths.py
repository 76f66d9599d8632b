"""How soon is there a certified path? Every scenario with one target, CPU seconds of all threads and by the clock.

python benchmarks/first_paths.py [--seeds 1] [SCENARIO ...]

Counted until the first path is certified and its histories are simulated, from the call on, robot and anatomy loaded.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

from own_cache import use_own_cache

import ctrplan
from ctrplan.errors import CtrplanError
from ctrplan.planning.stage_search import Progress
from ctrplan.scenario import Scenario

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
    arguments = parser.parse_args()
    print("| scenario | seed | CPU time | by the clock | cost |\n|---|---|---|---|---|")
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = ctrplan.load_scenario(path)
        if scenario.via or (arguments.scenarios and path.stem not in arguments.scenarios):
            continue
        for seed in range(arguments.seeds):
            try:
                cpu_s, clock_s, cost_mm = first_path(scenario, seed)
                print(f"| {path.stem} | {seed} | {cpu_s:.1f} s | {clock_s:.1f} s | {cost_mm:.0f} mm |", flush=True)
            except CtrplanError as error:
                print(f"| {path.stem} | {seed} | {error} | | |", flush=True)


if __name__ == "__main__":
    main()
