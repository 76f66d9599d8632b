"""How far bodies and bounds of both meshes are from the model of exact geometry, against what certificates allow.

python benchmarks/mesh_allowance.py [--count 40] [--clearances-mm 0.3 1 3]

Random configurations of the shipped robots, with their own clearances between tubes and with wider ones. Printed, in
mm: the largest distance of a body point (frictionless and corner shapes, at the tip where meshes have different
points), the most that a bound is short, and the allowances of ctrplan/certificate/friction_states.py. Shapes more
than BRANCH_M apart are other equilibria and are counted by themselves.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import get_args

import numpy as np
from own_cache import use_own_cache

from ctrplan.base.arrays import Array
from ctrplan.certificate.friction_states import bound_allowance_m, mesh_allowance_m
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.mechanics.shapes import FrictionBodies
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
NAMES = ("three_tube", "table_1_pair", "table_4_pair", "table_5_pair")
BRANCH_M = 5e-3


def bound_m(bodies: FrictionBodies) -> float:
    """Largest distance of a corner's tip from the frictionless one."""
    tips = bodies.point_m[:, -1]
    return float(np.linalg.norm(tips[1:] - tips[0], axis=1).max())


def apart_m(exact: FrictionBodies, found: FrictionBodies) -> float:
    """Largest distance of bodies, of their tips where their points differ."""
    if exact.point_m.shape != found.point_m.shape:
        return float(np.linalg.norm(exact.point_m[:, -1] - found.point_m[:, -1], axis=1).max())
    return float(np.linalg.norm(exact.point_m - found.point_m, axis=2).max())


def errors(robot: Robot, mesh: Accuracy, count: int) -> Array:
    """(K, 2) [m] distance of bodies, and what the bound is short by."""
    corners = itertools.product((1.0, -1.0), repeat=robot.n - 1)
    states, rows = np.array([(0.0,) * (robot.n - 1), *corners]), []
    for q in JointSpace.of_robot(robot).sample(np.random.default_rng(2), count):
        exact, found = (
            robot.mechanics.friction_bodies(*robot.drive.collars(q), states, accuracy=accuracy)
            for accuracy in ("exact", mesh)
        )
        if exact.solved.all() and found.solved.all():
            rows.append((apart_m(exact, found), bound_m(exact) - bound_m(found)))
    return np.array(rows).reshape(-1, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--clearances-mm", type=float, nargs="*", default=[0.3, 1.0, 3.0])
    options = parser.parse_args()
    use_own_cache()
    print("| robot | clearance, mm | mesh | solved | other equilibria | bodies, mm (allowed) | bounds, mm (allowed) |")
    print("|---|---|---|---|---|---|---|")
    for name, clearance_mm in itertools.product(NAMES, [None, *options.clearances_mm]):
        plain = load_robot(ROBOTS / f"{name}.toml")
        wider = [] if clearance_mm is None else [f"contact.{k}.clearance_mm={clearance_mm}" for k in range(1, plain.n)]
        robot = load_robot(ROBOTS / f"{name}.toml", wider)
        for mesh in get_args(Accuracy)[:2]:
            found = errors(robot, mesh, options.count)
            same = found[found[:, 0] < BRANCH_M]
            apart, short = same.max(axis=0, initial=0.0) * 1e3
            allowed = mesh_allowance_m(robot, mesh) * 1e3, bound_allowance_m(robot, mesh) * 1e3
            print(
                f"| {name} | {clearance_mm or 'own'} | {mesh} | {len(found)} | {len(found) - len(same)} "
                f"| {apart:.2f} ({allowed[0]:.2f}) | {short:.2f} ({allowed[1]:.2f}) |",
                flush=True,
            )


if __name__ == "__main__":
    main()
