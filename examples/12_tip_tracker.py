"""A loop at 20 Hz that leads the tip along a circle by inverse kinematics, friction followed from a released start."""

from pathlib import Path

import numpy as np

import ctrplan

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
DT_S, STEPS = 0.05, 100

robot = ctrplan.load_robot(ROBOTS / "three_tube.toml")
tracker = ctrplan.TipTracker(robot, [0.3, -0.4, 0.9, -0.04], friction="released")  # joints in rad and m
begin = tracker.step([0, 0, 0.2], dt_s=1e-4).tip_m  # a tick only: where is the tip?

left_mm, bound_mm = [], []
for turn in np.linspace(0, np.pi / 2, STEPS):
    point = begin + 5e-3 * np.array([np.cos(turn) - 1, np.sin(turn), 0])
    step = tracker.step(point, dt_s=DT_S)  # send step.joints to the drive
    if step.status != "reached":
        print(step.sentence)
    left_mm.append(1e3 * step.tip_error_m)
    bound_mm.append(1e3 * step.bound_m)
# An observer's state, where a tracker measures the tip, replaces the friction that is followed: tracker.know(state)
print(f"largest distance left: {max(left_mm):.3f} mm; friction, were it unknown: up to {max(bound_mm):.1f} mm")
