"""How soon is there a certified path? Every scenario with one target, CPU seconds of all threads and by the clock.

python benchmarks/run.py first_paths [--seeds 1] [--queries] [SCENARIO ...]
python benchmarks/run.py first_paths --against ROOT [--rounds 2]

With --queries, of every query of `planning.py`. Counted from the call on, robot and anatomy loaded, until the first
path is certified; at the end the median and 95th percentile of all. With --against, all queries in alternation with
another checkout, whose compiled core is in its ctrplan/: nothing is planned beyond the first path.
"""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import ROOT, SCENARIOS, elsewhere, table
from planning_queries import queries

import ctrplan


def first_path(scenario: ctrplan.Scenario, seed: int) -> tuple[float, float, float]:
    """CPU seconds, seconds by the clock until certified, cost [mm]; the search is interrupted after its first path."""
    interrupted, cpu, costs = threading.Event(), list[float](), list[float]()
    began = time.process_time()

    def progress(told: Any) -> None:
        if told.stage == "search" and told.best_cost_mm is not None and not interrupted.is_set():
            cpu.append(time.process_time() - began)
            costs.append(told.best_cost_mm)
            interrupted.set()

    plan = ctrplan.plan(scenario, seed=seed, progress=progress, interrupted=interrupted)
    return cpu[0], plan.first_certified_s, costs[0]


def asked(of_queries: bool) -> Iterator[tuple[str, ctrplan.Scenario]]:
    """Names and scenarios."""
    if of_queries:
        for query in queries():
            yield query.name, query.load([])
        return
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = ctrplan.load_scenario(path)
        if not scenario.via:
            yield path.stem, scenario


def timed(given: Any) -> Iterator[tuple[object, ...]]:
    """A row for each query and seed, then the median and 95th percentile."""
    taken = list[list[float]]()
    for name, scenario in asked(given.queries):
        if given.scenarios and name.split()[0] not in given.scenarios:
            continue
        for seed in range(given.seeds):
            try:
                *times, cost_mm = first_path(scenario, seed)
            except ctrplan.CtrplanError as error:
                yield name, seed, str(error), "", ""
                continue
            taken.append(times)
            yield name, seed, *(f"{x:.1f} s" for x in times), f"{cost_mm:.0f} mm"
    for share, label in ((50, "median"), (95, "95 %")):
        yield f"{label} of {len(taken)}", "", *(f"{x:.2f} s" for x in np.percentile(taken, share, axis=0)), ""


def compared(other: Path, rounds: int) -> Iterator[tuple[str, ...]]:
    """A row for each query and the medians, least of the rounds."""
    names = [query.name for query in queries()]
    taken = np.empty((rounds, len(names), 2, 2))
    for k, name in enumerate(names):
        for turn in range(rounds):
            for side in (0, 1) if (k + turn) % 2 else (1, 0):
                taken[turn, k, side] = elsewhere((other, ROOT)[side], "first_paths", "--ask", str(k))
        there, here = taken[:, k, :, 0].min(axis=0)
        yield name, f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"
    seconds = taken.min(axis=0)
    for share, of in ((50, "median"), (95, "95 %")):
        there, here = np.percentile(seconds[:, :, 0], share, axis=0)
        yield f"{of} of {len(names)}", f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"
    clock, cpu = seconds[:, 1].sum(axis=0) / seconds[:, 0].sum(axis=0)
    yield "sum", "", "", f"{clock:.2f}, of CPU time {cpu:.2f}"


def main() -> None:
    given = common.arguments(__doc__, "scenarios*", seeds=1, queries=False, against=Path, rounds=2, ask=-1)
    if given.ask >= 0:
        cpu_s, clock_s, _ = first_path(queries()[given.ask].load([]), 0)
        print(clock_s, cpu_s)
    elif given.against:
        rows = compared(given.against.resolve(), given.rounds)
        table("first paths beside another checkout", "query | there | here | ratio", rows)
    else:
        table("first certified paths", "query | seed | CPU time | by the clock | cost", timed(given))
