"""A tracker whose field is distorted, by metal nearby for instance."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import MILLIMETRE, Effect, Parameter, Values, register, two_digits
from ctrplan.measurement.measurements import Measurements, Poses, frames_along
from ctrplan.robot.robot import Robot

MONOMIALS = tuple("".join(m) or "1" for k in range(4) for m in itertools.combinations_with_replacement("xyz", k))
FACTORS = np.array([["1xyz".index(axis) for axis in monomial.rjust(3, "1")] for monomial in MONOMIALS])
PLACES = {f"{axis}_{m}_mm": (row, column) for row, m in enumerate(MONOMIALS) for column, axis in enumerate("xyz")}
CENTRE_M, SPAN_M = np.array([0.0, 0.0, 0.15]), 0.1  # where the polynomials are centred and how far one unit is
AHEAD_M = 1e-4  # along the tangent, for the slope of the field


@register
class SensorDistortion(Effect):
    """A distorted field D with coefficients `x_MONOMIAL_mm` ...; `tangent_share` of its slope turns the tangent.

    Monomials are in (p - CENTRE_M) / SPAN_M: `x_1_mm` is constant, `z_xxy_mm` of third degree.
    """

    name = "sensor_distortion"
    in_words = "distortion of the sensor's field"
    stage = "sensor"
    equation = "p = p + D(p), D a polynomial of third degree; t = t + tangent_share dD/dp t"
    signature = "errors are a smooth function of where the tip is, whatever the joints"
    look_alikes = ("base_misalignment", "joint_scale")
    experiment = "move the tracker's field generator and repeat, or probe a known grid"

    def in_figures(self, values: Values, robot: Robot) -> str:
        sizes = {name: abs(value) for name, value in values.items() if name.endswith("_mm")}
        largest = max(sizes, key=lambda name: sizes[name], default="x")
        size = two_digits(sizes.get(largest, 0.0))
        return f"the sensor's field is bent, by {size} mm along {largest[0]} in its largest term"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        field = (
            Parameter(f"{axis}_{monomial}_mm", 2.0, lower=-50, upper=50, si=MILLIMETRE)
            for axis in "xyz"
            for monomial in MONOMIALS
        )
        return (*field, Parameter("tangent_share", 0.5, neutral=1.0, lower=0.0, upper=1.5))

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        """Fields of second and third degree, with tangents unharmed and turned, where they are measured."""
        *field, share = (parameter.name for parameter in self.parameters(robot))
        by_degree = [[name for name in field if len(name.split("_")[1]) <= degree] for degree in (2, 3)]
        return [[*names, *turned] for names in by_degree for turned in (((), (share,)) if data.has_tangents else ((),))]

    def shared(self, names: Sequence[str]) -> Sequence[str]:
        """The part linear in position: turned and shifted bases act by it, and trackers of a wrong scale."""
        return [name for name in names if name == "tangent_share" or len(name.split("_")[1]) == 1]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        here, slope = _seen(poses)
        amounts, share = _amounts(values), values.get("tangent_share", 0.0)
        if not share:
            return Poses(poses.position + here @ amounts, poses.frame)
        tangent = poses.frame[:, :, 2] + share * (slope @ amounts)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        return Poses(poses.position + here @ amounts, frames_along(tangent, poses.frame[:, :, 0]))

    def sensor_by(self, values: Values, poses: Poses) -> Mapping[str, Array]:
        here, slope = _seen(poses)
        field, share = slope @ _amounts(values), values.get("tangent_share", 0.0)
        turned = poses.frame[:, :, 2] + share * field
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        tangent = turned / length
        across = (np.eye(3) - tangent[:, :, None] * tangent[:, None, :]) / length[:, :, None]
        by = {}
        for name in values:
            if name == "tangent_share":
                by[name] = np.hstack([np.zeros_like(field), np.einsum("kij,kj->ki", across, field)])
            else:
                monomial, axis = PLACES[name]
                shift = np.eye(3)[axis] * here[:, monomial, None]
                by[name] = np.hstack([shift, share * slope[:, monomial, None] * across[:, :, axis]])
        return by


def _amounts(values: Values) -> Array:
    """(M, 3) [m] of the monomials, along each axis."""
    amounts = np.zeros((len(MONOMIALS), 3))
    for name, amount in values.items():
        if name != "tangent_share":
            amounts[PLACES[name]] = amount
    return amounts


@lru_cache(1)  # a fit asks for the same poses once a parameter
def _seen(poses: Poses) -> tuple[Array, Array]:
    """(K, M) monomials of poses, and their slopes [1/m] along the tangents."""
    here = _monomials(poses.position)
    return here, (_monomials(poses.position + AHEAD_M * poses.frame[:, :, 2]) - here) / AHEAD_M


def _monomials(position: Array) -> Array:
    """(K, M) of positions (K, 3)."""
    axes = np.column_stack([np.ones(len(position)), (position - CENTRE_M) / SPAN_M])
    monomials: Array = axes[:, FACTORS].prod(axis=2)
    return monomials
