"""How far can friction push the tip off at one configuration?"""

from pathlib import Path

import numpy as np

import ctrplan

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"

robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml")
theta_b = np.radians([0, 90, 180])  # base rotations, outermost tube first
l_b = np.array([0, -17, -62.8]) * 1e-3  # base translations [m]

bound = robot.bound(theta_b, l_b, accuracy="certificate")
print(f"tip without friction: {np.round(bound.frictionless.tip_m * 1e3, 2)} mm")
for corner in bound.corners:  # friction of each pair of tubes at its limit, either way
    print(f"tip with friction:    {np.round(corner.tip_m * 1e3, 2)} mm, {corner.status.name}")
print(f"bound: {bound.position_m * 1e3:.2f} mm, {np.degrees(bound.tangent_rad):.2f} deg")
