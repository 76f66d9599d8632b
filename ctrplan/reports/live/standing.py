"""The robot's base where the live view has moved it to: the scenario there, and what checks its motions."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import MM_PER_M
from ctrplan.errors import InputError
from ctrplan.motion.checker import MotionChecker, path_limits

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

FARTHEST = 1e4  # mm or deg of a move
REMEMBERED = 4  # places


@dataclass(frozen=True, eq=False)
class Standing:
    """A scenario with its base somewhere."""

    scenario: Scenario
    checker: MotionChecker

    @classmethod
    def of(cls, scenario: Scenario) -> Standing:
        """Where the scenario has it."""
        checker = MotionChecker(scenario)
        checker.limits = path_limits(scenario)  # the scenario's own, without what a search adds
        return cls(scenario, checker)

    @property
    def lines(self) -> str:
        """[base] of a scenario file."""
        x, y, z, w = Rotation.from_matrix(self.scenario.base_R).as_quat(canonical=True).tolist()
        place = ", ".join(f"{value:.6g}" for value in (self.scenario.base_position_m * MM_PER_M + 0.0).tolist())
        turn = ", ".join(f"{value + 0.0:.9f}".rstrip("0").rstrip(".") for value in (w, x, y, z))
        return f"[base]\nposition_mm = [{place}]\nquaternion_wxyz = [{turn}]"


class Standings:
    """Places of the base; the last few are remembered. Calls may come from several threads."""

    def __init__(self, scenario: Scenario) -> None:
        """Begins where the scenario has it."""
        self.first = Standing.of(scenario)
        self._known: dict[tuple[float, ...], Standing] = {}
        self._lock = threading.Lock()

    def at(self, move: list[float] | None) -> Standing:
        """With the base moved by x, y, z [mm] and turned about the anatomy's axes through it, x first, then y, z [deg].

        Raises InputError unless there are six finite numbers.
        """
        if move is None or not any(move):
            return self.first
        if len(move) != 6 or not all(math.isfinite(value) and abs(value) <= FARTHEST for value in move):
            raise InputError(f"must be six numbers up to {FARTHEST:g}, mm and deg", key="base", value=move)
        key = tuple(move)
        with self._lock:
            if key not in self._known:
                while len(self._known) >= REMEMBERED:
                    del self._known[next(iter(self._known))]
                self._known[key] = Standing.of(self._moved(move))
            return self._known[key]

    def _moved(self, move: list[float]) -> Scenario:
        scenario = self.first.scenario
        position_m = scenario.base_position_m + np.array(move[:3]) / MM_PER_M
        turned = Rotation.from_euler("xyz", move[3:], degrees=True).as_matrix() @ scenario.base_R
        return replace(scenario, base_position_m=position_m, base_R=turned)
