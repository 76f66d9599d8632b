"""What walked pieces keep in every friction state, not in the solved shapes alone.

Every few samples are solved in states of the cube, those between them are interpolated along the path
(`states_between.py`). What that, or the mesh of the search, would refuse is solved itself on the certificate mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.cores import cores
from ctrplan.planning.certificate.allowances import TIGHT_M
from ctrplan.planning.certificate.anatomy_distance import AnatomyDistance
from ctrplan.planning.certificate.friction_cube import DEPTH, LEAST_DEPTH, CubeAsked, least_of_cubes
from ctrplan.planning.certificate.least_of_states import LeastOfStates, Needed
from ctrplan.planning.certificate.sample_states import SampleStates
from ctrplan.planning.certificate.states_between import StatesBetween
from ctrplan.planning.certificate.walked_piece import Piece, least_of
from ctrplan.planning.motion import path_limits

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.planning.scenario import Scenario

# Cells of every few samples and of those near the anatomy are halved once, some of them twice: a fold in the corner of
# a cell lasts for more than a few mm of motion.
NEAR_M, LOOK_EVERY, CLOSE_EVERY, CLOSE_DEPTH = 3e-3, 4, 16, 2
FIRST = 4  # narrowest samples
AT_ONCE = 32  # samples, of which there is little to compute of each
NARROW_EFFORT = 3  # of a sample that has to be solved on the certificate mesh, in those of any other
SPARE_M = 0.15e-3  # of a sample that may be interpolated: with less, what is taken off for that is too much
CLOSE_TUBES = 4  # of five tubes, cells halved twice have 881 corners and middles


def in_every_friction_state(scenario: Scenario, pieces: Sequence[Piece], spare_m: float) -> list[Piece]:
    """The pieces with clearance, stability and strain of every friction state.

    Where no state is found to have less than the solved shapes of the whole path, the least clearance is that of those
    shapes less TIGHT_M; no more than `spare_m` beyond the limit is asked for.
    """
    limits = path_limits(scenario)
    if scenario.robot.n == 1 or not scenario.robot.friction.any():
        return list(pieces)
    solved, distance = least_of(pieces), AnatomyDistance.of(scenario)
    enough = max(limits.clearance_m, min(solved - TIGHT_M, limits.clearance_m + spare_m))
    limited = Needed(limits.clearance_m, limits.stability, limits.max_strain)
    needed = replace(limited, clearance_m=enough)
    looks = [_Look(scenario, piece, needed, limits.clearance_m, distance) for piece in pieces]
    with ThreadPoolExecutor(cores()) as pool:
        rows = _narrowest(pieces)
        first = list(pool.map(lambda some: looks[some[0]].least(some[1]), rows))
        narrowest = [one for of_piece in first for one in of_piece]
        if any(not one.keeps(limited) for one in narrowest):  # no other sample makes the path valid again
            known = {piece: (samples, found) for (piece, samples), found in zip(rows, first, strict=True)}
            return [look.ended(_with(look.piece, *known.get(k, ((), ())))) for k, look in enumerate(looks)]
        enough = max(limits.clearance_m, min([enough, *(one.clearance_m for one in narrowest)]))
        return _longest_first(pool, looks, lambda look: _in_every_state(look, enough, limited))


def _longest_first(pool: Executor, looks: Sequence[_Look], work: Callable[[_Look], Piece]) -> list[Piece]:
    """In the order of `looks`; begun with those that take longest, so that no thread ends long before the others."""
    order = sorted(range(len(looks)), key=lambda k: looks[k].effort, reverse=True)
    found = dict(zip(order, pool.map(work, [looks[k] for k in order]), strict=True))
    return [found[k] for k in range(len(looks))]


def _narrowest(pieces: Sequence[Piece]) -> list[tuple[int, list[int]]]:
    """Pieces and their samples that come first: less than what they keep is not asked of any other sample.

    A piece stands there once, for its samples share what was solved and one thread has to look at them.
    """
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    chosen: dict[int, list[int]] = {}
    for clearance, piece, sample in rows[:FIRST]:
        if np.isfinite(clearance):
            chosen.setdefault(piece, []).append(sample)
    return list(chosen.items())


def _in_every_state(look: _Look, enough_m: float, limited: Needed) -> Piece:
    """Down to `enough_m` of clearance; ends with the first samples of which one breaks a limit."""
    piece, look.needed = look.piece, replace(look.needed, clearance_m=enough_m)
    for first in range(0, len(piece.clearance_m), AT_ONCE):
        samples = range(first, min(first + AT_ONCE, len(piece.clearance_m)))
        found = look.least(samples)
        piece = _with(piece, samples, found)
        if not all(one.keeps(limited) for one in found):
            break
    return look.ended(piece)


def _with(piece: Piece, samples: Sequence[int], found: Sequence[LeastOfStates]) -> Piece:
    """The piece with what was found of all states of some of its samples."""
    clearance, stability, strain = piece.clearance_m.copy(), piece.stability.copy(), piece.max_strain.copy()
    phi = piece.phi.copy()
    for k, one in zip(samples, found, strict=True):
        if one.clearance_m < clearance[k]:
            clearance[k], phi[k] = one.clearance_m, one.phi
        stability[k] = min(stability[k], one.stability)
        strain[k] = max(strain[k], one.max_strain)
    return replace(piece, clearance_m=clearance, stability=stability, max_strain=strain, phi=phi)


@dataclass(eq=False)
class _Look:
    """At a piece in all friction states; keeps the states of its samples, so that one thread at a time may look."""

    scenario: Scenario
    piece: Piece
    needed: Needed
    limit_m: float  # of clearance: of less it need not be known how little
    distance: AnatomyDistance | None
    _states: dict[tuple[int, Accuracy], SampleStates] = field(default_factory=dict)
    _found: dict[int, LeastOfStates] = field(default_factory=dict)

    @property
    def effort(self) -> int:
        """About what a look at all samples takes: those that the mesh of the search does not clear take most."""
        near = self.piece.as_walked_m < self.needed.clearance_m + NEAR_M
        short = self.piece.as_walked_m < self.needed.clearance_m
        return len(near) + int(near.sum()) + NARROW_EFFORT * int(short.sum())

    def ended(self, piece: Piece) -> Piece:
        """The piece, with how far bodies solved from scratch lay from those walked to; lets go of all bodies."""
        apart = max((states.apart_m for states in self._states.values()), default=0.0)
        self._states.clear()
        return replace(piece, apart_m=apart, finer={})

    def least(self, samples: Sequence[int]) -> list[LeastOfStates]:
        """Of each sample; all allowances taken off the clearance."""
        tries = {sample: self._tries(sample) for sample in samples if sample not in self._found}
        while going := {sample: asked for sample, one in tries.items() if (asked := next(one, None))}:
            for sample, found in zip(going, self._least(going), strict=True):
                self._found[sample] = found
                if found.keeps(self.needed):
                    tries[sample].close()
        return [self._found[sample] for sample in samples]

    def _least(self, going: Mapping[int, _Try]) -> list[LeastOfStates]:
        """What the tries find, one of each sample."""
        found = least_of_cubes([self._cube(sample, one) for sample, one in going.items()], self.distance)
        return [
            replace(least, clearance_m=least.clearance_m - self._offset_m(sample, one))
            for (sample, one), least in zip(going.items(), found, strict=True)
        ]

    def _tries(self, sample: int) -> Generator[_Try]:
        """From the cheapest on; what the last says holds."""
        own, is_walked_closely = self.piece.accuracy, self.piece.accuracy == "certificate"
        if is_walked_closely or self.piece.as_walked_m[sample] >= self.needed.clearance_m:
            depth = DEPTH if is_walked_closely else LEAST_DEPTH
            if sample % LOOK_EVERY:
                yield _Try(own, depth, is_between=True)
            if is_walked_closely or not sample % LOOK_EVERY:
                yield _Try(own, depth, is_last=is_walked_closely)
                if is_walked_closely or not np.isfinite(self._found[sample].clearance_m):
                    return
        if self.piece.clearance_m[sample] >= self.needed.clearance_m + SPARE_M:
            yield _Try("certificate", DEPTH, is_between=True)
        yield _Try("certificate", DEPTH, is_last=True)

    def _cube(self, sample: int, one: _Try) -> CubeAsked:
        """Only what is solved for itself is looked at in all cells, whatever is found in some."""
        states = self._of(sample, one.accuracy)
        known, radius = states.known
        return CubeAsked(
            known,
            radius,
            self._between(sample, one.accuracy) if one.is_between else states,
            replace(self.needed, clearance_m=self.needed.clearance_m + self._offset_m(sample, one)),
            one.depth,
            self._least_depth(sample),
            is_attempt=one.is_between,
            floor_m=self.limit_m + self._offset_m(sample, one) if one.is_last else np.inf,
        )

    def _offset_m(self, sample: int, one: _Try) -> float:
        return float(self.piece.offset_m(self.scenario, one.accuracy)[sample])

    def _between(self, sample: int, accuracy: Accuracy) -> StatesBetween:
        first = sample - sample % LOOK_EVERY
        last = min(first + LOOK_EVERY if sample > first else first, len(self.piece.l_b) - 1)
        ends = self._of(first, self.piece.accuracy), self._of(last, self.piece.accuracy)
        share = (sample - first) / max(last - first, 1)
        return StatesBetween(self._of(sample, accuracy).known[0], ends, share, accuracy != self.piece.accuracy)

    def _least_depth(self, sample: int) -> int:
        """How often all cells of a sample are halved."""
        if sample % CLOSE_EVERY == 0 and self.scenario.robot.n <= CLOSE_TUBES:
            return CLOSE_DEPTH
        is_near = self.piece.as_walked_m[sample] < self.needed.clearance_m + NEAR_M
        return LEAST_DEPTH if is_near or sample % LOOK_EVERY == 0 else 0

    def _of(self, sample: int, accuracy: Accuracy) -> SampleStates:
        key = sample, accuracy
        if key not in self._states:
            self._states[key] = SampleStates(self.scenario, self.piece, sample, accuracy)
        return self._states[key]


@dataclass(frozen=True)
class _Try:
    """A way to look at a sample."""

    accuracy: Accuracy
    depth: int
    is_between: bool = False  # by interpolation along the path
    is_last: bool = False
