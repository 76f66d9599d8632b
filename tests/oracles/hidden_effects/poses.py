"""Poses of a world at joint rows: solves share what they can, one cold solve for a configuration and its approaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hidden_effects.equilibrium import CORNER_BARRIER, NoEquilibrium, State, System, corner, tip_pose
from hidden_effects.mesh import Fineness
from hidden_effects.tube import Array, Tube
from hidden_effects.world import World

NEARBY_RAD, NEARBY_M = 0.3, 2e-3
EASING = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)
ROUGHLY_M = 1e-4  # for states that others start from


@dataclass
class Solver:
    """Solves poses of one world; remembers the last frictionless state, from which neighbours start."""

    world: World
    fineness: Fineness = field(default_factory=Fineness)
    _last: tuple[System, State] | None = None
    _places: tuple[Array, Array, list[float]] | None = None
    solved: tuple[System, State] = field(init=False)  # the last answer
    _known: tuple[tuple[bytes, float], tuple[Array, Array]] | None = None

    def pose(self, theta: Array, l_b: Array, phi: Array, time_s: float = 0.0) -> tuple[Array, Array]:
        """Tip (3,) [m] and tip frame (3, 3) at collar joints (n,) and friction states (n - 1,)."""
        world = self.world
        phi = phi * [pair.friction > 0 for pair in world.pairs] + 0.0  # no -0.0, whose bytes are others
        asked = np.concatenate([theta, l_b, phi]).tobytes(), time_s if world.warming else 0.0
        if self._known is None or self._known[0] != asked:
            self._known = asked, self._solve(theta, l_b, phi, time_s)
        return self._known[1]

    def _solve(self, theta: Array, l_b: Array, phi: Array, time_s: float) -> tuple[Array, Array]:
        world = self.world
        tubes, released = world.tubes_at(time_s, l_b), corner(np.zeros(world.n - 1).tolist())
        if self._places is None or _apart(self._places, theta, l_b):
            rough = System(tubes, world.pairs, theta, l_b, world.loads, Fineness.searching())
            try:
                state = rough.solve(rough.cold(), released, converged=ROUGHLY_M)
            except (NoEquilibrium, np.linalg.LinAlgError):
                state = rough.solve(_eased(rough, tubes), released, converged=ROUGHLY_M)
            found = rough.contact_places(state)
            self._places = theta, l_b, found
        system = System(tubes, world.pairs, theta, l_b, world.loads, self.fineness, self._places[2])
        start = self._neighbour(system)
        try:
            middle = system.solve(start or system.cold(), released, CORNER_BARRIER, ROUGHLY_M)
        except (NoEquilibrium, np.linalg.LinAlgError):
            middle = _eased(system, tubes)
        self._last = system, middle
        self.solved = system, system.solve(middle, corner(phi.tolist()))
        return tip_pose(*self.solved)

    def _neighbour(self, system: System) -> State | None:
        if self._last is None:
            return None
        old, state = self._last
        turned = system.theta_b - old.theta_b
        if (
            np.array_equal(system.start, old.start)
            and system.s.shape == old.s.shape  # unions of the rods' stations may differ where the rods' counts do not
            and [len(c.s) for c in system.contacts] == [len(c.s) for c in old.contacts]
            and np.abs(turned).max() < NEARBY_RAD
            and np.abs(system.s - old.s).max() < NEARBY_M
        ):
            near = state.copy()
            for i, rod in enumerate(system.rods):
                near.x[system.start[i] + rod.n_bend : system.start[i + 1]] += turned[i]
            near.barrier = CORNER_BARRIER
            return near
        return None


def _apart(places: tuple[Array, Array, list[float]], theta: Array, l_b: Array) -> bool:
    return bool(np.abs(theta - places[0]).max() > NEARBY_RAD or np.abs(l_b - places[1]).max() > NEARBY_M)


def _eased(system: System, tubes: Sequence[Tube]) -> State:
    """The frictionless state at CORNER_BARRIER by continuation from linear, round tubes on rigid shafts."""
    released = corner([0.0] * (len(tubes) - 1))
    state = system.with_tubes([tube.eased(0.0) for tube in tubes]).cold()
    for share in EASING:
        easier = system.with_tubes([tube.eased(share) for tube in tubes])
        state = easier.solve(state, released, CORNER_BARRIER, ROUGHLY_M)
    return state
