"""Which way the base of a scenario file looks: a quaternion, the direction of its z axis, or a point on it."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array, read_only
from ctrplan.base.directions import shortest_rotation
from ctrplan.files.scenario_entries import BaseEntry
from ctrplan.storage.toml_document import Document

QUATERNION_TOLERANCE = 1e-3
WAYS = ("quaternion_wxyz", "direction", "look_at")


def base_rotation(base: BaseEntry, document: Document) -> Array:
    """(3, 3) from the robot's frame to the anatomy's. Raises InputError for two ways of saying it, and none."""
    given = [way for way in WAYS if getattr(base, way) is not None]
    if len(given) > 1:
        raise document.fault(f"must have only one of {', '.join(WAYS)}, has {' and '.join(given)}", "base")
    if base.roll_deg is not None and given not in (["direction"], ["look_at"]):
        raise document.fault("goes with direction or look_at", "base", "roll_deg")
    if given in ([], ["quaternion_wxyz"]):
        return _turned(base.quaternion_wxyz or (1.0, 0.0, 0.0, 0.0), document)
    roll = Rotation.from_euler("z", base.roll_deg or 0.0, degrees=True).as_matrix()
    return read_only(shortest_rotation(_direction(base, document)) @ roll)


def _turned(wxyz: tuple[float, float, float, float], document: Document) -> Array:
    w, x, y, z = wxyz
    norm = math.hypot(w, x, y, z)
    if not abs(norm - 1) <= QUATERNION_TOLERANCE:
        rule = f"must have norm 1 within {QUATERNION_TOLERANCE}, has {norm:g}"
        raise document.fault(rule, "base", "quaternion_wxyz")
    return read_only(Rotation.from_quat([x, y, z, w]).as_matrix())


def _direction(base: BaseEntry, document: Document) -> Array:
    """(3,) of any length."""
    if base.direction is not None:
        if not any(base.direction):
            raise document.fault("must not be zero", "base", "direction")
        return np.array(base.direction)
    away: Array = np.subtract(base.look_at or base.position_mm, base.position_mm)
    if not away.any():
        raise document.fault("must not be the base's own position_mm", "base", "look_at")
    return away
