"""Does memory stay flat over a long life of one process?

    python benchmarks/long_runs.py [--plans 1000] [--bounds 100000]

Plans a tiny scenario again and again, each time from the file with another seed, and asks for bounds at random
configurations, one at a time and in batches. Resident memory after the first WARM_UP plans (a twentieth of the bounds)
is compared with that at the end. Exits with 1 where it grew by GROWTH or more.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import ctrplan
from ctrplan.scenario.joint_space import JointSpace

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
NEAR = "goal.joints={'rotate outer' = 6, 'rotate inner' = 10, 'translate inner' = -27}"  # of pair_free.toml
SEARCH_S = 0.1
WARM_UP = 50  # plans
BATCH = 100  # bounds
GROWTH = 0.05
LOOKS = 10  # at the memory, over a run


@dataclass(frozen=True)
class Growth:
    """Resident memory [MB] over a run, after the warm-up and then at even distances."""

    what: str
    memory_MB: tuple[float, ...]

    @property
    def share(self) -> float:
        """How much of it came after the warm-up."""
        return self.memory_MB[-1] / self.memory_MB[0] - 1


def resident_MB() -> float:
    """Memory of this process that is in use [MB], after what Python can collect is collected."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def growth(what: str, work: Callable[[int], object], count: int, warm_up: int) -> Growth:
    """Memory over `count` calls of work(k), k = 0, 1, .., the first `warm_up` left out."""
    looks = set(np.linspace(warm_up, count, LOOKS, dtype=int).tolist())
    memory = []
    for k in range(count):
        work(k)
        if k + 1 in looks:
            memory.append(resident_MB())
    return Growth(what, tuple(memory))


def plan_again(seed: int) -> None:
    """A plan of a scenario read from its file, its robot made anew; on a busy machine some find nothing in time."""
    with contextlib.suppress(ctrplan.NoAnswerError):
        ctrplan.plan(ctrplan.load_scenario(SCENARIOS / "pair_free.toml", [NEAR]), seed=seed, time_s=SEARCH_S)


def bounds_at_random(robot: ctrplan.Robot) -> Callable[[int], None]:
    """A function of the seed that asks for BATCH bounds in one call, and for the first of them once more."""
    space = JointSpace.of_robot(robot)

    def ask(seed: int) -> None:
        theta_b, l_b = robot.drive.collars(space.sample(np.random.default_rng(seed), BATCH))
        robot.bound_many(theta_b, l_b)
        robot.bound(theta_b[0], l_b[0])

    return ask


def main() -> int:
    """Prints a row per run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--bounds", type=int, default=100_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["CTRPLAN_CACHE_DIR"] = cache
        robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml")
        batches = arguments.bounds // BATCH
        found = [
            growth(f"{batches * BATCH:,} bounds, three tubes", bounds_at_random(robot), batches, max(batches // 20, 1)),
            growth(f"{arguments.plans:,} plans", plan_again, arguments.plans, min(WARM_UP, arguments.plans // 2)),
        ]
    print("| run | memory after the warm-up | at the end | growth | at even distances between, MB |")
    print("|---|---|---|---|---|")
    for run in found:
        first, last = run.memory_MB[0], run.memory_MB[-1]
        between = " ".join(f"{value:.1f}" for value in run.memory_MB[1:-1])
        print(f"| {run.what} | {first:.1f} MB | {last:.1f} MB | {100 * run.share:+.2f} % | {between} |")
    return int(any(run.share >= GROWTH for run in found))


if __name__ == "__main__":
    sys.exit(main())
