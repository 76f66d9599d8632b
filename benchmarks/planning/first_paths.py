"""How soon is there a certified path? Every query of `planning`, CPU seconds of all threads and by the clock.

    python benchmarks/run.py first_paths [SCENARIO ...] [--seeds 1]
    python benchmarks/run.py first_paths [SCENARIO ...] --against CHECKOUT [--rounds 2]

Counted from the call on, robot and anatomy loaded, until the first path is certified; at the end the median and 95th
percentile of all. Nothing is planned beyond the first path. With --against in alternation with another checkout, whose
compiled core is in its ctrplan/; only public functions of ctrplan are used here, so that it has them.

A query is a scenario with the tip of a configuration in a random tree of valid motions as its target. Trees began at
the start and grew by L-shaped motions of 40 mm at most; of their tips those deepest in the anatomy were kept, spread
out, beside the scenario's own target.
"""

import itertools
import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import ROOT, SCENARIOS, elsewhere, table

import ctrplan
from ctrplan import load_scenario

FILE = Path(__file__).with_name("planning_queries.json")  # targets [mm] by scenario
TOLERANCE_MM = 1.0


@dataclass(frozen=True)
class Query:
    """A scenario with another target."""

    scenario: str
    tip_mm: tuple[float, float, float]

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.scenario} {', '.join(f'{x:.1f}' for x in self.tip_mm)}"

    def load(self, overrides: list[str]) -> Any:
        """The scenario that asks for it."""
        goal = f"goal={{tip_mm={list(self.tip_mm)}, tolerance_mm={TOLERANCE_MM}}}"
        return load_scenario(SCENARIOS / f"{self.scenario}.toml", [goal, *overrides])


def queries() -> list[Query]:
    """All queries, as kept in the file."""
    targets = json.loads(FILE.read_text(encoding="utf-8"))
    return [Query(name, (x, y, z)) for name, tips in targets.items() for x, y, z in tips]


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


def timed(chosen: list[int], seeds: int) -> Iterator[tuple[object, ...]]:
    """A row for each of these queries and each seed, then the median and 95th percentile."""
    taken = list[list[float]]()
    for query, seed in itertools.product((queries()[k] for k in chosen), range(seeds)):
        try:
            *times, cost_mm = first_path(query.load([]), seed)
        except ctrplan.CtrplanError as error:
            yield query.name, seed, str(error), "", ""
            continue
        taken.append(times)
        yield query.name, seed, *(f"{x:.1f} s" for x in times), f"{cost_mm:.0f} mm"
    for share, label in ((50, "median"), (95, "95 %")) if taken else ():
        yield f"{label} of {len(taken)}", "", *(f"{x:.2f} s" for x in np.percentile(taken, share, axis=0)), ""


def compared(chosen: list[int], other: Path, rounds: int) -> Iterator[tuple[str, ...]]:
    """A row for each of these queries and the medians, least of the rounds."""
    taken = np.empty((rounds, len(chosen), 2, 2))
    for at, k in enumerate(chosen):
        for turn in range(rounds):
            for side in (0, 1) if (k + turn) % 2 else (1, 0):
                taken[turn, at, side] = elsewhere((other, ROOT)[side], "first_paths", "--query", str(k))
        there, here = taken[:, at, :, 0].min(axis=0)
        yield queries()[k].name, f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"
    seconds = taken.min(axis=0)
    for share, of in ((50, "median"), (95, "95 %")):
        there, here = np.percentile(seconds[:, :, 0], share, axis=0)
        yield f"{of} of {len(chosen)}", f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"
    clock, cpu = seconds[:, 1].sum(axis=0) / seconds[:, 0].sum(axis=0)
    yield "sum", "", "", f"{clock:.2f}, of CPU time {cpu:.2f}"


def main() -> None:
    scenarios = list(dict.fromkeys(query.scenario for query in queries()))
    given = common.arguments(__doc__, ("scenarios*", scenarios), seeds=1, against=Path, rounds=2, query=-1)
    chosen = [k for k, query in enumerate(queries()) if query.scenario in (given.scenarios or scenarios)]
    if given.query >= 0:
        cpu_s, clock_s, _ = first_path(queries()[given.query].load([]), 0)
        print(clock_s, cpu_s)
    elif given.against:
        rows = compared(chosen, given.against.resolve(), given.rounds)
        table("first paths beside another checkout", "query | there | here | ratio", rows)
    else:
        table("first certified paths", "query | seed | CPU time | by the clock | cost", timed(chosen, given.seeds))
