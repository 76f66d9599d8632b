"""How fast is inverse kinematics? Zero-clearance solves a second from random starts to tips of random configurations.

python benchmarks/inverse_kinematics.py [--count N]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from ctrplan.files.robot_file import load_robot
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.tip_solver import REACHED_M, TipSolver, TipTarget

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"


def row(name: str, count: int) -> str:
    robot = load_robot(ROBOTS / f"{name}.toml")
    space, rng = JointSpace.of_robot(robot), np.random.default_rng(0)
    solver = TipSolver(space, robot.mechanics)
    tips, _ = solver.tips(space.sample(rng, count))
    starts = space.sample(rng, count)
    wall, processor = time.perf_counter(), time.process_time()
    found = solver.solve(TipTarget(tips), starts)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    reached = int(np.sum(found.error_m <= REACHED_M))
    return f"| {name} | {100 * reached / count:.1f} % | {reached / wall:.0f} | {reached / processor:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    count = parser.parse_args().count
    print("| robot | reached within 0.01 mm | solves a second | solves a second of processor time |\n|---|---|---|---|")
    for name in ("three_tube", "three_tube_calibrated", "three_tube_insertion", "table_5_pair"):
        print(row(name, count), flush=True)


if __name__ == "__main__":
    main()
