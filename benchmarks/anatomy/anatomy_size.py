"""What large anatomies cost: reading, distance field, search and certificate of a plan among many spheres.

python benchmarks/run.py anatomy_size spheres [COUNT ...]       # default: 10 to 10,000
"""

import os
import shutil
import tempfile
import time
from pathlib import Path

import common
import numpy as np
from common import ROBOTS, table

import ctrplan

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
        f'[{where}]\n"rotate outer" = 0\n"rotate middle" = {turn}\n"rotate inner" = 0\n"translate inner" = -86.4\n'
        for where, turn in (("start", 0), ("goal.joints", 90))
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
    print_spheres(common.arguments(__doc__, ("section", ["spheres"]), "counts*").counts)
