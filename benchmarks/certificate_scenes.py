"""Does a certificate hold for friction states it did not solve? Spheres beside motions, checked by brute force.

python benchmarks/certificate_scenes.py [--scenes 60] [--states 41] [--seed 1]

Per robot and kind of scene: a short motion from a random configuration, one sphere of 0.5 to 2 mm. "Between": the
sphere stands beside a body point in a random friction state between the corners. "Anywhere": beside a random body
point of the frictionless shape, farther off. Each motion is certified. Then bodies are solved on a grid of friction
states at 5 configurations along it, and the clearance is the least distance of their points to the sphere less both
radii.

Printed: scenes, certified ones, certified ones that a state hits, scenes that no state comes within 1 mm of, the share
of these that is certified, and the largest excess of a certified clearance over the true one [mm].
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from own_cache import use_own_cache

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError
from ctrplan.files.bare_scenario import bare_scenario
from ctrplan.files.robot_file import load_robot
from ctrplan.planning.certificate.certify import certify
from ctrplan.planning.joint_space import JointSpace
from ctrplan.robot.robot import Robot

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
NAMES = ("table_1_pair", "table_4_pair", "table_5_pair", "three_tube", "three_tube_calibrated")
OUT_OF_REACH_M = 1e-3  # of every state: a certificate should not refuse such a scene
TURN_RAD, SLIDE_M = 0.2, 3e-3
PLACES = 5


def scenes(robot: Robot, kind: str, count: int, rng: np.random.Generator) -> Iterator[tuple[Array, Array, float]]:
    """Motions (2, m), and a sphere's centre (3,) and radius [m] beside each."""
    space = JointSpace.of_robot(robot)
    while count:
        start = space.sample(rng, 1)[0]
        step = np.where(robot.drive.is_rotation, TURN_RAD, SLIDE_M) * rng.uniform(-1, 1, len(start))
        way = np.array([start, start + step])
        if not space.allowed(way):
            continue
        phi = rng.uniform(-1, 1, (1, robot.n - 1)) if kind == "between" else np.zeros((1, robot.n - 1))
        body = robot.mechanics.friction_bodies(*robot.drive.collars(way.mean(axis=0)), phi)
        radius, side = rng.uniform(0.5e-3, 2e-3), rng.standard_normal(3)
        away = rng.uniform(0.0, 4e-3) if kind == "between" else rng.uniform(3e-3, 20e-3)
        place = len(body.radius_m) - 1 - int(rng.integers(len(body.radius_m) // 2))
        yield way, body.point_m[0, place] + (away + radius) * side / np.linalg.norm(side), radius
        count -= 1


def true_clearance(robot: Robot, way: Array, center: Array, radius: float, states: int) -> float:
    """[m] least over a grid of friction states at PLACES configurations of the motion; NaN where a state has none."""
    grid = np.array(list(itertools.product(np.linspace(-1, 1, states), repeat=robot.n - 1)))
    least = np.inf
    for share in np.linspace(0, 1, PLACES):
        found = robot.mechanics.friction_bodies(
            *robot.drive.collars(way[0] + share * (way[1] - way[0])), grid, accuracy="certificate"
        )
        if not found.solved.all():
            return np.nan
        least = min(least, float((np.linalg.norm(found.point_m - center, axis=2) - found.radius_m).min()) - radius)
    return least


def row(name: str, kind: str, count: int, states: int, rng: np.random.Generator) -> str:
    robot = load_robot(ROBOTS / f"{name}.toml")
    certified = hit = apart = apart_certified = 0
    excess = -np.inf
    for way, center, radius in scenes(robot, kind, count, rng):
        sphere = AnatomyPart(Sphere(center_m=center, radius_m=radius))
        case = replace(bare_scenario(robot), anatomy=(sphere,), start=way[0])
        try:
            found = certify(case, way)
        except CtrplanError:
            continue
        true = true_clearance(robot, way, center, radius, states)
        certified += found.valid
        if found.valid and np.isfinite(true):
            hit += true < 0
            excess = max(excess, found.min_clearance_m - true)
        if true > OUT_OF_REACH_M:
            apart += 1
            apart_certified += found.valid
    share = f"{100 * apart_certified / apart:.0f} %" if apart else "-"
    return f"| {name} | {kind} | {count} | {certified} | {hit} | {apart} | {share} | {1e3 * excess:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--states", type=int, default=41)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print("| robot | sphere | scenes | certified | of them hit | out of reach | of these certified | excess, mm |")
    print("|---|---|---|---|---|---|---|---|")
    for name, kind in itertools.product(NAMES, ("between", "anywhere")):
        print(row(name, kind, asked.scenes, asked.states, np.random.default_rng(asked.seed)), flush=True)


if __name__ == "__main__":
    use_own_cache()
    main()
