"""What is asked of a motion, which limit a walk of it breaks, and clearances between the corners of friction."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.anatomy.parts import exact_clearance_of_many
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.mechanics.core_arrays import core_grid
from ctrplan.mechanics.equilibria import SAME_SHAPE_M
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathLimits
from ctrplan.motion.play import usual_play_shift
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.uncertainty.body_clearance import usual_allowance_m

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import FrictionBodies
    from ctrplan.mechanics.walk import Field, PathSamples
    from ctrplan.scenario.scenario import Scenario

# What a certificate on the fine mesh takes off a clearance, half the motion between samples and the discretisation
# error, and a little for what the search's coarse mesh usually differs.
SEARCH_ROOM_M = 0.5e-3
SAMPLES, SEED = 8, 6  # configurations that say what a search has to allow for uncertain parameters
BESIDE = 0.25  # of what a pair can hold, to either side of an interpolated state: half the steps of the interpolation
TOO_CLOSE = "too close to the anatomy"  # how the sentences end that this is about


def path_limits(scenario: Scenario) -> PathLimits:
    """Margins as limits; the anatomy's own margins are in the field, what calibration left unexplained comes on top."""
    strain = min([scenario.margins.max_strain, *(tube.max_strain for tube in scenario.robot.tubes)])
    return PathLimits(scenario.margins.stability, strain, scenario.robot.model_error_m)


def search_limits(scenario: Scenario, reserve_m: float = SEARCH_ROOM_M) -> PathLimits:
    """Limits for the search, which keeps a little more clearance so that its paths pass the certificate."""
    limits = path_limits(scenario)
    space = JointSpace.of(scenario)
    room = reserve_m + usual_play_shift(scenario.robot, space)
    room += usual_allowance_m(scenario, lambda: space.sample(np.random.default_rng(SEED), SAMPLES))
    return replace(limits, clearance_m=limits.clearance_m + room)


def breach(samples: PathSamples, limits: PathLimits) -> str:
    """The limit that the last sample breaks, in words; empty if none."""
    if samples.status[-1] == Status.FAILED:
        return "the mechanics solver failed"
    if samples.status[-1] == Status.UNSTABLE:
        return "elastically unstable, the robot would snap"
    if samples.stability[-1] < limits.stability:
        return f"stability {samples.stability[-1]:.3g} is below the margin {limits.stability:g}"
    if samples.max_strain[-1] > limits.max_strain:
        return f"strain {100 * samples.max_strain[-1]:.2f} % is above {100 * limits.max_strain:g} %"
    if samples.clearance_m[-1] < limits.clearance_m:
        short = (limits.clearance_m - samples.clearance_m[-1]) * MM_PER_M
        is_between = samples.nearest_phi.size > 0 and bool(np.isfinite(samples.nearest_phi[-1]).all())
        return f"{'a shape that friction allows' if is_between else 'a corner shape'} comes {short:.2f} mm {TOO_CLOSE}"
    return ""


def clearance_between(
    scenario: Scenario, field: Field, q: Array, phi: Array, tip_m: Array, spacing_m: float
) -> tuple[float, int]:
    """Least clearance [m] at joints q (m,) in friction states between the corners, downhill from phi (P,), as a hint.

    Friction may move a body past an obstacle from one sign corner to another, where it is far away in both. inf where
    the states are not those of the equilibrium whose frictionless tip (3,) was walked to. And how many were solved.
    """
    solver = scenario.robot.mechanics.friction_states(*scenario.robot.drive.collars(q))
    none = solver.bodies(np.zeros((1, len(phi))), spacing_m=spacing_m)
    if not np.linalg.norm(none.point_m[0, -1] - tip_m) < SAME_SHAPE_M:
        return np.inf, 1
    sides = BESIDE * np.vstack([np.zeros(len(phi)), np.eye(len(phi)), -np.eye(len(phi))])
    known, least_m = set[bytes](), np.inf
    while True:
        states = np.unique(np.clip(phi + sides, -1.0, 1.0), axis=0)
        states = states[[state.tobytes() not in known for state in states]]
        if not len(states):
            return least_m, 1 + len(known)
        known |= {state.tobytes() for state in states}
        bodies = solver.bodies(states, spacing_m=spacing_m)
        rooms = _rooms(scenario, field, bodies)
        if not bodies.solved.all() or not rooms.min() < least_m:
            return least_m, 1 + len(known)
        phi, least_m = states[np.argmin(rooms)], float(rooms.min())


def _rooms(scenario: Scenario, field: Field, bodies: FrictionBodies) -> Array:
    """(S,) [m] clearances of bodies, exact where the grid, which is off by less than its spacing, has the least."""
    grid, points = core_grid(field), bodies.point_m.reshape(-1, 3)
    assert grid is not None, "there is a field"
    rooms = np.asarray(grid.sample(np.ascontiguousarray(points))) - np.tile(bodies.radius_m, len(bodies.point_m))
    near = np.flatnonzero(rooms < rooms.min() + field.spacing_m)
    radius_m = bodies.radius_m[near % len(bodies.radius_m)]
    rooms[near] = exact_clearance_of_many(scenario.anatomy, scenario.located(points[near])) - radius_m
    return np.asarray(rooms.reshape(len(bodies.point_m), -1).min(axis=1))
