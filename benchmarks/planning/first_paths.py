"""How soon is there a certified path? Every scenario with one target, CPU seconds of all threads and by the clock.

python benchmarks/run.py first_paths [--seeds 1] [--queries] [SCENARIO ...]
python benchmarks/run.py first_paths --against ROOT [--rounds 2]

With --queries, of every query of `planning.py`. Counted from the call on, robot and anatomy loaded, until the first
path is certified; at the end the median and 95th percentile of all. With --against, all queries in alternation with
another checkout, whose compiled core is in its ctrplan/: nothing is planned beyond the first path.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import ROOT, SCENARIOS, again, table
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


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("scenarios", nargs="*", help="names of scenarios; default: all")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--queries", action="store_true", help="of planning.py")
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--rounds", type=int, default=2, help="of every query in each checkout")
    parser.add_argument("--ask", action="store_true", help=argparse.SUPPRESS)  # numbers of queries on standard input
    arguments = parser.parse_args()
    if arguments.ask:
        answer()
        return
    if arguments.against:
        compare(arguments.against.resolve(), arguments.rounds)
        return
    rows, taken = list[tuple[object, ...]](), list[tuple[float, float]]()
    for name, scenario in asked(arguments.queries):
        if arguments.scenarios and name.split()[0] not in arguments.scenarios:
            continue
        for seed in range(arguments.seeds):
            try:
                *times, cost_mm = first_path(scenario, seed)
                taken.append((times[0], times[1]))
                rows.append((name, seed, *(f"{x:.1f} s" for x in times), f"{cost_mm:.0f} mm"))
            except ctrplan.CtrplanError as error:
                rows.append((name, seed, str(error), "", ""))
            print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    for share, label in ((50, "median"), (95, "95 %")):
        rows.append((f"{label} of {len(taken)}", "", *(f"{x:.2f} s" for x in np.percentile(taken, share, axis=0)), ""))
    table("first certified paths", ("query", "seed", "CPU time", "by the clock", "cost"), rows)


class _Found(Exception):
    """Ends a search."""


def answer() -> None:
    """Seconds by the clock and CPU seconds to the first path of each query whose number is read."""
    for line in sys.stdin:
        scenario = queries()[int(line)].load([])
        taken, began, cpu = list[tuple[float, float]](), time.perf_counter(), time.process_time()

        def progress(told: Any, taken=taken, began=began, cpu=cpu) -> None:  # type: ignore[no-untyped-def]
            if told.stage == "search" and told.best_cost_mm is not None:
                taken.append((time.perf_counter() - began, time.process_time() - cpu))
                raise _Found

        with suppress(_Found):
            ctrplan.plan(scenario, progress=progress)
        print(*taken[0], flush=True)


def compare(other: Path, rounds: int) -> None:
    """A row for each query and the medians, least of the rounds."""
    command = again("first_paths", "--ask")
    askers = [
        subprocess.Popen(
            command,
            env=os.environ | {"PYTHONPATH": str(checkout)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for checkout in (other, ROOT)
    ]
    names = [query.name for query in queries()]
    taken = np.empty((rounds, len(names), 2, 2))
    rows = list[tuple[str, ...]]()
    for k, name in enumerate(names):
        for turn in range(rounds):
            for side in (0, 1) if (k + turn) % 2 else (1, 0):
                stdin, stdout = askers[side].stdin, askers[side].stdout
                assert stdin and stdout
                stdin.write(f"{k}\n")
                stdin.flush()
                taken[turn, k, side] = [float(x) for x in stdout.readline().split()]
        there, here = taken[:, k, :, 0].min(axis=0)
        rows.append((name, f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"))
        print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    for label, seconds in (("least", taken.min(axis=0)), ("median", np.median(taken, axis=0))):
        for share, of in ((50, "median"), (95, "95 %")):
            there, here = np.percentile(seconds[:, :, 0], share, axis=0)
            label_of = f"{of} of {len(names)}, {label} of rounds"
            rows.append((label_of, f"{there:.2f} s", f"{here:.2f} s", f"{here / there:.2f}"))
        clock, cpu = seconds[:, 1].sum(axis=0) / seconds[:, 0].sum(axis=0)
        rows.append((f"sum, {label} of rounds", "", "", f"{clock:.2f}, of CPU time {cpu:.2f}"))
    for asker in askers:
        asker.communicate()
    table("first paths beside another checkout", ("query", "there", "here", "ratio"), rows)


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
