"""Bounds for whoever moves a robot step by step: each solve starts from the one before, shapes on demand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ctrplan import _model
from ctrplan.base.arrays import Array
from ctrplan.mechanics.core_arrays import joint_row, solved_bound
from ctrplan.mechanics.shapes import Bound, Status, input_errors


@dataclass(frozen=True, eq=False)
class BoundStep:
    """The bound where a walker stands. NaN where a solve FAILED."""

    position_m: float  # of the tip
    tangent_rad: float
    stability: float
    max_strain: float
    residual: float  # largest of all shapes
    status: Status  # never MULTIPLE: other solutions are not looked for
    tip_m: Array  # (3,) frictionless
    tip_tangent: Array  # (3,)
    started_cold: bool  # not from the last solution: the branch is that of continuation from no precurvature
    solves: int  # configurations on the way, this one among them


class Walker:
    """A robot that stands somewhere and is moved on. Made by `Robot.walker`.

    Warm steps stay on the branch that the path is on, which need not be that of `Robot.bound`. One thread at a time.
    """

    def __init__(self, core: _model.Walker, n: int) -> None:
        """core: what `Mechanics.core_walker` made, of n tubes."""
        self._core, self._n = core, n

    def bound(self, theta_b: ArrayLike, l_b: ArrayLike) -> BoundStep:
        """The bound at collars (n,) [rad], (n,) [m], from where the walker stands, in steps of 0.1 rad or 3 mm at most.

        Ctrl-C on the way leaves it nowhere: the next step starts cold. Raises InputError.
        """
        with input_errors():
            found = self._core.step(joint_row(theta_b, self._n), joint_row(l_b, self._n))
        position_m, tangent_rad, stability, max_strain, residual, status, tip, tangent, cold, solves = found
        return BoundStep(
            position_m=position_m,
            tangent_rad=tangent_rad,
            stability=stability,
            max_strain=max_strain,
            residual=residual,
            status=Status(status),
            tip_m=np.array(tip),
            tip_tangent=np.array(tangent),
            started_cold=cold,
            solves=solves,
        )

    def shapes(self) -> Bound:
        """The shapes of the last step. Raises InputError before the first one."""
        with input_errors():
            return solved_bound(self._core.shapes())
