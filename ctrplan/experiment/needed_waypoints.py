"""Waypoints of a log that a simulation of its history needs: where it is asked, and where the motion bends.

Logs have many waypoints on one straight line of joints, and more while nothing moves. Between those that are kept all
joints move together linearly, as ever.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

STRAIGHT_RAD, STRAIGHT_M = np.radians(0.3), 0.1e-3  # off a straight line that friction does not feel: it needs 30 deg


def needed_waypoints(theta: Array, l: Array, asked: NDArray[np.int_]) -> NDArray[np.int_]:  # noqa: E741
    """Numbers, in order, of the waypoints of a run (R, n) without those that lie on lines between others.

    Kept are the first, those `asked` for, and as many others as leave none farther off than 0.3 deg or 0.1 mm.
    """
    joints = np.hstack([theta / STRAIGHT_RAD, l / STRAIGHT_M])
    kept = np.zeros(len(joints), bool)
    kept[asked] = kept[0] = True
    stretches = [*zip(np.flatnonzero(kept)[:-1].tolist(), np.flatnonzero(kept)[1:].tolist(), strict=True)]
    while stretches:
        a, b = stretches.pop()
        if b - a > 1 and (far := _farthest(joints[a : b + 1])):
            kept[a + far] = True
            stretches += [(a, a + far), (a + far, b)]
    return np.flatnonzero(kept)


def _farthest(joints: Array) -> int:
    """Of the points (M, d) between the first and the last that are off their line, the farthest; 0 if none is."""
    start, along = joints[0], joints[-1] - joints[0]
    length = float(along @ along)
    places = np.clip((joints - start) @ along / length, 0.0, 1.0) if length > 0 else np.zeros(len(joints))
    away = np.abs(joints - start - places[:, None] * along).max(axis=1)
    far = int(away.argmax())
    return far if away[far] > 1 else 0
