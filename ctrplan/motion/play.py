"""Play of the drive: how far it may let the robot stand from where the joints say it is.

Nobody knows on which side of its play an actuator rests, so that a plan allows for both at every actuator. Each is
moved to both ends of its play by itself, and the larger shifts are added up: of the frictionless robot where a person
asks, of every shape that a certificate knows. Certificates look at the corners of the box of all plays too. Where the
collars are then, effects of the drive that act after the play among them, `held` says to all of these.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import CtrplanError
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.tip_table import held
from ctrplan.uncertainty.tip_slopes import friction_states, half_widths

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.joint_space import JointSpace

MOST_ACTUATORS = 6  # with play, of whose box all corners are solved
SAMPLES, SEED = 15, 5  # configurations that say what a search has to allow for


def play_shift(robot: Robot, theta: Array, l: Array) -> float:  # noqa: E741 (as in the equations)
    """How far [m] play may move the tip or any point of the body sideways, commanded to (n,) [rad], (n,) [m].

    0 without play; inf where the robot has no equilibrium at an end of its play.
    """
    if robot.drive.play is None:
        return 0.0
    here = robot.mechanics.body(*_held(robot, theta, l))[0][:1]
    return float(_farther(robot, here, theta, l)[0])


def play_reach(robot: Robot, theta: Array, l: Array) -> float:  # noqa: E741
    """How far play reaches, as `play_shift`, of the frictionless shape and all corners, actuators moved at once."""
    if robot.drive.play is None:
        return 0.0
    here = robot.mechanics.body(*_held(robot, theta, l))[0]
    shift, singles = _farther(robot, here, theta, l), _single_actuators(robot)
    corners = itertools.product((1, -1), repeat=len(singles)) if len(singles) <= MOST_ACTUATORS else ()
    for signs in corners:
        shift = np.maximum(shift, _shapes_apart(robot, here, *_held(robot, theta, l, np.array(signs) @ singles)))
    return float(shift.max())


def play_turn(robot: Robot, theta: Array, l: Array) -> float:  # noqa: E741
    """How far [rad] play may turn the tip's tangent in any corner of friction, one actuator after the other added up.

    Commanded to (n,) [rad], (n,) [m]. 0 without play; inf where the robot has no equilibrium at an end of its play.
    """
    if robot.drive.play is None:
        return 0.0
    here = _tangents(robot, *_held(robot, theta, l))
    turn = np.zeros(len(here))
    for ends in _ends(robot, theta, l):
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
    return float(np.median([play_shift(robot, *robot.drive.commanded(q)) for q in joints]))


def _single_actuators(robot: Robot) -> Array:
    """(A, 2 G n) [rad], [m] half widths of play as displacements of one collar at one place each."""
    rows = np.diag(half_widths(robot))
    return rows[rows.any(axis=1)]


def _ends(robot: Robot, theta: Array, l: Array) -> Iterator[tuple[tuple[Array, Array], tuple[Array, Array]]]:  # noqa: E741
    """Collars (n,) [rad], (n,) [m] at both ends of the play of each actuator by itself."""
    for off in _single_actuators(robot):
        yield _held(robot, theta, l, off), _held(robot, theta, l, -off)


def _held(robot: Robot, theta: Array, l: Array, off: Array | None = None) -> tuple[Array, Array]:  # noqa: E741
    """(n,) [rad], (n,) [m] of `held`."""
    theta_b, l_b = held(robot, np.atleast_2d(theta), np.atleast_2d(l), off)
    return theta_b[0], l_b[0]


def _farther(robot: Robot, here: Array, theta: Array, l: Array) -> Array:  # noqa: E741
    """(S,) [m] how far actuators by themselves move the first S shapes from here (S, N, 3), added up."""
    moved = np.zeros(len(here))  # of no actuator where all plays in the robot's file are 0
    for ends in _ends(robot, theta, l):
        moved += np.max([_shapes_apart(robot, here, *end) for end in ends], axis=0)
    return moved


def _shapes_apart(robot: Robot, here: Array, theta_b: Array, l_b: Array) -> Array:
    """(S,) [m] between the tips of the first S shapes of the robot, frictionless first, and those here (S, N, 3), or
    from any point of the one to the other.
    """
    try:
        there = robot.mechanics.body(theta_b, l_b)[0]
    except CtrplanError:
        return np.full(len(here), np.inf)
    apart = [
        max(float(np.linalg.norm(b[-1] - a[-1])), float(distance_from_polyline(b, a).max()))
        for a, b in zip(here, there[: len(here)], strict=True)
    ]
    return np.where(np.isfinite(apart), apart, np.inf)
