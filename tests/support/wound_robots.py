"""Robots that stand wound up: scenarios from there, L-shaped ways, and how far their histories leave a bound."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.certificate.certificate import Certificate
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Goal, Scenario


def wound(robot: Robot, start: Array, end: Array, **changes: Any) -> Scenario:
    """From joints to joints (m,), where turns count."""
    return bare_scenario(robot).with_(start=start, goal=Goal(joints=end), start_turns="absolute", **changes)


def l_shaped(robot: Robot, start: Array, by: Array) -> Array:
    """Rotations before translations, by a motion (m,)."""
    return np.array([start, start + np.where(robot.drive.is_rotation, by, 0.0), start + by])


def beyond_m(robot: Robot, certificate: Certificate, start: Array, rng: np.random.Generator) -> tuple[float, int]:
    """How far tips of the robot's own histories straight from home leave the stated bound, and snaps on the way.

    From every corner of friction at home, and with turns at the start that load it otherwise.
    """
    samples, turns, results = certificate.samples, robot.drive.is_rotation, [-np.inf]
    home, snaps = np.where(turns, 0.0, start), 0
    for phi in ("released", *itertools.product((1.0, -1.0), repeat=robot.n - 1)):
        for size in (0.0, 0.2):
            aside = start + np.where(turns, size * rng.uniform(-1, 1, len(start)), 0.0)
            history = robot.history(phi)
            before = history.follow(*robot.drive.collars(np.array([home, start, aside, start])))
            if before.snaps[2:].any():
                continue
            path = history.follow(*robot.drive.collars(samples.joints))
            off = np.linalg.norm(path.position_m - samples.tip_m, axis=1)
            results.append(float((off - samples.bound_m).max()))
            snaps += int(path.snaps.sum())
    return max(results), snaps
