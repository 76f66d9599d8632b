"""Ribs across the way."""

import numpy as np

from anatomies.swept import Mesh, joined, sweep_tube


def ribs() -> Mesh:
    """Four ribs across the way 75 mm ahead, 20 mm apart in y: 8 mm thick, arcs of 90 mm radius, with rounded ends."""
    return joined(_rib(y) for y in (-30.0, -10.0, 10.0, 30.0))


def _rib(y: float, radius: float = 4.0, arc_radius: float = 90.0, half_angle: float = 0.6) -> Mesh:
    length = 2 * arc_radius * half_angle
    # Towards each end the nodes crowd as on a hemisphere's meridian.
    cap = radius * (1 - np.cos(np.linspace(0, np.pi / 2, 7)))
    along = np.concatenate([cap[:-1], np.linspace(radius, length - radius, 40), length - cap[-2::-1]])
    angle = along / arc_radius - half_angle
    centreline = np.stack(
        [arc_radius * np.sin(angle), np.full_like(along, y), 75 + arc_radius * (1 - np.cos(angle))], axis=1
    )
    to_end = np.minimum(np.minimum(along, length - along), radius)
    return sweep_tube(centreline, np.sqrt(to_end * (2 * radius - to_end)), 16)
