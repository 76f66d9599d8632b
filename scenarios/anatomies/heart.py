"""A heart chamber reached through a vein."""

import numpy as np

from anatomies.swept import FRONT_MM, Array, Mesh, blend, space_curve, sweep_tube


def heart_chamber() -> Mesh:
    """A vein of 10.5 mm radius that widens into a chamber 40 mm across and 50 mm long, its far end 160 mm ahead.

    The proportions are those of an inferior vena cava and right atrium within the normal range of adults (Lang et al.
    2015, J. Am. Soc. Echocardiogr. 28:1-39). The way there bends with a radius of 240 mm.
    """
    length, inlet, across, half_length = 160 - FRONT_MM, 10.5, 20.0, 25.0
    s_centre = length - half_length

    def kx(s: Array) -> Array:
        return (blend(s, 20, 45) - blend(s, 115, 140)) / 240

    # Equal steps along the vein, equal steps of the ellipse's angle in the chamber.
    angle = np.linspace(np.pi * 0.78, 0, 44)
    s = np.concatenate(
        [np.linspace(0, s_centre + half_length * np.cos(angle[0]), 40)[:-1], s_centre + half_length * np.cos(angle)]
    )
    fine = space_curve(length, 401, kx, lambda s: np.zeros_like(s), (0, 0, FRONT_MM))
    centreline = np.stack([np.interp(s, np.linspace(0, length, 401), axis) for axis in fine.T], axis=1)
    ellipse = across * np.sqrt(np.clip(1 - ((s - s_centre) / half_length) ** 2, 0, None))
    opening = (inlet**6 + ellipse**6) ** (1 / 6)  # the larger of the two, without an edge where they meet
    opening = inlet + (opening - inlet) * blend(s, s_centre - 1.2 * half_length, s_centre)
    radius = np.where(s < s_centre, opening, ellipse)
    return sweep_tube(centreline, radius, 32)
