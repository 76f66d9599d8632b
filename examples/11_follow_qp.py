"""The tip follows a line in steps, each a quadratic programme on gradients; clearance and rates are kept."""

from pathlib import Path

import numpy as np
from scipy.optimize import nnls

import ctrplan

scenario = ctrplan.load_scenario(Path(__file__).resolve().parents[1] / "scenarios" / "heart_chamber.toml")
checker, robot = ctrplan.MotionChecker(scenario), scenario.robot
unit = np.array([joint.si_per_unit for joint in robot.drive.joints])  # steps are in deg and mm


def least_squares(A, b, G, h):
    """The x of least |A x - b| with G x >= h, a polyhedron's nearest point (Lawson and Hanson); or piqp, qpsolvers."""
    inverse, middle = np.linalg.inv(np.linalg.qr(A, "r")), np.linalg.lstsq(A, b)[0]
    edges, end = np.vstack([(G @ inverse).T, h - G @ middle]), np.eye(A.shape[1] + 1)[-1]
    rest = edges @ nnls(edges, end)[0] - end
    return middle - inverse @ rest[:-1] / rest[-1]


q, rates, least_mm = np.array([-58.1, 51.4, 49.2, -37.1, -50.2]) * unit, np.array([4, 4, 4, 1, 1]), 1.5  # a step
now, room = robot.bound(*robot.drive.collars(q), gradient=True).gradient, checker.clearance(q, gradient=True)
line, nearest = now.tip_m.value + np.linspace(0, 1, 21)[1:, None] * [-4e-3, 6e-3, -2e-3], np.inf
for wanted in line:
    moves = robot.drive.collars_by_joints(q)[0]
    tip_by, bound_by = (1e3 * of.by_joints(moves) * unit for of in (now.tip_m, now.position_m))
    A = np.vstack([tip_by, 0.02 * bound_by, 0.01 * np.eye(5)])  # onto the line, with little bound and little motion
    b = 1e3 * np.array([*(wanted - now.tip_m.value), -0.02 * now.position_m.value, *np.zeros(5)])
    G = np.vstack([1e3 * room.by_joints * unit, np.eye(5), -np.eye(5)])
    h = np.array([least_mm - 1e3 * room.clearance_m[0], *-rates, *-rates])
    q = q + unit * least_squares(A, b, G, h)
    now, room = robot.bound(*robot.drive.collars(q), gradient=True).gradient, checker.clearance(q, gradient=True)
    nearest = min(nearest, 1e3 * room.clearance_m[0])
off, bound = 1e3 * np.linalg.norm(now.tip_m.value - line[-1]), 1e3 * now.position_m.value
print(f"off the line at its end: {off:.3f} mm, least clearance {nearest:.2f} mm, bound {bound:.2f} mm")
