"""Bodies of a robot in every corner of friction, and where its uncertain parameters may displace them.

The core differentiates tips, not bodies. Bodies are differenced: solved at the middle of the intervals and at one end
of each axis of the box. The other end is taken to lie opposite; the worst combination is solved by whoever asks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import FrictionBodies
from ctrplan.uncertain.margin_spread import MarginSpread
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.tip_slopes import friction_states, held_collars
from ctrplan.uncertain.worst_case import OffsetBox, Sides

SPACING_M = 1e-3  # between the points of a body


@dataclass(frozen=True, eq=False)
class BodySpread:
    """One configuration in S friction states, N points from the plate to the tip."""

    point_m: Array  # (S, N, 3) robot frame
    radius_m: Array  # (N,)
    middle_m: Array  # (S, N, 3) displacement at the middle of the intervals
    sides_m: Array  # (S, N, 3, A) further displacement at the end of each axis of the box
    stability: MarginSpread
    spared_strain: MarginSpread  # strains, negative

    def sides(self) -> Sides:
        """Of all S N points, one state after the other."""
        states, count, _, axes = self.sides_m.shape
        return Sides(self.middle_m.reshape(-1, 3), self.sides_m.reshape(states * count, 3, axes))


def body_spread(parameters: UncertainParameters, theta: Array, l: Array) -> BodySpread:  # noqa: E741
    """At commanded collars theta (n,) [rad], l (n,) [m]. NaN where there is no equilibrium."""
    box = OffsetBox.of(parameters)
    here = solved_bodies(parameters, np.zeros(parameters.count), theta, l)
    middle = solved_bodies(parameters, box.middle, theta, l) if box.middle.any() else here
    ends = [solved_bodies(parameters, box.middle + axis, theta, l) for axis in box.axes.T]
    pattern = here.point_m
    inner = alike(middle.point_m, pattern)
    displaced = [alike(end.point_m, pattern) - inner for end in ends]
    sides = np.stack(displaced, axis=3) if ends else np.zeros((*pattern.shape, 0))
    return BodySpread(
        pattern,
        here.radius_m,
        inner - pattern,
        sides,
        _spread(here.stability, middle.stability, [end.stability for end in ends]),
        _spread(-here.max_strain, -middle.max_strain, [-end.max_strain for end in ends]),
    )


def solved_bodies(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> FrictionBodies:  # noqa: E741
    """Bodies [m] in S friction states with parameters (P,) away from their values; NaN where a solve failed."""
    robot = parameters.robot_at(offset)
    theta_b, l_b = held_collars(parameters, robot, theta[None], l[None])
    found = robot.mechanics.friction_bodies(theta_b[0], l_b[0], friction_states(robot), spacing_m=SPACING_M)
    lost = ~found.solved
    return replace(
        found,
        point_m=np.where(lost[:, None, None], np.nan, found.point_m),
        stability=np.where(lost, np.nan, found.stability),
        max_strain=np.where(lost, np.nan, found.max_strain),
    )


def body_at(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741
    """(S, N, 3) of these bodies [m], and outer radii (N,) [m]."""
    found = solved_bodies(parameters, offset, theta, l)
    return found.point_m, found.radius_m


def _spread(here: Array, middle: Array, ends: list[Array]) -> MarginSpread:
    sides = np.stack(ends, axis=1) - middle[:, None] if ends else np.zeros((len(here), 0))
    return MarginSpread(here, middle - here, sides)


def alike(bodies: Array, pattern: Array) -> Array:
    """(S, N, 3) as many points on bodies (S, M, 3) as `pattern` has, at the same shares of the length."""
    if bodies.shape == pattern.shape:
        return bodies
    count = pattern.shape[1]
    if bodies.shape[1] == 0:
        return np.zeros_like(pattern)
    at = np.linspace(0.0, bodies.shape[1] - 1.0, count)
    low = np.minimum(at.astype(int), max(bodies.shape[1] - 2, 0))
    share = (at - low)[:, None]
    found: Array = bodies[:, low] * (1 - share) + bodies[:, np.minimum(low + 1, bodies.shape[1] - 1)] * share
    return found
