"""Does the room around zero-clearance shapes tell which states and motions are valid? Shares by room, three scenarios.

python benchmarks/zero_clearance_rooms.py [SCENARIO ...]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from own_cache import use_own_cache

from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.search.insertion_chains import promising, retreat_roadmap
from ctrplan.planning.search.roadmap_search import RoadmapSearch

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
EDGES_MM = (-np.inf, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0, np.inf)
GROWN, MOTIONS = 100, 250


def found(name: str) -> tuple[list[float], list[bool]]:
    """Rooms [mm] of states and motions of a roadmap and of random motions, and whether each is valid."""
    checker, rng = MotionChecker(load_scenario(SCENARIOS / f"{name}.toml")), np.random.default_rng(0)
    goals = promising(checker, goal_states(checker, rng))
    search = RoadmapSearch(checker, retreat_roadmap(checker, goals), goals)
    search.grow(rng, GROWN)
    ways = [q[None] for q in search.joints] + [q[None] for q in checker.space.sample(rng, GROWN)]
    valid = {k for k, q in enumerate(search.joints) if checker.probe(q)[0].valid}
    for row in rng.choice(len(search.edges), MOTIONS, replace=False):
        a, b = (int(node) for node in search.edges[row])
        if {a, b} <= valid:
            ways.append(checker.space.corners(search.joints[a], search.joints[b], checker.style))
    rooms = checker.rooms(ways) * 1e3
    return rooms.tolist(), [(checker.probe(w[0])[0] if len(w) == 1 else checker.along(w)).valid for w in ways]


def main() -> None:
    use_own_cache()
    rooms: list[float] = []
    valid: list[bool] = []
    for name in sys.argv[1:] or ["sinus", "deploy", "ventricle"]:
        more = found(name)
        rooms += more[0]
        valid += more[1]
    print("| room of zero-clearance shapes, mm | states and motions | valid |\n|---|---|---|")
    place = np.digitize(rooms, EDGES_MM) - 1
    for k, (low, high) in enumerate(zip(EDGES_MM[:-1], EDGES_MM[1:], strict=True)):
        there = np.array(valid)[place == k]
        share = f"{100 * there.mean():.0f} %" if len(there) else ""
        print(f"| {low:g} to {high:g} | {len(there)} | {share} |")


if __name__ == "__main__":
    main()
