"""Do random trajectories keep the drive's limits and their legs?

    python benchmarks/run.py trajectory_limits [--legs 10000] [--seed 0]

Random plans of ten legs on drives of one to six joints: rotations only, translations only, or all joints at once, as a
planner's legs are, from a thousandth of the workspace to all of it. Exits with 1 where a promise is broken. That
they are as short as they can be is shown by tests/drive/test_trajectory.py.
"""

import common
import numpy as np
from common import table

from ctrplan import Drive, Joint
from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Kind
from ctrplan.drive.legs import merge_legs
from ctrplan.drive.trajectory import QUANTITIES, distance_from_legs, time_parameterise, verify_limits

LEGS_PER_PLAN = 10
FAST_ROTATION, FAST_TRANSLATION = (1.0, 4.0, 40.0), (0.01, 0.05, 0.5)  # per s, s^2, s^3


def main() -> int:
    given = common.arguments(__doc__, legs=10_000, seed=0)
    rng, plans = np.random.default_rng(given.seed), max(given.legs // LEGS_PER_PLAN, 1)
    worst, exceeded, deviation = dict.fromkeys(QUANTITIES, 0.0), 0, 0.0
    for _ in range(plans):
        drive = random_drive(rng)
        waypoints = random_plan(rng, drive)
        trajectory = time_parameterise(waypoints, drive)
        for quantity, ratio in (item for joint in verify_limits(trajectory, drive).values() for item in joint.items()):
            worst[quantity] = max(worst[quantity], ratio)
            exceeded += ratio > 1 + 1e-9
        deviation = max(deviation, distance_from_legs(trajectory, merge_legs(waypoints)))
    rows = [(f"limits exceeded, {plans * LEGS_PER_PLAN} legs", f"{exceeded}")]
    rows += [(f"worst {name} / limit - 1", f"{ratio - 1:.1e}") for name, ratio in worst.items()]
    table("random trajectories", ("", "found"), [*rows, ("worst distance from the leg (rad, m)", f"{deviation:.1e}")])
    return int(exceeded > 0 or deviation > 1e-12)


def random_drive(rng: np.random.Generator) -> Drive:
    joints = []
    for i in range(rng.integers(1, 7)):
        rotation = rng.random() < 0.5
        limits = np.array(FAST_ROTATION if rotation else FAST_TRANSLATION) * 10 ** rng.uniform(-0.5, 0.5, 3)
        reach = np.inf if rotation else 0.1
        kind: Kind = "rotation" if rotation else "translation"
        joints.append(Joint(f"joint {i}", kind, np.ones(1), -reach, reach, *limits))
    return Drive(tuple(joints), np.zeros(1), np.zeros(1))


def random_plan(rng: np.random.Generator, drive: Drive) -> Array:
    """Waypoints (LEGS_PER_PLAN + 1, m); each leg moves the joints of one kind, or all of them."""
    reach = np.where(drive.is_rotation, 2 * np.pi, 0.1)
    waypoints = [rng.uniform(-reach, reach)]
    while len(waypoints) <= LEGS_PER_PLAN:
        moving = (drive.is_rotation, ~drive.is_rotation, np.ones_like(drive.is_rotation))[rng.integers(3)]
        target = rng.uniform(-reach, reach)
        if moving.any():
            waypoints.append(waypoints[-1] + moving * 10 ** rng.uniform(-3, 0) * (target - waypoints[-1]))
    return np.array(waypoints)
