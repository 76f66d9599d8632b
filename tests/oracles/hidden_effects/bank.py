"""The bank: which cases there are, drawn from a seed. Folders: `python -m hidden_effects.bank make DIR` (resumable)."""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

import numpy as np

from hidden_effects.case import Case, write
from hidden_effects.effects import CATALOGUE, CONTINUOUS_ONLY, UNKNOWN
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.leftovers import Leftover

LOOK_ALIKES = ("off_plane_precurvature", "homing_rotation")
SEPARABLE = tuple(name for name in CATALOGUE if name not in LOOK_ALIKES)
ALSO_CONTINUOUS = ("drift", "sensor_distortion", "base_misalignment", "sensor_offset", "tip_load", "homing_translation")
SIZES = (0.5, 1.0, 2.0, 4.0)  # multiples of the noise left after recalibration, about; truth.json has what it came to
CORRELATED = "null, correlated"
REST_MM = (1.0, 2.0, 3.0)
MEMORIES = (("configuration", 0.3), ("configuration", 0.7), ("configuration", 1.5), ("time", 20.0), ("time", 100.0))
MEMORIES_OF_STREAMS = (("configuration", 0.7), ("time", 2.0), ("time", 8.0))  # of 16 s
RETRIES = 8


def cases(seed: int, repeats: int = 1) -> list[Case]:
    """All cases of a bank, mixed; `repeats` = 1 gives more than 200, the first dozens of which are a small bank.

    Nulls with correlated errors come last, so that the others are what they were before there were these.
    """
    rng = np.random.default_rng([seed, 77])
    found = [case for _ in range(repeats) for case in _one_of_each(rng)]
    mixed = [found[i] for i in rng.permutation(len(found)).tolist()]
    mixed += [case for _ in range(repeats) for case in _correlated(np.random.default_rng([seed, 78]))]
    return [_renamed(case, k, seed) for k, case in enumerate(mixed)]


def _one_of_each(rng: np.random.Generator) -> list[Case]:
    found = [_case("null", (), rng) for _ in range(24)]
    found += [_case("null", (), rng, continuous=True) for _ in range(8)]
    found += [_case("null, heavy tails", (), rng, noise="heavy") for _ in range(8)]
    found += [_case("null, misstated noise", (), rng, noise=k) for k in ("understated", "overstated") for _ in range(4)]
    for name in SEPARABLE:
        found += [_case("single", ((name, size),), rng, continuous=name in CONTINUOUS_ONLY) for size in SIZES]
    found += [_case("single", ((name, 3.0),), rng, continuous=True) for name in ALSO_CONTINUOUS]
    found += [_case("single, heavy tails", ((name, 3.0),), rng, noise="heavy") for name in SEPARABLE if name != "lag"]
    found += [_case("look-alike", ((name, size),), rng) for name in LOOK_ALIKES for size in (1.0, 2.0, 4.0, 4.0)]
    found += [_case("pair", several_known(2, rng), rng) for _ in range(20)]
    found += [_case("not in the catalogue", ((name, size),), rng) for name in UNKNOWN for size in (1.0, 2.0, 4.0)]
    found += [
        _case("taken out of the catalogue", ((name, 3.0),), rng, left_out=name)
        for name in SEPARABLE
        if name not in CONTINUOUS_ONLY | {"homing_translation"}
    ]
    found += [_case("known and unknown", (_known(rng), (_any(tuple(UNKNOWN), rng), 3.0)), rng) for _ in range(8)]
    return found


def _correlated(rng: np.random.Generator) -> list[Case]:
    at_rest = [(Leftover(size, *memory), False) for memory in MEMORIES for size in REST_MM]
    streams = [(Leftover(REST_MM[1], *memory), True) for memory in MEMORIES_OF_STREAMS]
    drawn = [(_case(CORRELATED, (), rng, continuous=is_stream), left) for left, is_stream in at_rest + streams]
    return [replace(case, left=left) for case, left in drawn]


def _case(
    row: str,
    hidden: tuple[tuple[str, float], ...],
    rng: np.random.Generator,
    *,
    noise: str = "gaussian",
    continuous: bool = False,
    left_out: str = "",
) -> Case:
    count = 160 if continuous else int(rng.integers(12, 19))
    seed = int(rng.integers(2**31))
    return Case("", row, seed, hidden, noise, count, continuous, left_out)


def _renamed(case: Case, k: int, seed: int) -> Case:
    return replace(case, name=f"b{seed}_{k:03d}")


def _any(names: tuple[str, ...], rng: np.random.Generator) -> str:
    return names[int(rng.integers(len(names)))]


def _known(rng: np.random.Generator) -> tuple[str, float]:
    return _any(tuple(n for n in SEPARABLE if n not in CONTINUOUS_ONLY), rng), 3.0


def several_known(count: int, rng: np.random.Generator) -> tuple[tuple[str, float], ...]:
    """Different effects at rest that do not replace one another, of size 3."""
    while True:
        drawn = tuple(_known(rng) for _ in range(count))
        names = {name for name, _ in drawn}
        if len(names) == count and not names >= {"friction", "translation_release"}:
            return drawn


def make(folder: Path, todo: list[Case], jobs: int = 1) -> None:
    """Writes what is not there yet, `jobs` cases at a time."""
    missing = [case for case in todo if not (folder / case.name / "truth.json").exists()]
    if jobs == 1:
        for case in missing:
            make_one(folder, case)
    else:
        with ProcessPoolExecutor(jobs) as pool:
            list(pool.map(partial(make_one, folder), missing))


def make_one(folder: Path, case: Case) -> None:
    """Writes a case. A robot that has no equilibrium in some pose is drawn again."""
    began = time.process_time()
    for attempt in range(RETRIES):
        try:
            write(replace(case, seed=case.seed + attempt), folder)
            break
        except (NoEquilibrium, np.linalg.LinAlgError) as refusal:
            print(f"{case.name}: drawn again, {refusal}", flush=True)
    print(f"{case.name}  {time.process_time() - began:5.1f} s of a processor  {case.row}: {case.hidden}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=["make", "list"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--row", nargs="*", default=[], help="only those of these lines of the table of goals")
    parser.add_argument("--first", type=int, help="only so many")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    given = parser.parse_args()
    drawn = cases(given.seed, given.repeats)
    todo = [case for case in drawn if not given.row or case.row in given.row][: given.first]
    if given.action == "list":
        for case in todo:
            print(case)
    else:
        make(given.folder, todo, given.jobs)


if __name__ == "__main__":
    main()
