"""What a bound field costs, how far it is off, and how many motions a second it prices and checks.

    python benchmarks/bound_field.py [ROBOT.toml]

Motions go from one random joint vector to another, rotations before translations, and are checked against a tube of
anatomy around the robot; one thread, one call into the core each.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits
from ctrplan.motion.bound_table import BoundTable, tabulated_bounds
from ctrplan.robot.robot import Robot

ROBOT = Path(__file__).parents[1] / "scenarios" / "robots" / "three_tube.toml"
DENSITY = PathDensity(rotation_rad=0.26, translation_m=8e-3, motion_m=15e-3)
MOTIONS = 2000
WALL_M = 0.2  # radius of the tube of anatomy


def main(robot_file: str | Path = ROBOT) -> None:
    robot = load_robot(robot_file)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as cache:  # built anew, and not left to change what this user plans
        os.environ["CTRPLAN_CACHE_DIR"] = cache
        field = tabulated_bounds(robot)
    assert field is not None
    print(f"{robot.name}: {len(field.values):,} grid points, {field.values.nbytes / 1e6:.0f} MB")
    print(f"built in {time.perf_counter() - began:.1f} s")
    print(
        f"added to bounds {field.error.margin_m * 1e3:.2f} mm, largest error {field.error.largest_m * 1e3:.2f} mm, ",
        end="",
    )
    print(f"no answer for {100 * field.error.uncovered:.1f} %\n")
    compare(robot, field)
    print("| | a second | a CPU second | samples each |")
    print("|---|---|---|---|")
    for name, anatomy in (("motions priced, no anatomy", None), ("motions checked against anatomy", tube())):
        rate, cpu_rate, samples = rates(robot, field, anatomy)
        print(f"| {name} | {rate:,.0f} | {cpu_rate:,.0f} | {samples:.1f} |")


def compare(robot: Robot, field: BoundTable) -> None:
    """Looked-up bounds against solved ones."""
    joints = random_joints(robot, 1, 400)
    theta_b, l_b = robot.drive.collars(joints)
    solved = robot.bound_many(theta_b, l_b)
    found = [
        field.check_path(theta_b[k : k + 1], l_b[k : k + 1], None, density=DENSITY, limits=PathLimits())
        for k in range(len(joints))
    ]
    usable = np.array([f.status[0] == Status.CONVERGED for f in found]) & (solved.status != Status.FAILED)
    excess = np.array([f.position_m[0] for f in found])[usable] - solved.position_m[usable]
    tips = np.linalg.norm(np.array([f.tip_m[0] for f in found])[usable] - solved.tip_m[usable], axis=1)
    print("| mm | median | 95 % | 99 % | largest |")
    print("|---|---|---|---|---|")
    for name, values in (("bound above the true one", excess), ("bound below it", -excess), ("tip off", tips)):
        print(f"| {name} | " + " | ".join(f"{q:.2f}" for q in 1e3 * np.quantile(values, [0.5, 0.95, 0.99, 1.0])) + " |")
    print()


def rates(robot: Robot, field: BoundTable, anatomy: Field | None) -> tuple[float, float, float]:
    """Motions a second by the clock and of CPU time, and samples a motion."""
    starts, ends = random_joints(robot, 2, MOTIONS), random_joints(robot, 3, MOTIONS)
    turns = robot.drive.is_rotation
    corners = [robot.drive.collars(np.array([a, np.where(turns, b, a), b])) for a, b in zip(starts, ends, strict=True)]
    samples, began, cpu = 0, time.perf_counter(), time.process_time()
    for theta_b, l_b in corners:
        found = field.check_path(theta_b, l_b, anatomy, density=DENSITY, limits=PathLimits(clearance_m=-1.0))
        samples += len(found.status)
    return MOTIONS / (time.perf_counter() - began), MOTIONS / (time.process_time() - cpu), samples / MOTIONS


def random_joints(robot: Robot, seed: int, count: int) -> np.ndarray:
    drive = robot.drive
    low, high = np.where(drive.wraps, -np.pi, drive.lower), np.where(drive.wraps, np.pi, drive.upper)
    return np.random.default_rng(seed).uniform(low, high, (count, len(drive.joints)))


def tube() -> Field:
    """Distances to a tube around the z axis, positive inside."""
    x = np.arange(-62, 63) * 4e-3
    radius = np.hypot(*np.meshgrid(x, x, indexing="ij"))
    values = np.repeat((WALL_M - radius)[:, :, None], 125, axis=2).astype(np.float32)
    return Field(np.ascontiguousarray(values), np.array([x[0], x[0], -0.1]), 4e-3, np.eye(3), np.zeros(3))


if __name__ == "__main__":
    main(*sys.argv[1:])
