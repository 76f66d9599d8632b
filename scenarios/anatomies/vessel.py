"""A vessel with a branch."""

import numpy as np

from anatomies.swept import FRONT_MM, Array, Mesh, blend, space_curve, sweep_tube


def vessel() -> Mesh:
    """A vessel 205 mm long: a trunk of 13 mm radius that bends with 300 mm radius, as the proximal tubes of the robot
    of Table II do, and from 150 mm on a branch of 9 mm radius that turns off with 75 mm radius, out of the trunk's
    plane.
    """

    def kx(s: Array) -> Array:
        return blend(s, 10, 30) / 300 + blend(s, 162, 174) * (0.7 / 75 - 1 / 300)

    def ky(s: Array) -> Array:
        return blend(s, 162, 174) * 0.7 / 75

    centreline = space_curve(205 - FRONT_MM, 84, kx, ky, (0, 0, FRONT_MM))
    s = np.linspace(0, 205 - FRONT_MM, 84)
    return sweep_tube(centreline, 13 - 4 * blend(s, 150, 195), 32)
