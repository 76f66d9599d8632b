"""The least friction bound with the tip on its target, by SLSQP on gradients; clearance is kept."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import ctrplan

scenario = ctrplan.load_scenario(Path(__file__).resolve().parents[1] / "scenarios" / "heart_chamber.toml")
checker, drive = ctrplan.MotionChecker(scenario), scenario.robot.drive
unit = np.array([joint.si_per_unit for joint in drive.joints])  # the unknowns are in deg and mm
target = scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m)  # in the robot's frame


@lru_cache(maxsize=4)  # values and slopes are asked for one after the other
def known(*x):
    """Bound, distances of the tip from the target and clearance, in mm, and their slopes, a row each."""
    q = np.array(x) * unit
    bound = scenario.robot.bound(*drive.collars(q), gradient=True).gradient
    room, moves = checker.clearance(q, gradient=True), drive.collars_by_joints(q)[0]
    values = np.array([bound.position_m.value, *(bound.tip_m.value - target), room.clearance_m[0]])
    slopes = [bound.position_m.by_joints(moves), *bound.tip_m.by_joints(moves), room.by_joints[0]]
    return 1e3 * values, 1e3 * np.array(slopes) * unit


result = minimize(
    lambda x: known(*x)[0][0],
    start := np.array([-58.1, 51.4, 49.2, -37.1, -50.2]),
    jac=lambda x: known(*x)[1][0],
    constraints=[
        {"type": "eq", "fun": lambda x: known(*x)[0][1:4], "jac": lambda x: known(*x)[1][1:4]},
        {"type": "ineq", "fun": lambda x: known(*x)[0][4:] - 1.0, "jac": lambda x: known(*x)[1][4:]},
    ],
    bounds=np.transpose([drive.lower, drive.upper] / unit),
    options={"ftol": 1e-3},
)
print(f"bound: {known(*start)[0][0]:.2f} mm before, {result.fun:.2f} mm after {result.nit} iterations")
