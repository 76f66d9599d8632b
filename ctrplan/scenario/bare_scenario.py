"""Scenarios where only a robot is given, and where a robot begins when nobody says it: retracted, joints near zero."""

from __future__ import annotations

import itertools
import math

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import CATALOGUE, DEFAULT, Goal, Margins, Scenario


def bare_scenario(robot: Robot) -> Scenario:
    """The robot in free space, its frame the anatomy's frame; the goal is the start."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    zero = np.clip(np.zeros(len(drive.joints)), drive.lower, drive.upper)
    start = space.projected(zero[None], fallback=zero[None])[0]
    if not space.allowed(start):  # `never_nests` found values; random ones find them too
        drawn = space.sample(np.random.default_rng(0), 1)
        if not len(drawn):
            raise InputError("no joint values were found that nest the tubes", file=robot.path)
        start = drawn[0]
    return Scenario(
        name=robot.name,
        robot=robot,
        base_position_m=np.zeros(3),
        base_R=np.eye(3),
        start=start,
        goal=Goal(joints=start, tip_m=None, tolerance_m=1e-3),
        planner=CATALOGUE[DEFAULT](),  # type: ignore[call-arg]  # every setting has a default
        path=robot.path,
        warnings=robot.warnings,
    )


TURNS_RAD = (0.0, math.pi / 2, math.pi, -math.pi / 2)
MOST_JOINTS = 6  # whose turns are tried in all combinations


def retracted(robot: Robot) -> Array:
    """(m,) joint values: every translation at the end that draws tubes back, rotations where stability is greatest.

    Raises InputError where there is none within limits that nests and is stable: then the start has to be said.
    """
    space = JointSpace.of_robot(robot)
    tried = space.projected(_combinations(robot.drive), fallback=np.clip(0.0, robot.drive.lower, robot.drive.upper))
    tried = tried[space.allowed_rows(tried)]
    if len(tried):
        solved = robot.mechanics.bound_many(*robot.drive.collars(tried))
        sound = (solved.stability >= Margins.stability) & (solved.max_strain <= Margins.max_strain)
        if sound.any():
            return np.asarray(tried[np.argmax(np.where(sound, solved.stability, -np.inf))])
    raise InputError("drawn back the robot is not stable within limits: a start has to be said", file=robot.path)


def _combinations(drive: Drive) -> Array:
    """(K, m) joint values; the first rotation stays at 0, since only turns against each other matter."""
    back = _backwards(drive)
    turning = np.flatnonzero(drive.is_rotation)[1 : 1 + MOST_JOINTS]
    rows = []
    for turns in itertools.product(TURNS_RAD, repeat=len(turning)):
        q = back.copy()
        q[turning] = turns
        rows.append(np.clip(q, drive.lower, drive.upper))
    return np.array(rows)


def _backwards(drive: Drive) -> Array:
    """(m,) with every translation at its limit that brings tubes back; at 0 where it has none."""
    q = np.zeros(len(drive.joints))
    for k in np.flatnonzero(~drive.is_rotation):
        one = np.zeros_like(q)
        one[k] = 1.0
        _, moved = drive.collars(one)
        _, still = drive.collars(np.zeros_like(q))
        end = drive.lower[k] if np.sum(moved - still) > 0 else drive.upper[k]
        q[k] = end if math.isfinite(end) else 0.0
    return q
