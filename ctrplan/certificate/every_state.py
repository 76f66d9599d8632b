"""What walked pieces keep in every friction state, not in the solved shapes alone.

Every few samples are solved in states of the cube, those between them are interpolated along the path
(`sample_states.py`). What that, or the mesh of the search, would refuse is solved itself on the certificate mesh; what
the allowance for that would refuse, with exact geometry.
"""

from __future__ import annotations

import itertools
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.long_work import cores
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_cube import (
    DEPTH,
    LEAST_DEPTH,
    CubeQuery,
    Needed,
    StateMinima,
    minima_of_cubes,
)
from ctrplan.certificate.friction_states import LOOK_EVERY, TIGHT_M, Solved, State, exact_gives_back_m
from ctrplan.certificate.narrow_samples import NARROWEST, CloserLooks, closer_looks, key_of
from ctrplan.certificate.sample_states import SampleStates, StatesBetween
from ctrplan.certificate.walked_piece import Piece, narrowest_of
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.motion.limits import path_limits

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario


# Cells of every few samples and of those near the anatomy are halved once, some of them twice: a fold in the corner of
# a cell lasts for more than a few mm of motion.
NEAR_M, CLOSE_EVERY, CLOSE_DEPTH = 3e-3, 16, 2
AT_ONCE = 64  # efforts: of most samples there is little to compute of each
NARROW_EFFORT = 3  # of a sample that has to be solved on the certificate mesh, in those of any other
SPARE_M = 0.15e-3  # of a sample that may be interpolated: with less, what is taken off for that is too much
CLOSE_TUBES = 4  # of five tubes, cells halved twice have 881 corners and middles


def in_every_friction_state(
    scenario: Scenario, pieces: Sequence[Piece], spare_m: float, more_m: float = 0.0
) -> list[Piece]:
    """The pieces with clearance, stability and strain of every friction state.

    Where no state is found to have less than the solved shapes of the whole path, the least clearance is that of those
    shapes less TIGHT_M; no more than `spare_m` beyond the limit is asked for, which is `more_m` above the scenario's.
    """
    limits = path_limits(scenario)
    limit_m = limits.clearance_m + more_m
    is_known = scenario.robot.n == 1 or not scenario.robot.friction.any()
    if is_known and not any(piece.variants.large for piece in pieces):
        return list(pieces)
    solved, distance = narrowest_of(pieces), AnatomyDistance.of(scenario)
    enough = max(limit_m, min(solved - TIGHT_M, limit_m + spare_m))
    limited = Needed(limit_m, limits.stability, limits.max_strain)
    needed = replace(limited, clearance_m=enough)
    looks = [_PieceView(scenario, piece, needed, limit_m, distance) for piece in pieces]
    known = closer_looks(spare_m)
    for look in looks:
        look.recall(known)
    with ThreadPoolExecutor(cores()) as pool:
        places = _narrowest(pieces)
        first = list(pool.map(lambda place: looks[place[0]].least([place[1]])[0], places))
        if any(not minima.keeps(limited) for minima in first):  # no other sample makes the path valid again
            for look in looks:
                look.remember(known)
            return [look.ended(_with(look.piece, *_of_piece(k, places, first))) for k, look in enumerate(looks)]
        enough = max(limit_m, min([enough, *(minima.clearance_m for minima in first)]))
        for look in looks:
            look.needed = replace(needed, clearance_m=enough)
            look.recall(known)
        result = _every_sample(pool, looks, limited)
    for look in looks:
        look.remember(known)
    return result


def _narrowest(pieces: Sequence[Piece]) -> list[tuple[int, int]]:
    """Pieces and samples that come first: less than what they keep is not asked of any other sample."""
    rows = sorted((float(c), p, k) for p, piece in enumerate(pieces) for k, c in enumerate(piece.clearance_m))
    return [(piece, sample) for clearance, piece, sample in rows[:NARROWEST] if np.isfinite(clearance)]


def _of_piece(
    piece: int, places: Sequence[tuple[int, int]], results: Sequence[StateMinima]
) -> tuple[list[int], list[StateMinima]]:
    """Samples of one piece among `places`, and what was found there."""
    rows = [(sample, minima) for (p, sample), minima in zip(places, results, strict=True) if p == piece]
    return [sample for sample, _ in rows], [minima for _, minima in rows]


def _every_sample(pool: Executor, looks: Sequence[_PieceView], limited: Needed) -> list[Piece]:
    """The pieces with what all of their samples keep, up to the first batch of which a sample breaks a limit.

    Pieces that take longest come first, in batches, so that no thread ends long before the others.
    """
    order = sorted(range(len(looks)), key=lambda k: looks[k].effort, reverse=True)
    work = {k: [(batch, pool.submit(looks[k].kept, batch, limited)) for batch in looks[k].batches()] for k in order}
    ended = dict[int, Piece]()
    for k in order:
        piece = looks[k].piece
        for samples, future in work[k]:
            result = future.result()
            if result is None:  # and all after it
                break
            piece = _with(piece, samples, result)
            if not all(minima.keeps(limited) for minima in result):
                break
        for _, future in work[k]:
            future.result()
        ended[k] = looks[k].ended(piece)
    return [ended[k] for k in range(len(looks))]


def _with(piece: Piece, samples: Sequence[int], results: Sequence[StateMinima]) -> Piece:
    """The piece with what was found of all states of some of its samples."""
    clearance, stability, strain = piece.clearance_m.copy(), piece.stability.copy(), piece.max_strain.copy()
    phi = piece.phi.copy()
    for k, minima in zip(samples, results, strict=True):
        if minima.clearance_m < clearance[k]:
            clearance[k], phi[k] = minima.clearance_m, minima.phi
        stability[k] = min(stability[k], minima.stability)
        strain[k] = max(strain[k], minima.max_strain)
    return replace(piece, clearance_m=clearance, stability=stability, max_strain=strain, phi=phi)


@dataclass(eq=False)
class _PieceView:
    """At a piece in all friction states; keeps those of its samples. Each thread looks at other samples."""

    scenario: Scenario
    piece: Piece
    needed: Needed
    limit_m: float  # of clearance: of less it need not be known how little
    distance: AnatomyDistance | None
    _states: dict[tuple[int, Accuracy], SampleStates] = field(default_factory=dict)
    _found: dict[int, StateMinima] = field(default_factory=dict)
    _asked_m: dict[int, float] = field(default_factory=dict)  # clearance that was needed when it was computed
    _broken: float = np.inf  # last sample of the first batch of which one breaks a limit
    _lock: Lock = field(default_factory=Lock)

    def recall(self, known: CloserLooks) -> None:
        """Takes over what is known of samples: that they keep what is needed, or how little there is where no less was
        asked for.
        """
        for sample, (asked_m, least) in known.minima.get(key_of(self.piece), {}).items():
            if sample not in self._found and (least.keeps(self.needed) or asked_m >= self.needed.clearance_m):
                self._found[sample], self._asked_m[sample] = least, asked_m

    def remember(self, known: CloserLooks) -> None:
        """Keeps what was found, unless a limit was broken: then it depends on when threads came to it."""
        if np.isinf(self._broken):
            rows = {sample: (self._asked_m[sample], least) for sample, least in self._found.items()}
            known.minima.setdefault(key_of(self.piece), {}).update(rows)

    @property
    def effort(self) -> int:
        """About what a look at all samples takes."""
        return int(self._efforts.sum())

    @property
    def _efforts(self) -> NDArray[np.int_]:
        """(K,) of each sample: those that the mesh of the search does not clear take most."""
        near = self.piece.as_walked_m < self.needed.clearance_m + NEAR_M
        short = self.piece.as_walked_m < self.needed.clearance_m
        efforts: NDArray[np.int_] = 1 + near.astype(int) + NARROW_EFFORT * short
        return efforts

    def batches(self) -> list[range]:
        """All samples in runs of about AT_ONCE efforts, between samples that are solved themselves."""
        efforts, firsts = np.append(0, np.cumsum(self._efforts)), [0]
        for k in range(LOOK_EVERY, len(efforts) - 1, LOOK_EVERY):
            if efforts[k] - efforts[firsts[-1]] >= AT_ONCE:
                firsts.append(k)
        return [range(*ends) for ends in itertools.pairwise([*firsts, len(efforts) - 1])]

    def kept(self, samples: range, limited: Needed) -> list[StateMinima] | None:
        """The minima of a batch; None if one before it breaks a limit, beyond which nothing is evaluated."""
        if samples[0] > self._broken:
            return None
        result = self.least(samples)
        if not all(minima.keeps(limited) for minima in result):
            with self._lock:
                self._broken = min(self._broken, samples[-1])
        return result

    def ended(self, piece: Piece) -> Piece:
        """The piece, with how far bodies solved from scratch lay from those walked to; lets go of all bodies."""
        is_whole = np.isinf(self._broken)  # else what lies behind the break depends on when threads came to it
        known = [states for (k, _), states in self._states.items() if is_whole or k <= self._broken]
        apart = max((states.apart_m for states in known), default=0.0)
        self._states.clear()
        return replace(piece, apart_m=apart, finer={})

    def least(self, samples: Sequence[int]) -> list[StateMinima]:
        """The minima of each sample; all allowances taken off the clearance."""
        tries = {sample: self._tries(sample) for sample in samples if sample not in self._found}
        while going := {sample: attempt for sample, attempts in tries.items() if (attempt := next(attempts, None))}:
            for sample, result in zip(going, self._least(going), strict=True):
                if going[sample].accuracy == "exact" and not np.isfinite(result.clearance_m):
                    with self._lock:
                        self._states.pop((sample, "exact"), None)  # not solved: what a mesh says counts
                    if sample in self._found:
                        continue
                self._found[sample], self._asked_m[sample] = result, self.needed.clearance_m
                if result.keeps(self.needed):
                    tries[sample].close()
        for sample in samples:
            for states in self._known_states(sample):
                states.let_go()
        return [self._found[sample] for sample in samples]

    def _least(self, going: Mapping[int, _Try]) -> list[StateMinima]:
        """What the tries find, one of each sample."""
        result = minima_of_cubes([self._cube(sample, attempt) for sample, attempt in going.items()], self.distance)
        return [
            replace(least, clearance_m=least.clearance_m - self._offset_m(sample, attempt))
            for (sample, attempt), least in zip(going.items(), result, strict=True)
        ]

    def _tries(self, sample: int) -> Generator[_Try]:
        """From the cheapest on; what the last says holds."""
        if is_exact := (sample, "exact") in self.piece.finer:
            yield _Try("exact", DEPTH, is_last=True)
            if np.isfinite(self._found[sample].clearance_m):
                return
        yield from self._on_meshes(sample)
        lacking_m = self.limit_m - self._found[sample].clearance_m
        if not is_exact and 0 < lacking_m <= exact_gives_back_m(self.scenario.robot):
            yield _Try("exact", DEPTH, is_last=True)

    def _on_meshes(self, sample: int) -> Generator[_Try]:
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

    def _cube(self, sample: int, attempt: _Try) -> CubeQuery:
        """Only what is solved for itself is looked at in all cells, whatever is found in some."""
        states = self._of(sample, attempt.accuracy)
        return CubeQuery(
            self._known(states),
            states.known.radius_m,
            self._between(sample, attempt.accuracy) if attempt.is_between else states,
            replace(self.needed, clearance_m=self.needed.clearance_m + self._offset_m(sample, attempt)),
            attempt.depth,
            self._least_depth(sample),
            is_attempt=attempt.is_between,
            pairs=self.piece.pairs if self.scenario.robot.friction.any() else 0,
            floor_m=self.limit_m + self._offset_m(sample, attempt) if attempt.is_last else np.inf,
        )

    def _known(self, states: SampleStates) -> dict[State, Solved]:
        """What was walked to; without the frictionless shape where that is not the middle of the box."""
        solved, variants = states.known.solved, self.piece.variants
        if not variants.large or variants.has_middle:
            return solved
        return {state: solved_state for state, solved_state in solved.items() if any(state)}

    def _offset_m(self, sample: int, attempt: _Try) -> float:
        return float(self.piece.offset_m(self.scenario, attempt.accuracy)[sample])

    def _between(self, sample: int, accuracy: Accuracy) -> StatesBetween:
        first = sample - sample % LOOK_EVERY
        last = min(first + LOOK_EVERY if sample > first else first, len(self.piece.l_b) - 1)
        ends = self._of(first, self.piece.accuracy), self._of(last, self.piece.accuracy)
        share = (sample - first) / max(last - first, 1)
        return StatesBetween(self._of(sample, accuracy).known, ends, share, accuracy != self.piece.accuracy)

    def _least_depth(self, sample: int) -> int:
        """How often all cells of a sample are halved."""
        if sample % CLOSE_EVERY == 0 and self.piece.phi.shape[1] < CLOSE_TUBES:
            return CLOSE_DEPTH
        is_near = self.piece.as_walked_m[sample] < self.needed.clearance_m + NEAR_M
        return LEAST_DEPTH if is_near or sample % LOOK_EVERY == 0 else 0

    def _known_states(self, sample: int) -> list[SampleStates]:
        with self._lock:
            return [states for key in get_args(Accuracy) if (states := self._states.get((sample, key)))]

    def _of(self, sample: int, accuracy: Accuracy) -> SampleStates:
        key = sample, accuracy
        with self._lock:
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
