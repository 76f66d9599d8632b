"""Play in the drive."""

from __future__ import annotations

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import (
    DEGREE,
    MILLIMETRE,
    Effect,
    Parameter,
    Values,
    clauses,
    joined_clauses,
    numbered,
    register,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class Backlash(Effect):
    """Play b per actuator: `theta_I_deg` and `l_I_mm` are its full widths, I the tube from 1 (outermost), b >= 0."""

    name = "backlash"
    in_words = "play in the drive"
    stage = "drive"
    equation = "joint = commanded - b / 2 times the sign of its last motion"
    signature = "poses differ with the last direction of an actuator, by the same angle everywhere"
    look_alikes = ("friction", "lag")
    experiment = "approach from both sides where curvatures are aligned: friction has no effect there, backlash has"
    depends_on_history = True
    acts_at_rest = False

    def in_figures(self, values: Values, robot: Robot) -> str:
        turned = clauses(values, "theta_I_deg", "the rotation of tube {I} has {value} deg of play")
        return joined_clauses(turned, clauses(values, "l_I_mm", "the translation of tube {I} has {value} mm of play"))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        tubes = range(1, robot.n + 1)
        turns = (Parameter(name, 4.0, lower=0.0, upper=60.0, si=DEGREE) for name in numbered("theta", tubes, "_deg"))
        slides = (Parameter(name, 1.0, lower=0.0, upper=20.0, si=MILLIMETRE) for name in numbered("l", tubes, "_mm"))
        return (*turns, *slides)

    def untestable(self, robot: Robot, data: Measurements) -> str:
        return "" if _reversed(data) else "every actuator was always approached in the same direction"

    def variants(self, robot: Robot, data: Measurements) -> list[list[str]]:
        return [_reversed(data)]

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        n = collars.theta.shape[1]
        theta, l = collars.theta.copy(), collars.l.copy()  # noqa: E741
        for name, width in values.items():
            kind, tube = name.split("_")[0], int(name.split("_")[1]) - 1
            if kind == "theta":
                theta[:, tube] -= width / 2 * directions[:, tube]
            else:
                l[:, tube] -= width / 2 * directions[:, n + tube]
        return Collars(theta, l)


def _reversed(data: Measurements) -> list[str]:
    """Parameters of the actuators that poses were approached with in both directions."""
    from ctrplan.measurement.approach import last_directions

    directions = last_directions(data)
    both = [(directions[:, j] > 0).any() and (directions[:, j] < 0).any() for j in range(2 * data.n)]
    turns = numbered("theta", (i + 1 for i in range(data.n) if both[i]), "_deg")
    return turns + numbered("l", (i + 1 for i in range(data.n) if both[data.n + i]), "_mm")
