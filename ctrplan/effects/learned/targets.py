"""What a built term acts on: a collar, a property of a tube, all in front of the plate, or what the sensor reads."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ctrplan.effects.effect import DEGREE, MILLIMETRE, Stage

PREFIX = "learned_"
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Kind:
    """Of a target: its stage, the unit of its coefficients, how large they may be, and what it is in words."""

    stage: Stage
    unit: str
    si: float
    prior: float
    words: str
    has_axes: bool = False

    @property
    def most(self) -> float:
        """Of a coefficient, either way."""
        return 12 * self.prior


KINDS = {
    "theta": Kind("drive", "deg", DEGREE, 5.0, "the rotation of tube {}"),
    "l": Kind("drive", "mm", MILLIMETRE, 2.0, "the translation of tube {}"),
    "curvature": Kind("mechanics", "percent", 0.01, 10.0, "the precurvature of tube {}"),
    "bend": Kind("mechanics", "percent", 0.01, 10.0, "the precurvature of tube {} across its plane"),
    "stiffness": Kind("mechanics", "percent", 0.01, 20.0, "the bending stiffness of tube {}"),
    "plate": Kind("mechanics", "deg", DEGREE, 2.0, "the tilt of all in front of the plate", has_axes=True),
    "sensor": Kind("sensor", "mm", MILLIMETRE, 3.0, "the position that is read", has_axes=True),
}
WAY = "_way"  # of a drive's term that depends on the last direction of motion
NAME = re.compile(r"learned_(theta|l|curvature|bend|stiffness|plate|sensor)(?:_([1-9]\d*))?(_way)?")


@dataclass(frozen=True)
class Target:
    """A kind and the tube that it is of, from 1; 0 of none."""

    kind_name: str
    tube: int = 0
    of_way: bool = False

    @property
    def kind(self) -> Kind:
        """Its kind."""
        return KINDS[self.kind_name]

    @property
    def effect_name(self) -> str:
        """As in a robot file."""
        return PREFIX + self.kind_name + (f"_{self.tube}" if self.tube else "") + (WAY if self.of_way else "")

    @property
    def words(self) -> str:
        """For people."""
        return self.kind.words.format(self.tube)


def target(effect_name: str, n: int) -> Target | None:
    """Of an effect's name, for a robot of n tubes; None where the name is of none."""
    found = NAME.fullmatch(effect_name)
    if not found:
        return None
    kind, tube, way = found[1], int(found[2] or 0), bool(found[3])
    if KINDS[kind].has_axes != (tube == 0) or tube > n or (way and KINDS[kind].stage != "drive"):
        return None
    return Target(kind, tube, way)
