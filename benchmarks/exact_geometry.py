"""How far is accuracy="exact" from independent solutions, what does it cost, and how fast do meshes converge?

    python benchmarks/exact_geometry.py [pairs] [bent] [order] [points] [robots] [speed]    (all if none is named)

Processor times of this process, which other work on the machine stretches less than the clock.
"""

import itertools
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import Tube, TubeSection

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / place) for place in ("oracles", "support")]
import paper_oracle as paper  # noqa: E402
from table_1_pair import table_1_pair  # noqa: E402

ROBOTS = ROOT / "scenarios" / "robots"
PAIRS = json.loads((ROOT / "tests" / "reference" / "pair_values.json").read_text())
ACCURACIES: tuple[Any, ...] = ("certificate", "exact")


def distance_mm(a: Any, b: Any) -> float:
    return 1e3 * float(np.linalg.norm(np.subtract(a, b)))


def pairs() -> None:
    """Largest tip errors against pair_values.json, frictionless over ten angles and with friction at 180 deg."""
    print("\nTable I pair, largest tip errors\nclearance mm  accuracy     frictionless mm  friction mm  % of deviation")
    table = PAIRS["table_I_pair"]
    for clearance_m, accuracy in itertools.product((1e-5, 5e-5, 2.5e-4, 1e-3, 3e-3), ACCURACIES):
        free, stuck = [], []
        for row in table["deviation_from_zero_clearance"]:
            if row["clearance_m"] == clearance_m:
                q = np.deg2rad([0, row["base_angle_deg"]]), [0, -0.017]
                free.append(distance_mm(table_1_pair(clearance_m, 0).solve(*q, accuracy=accuracy).tip_m, row["tip_m"]))
        for row in table["friction_at_180_deg"]:
            if row["clearance_m"] == clearance_m:
                model = table_1_pair(clearance_m, row["mu"])
                tip_m = model.solve([0, np.pi], [0, -0.017], 1, accuracy=accuracy).tip_m
                stuck.append((distance_mm(tip_m, row["tip_m"]), 1e3 * row["deviation_m"]))
        share = 100 * max(error / deviation for error, deviation in stuck)
        worst = max(error for error, _ in stuck)
        print(f"{1e3 * clearance_m:12g}  {accuracy:11}  {max(free):15.4f}  {worst:11.4f}  {share:14.2f}")


def bent() -> None:
    """Table V pair, 37 angles: friction on a robot that is bent as much as it is turned."""
    robot = load_robot(ROBOTS / "table_5_pair.toml")
    print("\nTable V pair, largest tip errors\naccuracy     frictionless mm  friction mm")
    for accuracy in ACCURACIES:
        free, stuck = [], []
        for row in PAIRS["table_V_pair"]["rows"]:
            bound = robot.bound(np.deg2rad([0, row["base_angle_deg"]]), [0, -0.0604], accuracy=accuracy)
            free.append(distance_mm(bound.frictionless.tip_m, row["zero"]["tip_m"]))
            for name, shape in zip(("plus", "minus"), bound.corners, strict=True):
                stuck.append(distance_mm(shape.tip_m, row[name]["tip_m"]))
        print(f"{accuracy:11}  {max(free):15.4f}  {max(stuck):11.4f}")


def order() -> None:
    """Geometric mean of tip errors of eighteen pairs with friction against 16 times shorter elements."""
    refinements = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
    print("\nmean tip error, nm\naccuracy     " + "".join(f"   1/{r:<5g}" for r in refinements) + "  order")
    for accuracy in ACCURACIES:
        errors = []
        for clearance_m, angle_deg in itertools.product([5e-5, 2.5e-4, 1e-3], [40, 60, 90, 120, 150, 170]):
            model, q = table_1_pair(clearance_m, 0.2), (np.deg2rad([0, angle_deg]), [0, -0.017])
            tips = [model.solve(*q, 1.0, accuracy=accuracy, refinement=float(r)).tip_m for r in (*refinements, 16.0)]
            errors.append([distance_mm(tip, tips[-1]) for tip in tips[:-1]])
        mean = np.exp(np.log(errors).mean(0))
        slope = -np.polyfit(np.log(refinements), np.log(mean), 1)[0]
        print(f"{accuracy:11}  " + "".join(f"  {1e6 * error:7.0f}" for error in mean) + f"  {slope:5.2f}")


def points() -> None:
    """Three-tube robot: tests/reference/three_tube_points.json, and the paper's own algorithm on its first point."""
    robot = load_robot(ROBOTS / "three_tube.toml")
    given = json.loads((ROOT / "tests" / "reference" / "three_tube_points.json").read_text())["points"]
    print("\nthree-tube points, largest distance to the reference\naccuracy     frictionless mm  friction mm")
    for accuracy in ACCURACIES:
        free, stuck = [], []
        for point in given:
            bound = robot.bound(np.deg2rad(point["theta_b_deg"]), point["l_b_m"], accuracy=accuracy)
            free.append(distance_mm(bound.frictionless.tip_m, point["tip_m"]["0,0"]))
            for signs, shape in zip(itertools.product("+-", repeat=2), bound.corners, strict=True):
                stuck.append(distance_mm(shape.tip_m, point["tip_m"][",".join(signs)]))
        print(f"{accuracy:11}  {max(free):15.4f}  {max(stuck):11.4f}")
    q = np.deg2rad(given[0]["theta_b_deg"]), given[0]["l_b_m"]
    nodes = paper.mesh(robot.tubes, q[1], 2.5e-3, 5e-4, 5e-3)
    problem = paper.Problem(robot.tubes, robot.clearance_m, robot.friction[:, 1], *q, (1.0, 1.0), nodes)
    tip_m = paper.refine(problem).tip_m
    tips = {accuracy: robot.solve(*q, 1.0, accuracy=accuracy).tip_m for accuracy in ACCURACIES}
    tips["reference"] = np.array(given[0]["tip_m"]["+,+"])
    apart = ", ".join(f"{name} {distance_mm(tip, tip_m):.3f}" for name, tip in tips.items())
    print(f"first point, phi = (1, 1), mm from the paper's algorithm on 223 nodes: {apart}")


def robots() -> None:
    """Random robots of 2 to 4 tubes, clearances of 0.01 mm to the 2 % rule: do all corners converge?"""
    failed, differ = dict.fromkeys(ACCURACIES, 0), []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = 2 + seed % 3
        model, theta_b, l_b = random_robot(rng, n)
        bounds = {accuracy: model.bound(theta_b, l_b, accuracy=accuracy) for accuracy in ACCURACIES}
        for accuracy, bound in bounds.items():
            failed[accuracy] += any(s.status is Status.FAILED for s in (bound.frictionless, *bound.corners))
        differ.append(distance_mm(*(bounds[accuracy].frictionless.tip_m for accuracy in ACCURACIES)))
    print(f"\n200 random robots: configurations with a failed shape {failed},")
    print("frictionless tips apart, mm: median {:.3f}, 95 % {:.3f}".format(*np.quantile(differ, (0.5, 0.95))))


def random_robot(rng: np.random.Generator, n: int) -> tuple[Mechanics, Any, Any]:
    curvature = rng.uniform(-15, 15, n)
    gaps = [10 ** rng.uniform(-5, np.log10(0.02 / 15)) for _ in range(n - 1)]
    base, tip, diameter, tubes, l_b = -rng.uniform(0, 0.02), rng.uniform(0.05, 0.12), 8e-3, [], []
    for i in range(n):
        wall, length = rng.uniform(2e-4, 4e-4), tip - base
        curved = rng.uniform(0.3, 0.9) * tip
        sections = (TubeSection(length - curved, 0.0, 0.0), TubeSection(curved, rng.uniform(-1, 1), curvature[i]))
        tubes.append(
            Tube(diameter, diameter - wall, 10 ** rng.uniform(-3, -1), rng.uniform(-0.3, 0.5), sections, 0.005)
        )
        l_b.append(base)
        if i + 1 < n:
            diameter -= wall + 2 * gaps[i]
            base, tip = base - rng.uniform(0.006, 0.04), tip + rng.uniform(0, 0.04)
    return Mechanics(tubes, gaps, rng.uniform(0, 0.5, n - 1)), rng.uniform(-np.pi, np.pi, n), l_b


def speed() -> None:
    """A bound (frictionless and four corners) of the three-tube robot on random joints."""
    robot, rng = load_robot(ROBOTS / "three_tube.toml"), np.random.default_rng(0)
    joints = [(rng.uniform(-np.pi, np.pi, 3), [0, -0.017, rng.uniform(-0.1204, -0.034)]) for _ in range(100)]
    print("\nbound of three tubes, ms of processor time\naccuracy       least  median    95 %  failed")
    for accuracy in ("search", *ACCURACIES):
        taken, failed = [], 0
        for q in joints:
            start = time.process_time()
            bound = robot.bound(*q, accuracy=accuracy)
            taken.append(1e3 * (time.process_time() - start))
            failed += any(shape.status is Status.FAILED for shape in bound.corners)
        print(f"{accuracy:12}" + "".join(f"{x:8.2f}" for x in np.quantile(taken, (0, 0.5, 0.95))) + f"{failed:8}")


if __name__ == "__main__":
    sections = {"pairs": pairs, "bent": bent, "order": order, "points": points, "robots": robots, "speed": speed}
    for name in sys.argv[1:] or sections:
        sections[name]()
