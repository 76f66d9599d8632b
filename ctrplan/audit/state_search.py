"""The hunt over places of the way and uniform friction states: at random, then downhill from the worst."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ctrplan.audit.case import Case, Finding
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError

PLACES = 8  # of a round
DRAWN = 8  # states at a place, besides the corners
STEPS, FINE_STEPS = (0.4, 0.2, 0.1, 0.05, 0.02), (0.05,)  # of phi in a descent; on the judge's mesh
PLACE_PER_PHI = 0.1  # step of the place for one of phi
GOLDEN = 0.6180339887498949
AIMS = ("clearance", "bound", "strain", "stability")


@dataclass(frozen=True, eq=False)
class State:
    """A place, a friction state there, and the play taken."""

    place: float
    phi: Array  # (P,)
    play: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Scores:
    """What the coarse mesh says of S states at a place: larger is worse."""

    clearance: Array  # (S,) less clearance [m]; -inf in free space, or where unsolved
    bound: Array  # (S,) tip's deviation beyond what is claimed [m]
    strain: Array  # (S,) beyond what is claimed
    stability: Array  # (S,) less of it than claimed

    def of(self, aim: str) -> Array:
        """By the name of the claim."""
        scores: Array = getattr(self, aim)
        return scores


class StateHunt:
    """Rounds over places; the sequence of what is looked at depends on the seed alone."""

    def __init__(self, case: Case, seed: int) -> None:
        """case: what is judged."""
        self.case = case
        self.rng = np.random.default_rng([seed, 1])
        self.corners = np.array(list(itertools.product((1.0, -1.0), repeat=case.pairs)))
        self.worst: dict[str, float] = dict.fromkeys(AIMS, -np.inf)
        self.at: dict[str, State] = {}
        self.drawn = 0

    def round(self) -> Iterator[None]:
        """Looks at some places, and goes downhill from the worst state found there. Yields where it may be stopped."""
        best: dict[str, tuple[float, State]] = {}
        for place in self._places():
            phi = np.vstack([self.corners, self.rng.uniform(-1, 1, (DRAWN, self.case.pairs))])
            play = self._play()
            scores = self.scores(State(place, phi[0], play), phi)
            for aim in AIMS:
                if (k := int(np.argmax(scores.of(aim)))) >= 0 and np.isfinite(scores.of(aim)[k]):
                    found = float(scores.of(aim)[k]), State(place, phi[k], play)
                    best[aim] = max(best.get(aim, found), found, key=lambda pair: pair[0])
            yield
        for aim, (score, state) in best.items():
            if aim in ("strain", "stability") and score <= self.worst[aim]:
                continue
            descended, state = self._downhill(aim, score, state)
            yield
            if descended > self.worst[aim]:
                self.worst[aim], self.at[aim] = descended, state
                self._confirm(aim, state)
                yield

    def scores(self, state: State, phi: Array) -> Scores:
        """Of friction states (S, P) at the state's place, on the coarse mesh."""
        case, none = self.case, np.full(len(phi), -np.inf)
        case.work += 2 * (len(phi) + 1)
        try:
            collars = case.collars(state.place, state.play)
            states = np.vstack([np.zeros((1, case.pairs)), phi])
            bodies = case.robot.mechanics.friction_bodies(*collars, states, spacing_m=2e-3)
        except CtrplanError:
            return Scores(none, none, none, none)
        if not bodies.solved[0]:
            return Scores(none, none, none, none)
        off = np.linalg.norm(bodies.point_m[1:, -1] - bodies.point_m[0, -1], axis=1)
        excess = none if state.play else off - case.stated("bound", state.place)
        room = none
        if case.plan.scenario.anatomy:
            points = bodies.point_m[1:].reshape(-1, 3)
            rooms = case.anatomy.room(case.located(points)).reshape(len(phi), -1) - bodies.radius_m
            room = -rooms.min(axis=1)
            case.work += len(phi)
        solved = bodies.solved[1:]
        strain = bodies.max_strain[1:] - np.nan_to_num(case.stated("strain", state.place))
        stability = np.nan_to_num(case.stated("stability", state.place)) - bodies.stability[1:]
        scores = (room, excess, strain, stability)
        return Scores(*(np.where(solved & ~np.isnan(s), s, -np.inf) for s in scores))

    def _places(self) -> Iterator[float]:
        """The ends first; then spread evenly, every fourth near the worst so far."""
        for _ in range(PLACES):
            number, self.drawn = self.drawn, self.drawn + 1
            if number < 2:
                yield float(number)
            elif number % 4 == 3 and self.at:
                near = list(self.at.values())[number // 4 % len(self.at)].place
                yield float(np.clip(near + 0.02 * self.rng.standard_normal(), 0, 1))
            else:
                yield number * GOLDEN % 1.0

    def _play(self) -> tuple[float, ...]:
        """Either end of every collar's play, every other time; empty without play."""
        if self.case.robot.drive.play is None or self.rng.integers(2):
            return ()
        return tuple(self.rng.choice((-1.0, 1.0), 2 * self.case.robot.n).tolist())

    def _downhill(self, aim: str, score: float, state: State) -> tuple[float, State]:
        """Compass search over place and friction state on the coarse mesh."""
        return descend(lambda s, phi: self.scores(s, phi).of(aim), score, state, STEPS)

    def _confirm(self, aim: str, state: State) -> None:
        """The state on the judge's mesh, and downhill from there by what that mesh says."""
        case = self.case

        def score(at: State, phi: Array) -> Array:
            scores = []
            for row in phi:
                found = case.solved(at.place, tuple(row), at.play)
                case.note(found)
                scores.append(max((worse(f) for f in found if f.claim == aim), default=-np.inf))
            return np.array(scores)

        begin = float(score(state, state.phi[None])[0])
        descend(score, begin, state, FINE_STEPS)


def worse(found: Finding) -> float:
    """A figure as a score: larger is worse, also where nothing is claimed."""
    return -found.value if found.claim == "clearance" else found.excess


def descend(
    scores: Callable[[State, Array], Array], score: float, state: State, steps: tuple[float, ...]
) -> tuple[float, State]:
    """The worst state that steps of phi one pair at a time, and of the place, lead to; each size twice at most."""
    for step in np.repeat(steps, 2).tolist():
        before = score
        sides = np.vstack([side * step * row for row in np.eye(len(state.phi)) for side in (1, -1)] or [state.phi])
        phi = np.clip(state.phi + sides, -1, 1) if len(state.phi) else state.phi[None]
        phi = phi[np.any(phi != state.phi, axis=1)]
        if len(phi):
            found = scores(state, phi)
            if found.max() > score:
                score, state = float(found.max()), State(state.place, phi[int(np.argmax(found))], state.play)
        for side in (1, -1):
            place = float(np.clip(state.place + side * step * PLACE_PER_PHI, 0, 1))
            if place == state.place:
                continue
            there = State(place, state.phi, state.play)
            if (found_there := float(scores(there, there.phi[None])[0])) > score:
                score, state = found_there, there
        if score == before and step <= steps[-1]:
            break
    return score, state
