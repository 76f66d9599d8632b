"""A tracker whose field is distorted, by metal nearby for instance."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from ctrplan.diagnosis.effect import MILLIMETRE, Effect, Parameter, Values, register
from ctrplan.drive import Array
from ctrplan.measurements import Measurements
from ctrplan.robot import Robot
from ctrplan.sensor import Poses

MONOMIALS = tuple("".join(m) or "1" for k in range(4) for m in itertools.combinations_with_replacement("xyz", k))
CENTRE_M, SPAN_M = np.array([0.0, 0.0, 0.15]), 0.1  # where the polynomials are centred and how far one unit is


@register
class SensorDistortion(Effect):
    name = "sensor_distortion"
    stage = "sensor"
    equation = "p = p + sum of a_k m_k(p), m_k the monomials up to third degree about the workspace's centre"
    signature = "errors are a smooth function of where the tip is, whatever the joints, tangents unharmed"
    look_alikes = ("base_misalignment", "joint_scale")
    experiment = "move the tracker's field generator and repeat, or probe a known grid"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{axis}_{monomial}_mm", 2.0, lower=-50, upper=50, si=MILLIMETRE)
            for axis in "xyz"
            for monomial in MONOMIALS
        )

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        names = [parameter.name for parameter in self.parameters(robot)]
        return [[name for name in names if len(name.split("_")[1]) <= degree] for degree in (2, 3)]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        by_monomial = _monomials(poses.position)
        position = poses.position.copy()
        for name, amount in values.items():
            axis, monomial, _ = name.split("_")
            position[:, "xyz".index(axis)] += amount * by_monomial[:, MONOMIALS.index(monomial)]
        return Poses(position, poses.frame)


def _monomials(position: Array) -> Array:
    axes = dict(zip("1xyz", [np.ones(len(position)), *((position - CENTRE_M) / SPAN_M).T], strict=True))
    return np.column_stack([np.prod([axes[axis] for axis in monomial], axis=0) for monomial in MONOMIALS])
