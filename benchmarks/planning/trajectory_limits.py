"""Do random trajectories keep the drive's limits and their legs, and are they as short as they can be?

    python benchmarks/run.py trajectory_limits [--legs 10000] [--seed 0]

Random plans of ten legs on drives of one to six joints: rotations only, translations only, or all joints at once, as a
planner's legs are, from a thousandth of the workspace to all of it. Exits with 1 where a promise is broken.
"""

import time
from dataclasses import dataclass, field
from itertools import pairwise

import common
import numpy as np
from common import table
from numpy.typing import NDArray

from ctrplan.drive.drive import Drive, Joint, Kind
from ctrplan.drive.legs import merge_legs
from ctrplan.drive.trajectory import QUANTITIES, distance_from_legs, time_parameterise, verify_limits

FloatArray = NDArray[np.float64]

LEGS_PER_PLAN = 10
FAST_ROTATION, FAST_TRANSLATION = (1.0, 4.0, 40.0), (0.01, 0.05, 0.5)  # per s, s^2, s^3


@dataclass
class Totals:
    """Worst values and sums over all legs."""

    ratio: dict[str, float] = field(default_factory=lambda: dict.fromkeys(QUANTITIES, 0.0))
    exceeded: int = 0
    deviation: float = 0.0
    stops: int = 0
    duration_s: float = 0.0
    line_optimum_s: float = 0.0
    elapsed_s: float = 0.0


def main() -> int:
    parser = common.parser(__doc__)
    parser.add_argument("--legs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng, totals = np.random.default_rng(arguments.seed), Totals()
    plans = max(arguments.legs // LEGS_PER_PLAN, 1)
    for _ in range(plans):
        drive = random_drive(rng)
        waypoints = random_plan(rng, drive)
        add_plan(totals, waypoints, drive)
        merged = pairwise(merge_legs(waypoints))
        totals.line_optimum_s += sum(straight_line_optimum(b - a, drive) for a, b in merged)
    print_table(totals, plans * LEGS_PER_PLAN)
    kept = totals.exceeded == 0 and totals.deviation <= 1e-12
    return 0 if kept and totals.duration_s <= 1.000001 * totals.line_optimum_s else 1


def random_drive(rng: np.random.Generator) -> Drive:
    joints = []
    for i in range(rng.integers(1, 7)):
        rotation = rng.random() < 0.5
        limits = np.array(FAST_ROTATION if rotation else FAST_TRANSLATION) * 10 ** rng.uniform(-0.5, 0.5, 3)
        reach = np.inf if rotation else 0.1
        kind: Kind = "rotation" if rotation else "translation"
        joints.append(Joint(f"joint {i}", kind, np.ones(1), -reach, reach, *limits))
    return Drive(tuple(joints), np.zeros(1), np.zeros(1))


def random_plan(rng: np.random.Generator, drive: Drive) -> FloatArray:
    """Waypoints (LEGS_PER_PLAN + 1, m); each leg moves the joints of one kind, or all of them."""
    reach = np.where(drive.is_rotation, 2 * np.pi, 0.1)
    waypoints = [rng.uniform(-reach, reach)]
    while len(waypoints) <= LEGS_PER_PLAN:
        moving = (drive.is_rotation, ~drive.is_rotation, np.ones_like(drive.is_rotation))[rng.integers(3)]
        target = rng.uniform(-reach, reach)
        if moving.any():
            waypoints.append(waypoints[-1] + moving * 10 ** rng.uniform(-3, 0) * (target - waypoints[-1]))
    return np.array(waypoints)


def add_plan(totals: Totals, waypoints: FloatArray, drive: Drive) -> None:
    begin = time.perf_counter()
    trajectory = time_parameterise(waypoints, drive)
    totals.elapsed_s += time.perf_counter() - begin
    for joint in verify_limits(trajectory, drive).values():
        for quantity, ratio in joint.items():
            totals.ratio[quantity] = max(totals.ratio[quantity], ratio)
            totals.exceeded += ratio > 1 + 1e-9
    totals.deviation = max(totals.deviation, distance_from_legs(trajectory, merge_legs(waypoints)))
    totals.stops += trajectory.stops
    totals.duration_s += trajectory.duration_s


def straight_line_optimum(delta: FloatArray, drive: Drive) -> float:
    """Closed form of the shortest rest-to-rest motion along delta (m,) [s], independent of ruckig."""
    moved = delta != 0
    limits = np.stack([drive.max_velocity, drive.max_acceleration, drive.max_jerk])[:, moved]
    v, a, j = (limits / np.abs(delta[moved])).min(axis=1)
    ramp = v / min(a, np.sqrt(v * j)) + min(a, np.sqrt(v * j)) / j
    if v * ramp <= 1:  # the speed limit is reached
        return float(1 / v + ramp)
    peak = (np.sqrt((a / j) ** 2 + 4 / a) - a / j) * a / 2
    return float(2 * (peak / a + a / j) if peak * j >= a * a else 4 * np.cbrt(1 / (2 * j)))


def print_table(totals: Totals, legs: int) -> None:
    rows = [
        (f"limits exceeded, {legs} legs", f"{totals.exceeded}"),
        *((f"worst {name} / limit - 1", f"{totals.ratio[name] - 1:.1e}") for name in QUANTITIES),
        ("worst distance from the leg (rad, m)", f"{totals.deviation:.1e}"),
        ("... / sum of the driven legs' optima on the line", f"{totals.duration_s / totals.line_optimum_s:.12f}"),
        ("interior stops", f"{totals.stops}"),
        ("time per leg, profile, samples and checks", f"{totals.elapsed_s / legs * 1e6:.0f} us"),
    ]
    table("random trajectories", ("", "found"), rows)
