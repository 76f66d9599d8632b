"""How much disk and time do distance fields of 20 base poses take, as bricks of the anatomy and as grids of each pose?

    python benchmarks/anatomy_bricks.py [ribs vessel ...]

Bases are moved by some 5 mm and turned by some 10 deg (standard deviations, each axis) from the scenario's.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.anatomy_field import anatomy_field, shared_spacing_m
from ctrplan.anatomy.clearance_grid import build_field, default_spacing_m, field_bounds
from ctrplan.base.arrays import Array
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario

POSES, MOVED_M, TURNED_RAD = 20, 5e-3, np.radians(10)
SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"


def bases(scenario: Scenario) -> list[tuple[Array, Array]]:
    """Base positions (3,) [m] and rotations (3, 3), the scenario's own first."""
    rng = np.random.default_rng(0)
    moved = rng.normal(scale=MOVED_M, size=(POSES, 3))
    turned = Rotation.from_rotvec(rng.normal(scale=TURNED_RAD, size=(POSES, 3))).as_matrix()
    moved[0], turned[0] = 0.0, np.eye(3)
    return [(scenario.base_position_m + m, scenario.base_R @ t) for m, t in zip(moved, turned, strict=True)]


def grids(scenario: Scenario, reach_m: float, base: tuple[Array, Array]) -> None:
    """A grid for this base alone."""
    lower, upper = field_bounds(scenario.anatomy, reach_m, *base)
    build_field(scenario.anatomy, lower, upper, default_spacing_m(lower, upper))


def bricks(scenario: Scenario, reach_m: float, base: tuple[Array, Array]) -> None:
    """The anatomy's bricks around this base."""
    lower, upper = field_bounds(scenario.anatomy, reach_m, *base)
    spacing_m = shared_spacing_m(scenario.anatomy, reach_m)
    anatomy_field(scenario.anatomy, lower, upper, spacing_m, base_position_m=base[0], reach_m=reach_m)


def row(name: str, field: Callable[[Scenario, float, tuple[Array, Array]], None]) -> str:
    """Disk, time of the first pose, of the others, and of all again from disk."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    reach_m = max(tube.length_m for tube in scenario.robot.tubes) + scenario.robot.tubes[0].outer_diameter_m
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CTRPLAN_CACHE_DIR"] = folder
        seconds = []
        for base in bases(scenario) * 2:
            began = time.perf_counter()
            field(scenario, reach_m, base)
            seconds.append(time.perf_counter() - began)
        megabytes = sum(file.stat().st_size for file in Path(folder).rglob("*.grid")) / 1e6
    times = seconds[0], sum(seconds[1:POSES]), sum(seconds[POSES:]) / POSES
    return f"{name:>14} {field.__name__:>7} {megabytes:9.1f} {times[0]:9.2f} {times[1]:11.2f} {times[2]:10.3f}"


def main() -> None:
    """Prints the table."""
    print(f"{'scenario':>14} {'kept as':>7} {'disk MB':>9} {'first s':>9} {'19 more s':>11} {'again s':>10}")
    for name in sys.argv[1:] or ["ribs", "ventricle"]:
        for field in (grids, bricks):
            print(row(name, field), flush=True)


if __name__ == "__main__":
    main()
