"""The joint space as an OMPL state space."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ompl import base as ob

from ctrplan.base.arrays import Array
from ctrplan.planning.joint_space import JointSpace

TURNS_RAD = 4 * math.pi  # either way, of unlimited rotations whose turns lead elsewhere


def state_space(space: JointSpace) -> Any:
    """One subspace a joint: SO(2) where a turn leads to the same place, an interval otherwise; distance in mm."""
    compound, drive = ob.CompoundStateSpace(), space.drive
    for joint, wraps, weight in zip(drive.joints, drive.wraps, space.weights_mm, strict=True):
        if wraps:
            subspace: Any = ob.SO2StateSpace()
        else:
            subspace = ob.RealVectorStateSpace(1)
            bounds = ob.RealVectorBounds(1)
            bounds.setLow(max(joint.lower, -TURNS_RAD) if joint.is_unlimited else joint.lower)
            bounds.setHigh(min(joint.upper, TURNS_RAD) if joint.is_unlimited else joint.upper)
            subspace.setBounds(bounds)
        compound.addSubspace(subspace, float(weight))
    compound.lock()
    return compound


class StateReader:
    """Joint values (m,) of an OMPL state."""

    def __init__(self, space: JointSpace) -> None:
        """space: the one that `state_space` was made of."""
        self.wraps = [bool(w) for w in space.drive.wraps]

    def __call__(self, state: Any) -> Array:
        """Joint values (m,) [rad, m] of a state."""
        return np.array([state[i].value if wraps else state[i][0] for i, wraps in enumerate(self.wraps)])

    def write(self, state: Any, q: Array) -> None:
        """Puts joint values into a state; unlimited rotations are wrapped into [-pi, pi), OMPL's range."""
        for i, wraps in enumerate(self.wraps):
            if wraps:
                angle = math.remainder(float(q[i]), 2 * math.pi)
                state[i].value = -math.pi if angle >= math.pi else angle
            else:
                state[i][0] = float(q[i])
