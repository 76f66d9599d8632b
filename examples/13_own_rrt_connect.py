"""An RRT-Connect of one's own on the library's checks; then the certificate and the plan of what it finds."""

from pathlib import Path

import numpy as np

import ctrplan
from ctrplan import MotionChecker, l_shaped

scenario = ctrplan.load_scenario(Path(__file__).resolve().parents[1] / "scenarios" / "ribs.toml")
checker, rng = MotionChecker(scenario), np.random.default_rng(0)
goals = ctrplan.inverse_kinematics(scenario, scenario.goal.tip_m).valid
trees = ([(scenario.start, -1)], [(goal.joints, -1) for goal in goals])  # states, each with the place of its parent


def grow(side: int, states: np.ndarray) -> list[int]:
    """Joins states (K, m) to the nearest ones of a tree where the drive can go; their places in it."""
    tree = trees[side]
    apart = checker.space.difference(states[:, None], np.array([q for q, _ in tree])) * checker.space.weights_mm
    near = np.linalg.norm(apart, axis=2).argmin(axis=1)
    joined = np.array([tree[k][0] for k in near])
    motions = checker.motions(joined, states) if side == 0 else checker.motions(states, joined)  # on every core
    tree += [(states[k], int(near[k])) for k, motion in enumerate(motions) if motion.valid]
    return list(range(len(tree) - sum(motion.valid for motion in motions), len(tree)))


def way(side: int, place: int) -> list[np.ndarray]:
    """States from a place of a tree to its root."""
    state, parent = trees[side][place]
    return [state] if parent < 0 else [state, *way(side, parent)]


side, ends = 1, [(k, 0) for k in grow(1, scenario.start[None])]
while not ends:
    side = 1 - side
    ends = [(k, j) for k in grow(side, checker.space.sample(rng, 8)) for j in grow(1 - side, trees[side][k][0][None])]
first, last = ends[0] if side == 0 else ends[0][::-1]
plan = ctrplan.reorder(l_shaped([*way(0, first)[::-1], *way(1, last)[1:]], scenario), scenario)
print(f"{sum(map(len, trees))} states; certified: {plan.certificate.valid}, cost {plan.reorder.cost_after_mm:.1f} mm")
