"""What a diagnosis costs a processor: `python -m banks.times FOLDER --seed 1 --count 8`, in tests/oracles.

User time of the whole command `ctrplan diagnose`, report and robot file included, with one thread of linear algebra: of
36 poses of a pair (12 configurations, each from three sides) and of 240 poses of three tubes (48, each from five), with
nothing hidden, one effect, two, and one that no catalogue has, in turn.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import resource
from pathlib import Path

import numpy as np
from hidden_effects.bank import SEPARABLE, several_known
from hidden_effects.case import Case, write
from hidden_effects.effects import CONTINUOUS_ONLY, UNKNOWN
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.run import COMMAND, diagnose

KINDS = ("nothing", "one effect", "two effects", "an unknown effect")
SETS = {"36 poses of a pair": ("two tubes", 12, 3.0), "240 poses": ("three tubes", 48, 10.0)}  # s of a processor
SIZE = 3.0
RETRIES = 8


def hidden(kind: str, rng: np.random.Generator) -> tuple[tuple[str, float], ...]:
    """What is hidden in a set."""
    if kind == "nothing":
        return ()
    if kind == "two effects":
        return tuple(several_known(2, rng))
    names = list(UNKNOWN) if kind == "an unknown effect" else [n for n in SEPARABLE if n not in CONTINUOUS_ONLY]
    return ((str(rng.choice(names)), SIZE),)


def made(folder: Path, row: str, k: int, seed: int) -> Path:
    """The folder of a set; drawn again where a pose has no equilibrium."""
    robot, count, _ = SETS[row]
    name = f"{row.replace(' ', '_')}_{k:02d}"
    for attempt in range(RETRIES):
        rng = np.random.default_rng([seed, k, attempt, count])
        case = Case(name, row, int(rng.integers(2**31)), hidden(KINDS[k % len(KINDS)], rng), count=count, robot=robot)
        if (folder / name / "truth.json").exists():
            return folder / name
        try:
            write(case, folder)
            return folder / name
        except (NoEquilibrium, np.linalg.LinAlgError):
            continue
    raise NoEquilibrium(f"{name}: no robot has an equilibrium in every pose")


def user_s(folder: Path) -> float:
    """Seconds of a processor that a diagnosis takes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    diagnose(folder, folder / "diagnosis", "", COMMAND)
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=8, help="sets of a row")
    parser.add_argument("--row", nargs="*", default=list(SETS), choices=list(SETS))
    given = parser.parse_args()
    print("| user time of a processor | goal | median | least to most | sets |\n|---|---|---|---|---|")
    for row in given.row:
        seconds = []
        for k in range(given.count):
            folder = made(given.folder, row, k, given.seed)
            seconds.append(user_s(folder))
            said = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
            print(f"{folder.name}, {KINDS[k % len(KINDS)]}: {said['verdict']}, {seconds[-1]:.1f} s", flush=True)
        low, middle, high = np.quantile(seconds, [0, 0.5, 1])
        print(
            f"| {row} | {SETS[row][2]:.0f} s | {middle:.1f} s | {low:.1f} to {high:.1f} s | {len(seconds)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
