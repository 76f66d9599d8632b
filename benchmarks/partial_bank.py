"""What a partial verdict is worth beside errors that nothing explains: false alarms, wrong parts, known parts listed.

    python benchmarks/partial_bank.py make FOLDER     # worlds of the tests' own generator, 40 s each
    python benchmarks/partial_bank.py ask FOLDER      # about 10 s for poses at rest, some minutes for a motion
    python benchmarks/partial_bank.py table FOLDER

Every world is solved once and gets several smooth random errors besides, fixed to the configuration or to the time, of
several memories. Asked is what holds beside a rest, and beside terms built of it, without the ordinary search before.
Resumable.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

import argparse
import json
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))

from hidden_effects.case import Case, make, true_names
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.leftovers import Leftover, add_leftover
from hidden_effects.noise import add_noise
from hidden_effects.score import wilson
from hidden_effects.world import believed

from ctrplan.diagnosis.adequacy import noise_floor
from ctrplan.diagnosis.built_term import build
from ctrplan.diagnosis.partial_diagnosis import diagnose_partially
from ctrplan.diagnosis.usable_poses import usable_poses
from ctrplan.diagnosis.workbench import candidates
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot

CONFIGURATIONS, ROWS, RETRIES = 14, 500, 8
Hidden = tuple[tuple[str, float], ...]


def world(row: str, *hidden: tuple[str, float], continuous: bool = False) -> tuple[str, Hidden, bool]:
    return row, hidden, continuous


BOTH = "known and unknown"
WORLDS = (
    world("null"),
    world(BOTH, ("friction", 4.0), ("kink", 3.0)),
    world(BOTH, ("sensor_offset", 3.0), ("third_harmonic", 3.0)),
    world(BOTH, ("joint_scale", 3.0), ("kink", 3.0)),
    world(BOTH, ("lag", 2.0), ("friction", 4.0), continuous=True),
    world("null"),
    world(BOTH, ("backlash", 3.0), ("screw_coupling", 3.0)),
    world(BOTH, ("tip_load", 3.0), ("third_harmonic", 3.0)),
    world("known", ("friction", 5.0)),
    world("known", ("sensor_offset", 3.0)),
    world("null", continuous=True),
    world(BOTH, ("friction", 5.0), ("plate_friction", 3.0)),
    world(BOTH, ("eccentricity", 3.0), ("kink", 3.0)),
    world("known", ("backlash", 4.0)),
    world(BOTH, ("base_misalignment", 4.0), ("collar_slip", 3.0)),
    world("known", ("tip_load", 4.0)),
    world(BOTH, ("homing_translation", 3.0), ("third_harmonic", 3.0)),
    world(BOTH, ("lag", 3.0), ("kink", 3.0), continuous=True),
    world("null"),
    world("known", ("joint_scale", 4.0)),
    world("unknown", ("kink", 4.0)),
    world("unknown", ("third_harmonic", 4.0)),
    world(BOTH, ("shaft_torsion", 3.0), ("tracker_jump", 3.0)),
    world("unknown", ("screw_coupling", 4.0)),
    world(BOTH, ("backlash", 4.0), ("warming", 3.0)),
    world("null", continuous=True),
    world("unknown", ("plate_friction", 4.0)),
    world("known", ("eccentricity", 4.0)),
    world(BOTH, ("sensor_offset", 3.0), ("kink", 3.0)),
    world(BOTH, ("friction", 4.0), ("tracker_jump", 3.0)),
    world("known", ("homing_translation", 4.0)),
    world("known", ("base_misalignment", 4.0)),
    world("unknown", ("collar_slip", 4.0)),
    world("unknown", ("tracker_jump", 4.0)),
    world("null"),
    world(BOTH, ("shaft_torsion", 3.0), ("kink", 3.0)),
    world(BOTH, ("gravity", 4.0), ("screw_coupling", 3.0)),
    world(BOTH, ("joint_scale", 3.0), ("warming", 3.0)),
)


def leftovers(case: Case) -> list[Leftover]:
    """Of several sizes and memories: rad of joints, or s."""
    if case.row == "null":
        slow = [Leftover(1.5, "time", s) for s in ((2.0, 6.0, 0.7) if case.continuous else (100.0,))]
        return [Leftover(1.5, "configuration", 0.5), Leftover(1.5, "configuration", 1.5), *slow, Leftover(3.0)]
    if case.row == "known":
        return [Leftover(1.2, "configuration", 0.7), Leftover(1.2, "configuration", 1.5)]
    return [Leftover(), Leftover(1.0)]


def solve(folder: Path, chosen: list[int]) -> None:
    """Worlds and their sets, FOLDER/w00.pickle and FOLDER/w00_0."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in chosen or range(len(WORLDS)):
        row, hidden, continuous = WORLDS[k]
        stored = folder / f"w{k:02d}.pickle"
        if not stored.exists():
            count = ROWS if continuous else CONFIGURATIONS
            for attempt in range(RETRIES):
                try:
                    case = Case(stored.stem, row, 9000 + 17 * k + 1000 * attempt, hidden, "gaussian", count, continuous)
                    made = make(case)
                except (NoEquilibrium, np.linalg.LinAlgError):
                    continue
                stored.write_bytes(pickle.dumps((case, made.experiment, made.poses)))
                print(stored.stem, row, hidden, flush=True)
                break
        if stored.exists():
            write(folder, stored)


def write(folder: Path, stored: Path) -> None:
    """The sets of a world."""
    case, plan, poses = pickle.loads(stored.read_bytes())
    for v, left in enumerate(leftovers(case)):
        target, rng = folder / f"{stored.stem}_{v}", np.random.default_rng([case.seed, 5, v])
        target.mkdir(exist_ok=True)
        p, tangent = add_leftover(poses.p, poses.tangent, plan, left, rng)
        p, tangent = add_noise(p, tangent, "gaussian", rng)
        (target / "robot.toml").write_text(robot_toml(believed(), "three tubes"))
        (target / "measurements.csv").write_text(measurements_csv(plan, p, tangent))
        truth = {"row": case.row, "continuous": case.continuous, "names": true_names(case), "size_mm": left.size_mm}
        (target / "truth.json").write_text(json.dumps({**truth, "kind": left.kind, "memory": left.memory}))


def ask(folder: Path) -> None:
    """What holds, into FOLDER/w00_0/found.json."""
    for path in sorted(folder.glob("w*_*/truth.json")):
        answer = path.with_name("found.json")
        if answer.exists():
            continue
        robot = load_robot(path.with_name("robot.toml"))
        data = load_measurements(path.with_name("measurements.csv"), robot)
        began = time.perf_counter()
        noise, usable = noise_floor(robot, data)[0], usable_poses(robot, data)
        found = diagnose_partially(robot, data, usable, noise, candidates(robot, data), lambda _: None)
        if built := build(found, lambda _: None):
            found = built.partly
        names = [[f.term.name, *(a.term.name for a in f.alternatives)] for f in found.judgement.findings]
        doubted = {e.term.name: e.doubts for e in found.doubted}
        seconds = round(time.perf_counter() - began, 1)
        answer.write_text(json.dumps({"names": names, "doubted": doubted, "seconds": seconds}))
        print(path.parent.name, json.loads(path.read_text()), "->", names, f"{seconds} s", flush=True)


def read(folder: Path) -> Iterator[tuple[dict[str, Any], list[set[str]]]]:
    """Truth and names found."""
    for path in sorted(folder.glob("w*_*/found.json")):
        truth = json.loads(path.with_name("truth.json").read_text())
        yield truth, [set(names) for names in json.loads(path.read_text())["names"]]


def table(folder: Path) -> None:
    """Shares with their Wilson intervals."""
    sets = list(read(folder))
    parts = [(truth, names) for truth, found in sets for names in found]

    def row(text: str, among: list[Any], hit: Callable[[Any], bool]) -> None:
        hits = sum(hit(one) for one in among)
        low, high = wilson(hits, len(among))
        print(f"| {text} | {hits} | {len(among)} | {100 * low:.1f} to {100 * high:.1f} % |")

    def of(*rows: str, continuous: bool) -> list[Any]:
        return [one for one in sets if one[0]["row"] in rows and one[0]["continuous"] == continuous]

    print("| | hits | trials | 95 % interval |\n|---|---|---|---|")
    row("false alarm on correlated nulls, at rest", of("null", continuous=False), lambda one: bool(one[1]))
    row("the same, motions", of("null", continuous=True), lambda one: bool(one[1]))
    row("unknown effects alone, given a name", of("unknown", continuous=False), lambda one: bool(one[1]))
    row("known effect beside a smooth error, listed", of("known", continuous=False), listed)
    row("known part of known and unknown, listed", of(BOTH, continuous=False), listed)
    row("the same, motions", of(BOTH, continuous=True), listed)
    row("wrong parts, of all parts listed", parts, lambda part: not any(true & part[1] for true in known(part[0])))


def known(truth: dict[str, Any]) -> list[set[str]]:
    return [set(name.split("|")) for name in truth["names"] if name != "unknown"]


def listed(one: tuple[dict[str, Any], list[set[str]]]) -> bool:
    """Every known part is among the names."""
    return all(any(true & names for names in one[1]) for true in known(one[0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["make", "ask", "table"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--worlds", type=int, nargs="*", default=[], help="make these only, by their numbers")
    given = parser.parse_args()
    if given.action == "make":
        solve(given.folder, given.worlds)
    else:
        {"ask": ask, "table": table}[given.action](given.folder)


if __name__ == "__main__":
    main()
