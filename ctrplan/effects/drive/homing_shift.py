"""A robot that was homed anew between runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import (
    ANYWHERE,
    DEGREE,
    MILLIMETRE,
    Effect,
    Parameter,
    Values,
    clauses,
    joined_clauses,
    register,
    shifted,
    sliding,
    turning,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

MOST_HOMINGS = 13


@register
class HomingShift(Effect):
    """Zeros of tube I after homing K beside those after the first: `theta_I_K_deg`, `l_I_K_mm`."""

    name = "homing_shift"
    in_words = "zeros of joints that differ by homing"
    stage = "drive"
    equation = "joint = commanded + zero_k in the runs of homing k from 2 on, rotations and translations"
    signature = "tubes stand turned or moved along by constants, others in the runs of each homing"
    look_alikes = ("homing_offset", "frame_shift", "drift")
    experiment = "repeat one run without homing again: its zeros stay"

    def in_figures(self, values: Values, robot: Robot) -> str:
        turned = clauses(values, "theta_I_K_deg", "after homing {K} tube {I} stands turned by {value} deg")
        place = "after homing {K} tube {I} stands {value} mm {sign}"
        return joined_clauses(turned, clauses(values, "l_I_K_mm", place, signs=("too far ahead", "too far back")))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        tubes = range(1, robot.n + 1)
        return tuple(
            parameter
            for k in range(2, MOST_HOMINGS + 1)
            for parameter in (
                *(Parameter(f"theta_{i}_{k}_deg", 8.0, lower=-90.0, upper=90.0, si=DEGREE) for i in tubes),
                *(Parameter(f"l_{i}_{k}_mm", 2.0, lower=-20.0, upper=20.0, si=MILLIMETRE) for i in tubes),
            )
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        last = int(data.homings[data.rows].max(initial=1))
        if last < 2:
            return "all runs are of one homing of the robot"
        if last > MOST_HOMINGS:
            return f"there are {last} homings, at most {MOST_HOMINGS} can be told"
        return "" if self._moving(data) else "no joint ever moves"

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        """Joints that move, in the homings that the poses are of."""
        later = [k for k in np.unique(data.homings[data.rows]).tolist() if k > 1]
        return [[f"{kind}_{i}_{k}_{unit}" for k in later for kind, i, unit in self._moving(data)]]

    def anywhere(self, values: Values) -> Mapping[str, float]:
        """Nobody knows after which homing a motion will be driven."""
        most: dict[str, float] = {}
        for name, value in values.items():
            of_joint = "_".join([*name.split("_")[:2], ANYWHERE])
            most[of_joint] = max(most.get(of_joint, 0.0), abs(value))
        return most

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        unknown = {name: value for name, value in values.items() if name.endswith(ANYWHERE)}
        return shifted(collars, unknown, lambda shift, _column: shift)

    def zeros(self, values: Values, data: Measurements) -> Array:
        shift = np.zeros((MOST_HOMINGS + 1, 2 * data.n))
        for name, value in values.items():
            kind, tube, homing, _ = name.split("_")
            shift[int(homing), int(tube) - 1 + (data.n if kind == "l" else 0)] = value
        of_each: Array = shift[np.minimum(data.homings[data.rows], MOST_HOMINGS)]
        return of_each

    def _moving(self, data: Measurements) -> list[tuple[str, int, str]]:
        """Joints as parts of the parameters' names."""
        return [*(("theta", i, "deg") for i in turning(data)), *(("l", i, "mm") for i in sliding(data))]
