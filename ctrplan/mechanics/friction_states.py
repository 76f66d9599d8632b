"""Bodies of one configuration in friction states, whatever is asked for first and later."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ctrplan import _model
from ctrplan.base.arguments import Number, checked
from ctrplan.base.arrays import numbers
from ctrplan.errors import InputError
from ctrplan.mechanics.core_errors import input_errors
from ctrplan.mechanics.shapes import FrictionBodies, Status
from ctrplan.mechanics.walk import SHORTEST_STEP

SPACING = Number(SHORTEST_STEP, 1, "m")


class FrictionStates:
    """A robot at a configuration, solved without friction. Made by `Mechanics.friction_states`.

    Every state is solved from where it parts from the frictionless robot, so that its body does not depend on what else
    was asked. Thread-safe; the GIL is released.
    """

    def __init__(self, core: _model.FrictionStates, n: int) -> None:
        """core: the compiled part, of n tubes."""
        self._core, self._n = core, n

    @checked(spacing_m=SPACING)
    def bodies(self, phi: ArrayLike, *, spacing_m: float = 1e-3) -> FrictionBodies:
        """Bodies in S friction states phi (S, n - 1), points `spacing_m` apart at most.

        Friction that differs along a contact has phi of shape (S, G, n - 1): of G equally long parts of each pair, from
        the plate to the end of its outer tube. The points are those of `check_path` with bodies: at the same arc
        lengths in every state. Raises InputError.
        """
        states = np.atleast_2d(numbers(phi, "phi"))
        states = states[:, None] if states.ndim == 2 else states
        pairs = self._n - 1
        if states.ndim != 3 or not states.shape[1] or states.shape[2] != pairs or not np.all(np.abs(states) <= 1):
            raise InputError(f"must have shape (S, {pairs}) or (S, G, {pairs}) and lie in [-1, 1]", key="phi")
        with input_errors():
            points, status, strain, stability = self._core.bodies(np.ascontiguousarray(states), float(spacing_m))
        return FrictionBodies(points[:, :, :3], points[0, :, 3], np.asarray(status) != Status.FAILED, strain, stability)
