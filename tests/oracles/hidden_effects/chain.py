"""Commanded joints -> drive -> mechanics with friction -> sensor: the poses of a world, without noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from hidden_effects.equilibrium import CORNER_BARRIER, NoEquilibrium, State, System, corner, tip_pose
from hidden_effects.experiment import Experiment
from hidden_effects.friction import SlipHistory, remaining
from hidden_effects.mesh import Fineness
from hidden_effects.poses import ROUGHLY_M, Solver
from hidden_effects.rod import rotations
from hidden_effects.tube import Array
from hidden_effects.world import World

GROWING = (0.25, 0.5, 0.75, 1.0)
KNOT_S, SLIP_KNOT_S = 0.4, 0.2  # between solves of a continuous motion, without and with friction; a spline fills in


@dataclass(frozen=True)
class Poses:
    """Tips (K, 3) [m] and material tip frames (K, 3, 3) at the measured rows."""

    p: Array
    F: Array

    @property
    def tangent(self) -> Array:
        return self.F[:, :, 2]


def poses(world: World, experiment: Experiment, fineness: Fineness | None = None, knot_s: float | None = None) -> Poses:
    """What an exact tracker would report."""
    mesh = fineness or Fineness()
    knots = knot_s or (SLIP_KNOT_S if any(pair.friction for pair in world.pairs) else KNOT_S)
    p, F = _continuous(world, experiment, mesh, knots) if experiment.continuous else _dwelling(world, experiment, mesh)
    times = experiment.motion.time_s[experiment.measured]
    if world.guide is not None:
        R = rotations(world.guide.rotations_rad(experiment.motion.l[experiment.measured]))[0]
        p, F = np.einsum("kij,kj->ki", R, p), R @ F
    for term in world.sensor:
        p, F = term(p, F, times)
    return Poses(p, F)


def _dwelling(world: World, experiment: Experiment, fineness: Fineness) -> tuple[Array, Array]:
    motion = experiment.motion
    for term in world.drive:
        motion = term(motion)
    solver, tips, frames = Solver(world, fineness), [], []
    for k in np.flatnonzero(experiment.measured):
        phi = remaining(experiment.phi[k], experiment.translated_m[k], world.release_m)
        p, F = solver.pose(motion.theta[k], motion.l[k], phi, float(motion.time_s[k]))
        tips.append(p)
        frames.append(F)
    return np.array(tips), np.array(frames)


def _continuous(world: World, experiment: Experiment, fineness: Fineness, knot_s: float) -> tuple[Array, Array]:
    """Solved at knots from well before the first row, friction followed from a released start; splines in between."""
    motion = experiment.motion
    for term in world.drive:
        motion = term(motion)
    time_s = motion.time_s
    knots = np.linspace(time_s[0], time_s[-1], int((time_s[-1] - time_s[0]) / knot_s) + 2)
    thetas, ls = CubicSpline(time_s, motion.theta)(knots), CubicSpline(time_s, motion.l)(knots)
    at_rest = np.zeros(world.n - 1)
    tips, frames = [], []
    if any(pair.friction for pair in world.pairs):
        for p, F in _followed(world, thetas, ls, fineness):
            tips.append(p)
            frames.append(F)
    else:
        solver = Solver(world, fineness)
        for theta, l_b, time in zip(thetas, ls, knots.tolist(), strict=True):
            p, F = solver.pose(theta, l_b, at_rest, time)
            tips.append(p)
            frames.append(F)
    asked = np.maximum(time_s - world.lag_s, time_s[0])
    p = CubicSpline(knots, np.array(tips))(asked)
    F = CubicSpline(knots, np.array(frames).reshape(len(knots), 9))(asked).reshape(-1, 3, 3)
    u, _, v = np.linalg.svd(F)
    return p, u @ v


def _followed(world: World, thetas: Array, ls: Array, fineness: Fineness) -> list[tuple[Array, Array]]:
    """Tips along a motion whose friction follows the slip; stations move with the translations."""
    history: SlipHistory | None = None
    found = []
    for theta, l_b in zip(thetas, ls, strict=True):
        system = System(world.tubes, world.pairs, theta, l_b, world.loads, fineness)
        middle = system.solve(system.cold(), corner([0.0] * (world.n - 1)), CORNER_BARRIER)
        if history is None:
            state = system.solve(middle, corner([0.0] * (world.n - 1)))
            history = SlipHistory.begin(system, state, np.zeros(world.n - 1))
        else:
            history = history.moved(system)
            state = _loaded(system, middle, history)
        history = history.after(system, state)
        found.append(tip_pose(system, state))
    return found


def _loaded(system: System, middle: State, history: SlipHistory) -> State:
    """From the frictionless state at once, or with friction that grows where Newton's method goes in circles."""
    try:
        return system.solve(middle, history)
    except NoEquilibrium:
        for share in GROWING:
            middle = system.solve(middle, history.scaled(share), CORNER_BARRIER, ROUGHLY_M)
        return system.solve(middle, history)
