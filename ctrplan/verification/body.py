"""Points of the body of a solved shape: every tube where it is the outermost one in front of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Shape, TubeShape
    from ctrplan.robot.robot import Robot

SPACING_M = 0.5e-3  # between points


@dataclass(frozen=True, eq=False)
class Body:
    """N points along the robot, from the plate to the tip, robot frame."""

    point_m: Array  # (N, 3)
    radius_m: Array  # (N,) outer radius of the tube there
    tube: NDArray[np.int_]  # (N,) its number, from 1

    def around(self, index: int, count: int = 10) -> Body:
        """`count` times as many points, on the chords from the point before to the one after."""
        ends = range(max(index - 1, 0), min(index + 2, len(self.tube)))
        share = np.linspace(0, len(ends) - 1, count * (len(ends) - 1) + 1)
        points = np.stack([np.interp(share, range(len(ends)), column) for column in self.point_m[ends].T], axis=1)
        radius = np.interp(share, range(len(ends)), self.radius_m[ends])
        return Body(points, radius, np.full(len(share), self.tube[index]))


def body_of(robot: Robot, shape: Shape) -> Body:
    """The body of a shape: cubic curves through the stations of each tube, along its tangents."""
    points, radii, numbers, begin = [], [], [], 0.0
    for number, (tube, solved) in enumerate(zip(robot.tubes, shape.tubes, strict=True), start=1):
        end = float(solved.s_m[-1])
        if end <= begin:
            continue
        s = np.linspace(begin, end, max(2, int(np.ceil((end - begin) / SPACING_M)) + 1))
        points.append(_curve(solved, s))
        radii.append(np.full(len(s), tube.outer_diameter_m / 2))
        numbers.append(np.full(len(s), number))
        begin = end
    return Body(np.concatenate(points), np.concatenate(radii), np.concatenate(numbers))


def _curve(tube: TubeShape, s: Array) -> Array:
    """(N, 3) at arc lengths s (N,) within the tube's: Hermite's cubics."""
    stations, points, tangents = tube.s_m, tube.centreline_m, tube.frames[:, :, 2]
    k = np.clip(np.searchsorted(stations, s, side="right") - 1, 0, len(stations) - 2)
    step = stations[k + 1] - stations[k]
    t = ((s - stations[k]) / np.where(step > 0, step, 1.0))[:, None]
    slopes = step[:, None] * tangents[k], step[:, None] * tangents[k + 1]
    curve: Array = (
        (1 + 2 * t) * (1 - t) ** 2 * points[k]
        + t * (1 - t) ** 2 * slopes[0]
        + t**2 * (3 - 2 * t) * points[k + 1]
        - t**2 * (1 - t) * slopes[1]
    )
    return curve
