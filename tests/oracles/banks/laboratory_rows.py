"""Rows of measured data that a laboratory may hand over, each with smooth random errors of several memories beside it:

known pairs and triples, positions without tangents, innermost tubes that are withdrawn, streams with lag and friction,
and with effects that nobody knows.

    python -m banks.laboratory_rows make FOLDER --seed 1   # in tests/oracles; worlds take 10 to 60 s each
    python -m banks.laboratory_rows ask FOLDER             # about 30 s a set, some minutes on streams
    python -m banks.laboratory_rows table FOLDER

Every world is solved once. A set adds noise and a smooth error: 0.3 and 1 mm beside hidden effects, 1 to 3 mm and five
memories in nulls, of which every row has its own. Sets without tangents are those of pairs and of other poses at rest,
with the columns left out. Asked as in built_terms.py, rows in turn; several processes may ask at once. Resumable.
"""

from __future__ import annotations

import argparse
import json
import pickle
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.bank import several_known
from hidden_effects.case import Case, true_names
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.leftovers import Leftover, add_leftover
from hidden_effects.noise import add_noise
from hidden_effects.score import wilson

from banks.built_terms import (  # first: it sets threads and finds the tests' generator
    Hidden,
    ask,
    made_of,
    read,
)

AT_REST, POSITIONS, WITHDRAWN, STREAM = "at rest", "position only", "withdrawn", "stream"
WAYS = (AT_REST, POSITIONS, WITHDRAWN, STREAM)  # of measuring; every one has its nulls
NULL, SINGLE, PAIR, TRIPLE, BOTH = "null", "known single", "known pair", "known triple", "unknown and known"
UNKNOWN = "unknown"
KINDS = (NULL, SINGLE, PAIR, TRIPLE, BOTH, UNKNOWN)
CONFIGURATIONS, STREAM_ROWS, KNOWN_SIZE = 32, 500, 3.0
FIRST_SEED = 3_000_000  # apart from those of built_terms.py
MEMORIES = (("configuration", 0.3), ("configuration", 0.7), ("configuration", 1.5), ("time", 20.0), ("time", 100.0))
BESIDE = (Leftover(0.3, "configuration", 0.7), Leftover(1.0, "configuration", 1.5))
BESIDE_STREAM = (Leftover(0.3, "configuration", 0.7), Leftover(1.0, "time", 20.0), Leftover(1.0, "configuration", 1.5))
THREE, TWO = "three tubes", "two tubes"
SINGLES = ("friction", "sensor_offset", "joint_scale", "backlash")
UNKNOWN_AND_KNOWN = (
    ("third_harmonic", "sensor_offset"),
    ("cross_talk", "tip_load"),
    ("screw_coupling", "backlash"),
    ("metal_nearby", "joint_scale"),
    ("overlap_stiffness", "homing_translation"),
    ("warm_offset", "base_misalignment"),
)
WITHDRAWN_SINGLES = (  # no loads, which are not modelled there, and no sensor_offset, whose frame is that of one tube
    ("joint_scale", THREE),
    ("friction", THREE),
    ("homing_translation", THREE),
    ("backlash", TWO),
    ("eccentricity", THREE),
    ("joint_scale", TWO),
    ("backlash", THREE),
)
LAG_AND_FRICTION = ((3.0, 4.0), (4.0, 5.0), (2.0, 6.0), (3.0, 6.0))

UNKNOWN_MOVING = ("kink", "plate_friction", "third_harmonic", "screw_coupling", "collar_slip", "metal_nearby")
UNKNOWN_AND_KNOWN_MOVING = (
    ("kink", "lag"),
    ("plate_friction", "lag"),
    ("third_harmonic", "friction"),
    ("screw_coupling", "lag"),
    ("collar_slip", "friction"),
    ("metal_nearby", "friction"),
)


@dataclass(frozen=True)
class Row:
    """Worlds of one kind: what is hidden in each, in which robot, and the ways in which it is measured."""

    kind: str
    ways: tuple[str, ...]
    hidden: tuple[Hidden, ...]
    robots: tuple[str, ...] = (THREE,)

    def worlds(self) -> list[tuple[str, tuple[str, ...], Hidden, str]]:
        robots = self.robots * len(self.hidden)
        return [(self.kind, self.ways, hidden, robot) for hidden, robot in zip(self.hidden, robots, strict=False)]


def rows(seed: int) -> list[Row]:
    """Another seed draws other pairs and triples."""
    rng = np.random.default_rng([seed, 91])
    pairs, triples = (tuple(several_known(count, rng) for _ in range(8)) for count in (2, 3))
    none, back = ((),), ", withdrawn"
    singles = tuple(((name, KNOWN_SIZE),) for name, _ in WITHDRAWN_SINGLES)
    robots = tuple(robot + back for _, robot in WITHDRAWN_SINGLES)
    return [
        Row(NULL, (AT_REST, POSITIONS), 4 * none),
        Row(PAIR, (AT_REST, POSITIONS), pairs),
        Row(TRIPLE, (AT_REST,), triples),
        Row(NULL, (WITHDRAWN,), 4 * none, (THREE + back, TWO + back)),
        Row(SINGLE, (WITHDRAWN,), singles, robots),
        Row(SINGLE, (POSITIONS,), tuple(((name, KNOWN_SIZE),) for name in SINGLES)),
        Row(BOTH, (POSITIONS,), tuple(((name, 4.0), (other, KNOWN_SIZE)) for name, other in UNKNOWN_AND_KNOWN)),
        Row(NULL, (STREAM,), 3 * none),
        Row(PAIR, (STREAM,), tuple((("lag", late), ("friction", rough)) for late, rough in LAG_AND_FRICTION)),
    ]


def later_rows() -> list[Row]:
    """Worlds that are numbered after the others, which keep their numbers."""
    beside = tuple(((name, 4.0), (other, KNOWN_SIZE)) for name, other in UNKNOWN_AND_KNOWN_MOVING)
    return [Row(UNKNOWN, (STREAM,), tuple(((name, 4.0),) for name in UNKNOWN_MOVING)), Row(BOTH, (STREAM,), beside)]


def worlds(seed: int) -> list[tuple[str, tuple[str, ...], Hidden, str]]:
    """Kind, ways of measuring, what is hidden, robot: rows in turn, so that some of each are there early."""
    first, later = (zip_longest(*(row.worlds() for row in part)) for part in (rows(seed), later_rows()))
    return [world for turn in (*first, *later) for world in turn if world]


def leftovers(kind: str, way: str) -> Iterable[Leftover]:
    """Sizes [mm] and memories, rad of joints or s, of the sets of a world."""
    if kind != NULL:
        return BESIDE_STREAM if way == STREAM else BESIDE
    return [Leftover(size, of, memory) for size in (1.0, 2.0, 3.0) for of, memory in MEMORIES]


def solve(folder: Path, chosen: list[int], seed: int) -> None:
    """Worlds and their sets, FOLDER/w00.pickle and FOLDER/w00_00."""
    folder.mkdir(parents=True, exist_ok=True)
    every = worlds(seed)
    for k in chosen or range(len(every)):
        kind, ways, hidden, robot = every[k]
        stored = folder / f"w{k:02d}.pickle"
        if not stored.exists():
            count, drawn = STREAM_ROWS if STREAM in ways else CONFIGURATIONS, FIRST_SEED + 17 * k + 100_000 * seed
            case = Case(stored.stem, kind, drawn, hidden, "gaussian", count, STREAM in ways, robot=robot)
            if made := made_of(case):
                stored.write_bytes(pickle.dumps((made.case, made.experiment, made.poses, made.world.room)))
                print(stored.stem, kind, ways, hidden, robot, flush=True)
        if stored.exists():
            write(folder, stored, ways)


def write(folder: Path, stored: Path, ways: tuple[str, ...]) -> None:
    """The sets of a world; ways of measuring share errors and noise."""
    case, plan, poses, room = pickle.loads(stored.read_bytes())
    sets = [(v, left, way) for way in ways for v, left in enumerate(leftovers(case.row, way))]
    for number, (v, left, way) in enumerate(sets):
        target, rng = folder / f"{stored.stem}_{number:02d}", np.random.default_rng([case.seed, 5, v])
        target.mkdir(exist_ok=True)
        p, tangent = add_leftover(poses.p, poses.tangent, plan, left, rng)
        p, tangent = add_noise(p, tangent, "gaussian", rng)
        seen = way != POSITIONS
        (target / "robot.toml").write_text(robot_toml(case.believed(), case.robot, tangents=seen))
        (target / "measurements.csv").write_text(measurements_csv(plan, p, tangent if seen else None, room))
        truth = {"row": f"{way}, {case.row}", "way": way, "of": case.row, "hidden": case.hidden, "robot": case.robot}
        truth |= {"names": true_names(case), "size_mm": left.size_mm, "kind": left.kind, "memory": left.memory}
        (target / "truth.json").write_text(json.dumps(truth))


def table(folder: Path) -> None:
    """Hits and trials with their Wilson intervals, by the way of measuring and by what is hidden."""
    every = read(folder)
    print("| measured | hidden | what is counted | goal | hits | trials | 95 % interval |")
    print("|---|---|---|---|---|---|---|")
    for way in WAYS:
        sets = [(truth, found) for truth, found in every if truth["way"] == way]
        for kind in KINDS:
            _counted(way, kind, [one for one in sets if one[0]["of"] == kind])
        if sets:
            _of_all(way, sets)
    print("\n| measured, hidden | sets | median processor time of one [s] |\n|---|---|---|")
    for row in sorted({truth["row"] for truth, _ in every}):
        seconds = [sum(found["seconds"]) for truth, found in every if truth["row"] == row]
        print(f"| {row} | {len(seconds)} | {np.median(seconds):.0f} |")
    if open_ones := [path.parent.name for path in sorted(folder.glob("w*_*/found.json")) if path.read_text() == "{}"]:
        print(f"\nwithout an answer, being asked or broken off: {', '.join(open_ones)}")


def _counted(way: str, kind: str, sets: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    """Row of the table for sets in which equally many effects are hidden."""
    if not sets:
        return

    def line(text: str, goal: str, among: list[Any], hit: Callable[[Any], bool]) -> None:
        _line(f"{way} | {kind}", text, goal, among, hit)

    if kind == NULL:
        line("a name or a built term", "<= 5 %", sets, lambda one: bool(one[1]["names"]) or one[1]["built"])
        line("of these: a built term", "", sets, lambda one: one[1]["built"])
        return
    if kind == UNKNOWN:
        line("given a name", "<= 5 %", sets, lambda one: bool(one[1]["names"]))
        line("given a built term", "", sets, lambda one: one[1]["built"])
        return
    parts = [(part, found["names"]) for truth, found in sets for part in known(truth)]
    line("a known part is listed", ">= 80 %", parts, lambda one: any(one[0] & names for names in one[1]))
    for size in sorted({truth["size_mm"] for truth, _ in sets}):
        of_size = [(part, f["names"]) for t, f in sets if t["size_mm"] == size for part in known(t)]
        line(f"the same beside {size:g} mm", "", of_size, lambda one: any(one[0] & names for names in one[1]))
    if max(len(known(truth)) for truth, _ in sets) > 1:
        line("all known parts are listed", "", sets, lambda one: is_listed(*one))
    listed = [(truth, names) for truth, found in sets for names in found["names"]]
    line("wrong parts, of those listed", "<= 5 %", listed, lambda one: is_wrong(*one))


def _of_all(way: str, sets: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    """Row of the table for all sets that were measured in this way, nulls too."""
    listed = [(truth, names) for truth, found in sets for names in found["names"]]
    line = f"{way} | any"
    _line(line, "sets with a confident wrong part", "<= 2 %", sets, lambda one: is_confidently_wrong(*one))
    _line(line, "wrong parts, of those listed", "<= 5 %", listed, lambda one: is_wrong(*one))


def known(truth: dict[str, Any]) -> list[set[str]]:
    """For every hidden effect that the catalogue has, the names that are right."""
    return [set(name.split("|")) for name in truth["names"] if name != "unknown"]


def is_listed(truth: dict[str, Any], found: dict[str, Any]) -> bool:
    """Every known part is among the names."""
    return all(any(part & names for names in found["names"]) for part in known(truth))


def is_wrong(truth: dict[str, Any], names: set[str]) -> bool:
    """Whether a listed part has no hidden effect among its names."""
    return not any(part & names for part in known(truth))


def is_confidently_wrong(truth: dict[str, Any], found: dict[str, Any]) -> bool:
    """Whether a part is listed without an alternative, and is not hidden."""
    return any(len(names) == 1 and is_wrong(truth, names) for names in found["names"])


def _line(of: str, text: str, goal: str, among: list[Any], hit: Callable[[Any], bool]) -> None:
    hits = sum(hit(one) for one in among)
    low, high = wilson(hits, len(among))
    print(f"| {of} | {text} | {goal} | {hits} | {len(among)} | {100 * low:.1f} to {100 * high:.1f} % |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["make", "ask", "table", "list"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--worlds", type=int, nargs="*", default=[], help="make these only, by their numbers")
    parser.add_argument("--rows", nargs="*", default=[], help="ask these only, as the table calls them")
    parser.add_argument("--seed", type=int, default=1, help="of the worlds: another one makes others of the same kinds")
    given = parser.parse_args()
    if given.action == "make":
        solve(given.folder, given.worlds, given.seed)
    elif given.action == "ask":
        ask(given.folder, given.rows)
    elif given.action == "list":
        for number, world in enumerate(worlds(given.seed)):
            print(number, *world)
    else:
        table(given.folder)


if __name__ == "__main__":
    main()
