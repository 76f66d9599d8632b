"""What large anatomies cost: bricks of distance fields for many base poses, and plans among many spheres.

    python benchmarks/run.py anatomy_size bricks [SCENARIO ...]     # default: ribs ventricle
    python benchmarks/run.py anatomy_size spheres [COUNT ...]       # default: 10 to 10,000

bricks: disk and time of fields of 20 base poses, as bricks of the anatomy and as grids of each pose. Bases are moved by
some 5 mm and turned by some 10 deg (standard deviations, each axis) from the scenario's. spheres: reading, distance
field, search and certificate of a plan.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import common
import numpy as np
from common import ROBOTS, SCENARIOS, table
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.anatomy.clearance_grid import (
    COARSEST,
    anatomy_field,
    content_key,
    default_spacing_m,
    field_bounds,
    grid_distance,
    shared_spacing_m,
)
from ctrplan.anatomy.parts import combined_clearance
from ctrplan.base.arrays import Array
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage import cache

POSES, MOVED_M, TURNED_RAD = 20, 5e-3, np.radians(10)


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
    spacing_m = default_spacing_m(lower, upper)
    nx, ny, nz = (int(n) * COARSEST + 1 for n in np.ceil((upper - lower) / (COARSEST * spacing_m)))
    key = content_key(scenario.anatomy, lower, spacing_m, (nx, ny, nz))
    if cache.load(key, (nx, ny, nz)) is None:
        values = combined_clearance(
            scenario.anatomy, lambda part: grid_distance(part, lower, spacing_m, (nx, ny, nz), lambda _: None)
        )
        cache.store_all({key: values.astype(np.float32)})


def bricks(scenario: Scenario, reach_m: float, base: tuple[Array, Array]) -> None:
    """The anatomy's bricks around this base."""
    lower, upper = field_bounds(scenario.anatomy, reach_m, *base)
    spacing_m = shared_spacing_m(scenario.anatomy, reach_m)
    anatomy_field(scenario.anatomy, lower, upper, spacing_m, base_position_m=base[0], reach_m=reach_m)


def brick_row(name: str, field: Callable[[Scenario, float, tuple[Array, Array]], None]) -> tuple[object, ...]:
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
    return name, field.__name__, f"{megabytes:.1f}", *(f"{seconds:.2f}" for seconds in times)


def print_bricks(names: list[str]) -> None:
    rows = [brick_row(name, field) for name in names or ["ribs", "ventricle"] for field in (grids, bricks)]
    head = ("scenario", "kept as", "disk, MB", "first, s", f"{POSES - 1} more, s", "again, s")
    table("fields of 20 base poses", head, rows)


ROBOT = ROBOTS / "three_tube.toml"
COUNTS = (10, 100, 1000, 3000, 10_000)
RADIUS_MM = (0.5, 2.0)
BOX_MM = ((-120, -120, 0), (120, 120, 220))
FREE_MM = 45.0  # around the axis, so that there is a way; the robot still passes some


def scenario(folder: Path, count: int) -> Path:
    """A file with so many spheres around the robot, which turns by 90 degrees."""
    random, rows = np.random.default_rng(count), []
    while len(rows) < count:
        center, radius = random.uniform(*BOX_MM), random.uniform(*RADIUS_MM)
        if np.hypot(*center[:2]) - radius > FREE_MM:
            x, y, z = center.round(3).tolist()
            rows.append(f'[[anatomy]]\nkind = "sphere"\ncenter_mm = [{x}, {y}, {z}]\nradius_mm = {radius:.3f}\n')
    joints = [
        '[start]\n"rotate outer" = 0\n"rotate middle" = 0\n"rotate inner" = 0\n"translate inner" = -86.4\n',
        '[goal.joints]\n"rotate outer" = 0\n"rotate middle" = 90\n"rotate inner" = 0\n"translate inner" = -86.4\n',
    ]
    text = (
        f'name = "spheres"\nrobot = "{ROBOT.name}"\n' + "\n".join(joints) + "[planner]\ntime_s = 3\n" + "\n".join(rows)
    )
    path = folder / f"spheres_{count}.toml"
    path.write_text(text)
    return path


def print_spheres(counts: list[str]) -> None:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(ROBOT, folder)
        os.environ["CTRPLAN_CACHE_DIR"] = folder  # nothing is known beforehand
        for count in map(int, counts) if counts else COUNTS:
            path, begun = scenario(Path(folder), count), time.perf_counter()
            read = ctrplan.load_scenario(path)
            loaded = time.perf_counter()
            valid = ctrplan.plan(read, seed=1).certificate.valid
            took = time.perf_counter() - loaded
            rows.append((f"{count:,}", f"{loaded - begun:.1f}", f"{took:.0f}", "yes" if valid else "NO"))
    table("plans among spheres, of which search 3 s", ("spheres", "read, s", "plan, s", "certified"), rows)


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("section", choices=["bricks", "spheres"])
    parser.add_argument("which", nargs="*")
    given = parser.parse_args()
    {"bricks": print_bricks, "spheres": print_spheres}[given.section](given.which)
