"""What a robot must tell the algorithm; ctrplan.mechanics.tube.Tube does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Section(Protocol):
    """A piece of constant precurvature."""

    @property
    def length_m(self) -> float: ...
    @property
    def curvature_x_per_m(self) -> float: ...
    @property
    def curvature_y_per_m(self) -> float: ...


class Tube(Protocol):
    """Sections from base to tip; torsional stiffness is bending stiffness / (1 + nu), below (10)."""

    @property
    def outer_diameter_m(self) -> float: ...
    @property
    def inner_diameter_m(self) -> float: ...
    @property
    def bending_stiffness_Nm2(self) -> float: ...
    @property
    def poisson_ratio(self) -> float: ...
    @property
    def sections(self) -> Sequence[Section]: ...
