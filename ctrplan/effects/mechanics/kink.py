"""A tube that is bent at a place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ctrplan.effects.effect import (
    DEGREE,
    Clauses,
    Effect,
    Parameter,
    Values,
    joined_clauses,
    length_of,
    register,
    two_digits,
)
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot


@register
class Kink(Effect):
    """`along_I_K_C_deg`, `across_I_K_C_deg`: by how much cell C of section K of tube I is bent besides.

    Along the drawn precurvature, and out of its plane. Cells are equal parts of a curved section, 15 mm long at most.
    """

    name = "kink"
    in_words = "a tube that is bent at a place"
    stage = "mechanics"
    equation = "u_hat += angle / w along one of the equal cells of a section, w <= 15 mm long"
    signature = "errors that turn with one tube and begin where that is bent"
    is_alone = True
    look_alikes = ("off_plane_precurvature", "homing_offset", "varying_precurvature")
    experiment = "draw the bent place into the tube around it and out of it: outside it bends the robot more"

    def in_figures(self, values: Values, robot: Robot) -> str:
        bends: Clauses = []
        for i, k, c in sorted({_place(name) for name in values}):
            sections = robot.tubes[i - 1].sections
            section, before = sections[k - 1], sum(each.length_m for each in sections[: k - 1])
            angle = length_of(values, *_names(i, k, c))
            at_mm = 1e3 * (before + (c - 0.5) * section.length_m / section.cells)
            bends.append((angle, f"tube {i} is bent by {two_digits(angle)} deg {at_mm:.0f} mm from its base"))
        return joined_clauses(bends)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        names = (name for place in _cells(robot) for name in _names(*place))
        # a prior: 3 deg are 5 mm at a tip 100 mm on; a range: 60 deg in 15 mm are a radius of 14 mm
        return tuple(Parameter(name, 3.0, lower=-60.0, upper=60.0, si=DEGREE) for name in names)

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        return [_names(*place) for place in _cells(robot)]

    def shared(self, names: Sequence[str]) -> Sequence[str]:
        """Within its plane: a precurvature that varies along its section in any other way acts so, too."""
        return [name for name in names if name.startswith("along")]

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        changed: dict[str, float] = {}
        for i, k, c in sorted({_place(name) for name in values}):
            section = robot.tubes[i - 1].sections[k - 1]
            x, y = np.array([section.curvature_x_per_m, section.curvature_y_per_m]) / section.curvature_per_m
            along, across = (values.get(name, 0.0) for name in _names(i, k, c))
            cell = f"tube.{i}.section.{k}.cell.{c}"
            changed |= {f"{cell}.x_rad": along * x + across * y, f"{cell}.y_rad": along * y - across * x}
        return changed


def _cells(robot: Robot) -> Iterator[tuple[int, int, int]]:
    """Tube, section and cell, from 1, of all that are curved."""
    for i, tube in enumerate(robot.tubes, start=1):
        for k, section in enumerate(tube.sections, start=1):
            if section.curvature_per_m > 0:
                yield from ((i, k, c) for c in range(1, section.cells + 1))


def _names(i: int, k: int, c: int) -> list[str]:
    return [f"{way}_{i}_{k}_{c}_deg" for way in ("along", "across")]


def _place(name: str) -> tuple[int, int, int]:
    i, k, c = map(int, name.split("_")[1:4])
    return i, k, c
