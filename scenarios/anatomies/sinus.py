"""Bone on the way through the nose into the sphenoid sinus."""

import numpy as np

from anatomies.implicit import box, round_cone, surface, without
from anatomies.swept import Mesh, joined, sweep_tube

# From the anterior nasal spine to the anterior wall of the sphenoid sinus 62.3 mm, to the wall of the sella 75.9 mm, so
# that the sinus is 13.6 mm deep (means of 24 cadavers, Clinical Anatomy 23:629-636, 2010, doi 10.1002/ca.20984). The
# opening made in the wall, the thickness of bone and mucosa, and size and place of the conchae are chosen.
WALL_MM, SELLA_MM, THICKNESS_MM = 62.3, 75.9, 3.5
OPENING_RADIUS, HALF_WIDTH = 7.5, 22.0


def sphenoid_wall() -> Mesh:
    """The wall of the sinus as a plate across the way with a round opening, 15 mm wide."""
    plate = box((-HALF_WIDTH, -HALF_WIDTH, WALL_MM), (HALF_WIDTH, HALF_WIDTH, WALL_MM + THICKNESS_MM), 1.2)
    hole = round_cone((0, 0, WALL_MM - 20), (0, 0, WALL_MM + 20), OPENING_RADIUS)
    margin = HALF_WIDTH + 2.6
    return surface(without(plate, hole), (-margin, -margin, WALL_MM - 2.6), (margin, margin, WALL_MM + 7), 1.3)


def conchae() -> Mesh:
    """Inferior and middle nasal concha beside the way: scrolls of bone, here rods of 4 and 3 mm radius."""
    return joined([_concha(10.5, -7.0, 12.0, 50.0, 4.0), _concha(9.0, 6.0, 22.0, 56.0, 3.0)])


def _concha(x: float, y: float, begin: float, end: float, radius: float) -> Mesh:
    """A rod along z with rounded ends, bent slightly towards the septum."""
    length = end - begin
    cap = radius * (1 - np.cos(np.linspace(0, np.pi / 2, 7)))
    along = np.concatenate([cap[:-1], np.linspace(radius, length - radius, 16), length - cap[-2::-1]])
    bow = 1.5 * np.sin(np.pi * along / length)
    centreline = np.stack([x - bow, np.full_like(along, y), begin + along], axis=1)
    to_end = np.minimum(np.minimum(along, length - along), radius)
    return sweep_tube(centreline, np.sqrt(to_end * (2 * radius - to_end)), 16)
