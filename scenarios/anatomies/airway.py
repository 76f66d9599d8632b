"""The airway from the trachea to the lobar bronchi."""

import numpy as np

from anatomies.implicit import Distance, cut_at_z, round_cone, surface, united
from anatomies.swept import FRONT_MM, Array, Mesh

# Diameters and lengths of generations 0 to 2: Weibel's model A (E. R. Weibel, Morphometry of the Human Lung, Springer
# 1963). Inclinations of generations 1 and 2 against the trachea: K. Horsfield's model (Horsfield et al. 1971, J. Appl.
# Physiol. 31:207-217, as tabulated later: 20 and 31 degrees). The planes in which lobar bronchi part are chosen.
TRACHEA_RADIUS, MAIN_RADIUS, LOBAR_RADIUS = 9.0, 6.1, 4.15
MAIN_LENGTH, LOBAR_LENGTH = 47.6, 19.0
MAIN_INCLINATION, LOBAR_INCLINATION = np.radians(20), np.radians(31)
CARINA_MM = 45.0  # ahead of the robot's plate, which a bronchoscope has brought into the trachea
LOBAR_TURN = np.radians(75)  # of a lobar bronchus against its main bronchus, about the trachea


def airway() -> Mesh:
    """A trachea of 18 mm diameter, two main bronchi, four lobar bronchi, flowing into each other."""
    return surface(airway_distance(), (-36, -24, FRONT_MM - 3), (36, 24, 114), 1.75)


def airway_distance() -> Distance:
    """Its distance, which phantoms are made of."""
    tube: list[Distance] = [round_cone((0, 0, FRONT_MM - 20), (0, 0, CARINA_MM - 6), TRACHEA_RADIUS)]
    carina = np.array([0, 0, CARINA_MM - 8.0])
    for side in (0.0, np.pi):
        fork = carina + MAIN_LENGTH * _direction(MAIN_INCLINATION, side)
        tube.append(round_cone(carina, fork, MAIN_RADIUS))
        for turn in (-LOBAR_TURN, LOBAR_TURN):
            end = fork + LOBAR_LENGTH * _direction(LOBAR_INCLINATION, side + turn)
            tube.append(round_cone(fork, end, LOBAR_RADIUS))
    return cut_at_z(united(tube, 3.0), FRONT_MM)


def _direction(inclination: float, azimuth: float) -> Array:
    across = np.sin(inclination)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(inclination)])
