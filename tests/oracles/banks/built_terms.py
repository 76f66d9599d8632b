"""What built terms and names beside them are worth: effects that no catalogue has, alone and beside a known one, and
nulls with memory.

    python -m banks.built_terms make FOLDER     # in tests/oracles; worlds take 15 to 40 s each
    python -m banks.built_terms ask FOLDER      # about 30 s each
    python -m banks.built_terms table FOLDER

Every world is solved once and measured in 32 configurations, with three tubes five approaches each. A set adds noise
and smooth random errors: of 0.3 and 1 mm, to nulls of 1 to 3 mm and several memories. Robots of two and four tubes are
asked as well. Asked is what holds of the whole catalogue beside a rest, what can be built of the rest, and what holds
beside that, without the ordinary search before it. The gap is what the poses kept aside show, their noise taken out.
Resumable.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: its threads only fight over small matrices here

import argparse
import hashlib
import json
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case import Case, Made, make
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.effects import truth_name
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.leftovers import Leftover, add_leftover
from hidden_effects.noise import add_noise
from hidden_effects.score import wilson

from ctrplan.calibration.estimates import distances
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.diagnosis.conclusion import Conclusion
from ctrplan.diagnosis.partial_diagnosis import build, diagnose_partially
from ctrplan.diagnosis.usable_poses import usable_poses
from ctrplan.diagnosis.workbench import Scored, Teller, candidates
from ctrplan.effects.learned.learned import Learned
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain

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
BEYOND = (  # what no piece has the form of, beside something known
    ("kink", "sensor_offset"),
    ("collar_slip", "tip_load"),
    ("tracker_jump", "joint_scale"),
    ("plate_friction", "homing_translation"),
    ("kink", "joint_scale"),
    ("tracker_jump", "sensor_offset"),
    ("collar_slip", "base_misalignment"),
    ("plate_friction", "tip_load"),
)
OTHER_ROBOTS = (  # what is unknown and what is known, on two and on four tubes
    ("third_harmonic", "sensor_offset"),
    ("heading_shift", "backlash"),
    ("guide_bend", "joint_scale"),
    ("overlap_stiffness", "base_misalignment"),
)
SIZES, KNOWN_SIZE = (4.0, 4.0, 2.0), 3.0  # 1 leaves about the noise after recalibration
NULL_WORLDS = 6  # besides, half of them with a temperature that nothing depends on
NULL, BOTH = "null", "unknown and known"
THREE, ROBOTS = "three tubes", ("three tubes", "two tubes", "four tubes")


def worlds() -> list[tuple[str, Hidden, str]]:
    """Row of the table, what is hidden and in which robot, in the order in which they are made."""
    others = [(row, hidden, robot) for row, hidden in of_other_robots() for robot in ROBOTS[1:]]
    return [(row, hidden, THREE) for row, hidden in of_three_tubes()] + others


def of_other_robots() -> list[tuple[str, Hidden]]:
    beside: list[tuple[str, Hidden]] = [(BOTH, ((name, 4.0), (other, KNOWN_SIZE))) for name, other in OTHER_ROBOTS]
    return [(NULL, ()), *beside[:2], (NULL, ()), *beside[2:]]


def of_three_tubes() -> list[tuple[str, Hidden]]:
    found: list[tuple[str, Hidden]] = []
    for k, size in enumerate(SIZES):
        found += [(NULL, ())]
        found += [("unknown alone", ((name, size),)) for name in UNKNOWN]
        beside = (KNOWN[(i + k) % len(KNOWN)] for i in range(len(UNKNOWN)))
        found += [(BOTH, ((name, size), (other, KNOWN_SIZE))) for name, other in zip(UNKNOWN, beside, strict=True)]
    logged: tuple[Hidden, ...] = ((), (("logged_room", 1.0),))
    found += [(NULL, logged[k % 2]) for k in range(NULL_WORLDS)]
    return found + [("no piece and known", ((name, 4.0), (other, KNOWN_SIZE))) for name, other in BEYOND]


def leftovers(row: str) -> list[Leftover]:
    """Sizes [mm] and memories, rad of joints or s, of the sets of a world."""
    if row != NULL:
        return [Leftover(0.3, "configuration", 0.7), Leftover(1.0, "configuration", 1.5)]
    kinds = (("configuration", 0.3), ("configuration", 0.7), ("configuration", 1.5), ("time", 20.0), ("time", 100.0))
    return [Leftover(size, kind, memory) for _ in range(3) for size in (1.0, 2.0, 3.0) for kind, memory in kinds]


def solve(folder: Path, only: str, chosen: list[int], seed: int) -> None:
    """Worlds and their sets, FOLDER/w00.pickle and FOLDER/w00_00; of one robot where it is named."""
    folder.mkdir(parents=True, exist_ok=True)
    every = worlds()
    for k in chosen or range(len(every)):
        row, hidden, robot = every[k]
        if only and robot != only:
            continue
        stored = folder / f"w{k:02d}.pickle"
        drawn = 50000 + 17 * k + 100_000 * seed
        case = Case(stored.stem, row, drawn, hidden, "gaussian", CONFIGURATIONS, robot=robot)
        if not stored.exists() and (made := made_of(case)):
            stored.write_bytes(pickle.dumps((made.case, made.experiment, made.poses, made.world.room)))
            print(stored.stem, row, hidden, robot, flush=True)
        if stored.exists():
            write(folder, stored)


def made_of(case: Case) -> Made | None:
    """With the first seed of which every pose has an equilibrium."""
    for attempt in range(RETRIES):
        try:
            return make(replace(case, seed=case.seed + 1000 * attempt))
        except (NoEquilibrium, np.linalg.LinAlgError):
            continue
    return None


def write(folder: Path, stored: Path) -> None:
    """The sets of a world."""
    case, plan, poses, room = pickle.loads(stored.read_bytes())
    for v, left in enumerate(leftovers(case.row)):
        target, rng = folder / f"{stored.stem}_{v:02d}", np.random.default_rng([case.seed, 5, v])
        target.mkdir(exist_ok=True)
        p, tangent = add_leftover(poses.p, poses.tangent, plan, left, rng)
        p, tangent = add_noise(p, tangent, "gaussian", rng)
        (target / "robot.toml").write_text(robot_toml(case.believed(), case.robot))
        (target / "measurements.csv").write_text(measurements_csv(plan, p, tangent, room))
        truth = {"row": case.row, "hidden": case.hidden, "robot": case.robot, "size_mm": left.size_mm}
        (target / "truth.json").write_text(json.dumps({**truth, "kind": left.kind, "memory": left.memory}))


def ask(folder: Path, only: Sequence[str] = ()) -> None:
    """What holds and what is built, into FOLDER/w00_00/found.json; of some rows only where they are named."""
    for path in _in_turn(folder, only):
        answer = path.with_name("found.json")
        if not answer.exists():
            answer.write_text("{}")  # taken, where two ask
            answer.write_text(json.dumps(asked(path.parent)))
            print(path.parent.name, json.loads(path.read_text())["hidden"], answer.read_text(), flush=True)


def _in_turn(folder: Path, only: Sequence[str]) -> list[Path]:
    """Rows and robots in turn, by chance within each, so that what is there at any time is a fair part of all."""
    rows: dict[tuple[str, str], list[Path]] = {}
    for path in sorted(folder.glob("w*_*/truth.json"), key=_by_chance):
        truth = json.loads(path.read_text())
        if not only or truth["row"] in only:
            rows.setdefault((truth["row"], truth.get("robot", THREE)), []).append(path)
    return [path for turn in zip_longest(*rows.values()) for path in turn if path is not None]


def _by_chance(path: Path) -> str:
    return hashlib.md5(path.parent.name.encode()).hexdigest()


def asked(folder: Path) -> dict[str, Any]:
    """Gaps [mm] on the poses kept aside: calibrated, with named effects, with the built term; and the evidence."""
    robot = load_robot(folder / "robot.toml")
    data = load_measurements(folder / "measurements.csv", robot)
    began = time.process_time()
    noise, usable = noise_floor(robot, data)[0], usable_poses(robot, data)
    found = diagnose_partially(robot, data, usable, noise, candidates(robot, data), Teller())
    halfway = time.process_time()
    aside = data.subset(found.split.held_out_set)
    result: dict[str, Any] = {"named": names(found), "seconds": [round(halfway - began, 1)], "first": probable(found)}
    result["before_mm"] = gap_mm(found.base, aside, noise.floor_m)
    result["named_mm"] = gap_mm(found.handed_over, aside, noise.floor_m)
    after = build(found, Teller())
    result["seconds"].append(round(time.process_time() - halfway, 1))
    if after is None or after.built is None:
        return result | {"built": False}
    built = after.built
    result["beside_mm"] = gap_mm(after.bench.handed_over(built.named), aside, noise.floor_m)
    result["names"], result["probable"] = names(after), probable(after)
    result["built_mm"] = gap_mm(after.handed_over, aside, noise.floor_m)
    terms = [
        t.effect.stated({})["acts_on"] + ": " + ", ".join(t.effect.parts)
        for t in after.chosen.terms
        if isinstance(t.effect, Learned)
    ]
    return result | {"built": True, "terms": terms, "share": built.share, "gain": built.gain}


def probable(found: Conclusion) -> dict[str, float]:
    """Effects that are not improbable, and what the catalogue lacks."""
    assert found.compared is not None
    told = found.compared.posterior.to_json()
    return {name: p for name, p in told["effects"].items() if p > 0.01} | {"unknown": told["unknown"]}


def names(found: Conclusion) -> list[list[str]]:
    """Parts that hold, each with what does as well in its place."""
    return [[f.term.name, *(a.term.name for a in f.alternatives)] for f in found.judgement.findings]


def gap_mm(scored: Scored, aside: Measurements, floor_m: float) -> float:
    """Rms error on poses that nothing has read, the noise taken out."""
    fit = scored.fit
    chain = ParametricChain(fit.chain.robot, aside, fit.chain.terms)
    chain.correction = friction_correction(chain, fit.p)
    error = distances(chain.predict(fit.p, derivatives=False), aside)
    return float(1e3 * np.sqrt(max(float(np.mean(error**2)) - floor_m**2, 0.0)))


def table(folder: Path) -> None:
    """Shares with their Wilson intervals, by robot, and the median of the gap that is left."""
    sets = read(folder)
    for robot in ROBOTS:
        if those := [one for one in sets if one[0].get("robot", THREE) == robot]:
            print(
                f"\n{robot}, {len(those)} sets, {np.median([sum(f['seconds']) for _, f in those]):.0f} s of processor"
            )
            _shares(those)
    print("\n| effect | sets | built | median gap: named effects, built term [mm] | median share that is left |")
    print("|---|---|---|---|---|")
    for name in UNKNOWN:
        those = [found for truth, found in sets if truth["row"] != NULL and truth["hidden"][0][0] == name]
        if those:
            sizes = [np.median([found[key] for found in those]) for key in ("named_mm", "left_mm")]
            count, share = sum(f["built"] for f in those), 100 * np.median([*map(left, those)])
            print(f"| {name} | {len(those)} | {count} | {sizes[0]:.2f}, {sizes[1]:.2f} | {share:.0f} % |")


def read(folder: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Truth, and what was found and handed over."""
    sets = []
    for path in sorted(folder.glob("w*_*/found.json")):
        if found := json.loads(path.read_text()):
            beside = found["built"] and bool(found["names"] or is_handed_over(found))
            found["built"] = is_handed_over(found)
            found["left_mm"] = found["built_mm"] if found["built"] else found["named_mm"]
            found["names"] = [set(part) for part in found["names" if beside else "named"]]
            sets.append((json.loads(path.with_name("truth.json").read_text()), found))
    return sets


def _shares(sets: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    print("\n| | hits | trials | 95 % interval |\n|---|---|---|---|")
    nulls = [found for truth, found in sets if truth["row"] == NULL]
    _line("built term in a null", nulls, lambda found: found["built"])
    _line("name in a null", nulls, lambda found: bool(found["names"]))
    alone = [found for truth, found in sets if truth["row"] == "unknown alone"]
    _line("unknown alone: given a name", alone, lambda found: bool(found["names"]))
    both = [(known(truth), found["names"]) for truth, found in sets if known(truth)]
    _line(f"{BOTH}: the known part is listed", both, lambda one: any(one[0] & part for part in one[1]))
    parts = [(named(truth), part) for truth, found in sets for part in found["names"]]
    _line("wrong parts, of all that are listed", parts, lambda one: not one[0] & one[1])
    for row in ("unknown alone", BOTH):
        those = [found for truth, found in sets if truth["row"] == row]
        _line(f"{row}: a term was built", those, lambda found: found["built"])
        _line(f"{row}: the gap beside named effects is halved", those, lambda found: left(found) <= 0.5)
        if those:
            print(f"| {row}: median of the gap that is left | {100 * np.median([*map(left, those)]):.0f} % | | |")
    built = [found for _, found in sets if found["built"]]
    _line("built terms with which the poses kept aside are worse by 5 %", built, lambda found: left(found) > 1.05)


def known(truth: dict[str, Any]) -> set[str]:
    """Names that the catalogue has for what acts beside the unknown effect; empty where nothing does."""
    return {name for hidden, _ in truth["hidden"][1:] for name in truth_name(hidden).split("|")}


def named(truth: dict[str, Any]) -> set[str]:
    """All names that the catalogue has for what acts."""
    return {name for hidden, _ in truth["hidden"] for name in truth_name(hidden).split("|")}


def is_handed_over(found: dict[str, Any]) -> bool:
    """Whether a term was built and brings the poses kept aside nearer."""
    return bool(found["built"]) and found["built_mm"] < found["beside_mm"]


def left(found: dict[str, Any]) -> float:
    """Share of the gap that is left beside the named effects, 1 where nothing was built."""
    return float(found["built_mm"] / max(found["named_mm"], 1e-9)) if found["built"] else 1.0


def _line(text: str, among: list[Any], hit: Callable[[Any], bool]) -> None:
    hits = sum(hit(one) for one in among)
    low, high = wilson(hits, len(among))
    print(f"| {text} | {hits} | {len(among)} | {100 * low:.1f} to {100 * high:.1f} % |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["make", "ask", "table"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=ROBOTS, default="", help="make the worlds of this one only")
    parser.add_argument("--worlds", type=int, nargs="*", default=[], help="make these only, by their numbers")
    parser.add_argument("--seed", type=int, default=0, help="of the worlds: another one makes others of the same kinds")
    given = parser.parse_args()
    if given.action == "make":
        solve(given.folder, given.robot, given.worlds, given.seed)
    else:
        {"ask": ask, "table": table}[given.action](given.folder)


if __name__ == "__main__":
    main()
