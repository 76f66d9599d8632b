"""Bounds looked up on a grid in the core; `ctrplan.motion.bound_table` decides what is on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan import _model
from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.core_arrays import core_density, core_grid, core_limits, joint_rows, promised
from ctrplan.mechanics.shapes import input_errors
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits, PathSamples

COLUMNS = {name: slice(first, first + count) for name, (first, count) in _model.entry_columns().items()}


def _mirror() -> NDArray[np.float32]:
    factors = np.ones(max(columns.stop for columns in COLUMNS.values()), np.float32)
    for vectors in ("point", "tip_tangent"):
        factors[COLUMNS[vectors]][1::3] = -1
    return factors


@dataclass(frozen=True, eq=False)
class FieldEntries:
    """Bounds and shapes of K configurations as a grid of bounds holds them, tube 1 turned to zero."""

    position_m: Array  # (K,) bound of the tip
    valid: Array  # (K,) 1 where solved and stable
    points_m: Array  # (K, S, 3) outermost centreline, evenly from the plate (not counted) to the innermost tip
    envelope_m: Array  # (K, S) largest deviation of a corner there


class FieldLookup:
    """A grid of bounds in the core. axes: (tube, is a rotation, lower, step, count), last one fastest.

    values (points, NUMBERS) float32 as `Mechanics.field_entries` gives them; margin_m is added to bounds and envelopes.
    A joint without an axis is taken to stand where it stood for the values, whatever a configuration says of it.
    """

    NUMBERS = max(columns.stop for columns in COLUMNS.values())  # of an entry
    VALID = COLUMNS["valid"].start
    MIRROR = _mirror()  # factor of each number where the robot is seen in the mirror y = 0

    def __init__(
        self,
        mechanics: Mechanics,
        axes: Sequence[tuple[int, bool, float, float, int]],
        values: NDArray[np.float32],
        margin_m: float,
    ) -> None:
        """Refers to the values, which must not change.

        Raises InputError where they do not fit the axes, or the axes the tubes.
        """
        self.n = mechanics.n
        self._core = mechanics.core_lookup(axes, values, margin_m)

    def sample(self, theta_b: ArrayLike, l_b: ArrayLike) -> FieldEntries:
        """Interpolated entries at configurations (K, n), (K, n); not valid next to unsolved or unstable ones."""
        return self.entries(np.asarray(self._core.sample(*joint_rows(theta_b, l_b, self.n))))

    @classmethod
    def entries(cls, table: Array) -> FieldEntries:
        """Names for the columns of a table of entries."""
        return FieldEntries(
            position_m=table[:, COLUMNS["position"].start],
            valid=table[:, cls.VALID],
            points_m=table[:, COLUMNS["point"]].reshape(len(table), -1, 3),
            envelope_m=table[:, COLUMNS["envelope"]],
        )

    def check_path(
        self, theta_b: ArrayLike, l_b: ArrayLike, field: Field | None, *, density: PathDensity, limits: PathLimits
    ) -> PathSamples:
        """As `Mechanics.check_path`, by lookup; FAILED next to configurations that the grid has no answer for."""
        until = core_density(density), core_limits(limits)
        with input_errors():
            rows = joint_rows(theta_b, l_b, self.n)
            return promised(PathSamples(**self._core.check_path(*rows, core_grid(field), *until)))
