"""Planning queries known to have an answer: tips of configurations that a random tree of valid motions reached.

python benchmarks/planning_queries.py      writes planning_queries.json anew; takes a minute or two
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.scenario.scenario import Scenario

Array = NDArray[np.float64]
SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
FILE = Path(__file__).with_suffix(".json")
NODES, TRIES, LONGEST_MM = 60, 1200, 40.0  # of the tree, motions tried for it, and the longest of them
FAR_M = 8e-3  # from the start's tip
DEEP_SHARE = 0.5  # of the tips, the ones farthest from the plate
TOLERANCE_MM = 1.0
PER_SCENARIO = {
    "ribs": 6,
    "vessel": 6,
    "airway": 6,
    "heart_chamber": 6,
    "ventricle": 5,
    "sinus": 4,
    "deploy": 5,
    "pair_free": 4,
}


@dataclass(frozen=True)
class Query:
    """A scenario with another target."""

    scenario: str
    tip_mm: tuple[float, float, float]

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.scenario} {', '.join(f'{x:.1f}' for x in self.tip_mm)}"

    def load(self, overrides: list[str]) -> Scenario:
        """The scenario that asks for it."""
        goal = f"goal={{tip_mm={list(self.tip_mm)}, tolerance_mm={TOLERANCE_MM}}}"
        return load_scenario(SCENARIOS / f"{self.scenario}.toml", [goal, *overrides])


def queries() -> list[Query]:
    """All queries, as kept in the file."""
    return [Query(name, (x, y, z)) for name, (x, y, z) in json.loads(FILE.read_text(encoding="utf-8"))]


def own(name: str) -> list[Query]:
    """The scenario's own target, which it is tested to reach."""
    tip = load_scenario(SCENARIOS / f"{name}.toml").goal.tip_m
    return [] if tip is None else [Query(name, _rounded(tip * 1e3))]


def feasible(name: str, count: int, seed: int) -> list[Query]:
    """`count` targets of a scenario, spread out, each at the frictionless tip of a state that valid motions lead to."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    checker, rng = MotionChecker(scenario), np.random.default_rng(seed)
    joints = _tree(checker, rng)
    samples = [checker.probe(q)[1] for q in joints]
    tips = np.array([s.tip_m[-1] for s in samples if s is not None]) @ scenario.base_R.T + scenario.base_position_m
    tips = tips[np.linalg.norm(tips - tips[0], axis=1) > FAR_M]
    depth = (tips - scenario.base_position_m) @ scenario.base_R[:, 2]
    tips = tips[np.argsort(-depth)[: max(count, int(DEEP_SHARE * len(tips)))]]
    return [Query(name, _rounded(tip)) for tip in _spread(tips, count) * 1e3]


def _rounded(tip_mm: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 1) for value in tip_mm)
    return x, y, z


def _tree(checker: MotionChecker, rng: np.random.Generator) -> Array:
    """(K, m) states reached from the start by valid L-shaped motions towards random joint values."""
    nodes, space = [checker.scenario.start], checker.space
    for aim in space.sample(rng, TRIES):
        if len(nodes) == NODES:
            break
        apart = [space.length_mm(space.difference(node, aim)) for node in nodes]
        near = nodes[int(np.argmin(apart))]
        reached = near + min(1.0, LONGEST_MM / max(min(apart), 1e-9)) * space.difference(near, aim)
        if space.allowed(reached) and checker.motion(near, reached).valid:
            nodes.append(reached)
    return np.array(nodes)


def _spread(points: Array, count: int) -> Array:
    """`count` of the points (K, 3), each as far as can be from those before."""
    kept = [0]
    apart = np.linalg.norm(points - points[0], axis=1)
    while len(kept) < min(count, len(points)):
        kept.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(points - points[kept[-1]], axis=1))
    return points[kept]


def main() -> None:
    found = [query for name, count in PER_SCENARIO.items() for query in feasible(name, count, seed=0)]
    found += [query for name in PER_SCENARIO for query in own(name)]
    rows = ",\n".join(json.dumps([query.scenario, list(query.tip_mm)]) for query in found)
    FILE.write_text(f"[\n{rows}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
