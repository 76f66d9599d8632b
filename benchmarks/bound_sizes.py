"""Times and peak memory of one bound for 2 to 12 tubes, and what the extreme corners miss of all of them.

python benchmarks/bound_sizes.py [times | extremes]
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from typing import Any

import numpy as np

from ctrplan.errors import CtrplanError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot

MOST_TUBES = 12
CONFIGURATIONS = 40  # per number of tubes, for what extremes miss
COLLAR_MM = 5.0


def nested_robot(n: int, friction: float = 0.2) -> Robot:
    """A robot of n curved tubes, each stiffer than the one within."""
    tubes: list[dict[str, Any]] = [
        {
            "outer_diameter_mm": 1.0 + 0.5 * (n - 1 - i),
            "inner_diameter_mm": 0.7 + 0.5 * (n - 1 - i),
            "bending_stiffness_Nm2": 0.01 * 1.6 ** (n - 1 - i),
            "poisson_ratio": 0.3,
            "collar_length_mm": COLLAR_MM,
            "section": [
                {"length_mm": 30 + 15 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 0},
                {"length_mm": 40, "curvature_x_per_m": 0, "curvature_y_per_m": 5 + 1.5 * i},
            ],
        }
        for i in range(n)
    ]
    return robot_from_dict({"tube": tubes, "contact": [{"friction_coefficient": friction}] * (n - 1)})


def anywhere(n: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Collars (n,) [rad], (n,) [m], tubes 5 to 10 mm behind each other."""
    apart = random.uniform(COLLAR_MM, 2 * COLLAR_MM, n) * 1e-3
    return random.uniform(-np.pi, np.pi, n), -np.concatenate([[0.0], np.cumsum(apart[1:])])


def measured(n: int, corners: str, line: Any) -> None:
    """Sends time [s], peak memory above that before [MB] and the corners of one bound; in a process of its own."""
    robot = nested_robot(n)
    theta_b, l_b = anywhere(n, np.random.default_rng(n))
    robot.zero_clearance(theta_b, l_b)
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    try:
        found = robot.bound(theta_b, l_b, corners=corners)
    except CtrplanError as refusal:
        line.send(str(refusal))
        return
    took, peak = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line.send((took, (peak - before) / 1024, len(found.corners), found.position_m * 1e3))


def times() -> None:
    """Prints a row per number of tubes."""
    print("tubes   all: corners  time (s)  memory (MB)  bound (mm)   extreme: kept  time (s)  memory (MB)  bound (mm)")
    for n in range(2, MOST_TUBES + 1):
        row = f"{n:5d}"
        for corners in ("all", "extreme"):
            here, there = multiprocessing.Pipe()
            process = multiprocessing.get_context("spawn").Process(target=measured, args=(n, corners, there))
            process.start()
            found = here.recv()
            process.join()
            row += (
                f"{'refused':>45}" if isinstance(found, str) else "{2:18d} {0:9.3f} {1:12.0f} {3:11.3f}".format(*found)
            )
        print(row, flush=True)


def extremes() -> None:
    """Prints by how much the bound by extremes falls short of that over all corners."""
    print("tubes  configurations  largest shortfall of position (%)  of tangent (%)  exactly the same")
    for n in range(3, 7):
        random, short = np.random.default_rng(n), []
        for _ in range(CONFIGURATIONS):
            robot = nested_robot(n, friction=random.uniform(0.05, 0.4))
            q = anywhere(n, random)
            whole, part = (robot.bound(*q, corners=corners) for corners in ("all", "extreme"))  # type: ignore[arg-type]
            short.append([1 - part.position_m / whole.position_m, 1 - part.tangent_rad / whole.tangent_rad])
        worst = 100 * np.nanmax(short, axis=0)
        same = np.mean(np.nanmax(short, axis=1) < 1e-6)
        print(f"{n:5d} {len(short):15d} {worst[0]:34.4f} {worst[1]:15.4f} {same:16.0%}", flush=True)


if __name__ == "__main__":
    {"times": times, "extremes": extremes}[sys.argv[1] if len(sys.argv) > 1 else "times"]()
