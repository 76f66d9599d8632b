"""Time of a plan among 10 to 10,000 spheres: reading, distance field, search, certificate.

python benchmarks/many_primitives.py [COUNT ...]
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import ctrplan

ROBOT = Path(ctrplan.__file__).parent / "scenarios" / "robots" / "three_tube.toml"
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


def main() -> None:
    """Prints a row per number of spheres."""
    print("spheres  read (s)  plan (s), of which search 3 s")
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(ROBOT, folder)
        os.environ["CTRPLAN_CACHE_DIR"] = folder  # nothing is known beforehand
        for count in [int(text) for text in sys.argv[1:]] or COUNTS:
            path, begun = scenario(Path(folder), count), time.perf_counter()
            read = ctrplan.load_scenario(path)
            loaded = time.perf_counter()
            plan = ctrplan.plan(read, seed=1)
            took = time.perf_counter() - loaded
            print(
                f"{count:7d} {loaded - begun:9.2f} {took:9.1f}   valid {plan.certificate.valid}",
                flush=True,
            )


if __name__ == "__main__":
    main()
