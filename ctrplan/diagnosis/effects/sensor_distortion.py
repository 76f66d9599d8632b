"""A tracker whose field is distorted, by metal nearby for instance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.diagnosis.effect import MILLIMETRE, Effect, Parameter, Values, register
from ctrplan.drive import Array
from ctrplan.measurements import Measurements
from ctrplan.robot import Robot
from ctrplan.sensor import Poses

SQUARES = ("x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")
CENTRE_M, SPAN_M = np.array([0.0, 0.0, 0.15]), 0.1  # where the polynomials are centred and how far one unit is


@register
class SensorDistortion(Effect):
    name = "sensor_distortion"
    stage = "sensor"
    equation = "p = p + sum of a_k m_k(p), m_k the monomials of first and second degree about the workspace's centre"
    signature = "errors are a smooth function of where the tip is, whatever the joints, tangents unharmed"
    look_alikes = ("base_misalignment", "joint_scale")
    experiment = "move the tracker's field generator and repeat, or probe a known grid"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{axis}_{monomial}_mm", 2.0, lower=-50, upper=50, si=MILLIMETRE)
            for axis in "xyz"
            for monomial in SQUARES
        )

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        names = [parameter.name for parameter in self.parameters(robot)]
        return [[name for name in names if len(name.split("_")[1]) == 2], names]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        by_monomial = _monomials(poses.position)
        position = poses.position.copy()
        for name, amount in values.items():
            axis, monomial, _ = name.split("_")
            position[:, "xyz".index(axis)] += amount * by_monomial[:, SQUARES.index(monomial)]
        return Poses(position, poses.frame)


def _monomials(position: Array) -> Array:
    x, y, z = ((position - CENTRE_M) / SPAN_M).T
    return np.column_stack([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
