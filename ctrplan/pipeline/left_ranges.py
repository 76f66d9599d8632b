"""Where a robot's built terms are asked outside the data that they were built from, as sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array
from ctrplan.effects.learned.inputs import Situation, unit
from ctrplan.effects.learned.learned import Learned
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot
from ctrplan.sensor.poses import Poses


def range_notes(
    robot: Robot, theta_commanded: ArrayLike, l_commanded: ArrayLike, poses: Poses | None = None
) -> tuple[str, ...]:
    """One sentence for each input that leaves its range, at rotations (n,) or (K, n) [rad] and translations [m] alike.

    `poses` are the K tips, for terms of the sensor; without them nothing is said about tips.
    """
    built = [given.effect for given in Chain.of(robot).acting if isinstance(given.effect, Learned)]
    if not built:
        return ()
    theta, l = np.atleast_2d(np.asarray(theta_commanded, float)), np.atleast_2d(np.asarray(l_commanded, float))  # noqa: E741
    at = Situation(theta, l, poses=poses, tubes=robot.tubes)
    return tuple(_sentence(effect, name, worst) for effect in built for name, worst in effect.leaves(at).items())


def plan_range_notes(robot: Robot, joints: Array) -> tuple[str, ...]:
    """The same of joint values (K, m), in the order of the drive."""
    return range_notes(robot, *robot.drive.commanded(joints))


def _sentence(effect: Learned, name: str, worst: float) -> str:
    span, of = effect.ranges[name], unit(name)
    ends = f"{span.low:.4g} to {span.high:.4g} {of}".rstrip()
    where = f"{name} reaches {worst:.4g} {of}".rstrip()
    return f"{effect.name} was built from data with {name} from {ends}; here {where}, and it is held at the edge."
