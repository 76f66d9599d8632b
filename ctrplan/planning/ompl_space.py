"""The joint space as an OMPL state space, and its callbacks. OMPL objects hold no Python state of ours beyond these."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ompl import base as ob

from ctrplan.drive import Array
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import MotionChecker


def state_space(space: JointSpace) -> Any:
    """One subspace a joint: SO(2) where a rotation is unlimited, an interval otherwise; distance in mm."""
    compound = ob.CompoundStateSpace()
    for joint, weight in zip(space.drive.joints, space.weights_mm, strict=True):
        if joint.wraps:
            subspace: Any = ob.SO2StateSpace()
        else:
            subspace = ob.RealVectorStateSpace(1)
            bounds = ob.RealVectorBounds(1)
            bounds.setLow(joint.lower)
            bounds.setHigh(joint.upper)
            subspace.setBounds(bounds)
        compound.addSubspace(subspace, float(weight))
    compound.lock()
    return compound


class StateReader:
    """Joint values (m,) of an OMPL state."""

    def __init__(self, space: JointSpace) -> None:
        self.wraps = [bool(w) for w in space.drive.wraps]

    def __call__(self, state: Any) -> Array:
        return np.array([state[i].value if wraps else state[i][0] for i, wraps in enumerate(self.wraps)])

    def write(self, state: Any, q: Array) -> None:
        """Puts joint values into a state; unlimited rotations are wrapped into [-pi, pi), OMPL's range."""
        for i, wraps in enumerate(self.wraps):
            if wraps:
                angle = math.remainder(float(q[i]), 2 * math.pi)
                state[i].value = -math.pi if angle >= math.pi else angle
            else:
                state[i][0] = float(q[i])


class Validity(ob.StateValidityChecker):  # type: ignore[misc]
    """Limits, nesting, stability, strain and clearance of a state."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def isValid(self, state: Any) -> bool:  # noqa: N802, OMPL's name
        return self.checker.state(self.read(state)).valid


class MotionValidity(ob.MotionValidator):  # type: ignore[misc]
    """The whole motion in the direction driven; OMPL's own interpolation is never asked."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802, OMPL's name
        return self.checker.motion(self.read(a), self.read(b)).valid
