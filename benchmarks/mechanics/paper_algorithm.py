"""What does one friction evaluation cost by the paper's own algorithm, and what by ctrplan?

    python benchmarks/run.py paper_algorithm [--limit SECONDS]

Three-tube robot of Table II, 2.5 mm elements (the paper's density: it has 133 contacts when fully extended), one
configuration, both relative rotations counterclockwise. The ascent of tests/oracles/paper_oracle in numpy runs
to the paper's own criterion or to the limit, 1000 inner iterations at most for each linearisation; its tip is compared
with the solution of the same equations on the same mesh by Newton's method. CPU seconds of one thread; nothing is
extrapolated. ctrplan places its own elements, as its accuracy demands.
"""

import time
from typing import Any

import common
import numpy as np
import paper_oracle as paper
from common import ROBOTS, processors, took

from ctrplan import load_robot

THETA_B, L_B = np.deg2rad([0, 0, 90]), np.array([0, -0.017, -0.0916])
SPACING_M, MAX_INNER, NEAR_M = 2.5e-3, 1000, 5e-5
PAPER_S = 11.7  # Table VIII, friction, its machine


def ascent(problem: Any, tip_m: Any, limit_s: float) -> dict[str, Any]:
    """The outer loop with a clock: seconds, loops, and when the tip came to stay within NEAR_M of `tip_m`."""
    settings = paper.Ascent(max_inner=MAX_INNER, max_outer=1)
    taken, inner, outer, near_s = 0.0, 0, 0, None
    solution, u, multiplier = None, None, None
    while taken < limit_s and (solution is None or solution.step >= settings.gamma):
        start = time.process_time()
        solution = paper.solve(problem, settings, u, multiplier)
        taken += time.process_time() - start
        u, multiplier = solution.u, solution.multiplier
        outer, inner = outer + 1, inner + solution.inner
        error_m = float(np.linalg.norm(solution.tip_m - tip_m))
        near_s = (near_s or taken) if error_m <= NEAR_M else None
    assert solution is not None
    done = solution.step < settings.gamma
    return {"s": taken, "outer": outer, "inner": inner, "near_s": near_s, "error_m": error_m, "done": done}


def main() -> None:
    limit_s = common.arguments(__doc__, limit=110.0).limit
    robot = load_robot(ROBOTS / "three_tube.toml")
    nodes = paper.mesh(robot.tubes, L_B, SPACING_M)
    friction = [mu for _, mu in robot.friction]
    problem = paper.Problem(robot.tubes, robot.clearance_m, friction, THETA_B, L_B, [1.0, 1.0], nodes)
    start = time.process_time()
    newton = paper.refine(problem)
    newton_s = time.process_time() - start
    run = ascent(problem, newton.tip_m, limit_s)
    bound_s = float(np.median([took(robot.bound, THETA_B, L_B)[1] for _ in range(100)]))

    elements, contacts = len(problem.u_hat), len(problem.contacts.node)
    print(f"{processors()}; CPU seconds of one thread")
    print(f"{elements} elements of all tubes together, {3 * elements} unknowns, {contacts} contacts")
    done = "to |Delta u| < 1e-6 / mm" if run["done"] else "CUT SHORT: a lower bound"
    near = f"{run['near_s']:.1f} s" if run["near_s"] else "more than that"
    print(f"paper's algorithm, one friction evaluation: {run['s']:.1f} s ({PAPER_S} s on the paper's machine)")
    print(f"  {done}, {run['outer']} linearisations, {run['inner']} inner iterations;")
    error = f"{1e3 * run['error_m']:.4f} mm from the solution on this mesh"
    print(f"  tip {error}, within {1e3 * NEAR_M:g} mm after {near}")
    print(f"same by Newton's method in numpy: {newton_s:.1f} s{'' if newton.converged else ', NOT CONVERGED'}")
    ratio = f"ratio {run['s'] / bound_s:,.0f}, of the five solves {5 * run['s'] / bound_s:,.0f}"
    print(f"Robot.bound, frictionless + 4 corners, search accuracy: {1e3 * bound_s:.2f} ms; {ratio}")
