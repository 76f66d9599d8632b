"""Play of the drive: how far it may let the robot stand from where the joints say it is.

Nobody knows on which side of its play an actuator rests, so that a plan allows for both at every actuator. Each is
moved to both ends of its play by itself, and the larger shifts are added up: of the frictionless robot where a person
asks, of every shape that a certificate knows. Certificates look at the corners of the box of all plays too.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import CtrplanError
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.tip_table import nested
from ctrplan.uncertainty.tip_slopes import friction_states

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.joint_space import JointSpace

MOST_ACTUATORS = 6  # with play, of whose box all corners are solved
SAMPLES, SEED = 15, 5  # configurations that say what a search has to allow for


def play_shift(robot: Robot, theta_b: Array, l_b: Array) -> float:
    """How far [m] play may move the tip or any point of the body sideways, at (n,) [rad], (n,) [m].

    0 without play; inf where the robot has no equilibrium at an end of its play.
    """
    if robot.drive.play is None:
        return 0.0
    here, shift = robot.mechanics.body(theta_b, l_b)[0][0], 0.0
    for theta_off, l_off in _single_actuators(*robot.drive.play):
        ends = [(theta_b + side * theta_off, nested(robot, (l_b + side * l_off)[None])[0]) for side in (1, -1)]
        shift += max(_apart(robot, here, *end) for end in ends)
    return shift


def play_reach(robot: Robot, theta_b: Array, l_b: Array) -> float:
    """How far play reaches, as `play_shift`, of the frictionless shape and all corners, actuators moved at once."""
    if robot.drive.play is None:
        return 0.0
    here, singles = robot.mechanics.body(theta_b, l_b)[0], _single_actuators(*robot.drive.play)
    shift = np.zeros(len(here))
    for theta_off, l_off in singles:
        ends = [(theta_b + side * theta_off, nested(robot, (l_b + side * l_off)[None])[0]) for side in (1, -1)]
        shift += np.max([_shapes_apart(robot, here, *end) for end in ends], axis=0)
    corners = itertools.product((1, -1), repeat=len(singles)) if len(singles) <= MOST_ACTUATORS else ()
    for signs in corners:
        off = [sum(sign * single[k] for sign, single in zip(signs, singles, strict=True)) for k in (0, 1)]
        end = theta_b + off[0], nested(robot, (l_b + off[1])[None])[0]
        shift = np.maximum(shift, _shapes_apart(robot, here, *end))
    return float(shift.max())


def play_turn(robot: Robot, theta_b: Array, l_b: Array) -> float:
    """How far [rad] play may turn the tip's tangent in any corner of friction, one actuator after the other added up.

    Collars at (n,) [rad], (n,) [m]. 0 without play; inf where the robot has no equilibrium at an end of its play.
    """
    if robot.drive.play is None:
        return 0.0
    here = _tangents(robot, theta_b, l_b)
    turn = np.zeros(len(here))
    for theta_off, l_off in _single_actuators(*robot.drive.play):
        ends = [(theta_b + side * theta_off, nested(robot, (l_b + side * l_off)[None])[0]) for side in (1, -1)]
        chords = [np.linalg.norm(_tangents(robot, *end) - here, axis=1) for end in ends]
        turn += 2 * np.arcsin(np.minimum(np.max(chords, axis=0) / 2, 1.0))
    return float(np.nan_to_num(turn, nan=np.inf).max())


def _tangents(robot: Robot, theta_b: Array, l_b: Array) -> Array:
    """(S, 3) of the tip, released and in every corner of friction; NaN without a solution."""
    states = friction_states(robot)
    theta_rows, l_rows = (np.tile(part, (len(states), 1)) for part in (theta_b, l_b))
    result = robot.mechanics.tips_with_friction(theta_rows, l_rows, states)
    return np.where((result.status == Status.FAILED)[:, None], np.nan, result.tangent)


def usual_play_shift(robot: Robot, space: JointSpace) -> float:
    """The median [m] of `play_shift` over configurations in reach: for searches, whose paths are certified after."""
    if robot.drive.play is None:
        return 0.0
    joints = space.sample(np.random.default_rng(SEED), SAMPLES)
    return float(np.median([play_shift(robot, *robot.drive.collars(q)) for q in joints]))


def _single_actuators(theta: Array, l: Array) -> list[tuple[Array, Array]]:  # noqa: E741 (as in the equations)
    """Half widths (n,), (n,) as displacements of one collar each."""
    rows = np.diag(np.concatenate([theta, l]))
    return [(row[: len(theta)], row[len(theta) :]) for row in rows if row.any()]


def _apart(robot: Robot, here: Array, theta_b: Array, l_b: Array) -> float:
    """Between frictionless centrelines: of their tips, or of any point of the one from the other."""
    return float(_shapes_apart(robot, here[None], theta_b, l_b)[0])


def _shapes_apart(robot: Robot, here: Array, theta_b: Array, l_b: Array) -> Array:
    """(S,) the same of the first S shapes of the robot from here (S, N, 3), frictionless first."""
    try:
        there = robot.mechanics.body(theta_b, l_b)[0]
    except CtrplanError:
        return np.full(len(here), np.inf)
    apart = [
        max(float(np.linalg.norm(b[-1] - a[-1])), float(distance_from_polyline(b, a).max()))
        for a, b in zip(here, there[: len(here)], strict=True)
    ]
    return np.where(np.isfinite(apart), apart, np.inf)
