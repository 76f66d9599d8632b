"""How fast studies are: tasks a second against a plain loop on one core, what a task costs beside its work.

    python benchmarks/run.py study_speed                      # all of it: some 12 minutes on two idle cores
    python benchmarks/run.py study_speed --bounds 1000 --plans 6 --rounds 1  # a minute
    python benchmarks/run.py study_speed --bounds 8000 --plans 0             # bounds alone

What it prints: tasks a second of a plain loop and of a study on two workers, in alternation, medians of all rounds.

Times of the clock mean something on an idle machine only. Where others work on it, look at the ratio of processor
times: that of the loop to that of workers, client and scheduler together, times the number of workers.
"""

import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np
import psutil  # of dask, which studies need
from common import ROBOTS, SCENARIOS, again, processors

import ctrplan
from ctrplan import Study
from ctrplan.base.long_work import one_core
from ctrplan.studies.study.study import Doing

ROBOT = str(ROBOTS / "three_tube.toml")
SCENARIO = str(SCENARIOS / "pair_free.toml")
WORKERS = 2


def bounds_study(count: int) -> dict[str, Any]:
    """Bounds of one robot at different rotations."""
    side = max(2, round(count**0.5))
    turns = [{"key": f"theta_{k}", "low": 0, "high": 350, "count": side} for k in (2, 3)]
    return {"robot": ROBOT, "task": {"kind": "bound", "theta_deg": [0, 0, 0], "l_mm": [0, -17, -62.8]}, "vary": turns}


def plans_study(count: int) -> dict[str, Any]:
    """Plans of a pair in free space, a second or so each."""
    seeds = [{"key": "seed", "values": list(range(count))}, {"key": "planner.time_s", "values": [0.5]}]
    return {"scenario": SCENARIO, "task": {"kind": "plan"}, "vary": seeds}


def loop_of_bounds() -> Callable[[dict[str, Any]], object]:
    """Bounds as of a batch, one call each."""
    robot = ctrplan.load_robot(ROBOT)

    def bound(settings: dict[str, Any]) -> object:
        theta = np.radians([0, settings["theta_2"], settings["theta_3"]])
        return robot.bound_many(theta[None], np.array([[0, -17e-3, -62.8e-3]]))

    return bound


def loop_of_plans() -> Callable[[dict[str, Any]], object]:
    scenario = ctrplan.load_scenario(SCENARIO, ["planner.time_s=0.5"])
    return lambda settings: ctrplan.plan(scenario, seed=settings["seed"])


class Run:
    """A study on workers of this machine: from when they are there to the last row."""

    def __init__(self, content: dict[str, Any], folder: Path) -> None:
        self.told: list[tuple[int, float, float, float]] = []
        self.workers: list[psutil.Process] = []
        study = Study.of(content, folder)
        self.table = study.run(folder / f"out-{len(list(folder.iterdir()))}", progress=self.tell, workers=WORKERS)
        done, clock_s, client_s, workers_s = np.subtract(self.told[-1], self.told[0])
        self.clock_s = clock_s / max(done, 1)  # of a task, as the following ones
        self.client_s, self.workers_s = client_s / max(done, 1), workers_s / max(done, 1)  # of a processor

    def tell(self, doing: Doing) -> None:
        if doing.stage == "tasks":
            self.workers = self.workers or psutil.Process().children(recursive=True)  # once: it counts as the client's
            used = time.process_time(), sum(map(processor_s, self.workers))
            self.told.append((doing.done, time.monotonic(), *used))


def processor_s(process: psutil.Process) -> float:
    """Processor time [s] of a process so far."""
    try:
        return sum(process.cpu_times()[:2])
    except psutil.NoSuchProcess:  # it has ended
        return 0.0


LOOPS = {"bounds": (bounds_study, loop_of_bounds), "plans": (plans_study, loop_of_plans)}


def serve_loop(name: str, count: int) -> None:
    """The plain loop, in a process of its own: prints its seconds a task, by the clock and of the processor."""
    content, loop = LOOPS[name]
    study = Study.of(content(count), Path())
    work, rows = loop(), [study.tasks[k].settings for k in range(study.count)]
    with one_core():
        work(rows[0])
        begun = time.monotonic(), time.process_time()
        for settings in rows:
            work(settings)
        print((time.monotonic() - begun[0]) / len(rows), (time.process_time() - begun[1]) / len(rows))


def compare(name: str, count: int, folder: Path, rounds: int) -> None:
    """A loop and a study in alternation; prints medians of all rounds."""
    times = []
    for _ in range(rounds):
        alone = again("study_speed", "--serve-loop", name, str(count))
        loop = subprocess.run(alone, stdout=subprocess.PIPE, check=True)
        found = Run(LOOPS[name][0](count), folder)
        times.append((*map(float, loop.stdout.split()), found.clock_s, found.workers_s + found.client_s))
    clock, processor, study, of_study = np.array(times).T
    by_clock, by_time = clock / study, np.median(WORKERS * processor / of_study)
    rate = f"plain loop {1 / np.median(clock):.1f} a second of the clock"
    print(f"{name}: {len(found.table)} tasks, medians of {rounds}; {rate}")
    shown = f"{np.median(by_clock):.2f} times the loop by the clock ({by_clock.min():.2f} to {by_clock.max():.2f})"
    print(f"  a study on two workers: {shown}, {by_time:.2f} by processor time")


def main() -> None:
    given = common.arguments(__doc__, bounds=8000, plans=48, rounds=3, serve_loop=[""])
    if any(given.serve_loop):
        return serve_loop(given.serve_loop[0], int(given.serve_loop[1]))
    print(f"{processors()}, {WORKERS} workers")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if given.bounds:
            compare("bounds", given.bounds, folder, given.rounds)
        if given.plans:
            compare("plans", given.plans, folder, given.rounds)
