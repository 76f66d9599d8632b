"""What a built term is worth: effects that no catalogue has, alone and beside a known one, and nulls with memory.

    python benchmarks/built_terms.py make FOLDER     # worlds of the tests' own generator, 15 to 40 s each
    python benchmarks/built_terms.py ask FOLDER      # about 20 s each
    python benchmarks/built_terms.py table FOLDER

Every world is solved once and measured in 32 configurations, five approaches each. A set adds noise to it, and to
nulls smooth random errors of several memories. Asked is what holds beside a rest and what can be built of the rest,
without the ordinary search before it. The gap is what the poses kept aside show, their noise taken out. Resumable.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

import argparse
import json
import pickle
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))

from hidden_effects.case import Case, make
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.leftovers import Leftover, add_leftover
from hidden_effects.noise import add_noise
from hidden_effects.world import believed

CONFIGURATIONS, RETRIES = 32, 8
Hidden = tuple[tuple[str, float], ...]

UNKNOWN = (
    "third_harmonic",
    "cross_talk",
    "guide_bend",
    "overlap_stiffness",
    "metal_nearby",
    "heading_shift",
    "warm_offset",
    "screw_coupling",
)
KNOWN = ("sensor_offset", "joint_scale", "homing_translation", "tip_load", "base_misalignment", "backlash")
SIZE, KNOWN_SIZE = 4.0, 3.0
NULL = "null"


def worlds() -> list[tuple[str, Hidden]]:
    """Row of the table and what is hidden, in the order in which they are made."""
    found: list[tuple[str, Hidden]] = []
    for k in range(3):
        found += [(NULL, ())]
        found += [("unknown alone", ((name, SIZE),)) for name in UNKNOWN]
        beside = (KNOWN[(i + k) % len(KNOWN)] for i in range(len(UNKNOWN)))
        found += [
            ("unknown and known", ((name, SIZE), (other, KNOWN_SIZE)))
            for name, other in zip(UNKNOWN, beside, strict=True)
        ]
    return found


def leftovers(row: str) -> list[Leftover]:
    """Sizes [mm] and memories, rad of joints or s, of the sets of a world."""
    if row != NULL:
        return [Leftover(0.3, "configuration", 0.7)]
    kinds = (("configuration", 0.3), ("configuration", 0.7), ("configuration", 1.5), ("time", 20.0), ("time", 100.0))
    return [Leftover(size, kind, memory) for _ in range(3) for size in (1.0, 2.0, 3.0) for kind, memory in kinds]


def solve(folder: Path) -> None:
    """Worlds and their sets, FOLDER/w00.pickle and FOLDER/w00_00."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, (row, hidden) in enumerate(worlds()):
        stored = folder / f"w{k:02d}.pickle"
        if not stored.exists():
            for attempt in range(RETRIES):
                try:
                    case = Case(stored.stem, row, 50000 + 17 * k + 1000 * attempt, hidden, "gaussian", CONFIGURATIONS)
                    made = make(case)
                except (NoEquilibrium, np.linalg.LinAlgError):
                    continue
                stored.write_bytes(pickle.dumps((case, made.experiment, made.poses, made.world.room)))
                print(stored.stem, row, hidden, flush=True)
                break
        if stored.exists():
            write(folder, stored)


def write(folder: Path, stored: Path) -> None:
    """The sets of a world."""
    case, plan, poses, room = pickle.loads(stored.read_bytes())
    for v, left in enumerate(leftovers(case.row)):
        target, rng = folder / f"{stored.stem}_{v:02d}", np.random.default_rng([case.seed, 5, v])
        target.mkdir(exist_ok=True)
        p, tangent = add_leftover(poses.p, poses.tangent, plan, left, rng)
        p, tangent = add_noise(p, tangent, "gaussian", rng)
        (target / "robot.toml").write_text(robot_toml(believed(), "three tubes"))
        (target / "measurements.csv").write_text(measurements_csv(plan, p, tangent, room))
        truth = {"row": case.row, "hidden": case.hidden, "size_mm": left.size_mm}
        (target / "truth.json").write_text(json.dumps({**truth, "kind": left.kind, "memory": left.memory}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["make", "ask", "table"])
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    {"make": solve}[given.action](given.folder)


if __name__ == "__main__":
    main()
