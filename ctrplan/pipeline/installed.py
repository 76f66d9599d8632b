"""A robot with its effects at work in it: what bounds, plans, goals and the live view ask.

Effects of the mechanics are in its tubes, contacts and loads, those of the drive in `drive.collars`. Effects of the
clock and of the sensor change what is measured, not where the robot is: the chain has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.collars import Collars
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot


def installed(robot: Robot) -> Robot:
    """The robot of a file with the file's effects at work; itself if it has none."""
    return with_chain(robot, Chain.of(robot)) if robot.effects else robot


def with_chain(robot: Robot, chain: Chain) -> Robot:
    """`robot` with the mechanics and the drive of a chain."""
    built = chain.mechanics
    drive = replace(built.drive, terms=_at_rest(chain), play=_play(chain))
    given = replace(
        robot, tubes=built.tubes, contacts=built.contacts, loads=built.loads, drive=drive, ideal=chain.ideal
    )
    return replace(given, model_error_m=robot.model_error_m + _not_in_shapes_m(chain))


def _not_in_shapes_m(chain: Chain) -> float:
    """How far [m] effects may move any point of the robot that shapes do not have.

    A turn of the plate moves it by its length at the largest angle.
    """
    robot = chain.mechanics
    turn_rad = sum(given.effect.largest_turn_rad(given.values, robot) for given in chain.of_stage("mechanics"))
    shift_m = sum(given.effect.largest_shift_m(given.values, robot) for given in chain.of_stage("mechanics"))
    return turn_rad * max(tube.length_m for tube in robot.tubes) + shift_m


def _at_rest(chain: Chain) -> tuple[DriveAtRest, ...]:
    able = [given for given in chain.on(None, {}).of_stage("drive") if given.effect.acts_at_rest]
    return (DriveAtRest(Chain(chain.ideal, tuple(able))),) if able else ()


def _play(chain: Chain) -> tuple[Array, Array] | None:
    """(n,) [rad], (n,) [m] how far effects that depend on directions move the collars, every way the same.

    Those of several effects add up.
    """
    able = [given for given in chain.on(None, {}).of_stage("drive") if not given.effect.acts_at_rest]
    if not able:
        return None
    n = chain.ideal.n
    moved = [given.effect.play(given.values, n) for given in able]
    return np.sum([m.theta[0] for m in moved], axis=0), np.sum([m.l[0] for m in moved], axis=0)


@dataclass(frozen=True)
class DriveAtRest:
    """The drive's stage at collars (K, n), (K, n) whose last directions nobody knows."""

    chain: Chain

    def __call__(self, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741 (as in the equations)
        """Where collars stand that are commanded to theta [rad], l [m]."""
        moved = self.chain.drive(Collars(theta, l), np.zeros((len(theta), 2 * theta.shape[1])))
        return moved.theta, moved.l
