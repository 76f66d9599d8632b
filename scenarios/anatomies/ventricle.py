"""A lateral ventricle reached through a burr hole and a sheath."""

import numpy as np

from anatomies.implicit import cut_at_z, round_cone, surface, united
from anatomies.swept import FRONT_MM, Mesh

# From Kocher's point the frontal horn is reached 5 to 6 cm deep (P. J. Morone et al. 2020, Operative Neurosurgery 18,
# doi 10.1093/ons/opz194, review the entry points). Lengths of the ventricle: body 74.9 mm, frontal horn 28.5 mm (means
# of men, CT of 152 patients, Open Journal of Radiology 2015, doi 10.4236/ojrad.2015.51003). Its width is that of a
# dilated one, for whose treatment such an entry is made: chosen, as are the angle of 40 degrees between sheath and
# ventricle and the sheath's width.
SHEATH_RADIUS, DEPTH_MM = 6.0, 50.0
HORN_MM, BODY_MM, WIDEST_RADIUS = 28.5, 74.9, 11.0
ANGLE = np.radians(40)


def ventricle() -> Mesh:
    """Sheath along z, then frontal horn and body of the ventricle, slightly bent, as one room."""
    along = np.array([np.sin(ANGLE), 0.0, np.cos(ANGLE)])
    bend = np.array([-np.cos(ANGLE), 0.0, np.sin(ANGLE)])
    entry = np.array([0.0, 0.0, DEPTH_MM + WIDEST_RADIUS])
    horn = entry - (HORN_MM - 8) * along + 3.0 * bend
    middle = entry + 0.45 * (BODY_MM - HORN_MM) * along
    end = entry + (BODY_MM - HORN_MM) * along + 6.0 * bend
    room = united(
        [
            round_cone((0, 0, FRONT_MM - 20), entry, SHEATH_RADIUS),
            round_cone(horn, entry, 7.0, WIDEST_RADIUS),
            round_cone(entry, middle, WIDEST_RADIUS, 10.0),
            round_cone(middle, end, 10.0, 7.0),
        ],
        4.0,
    )
    return surface(cut_at_z(room, FRONT_MM), (-30, -15, FRONT_MM - 3), (48, 15, 116), 1.9)
