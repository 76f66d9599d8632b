"""Rings of a tube's colour around the robot where the tube ends, if tubes around it hide all of it."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod, Surface
from ctrplan.reports.pose import Pose

WIDTH, STANDS_OUT = 0.018, 1.35  # share of the robot's length, and of the outermost radius


def tube_surface(pose: Pose, tube: int, sides: int) -> Surface:
    """The tube with the ring at its end, which has no size where the tube can be seen; 0 the outermost."""
    rod, ring = pose.tubes[tube].surface(sides), end_ring(pose, tube).surface(sides)
    return Surface(
        np.concatenate([rod.vertices_m, ring.vertices_m]),
        np.concatenate([rod.faces, ring.faces + len(rod.vertices_m)]),
    )


def end_ring(pose: Pose, tube: int) -> Rod:
    """Rings of tubes that end at the same place stand behind each other, the outer one's first."""
    lengths = [_arc_lengths(rod.centreline_m)[-1] for rod in pose.tubes]
    width, rod = WIDTH * max(lengths), pose.tubes[tube]
    hidden = tube > 0 and lengths[tube] < max(lengths[:tube]) + width and rod.radius_m[0] > 0
    place = sum(abs(length - lengths[tube]) < width for length in lengths[:tube])
    s_m, last = _arc_lengths(rod.centreline_m), lengths[tube] - place * width
    ends = np.clip([last - width, last], 0.0, None)
    line = np.stack([np.interp(ends, s_m, column) for column in rod.centreline_m.T], axis=1)
    tangent = np.repeat(rod.tangent[-1:], 2, axis=0)
    radius = STANDS_OUT * max(other.radius_m.max() for other in pose.tubes) if hidden else 0.0
    return Rod(line, tangent, np.full(2, radius))


def _arc_lengths(line_m: Array) -> Array:
    """(S,) along the line, 0 at its beginning."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_m, axis=0), axis=1))])
