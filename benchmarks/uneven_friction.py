"""How much nearer to obstacles a robot comes where friction differs along its contacts than in any uniform state.

python benchmarks/uneven_friction.py [--count 40]

Random configurations of the shipped robots, each with a sphere or a rod beside the body of a random friction
state that differs along the contacts. The worst uneven friction is looked for as certificates do it. Printed for each
robot, in mm: percentiles of how much nearer it comes, and the allowance that certificates take off anyway. Nearest
uniform states are those of a grid of five along each pair, so that the numbers are rather too large.
"""

from __future__ import annotations

import argparse

import numpy as np
from mesh_allowance import NAMES, ROBOTS
from own_cache import use_own_cache

from ctrplan.base.arrays import Array
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import UNEVEN_FRICTION_M
from ctrplan.certificate.uneven_friction import PARTS, worst_uneven_friction
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace


def obstacle(rng: np.random.Generator, near_mm: Array) -> dict[str, object]:
    """A small one whose surface is 1 to 4 mm from a point."""
    side = rng.standard_normal(3)
    side /= np.linalg.norm(side)
    kind, away = rng.choice(["sphere", "capsule"]), rng.uniform(1, 4)
    if kind == "sphere":
        radius = rng.uniform(0.3, 4)
        return {"kind": "sphere", "center_mm": (near_mm + (away + radius) * side).tolist(), "radius_mm": radius}
    along = np.cross(side, rng.standard_normal(3))
    along *= 15 / np.linalg.norm(along)
    start, radius = near_mm + (away + 0.5) * side, 0.5
    ends = {"from_mm": (start - along).tolist(), "to_mm": (start + along).tolist()}
    return {"kind": "capsule", **ends, "radius_mm": radius}


def nearer_mm(robot: Robot, count: int) -> Array:
    """(count,) [mm]"""
    rng, found = np.random.default_rng(4), []
    for q in JointSpace.of_robot(robot).sample(rng, count):
        theta_b, l_b = robot.drive.collars(q)
        phi = rng.uniform(-1, 1, (1, PARTS, robot.n - 1))
        body = robot.mechanics.friction_bodies(theta_b, l_b, phi).point_m[0]
        near = body[-1 - rng.integers(len(body) // 2)] * 1e3
        names = {j.name: v / j.si_per_unit for j, v in zip(robot.drive.joints, q.tolist(), strict=True)}
        content = {"robot": robot.path, "start": names, "goal": {"joints": names}, "anatomy": [obstacle(rng, near)]}
        scenario = scenario_from_dict(content, file="made_up.toml")
        distance = AnatomyDistance.of(scenario)
        assert distance is not None
        found.append(worst_uneven_friction(distance, theta_b, l_b).nearer_m * 1e3)
    return np.array(found)


def main() -> None:
    """Prints a line for each robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40)
    options = parser.parse_args()
    use_own_cache()
    for name in NAMES:
        robot = load_robot(ROBOTS / f"{name}.toml")
        found = nearer_mm(robot, options.count)
        beyond = np.mean(found > UNEVEN_FRICTION_M * 1e3)
        most = " ".join(f"{p}%: {np.percentile(found, p):.3f}" for p in (50, 90, 95, 100))
        print(f"{name:14} nearer by {most} mm, beyond {UNEVEN_FRICTION_M * 1e3} mm: {beyond:.1%}", flush=True)


if __name__ == "__main__":
    main()
