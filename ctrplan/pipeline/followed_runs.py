"""Whole runs followed with friction: tips, markers and friction states at the poses of a continuous motion.

At rest after a 90 degree approach the states are right, and a finer mesh gives the rest. On a continuous motion
friction is spread unevenly along the tubes, and the whole path is simulated.

The whole motion is simulated, however few of the poses are asked about. Where a simulation stops, it begins again at
the next waypoint, from the friction state it had; the tip remembers that for some tens of degrees only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.measurement.approach import friction_state, needed_waypoints
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.history import History, HistoryPath, Start
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.pipeline.tip_table import FrictionCorrection, markers_on, nested, on_body, point_table
from ctrplan.robot.robot import Robot


def walked(robot: Robot, history: History, theta_b: Array, l_b: Array) -> tuple[HistoryPath, Array]:
    """The history along collars (K, n) [rad], (K, n) [m], and (K, M, 6) position [m] and tangent of M markers.

    NaN after a waypoint without an equilibrium. Without markers it is one call into the core.
    """
    markers = np.full((len(theta_b), len(robot.markers), 6), np.nan)
    if not robot.markers:
        return history.follow(theta_b, l_b), markers
    steps = []
    for k in range(len(theta_b)):
        steps.append(history.follow(theta_b[k : k + 1], l_b[k : k + 1]))
        if steps[-1].status[0] < Status.FAILED:
            markers[k] = np.hstack(markers_on(robot, history.shape(), l_b[k]))
    names = HistoryPath.__dataclass_fields__
    return HistoryPath(*(np.concatenate([getattr(step, name) for step in steps]) for name in names)), markers


MOST_RESTARTS = 20  # of a run; a robot that fails more often is not this robot


@dataclass(frozen=True, eq=False)
class Followed:
    """What a simulation says of K poses; NaN where it has no equilibrium."""

    position_m: Array  # (K, 3) tips and markers
    tangent: Array  # (K, 3)
    phi: Array  # (K, n - 1) circumferential friction state of each pair, averaged by normal force
    restarts: int  # waypoints without an equilibrium, behind which it began again


def followed(chain: ParametricChain, p: Array) -> Followed:
    """Every run of a chain's data at parameters (P,), from its first waypoint on."""
    data, robot = chain.data, chain.at(p).mechanics
    every = np.arange(len(data.sequence))
    blank = np.zeros((len(every), 3))
    waypoints = replace(data, rows=every, position_m=blank, tangent=blank, marker=None, noise_ratio=None)
    collars = ParametricChain(chain.robot, waypoints, chain.terms).collars(p)
    l_b = nested(robot, collars.l)  # a fit may push collars against each other, and moves on
    if not on_body(robot, data).any():
        robot = replace(robot, markers=())  # nobody asks for them
    table, restarts = np.full((len(every), 6 + robot.n - 1 + 6 * len(robot.markers)), np.nan), 0
    for run in np.unique(data.sequence[data.rows]).tolist():
        rows = np.flatnonzero(data.sequence == run)
        measured = np.flatnonzero(np.isin(rows, data.rows))
        rows = rows[needed_waypoints(collars.theta[rows], l_b[rows], measured)]
        table[rows], failed = _run(robot, collars.theta[rows], l_b[rows])
        restarts += failed
    result, ends = table[data.rows], np.cumsum([0, 3, 3, robot.n - 1])
    position, tangent, phi = (result[:, a:b] for a, b in pairwise(ends.tolist()))
    if robot.markers:
        body = on_body(robot, data)
        markers = result[body, ends[-1] :].reshape(-1, len(robot.markers), 6)
        seen = markers[np.arange(len(markers)), data.seen_marker[body] - 1]
        position[body], tangent[body] = seen[:, :3], seen[:, 3:]
    return Followed(position, tangent, phi, restarts)


def _run(robot: Robot, theta: Array, l_b: Array) -> tuple[Array, int]:
    """(R, 6 + n - 1 + 6 M) tips, tangents, states and M markers of a run, and how often it was begun again."""
    table, at, restarts = np.full((len(theta), 6 + robot.n - 1 + 6 * len(robot.markers)), np.nan), 0, 0
    start: Start = "released"
    while at < len(theta):
        try:
            path, markers = walked(robot, robot.history(start), theta[at:], l_b[at:])
        except SolverError:  # no equilibrium where it was to start
            reached = 0
        else:
            failed = np.flatnonzero(path.status >= Status.FAILED)
            reached = int(failed[0]) if len(failed) else len(theta) - at
            sound = path.status[:reached] <= Status.MULTIPLE
            rows = np.hstack([path.position_m, path.tangent, path.phi, markers.reshape(len(markers), -1)])[:reached]
            table[at : at + reached][sound] = rows[sound]
            start = np.clip(path.phi[reached - 1], -1.0, 1.0) if reached else start
        at += reached
        if at < len(theta):  # a waypoint without an equilibrium
            at, restarts = at + 1, restarts + 1
            if restarts > MOST_RESTARTS:
                break
    return table, restarts


LARGEST_M = 5e-3  # corrections beyond it are a path that snapped, and are left out


def friction_correction(chain: ParametricChain, p: Array) -> FrictionCorrection | None:
    """What the rule of friction states leaves out at parameters (P,); None without friction.

    On a continuous motion the states are those of the simulated history: between those of the rule and these may lie
    twice the bound.
    """
    robot, data = chain.at(p).mechanics, chain.data
    if not robot.friction.any():
        return None
    # friction that a rest or a speed has changed is as much less in the states as in the history, to first order
    collars, phi = chain.collars(p), friction_state(data, chain.at(p).release_m)
    if data.is_stream:
        path = followed(chain, p)
        position, tangent = path.position_m, path.tangent
        phi = np.where(np.isfinite(path.phi), np.clip(path.phi, -1.0, 1.0), phi)
    else:
        fine = point_table(robot, data, collars, phi, accuracy="certificate")
        position, tangent = fine.position_m, fine.tangent
    coarse = point_table(robot, data, collars, phi)
    shift, turn = position - coarse.position_m, tangent - coarse.tangent
    wild = ~(np.linalg.norm(shift, axis=1) < LARGEST_M)
    shift[wild], turn[wild] = 0.0, 0.0
    return FrictionCorrection(phi if data.is_stream else None, shift, turn)


def simulated(robot: Robot, data: Measurements, terms: Sequence[Term], p: Array) -> ParametricChain:
    """The chain of terms for some data, with what friction states leave out of its poses at parameters (P,)."""
    chain = ParametricChain(robot, data, terms)
    chain.correction = friction_correction(chain, p)
    return chain
