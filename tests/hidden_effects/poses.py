"""Poses of a world at joint rows: solves share what they can, one cold solve for a configuration and its approaches."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hidden_effects.equilibrium import CORNER_BARRIER, NoEquilibrium, State, System, corner, tip_pose
from hidden_effects.mesh import Fineness
from hidden_effects.tube import Array
from hidden_effects.world import World

NEARBY_RAD = 0.3


@dataclass
class Solver:
    """Solves poses of one world; remembers the last frictionless state, from which neighbours start."""

    world: World
    fineness: Fineness = field(default_factory=Fineness)
    _last: tuple[System, State] | None = None

    def pose(self, theta: Array, l_b: Array, phi: Array, time_s: float = 0.0) -> tuple[Array, Array]:
        """Tip (3,) [m] and tip frame (3, 3) at collar joints (n,) and friction states (n - 1,)."""
        world = self.world
        system = System(world.tubes_at(time_s), world.pairs, theta, l_b, world.loads, self.fineness)
        released = corner(np.zeros(world.n - 1).tolist())
        start = self._neighbour(system)
        try:
            middle = system.solve(start or system.cold(), released, CORNER_BARRIER)
        except (NoEquilibrium, np.linalg.LinAlgError):
            if start is None:
                raise
            middle = system.solve(system.cold(), released, CORNER_BARRIER)
        self._last = system, middle
        return tip_pose(system, system.solve(middle, corner(phi.tolist())))

    def _neighbour(self, system: System) -> State | None:
        if self._last is None:
            return None
        old, state = self._last
        turned = system.theta_b - old.theta_b
        if np.array_equal(system.start, old.start) and [len(c.s) for c in system.contacts] == [
            len(c.s) for c in old.contacts
        ] and np.abs(turned).max() < NEARBY_RAD and np.abs(system.s - old.s).max() < 2e-3:
            near = state.copy()
            for i, rod in enumerate(system.rods):
                near.x[system.start[i] + rod.n_bend : system.start[i + 1]] += turned[i]
            near.barrier = CORNER_BARRIER
            return near
        return None
