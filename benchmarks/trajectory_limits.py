"""Do random trajectories keep the drive's limits and their legs, and are they as short as they can be?

    python benchmarks/trajectory_limits.py [--legs 10000] [--seed 0]

Random plans of ten legs on drives of one to six joints: rotations only, translations only, or all joints at once, as a
planner's legs are, from a thousandth of the workspace to all of it. Exits with 1 where a promise is broken.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ctrplan.drive.trajectory
from ctrplan.drive.drive import Drive, Joint, Kind
from ctrplan.drive.legs import distance_from_leg, merge_legs
from ctrplan.drive.trajectory import QUANTITIES, distance_from_legs, time_parameterise, verify_limits

FloatArray = NDArray[np.float64]

# Only ctrplan.drive.trajectory imports ruckig; here it is compared with its own synchronisation.
ruckig: Any = ctrplan.drive.trajectory.ruckig  # type: ignore[attr-defined]
LEGS_PER_PLAN = 10
FAST_ROTATION, FAST_TRANSLATION = (1.0, 4.0, 40.0), (0.01, 0.05, 0.5)  # per s, s^2, s^3


@dataclass
class Totals:
    """Worst values and sums over all legs."""

    ratio: dict[str, float] = field(default_factory=lambda: dict.fromkeys(QUANTITIES, 0.0))
    exceeded: int = 0
    deviation: float = 0.0
    stops: int = 0
    samples: int = 0
    duration_s: float = 0.0
    line_optimum_s: float = 0.0
    unmerged_optimum_s: float = 0.0
    joint_optimum_s: float = 0.0
    elapsed_s: float = 0.0
    profiles_elapsed_s: float = 0.0
    fallbacks: int = 0
    phase_difference: float = 0.0
    phase_deviation: float = 0.0
    phase_elapsed_s: float = 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--legs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng, totals = np.random.default_rng(arguments.seed), Totals()
    plans = max(arguments.legs // LEGS_PER_PLAN, 1)
    for _ in range(plans):
        drive = random_drive(rng)
        waypoints = random_plan(rng, drive)
        add_plan(totals, waypoints, drive)
        totals.unmerged_optimum_s += sum(straight_line_optimum(b - a, drive) for a, b in pairwise(waypoints))
        for start, end in pairwise(merge_legs(waypoints)):
            add_leg(totals, start, end, drive)
    print_table(totals, plans * LEGS_PER_PLAN, plans + totals.stops)
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
    begin = time.perf_counter()
    time_parameterise(waypoints, drive, period_s=1e6)
    totals.profiles_elapsed_s += time.perf_counter() - begin
    for joint in verify_limits(trajectory, drive).values():
        for quantity, ratio in joint.items():
            totals.ratio[quantity] = max(totals.ratio[quantity], ratio)
            totals.exceeded += ratio > 1 + 1e-9
    totals.deviation = max(totals.deviation, distance_from_legs(trajectory, merge_legs(waypoints)))
    totals.stops += trajectory.stops
    totals.samples += len(trajectory.time_s)
    totals.duration_s += trajectory.duration_s


def add_leg(totals: Totals, start: FloatArray, end: FloatArray, drive: Drive) -> None:
    """The leg's own optimum, and what ruckig's Synchronization.Phase makes of it."""
    line_s = straight_line_optimum(end - start, drive)
    begin = time.perf_counter()
    phase = phase_synchronised(start, end, drive)
    totals.phase_elapsed_s += time.perf_counter() - begin
    totals.line_optimum_s += line_s
    totals.joint_optimum_s += max(phase.independent_min_durations)
    samples = np.array([phase.at_time(t)[0] for t in np.linspace(0, phase.duration, 20)])
    deviation = float(distance_from_leg(samples, start, end).max() / np.linalg.norm(end - start))
    if deviation > 1e-9:
        totals.fallbacks += 1
        totals.phase_deviation = max(totals.phase_deviation, deviation)
    else:
        totals.phase_difference = max(totals.phase_difference, abs(phase.duration / line_s - 1))


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


def phase_synchronised(start: FloatArray, end: FloatArray, drive: Drive) -> Any:
    request, answer = ruckig.InputParameter(len(start)), ruckig.Trajectory(len(start))
    request.current_position, request.target_position = start.tolist(), end.tolist()
    request.max_velocity, request.max_acceleration = drive.max_velocity.tolist(), drive.max_acceleration.tolist()
    request.max_jerk, request.synchronization = drive.max_jerk.tolist(), ruckig.Synchronization.Phase
    ruckig.Ruckig(len(start)).calculate(request, answer)
    return answer


def print_table(totals: Totals, legs: int, driven: int) -> None:
    rows = [
        (f"limits exceeded, {legs} legs", f"{totals.exceeded}"),
        *((f"worst {name} / limit - 1", f"{totals.ratio[name] - 1:.1e}") for name in QUANTITIES),
        ("worst distance from the leg (rad, m)", f"{totals.deviation:.1e}"),
        ("total duration", f"{totals.duration_s:.1f} s"),
        ("... / sum of the driven legs' optima on the line", f"{totals.duration_s / totals.line_optimum_s:.12f}"),
        ("... / sum of the legs' optima without merging", f"{totals.duration_s / totals.unmerged_optimum_s:.4f}"),
        ("... / sum of the slowest joints' optima, any path", f"{totals.duration_s / totals.joint_optimum_s:.4f}"),
        ("legs driven after merging collinear ones", f"{driven}"),
        ("interior stops", f"{totals.stops}"),
        ("time per leg, profile, samples and checks", f"{totals.elapsed_s / legs * 1e6:.0f} us"),
        ("samples per leg (period 0.01 s)", f"{totals.samples / legs:.0f}"),
        ("... time per leg with two samples a plan", f"{totals.profiles_elapsed_s / legs * 1e6:.0f} us"),
        ("Synchronization.Phase: driven legs where it leaves the line", f"{totals.fallbacks / driven:.1%}"),
        ("... by up to, relative to the leg", f"{totals.phase_deviation:.1%}"),
        ("... elsewhere, largest relative difference in duration", f"{totals.phase_difference:.1e}"),
        ("... time per leg, profile only", f"{totals.phase_elapsed_s / driven * 1e6:.0f} us"),
    ]
    for name, value in rows:
        print(f"{name:<60}{value:>18}")


if __name__ == "__main__":
    sys.exit(main())
