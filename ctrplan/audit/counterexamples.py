"""The search for counter-examples to a certificate: places and friction states of the way, and what the robot did
before it.

Small turns leave friction states that no corner has. Large ones and whole ones reach other equilibria, which the way
then starts from. The robot follows the way from there; its bodies are looked at where the least clearance was found so
far. Histories begin with no other friction than the scenario allows at its start.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ctrplan.audit.audited_plan import AuditedPlan, WorstFigure
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, SolverError
from ctrplan.mechanics.history import OSCILLATION_DEG, History, HistoryOptions
from ctrplan.mechanics.shapes import Accuracy, Status
from ctrplan.robot.named_numbers import with_values
from ctrplan.scenario.prediction import FrictionStart, begun_histories, start_states

PLACES = 8  # of a round
DRAWN = 8  # states at a place, besides the corners
STEPS, FINE_STEPS = (0.4, 0.2, 0.1, 0.05, 0.02), (0.05,)  # of phi in a descent; on the judge's mesh
PLACE_PER_PHI = 0.1  # step of the place for one of phi
GOLDEN = (math.sqrt(5) - 1) / 2  # whose multiples are spread evenly
AIMS = ("clearance", "bound", "strain", "stability")


@dataclass(frozen=True, eq=False)
class State:
    """A place, a friction state there, and the play taken."""

    place: float
    phi: Array  # (P,)
    axes: Array | None = None  # (A,) of the allowed robots, where play is taken


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

    is_done = False  # there is always another place

    def __init__(self, case: AuditedPlan, seed: int) -> None:
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
            axes = self._play()
            scores = self.scores(State(place, phi[0], axes), phi)
            for aim in AIMS:
                if (k := int(np.argmax(scores.of(aim)))) >= 0 and np.isfinite(scores.of(aim)[k]):
                    result = float(scores.of(aim)[k]), State(place, phi[k], axes)
                    best[aim] = max(best.get(aim, result), result, key=lambda pair: pair[0])
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
        """Scores of friction states (S, P) at the state's place, on the coarse mesh."""
        case, none = self.case, np.full(len(phi), -np.inf)
        case.work += 2 * (len(phi) + 1)
        try:
            collars = case.collars(state.place, state.axes)
            states = np.vstack([np.zeros((1, case.pairs)), phi])
            bodies = case.robot.mechanics.friction_bodies(*collars, states, spacing_m=2e-3)
        except CtrplanError:
            return Scores(none, none, none, none)
        if not bodies.solved[0]:
            return Scores(none, none, none, none)
        off = np.linalg.norm(bodies.point_m[1:, -1] - bodies.point_m[0, -1], axis=1)
        excess = none if state.axes is not None else off - case.stated("bound", state.place)
        room = none
        if case.plan.scenario.anatomy:
            for points, margin_m in case.stands(bodies.point_m[1:], state.place, state.axes):
                located = case.located(points.reshape(-1, 3)).reshape(points.shape)
                least, looked = case.anatomy.least(located, bodies.radius_m)
                room = np.maximum(room, -least - margin_m)
                case.count_points(looked)
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

    def _play(self) -> Array | None:
        """Either end of every collar's play, every other time; None without play."""
        played = len(self.case.robots.played)
        if not played or self.rng.integers(2):
            return None
        return np.append(self.rng.choice((-1.0, 1.0), played), np.zeros(self.case.robots.count - played))

    def _downhill(self, aim: str, score: float, state: State) -> tuple[float, State]:
        """Compass search over place and friction state on the coarse mesh."""
        return descend(lambda s, phi: self.scores(s, phi).of(aim), score, state, STEPS)

    def _confirm(self, aim: str, state: State) -> None:
        """The state on the judge's mesh, and downhill from there by what that mesh says."""
        case = self.case

        def score(at: State, phi: Array) -> Array:
            scores = []
            for row in phi:
                result = case.solved(at.place, tuple(row), at.axes)
                case.note(result)
                scores.append(max((worse(f) for f in result if f.claim == aim), default=-np.inf))
            return np.array(scores)

        begin = float(score(state, state.phi[None])[0])
        descend(score, begin, state, FINE_STEPS)


def worse(figure: WorstFigure) -> float:
    """A figure as a score: larger is worse, also where nothing is claimed."""
    return -figure.value if figure.claim == "clearance" else figure.excess


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
            result = scores(state, phi)
            if result.max() > score:
                score, state = float(result.max()), State(state.place, phi[int(np.argmax(result))], state.axes)
        for side in (1, -1):
            place = float(np.clip(state.place + side * step * PLACE_PER_PHI, 0, 1))
            if place == state.place:
                continue
            there = State(place, state.phi, state.axes)
            if (found_there := float(scores(there, there.phi[None])[0])) > score:
                score, state = found_there, there
        if score == before and step <= steps[-1]:
            break
    return score, state


GRID = 64  # places of the way where tips are looked at
LOOKS = 9  # bodies around the worst place of another equilibrium, on the judge's mesh
STEPPED = HistoryOptions()  # of a history, for counting its work
STEP_WORK: dict[Accuracy, int] = {"search": 8, "certificate": 20, "exact": 20}
SMALL_DEG = (1.0, 30.0)
LARGE_DEG = (SMALL_DEG[1], 180.0)
MOST_TURNS = 4
KEPT = 0.5  # share of histories that are the worst one so far, changed a little
MOST_WINDINGS = 2  # whole turns of a joint before the start, either way
MOST_WOUND = 60  # combinations of them
COARSE = HistoryOptions(rotation_rad=0.1, translation_m=1e-3)  # without friction there is no state to step finely for
COARSE_SHARE = 0.25  # of the work of a history
OTHER_M = 1e-3  # between tips of one configuration, beyond which its equilibria are two


@dataclass(frozen=True, eq=False)
class Before:
    """What happened before the start: joints (H, m) driven through, and the friction state at the first.

    The history is one without friction at all, or ends at the start with the oscillation that takes friction away,
    where the scenario says so.
    """

    joints: Array
    start: FrictionStart = "released"
    without_friction: bool = False
    oscillates: bool = False
    elsewhere: bool = False  # the start is another equilibrium then, whose bodies are looked at all along the way

    def phi(self, pairs: int) -> tuple[float, ...]:
        """(P,) of the state where it began."""
        return tuple(float(x) for x in self.start) if isinstance(self.start, tuple) else (0.0,) * pairs

    @property
    def began(self) -> str:
        """How the friction at the start came about, in words; empty where its state says it."""
        if self.without_friction:
            return "without friction"
        if self.oscillates or self.start == "oscillated":
            return "oscillated at the start"
        return "" if isinstance(self.start, (tuple, str)) else "as observed"


class HistoryHunt:
    """Simulated histories one by one; their sequence depends on the seed and on what was found."""

    def __init__(self, case: AuditedPlan, seed: int) -> None:
        """case: what is judged."""
        self.case = case
        self.rng = np.random.default_rng([seed, 2])
        ends = case.way.places_of(np.arange(len(case.plan.waypoints), dtype=np.float64))
        self.grid = np.unique(np.concatenate([np.linspace(0, 1, GRID), ends]))
        self.kept: dict[str, tuple[float, Before]] = {}
        self.friction = case.plan.certificate.get("start_friction", case.plan.scenario.start_friction)
        is_lost = self.friction == "observed" and case.plan.scenario.start_state is None  # no file holds that state
        begun = [] if is_lost else start_states(case.plan.scenario)
        self.queue = [Before(case.way.joints[:0], start) for start in begun]
        self.starts = len(self.queue)
        is_known = self.friction == "observed" or case.plan.scenario.start_turns == "absolute"
        self.wound = [] if is_known else self._wound()
        self.usual: Array | None = None  # (3,) the tip at the start without turns before
        self.late: list[Before] = []  # whole turns that lead back to the same equilibrium, without friction
        self.number = 0
        self.snaps = 0  # of simulated robots on the way
        self.is_done = False
        self.mesh: Accuracy = "certificate" if case.accuracy == "exact" else case.accuracy
        names = [f"contact.{k + 1}.friction_coefficient" for k in range(case.pairs)]
        self.frictionless = with_values(case.robot, dict.fromkeys(names, 0.0))

    def round(self) -> Iterator[None]:
        """One history on the coarse mesh; once more on the judge's where it is the worst of its kind."""
        before = self._drawn()
        if before is None:
            yield
            return
        result = self._driven(before, 1.0 if before.elsewhere else self._end(), "search")
        self._note(result)
        yield
        for aim in ("clearance", "bound"):
            worst = max((f for f in result if f.claim == aim), key=worse, default=None)
            if worst is not None and worse(worst) > self.kept.get(aim, (-np.inf, before))[0]:
                self.kept[aim] = worse(worst), before
                if self.mesh != "search":
                    near: Any = (
                        np.clip(worst.place + np.linspace(-1, 1, LOOKS) / GRID, 0, 1) if before.elsewhere else []
                    )
                    looks = (worst.place, *map(float, near))
                    self._note(self._driven(before, max(looks), self.mesh, looks=looks))
                yield

    def _wound(self) -> list[Array]:
        """Joints (m,) that are whole turns away from the start, no tube more than some; the nearest first."""
        drive, start = self.case.robot.drive, self.case.way.joints[0]
        turns = [
            [k for k in range(-MOST_WINDINGS, MOST_WINDINGS + 1) if low <= q + 2 * np.pi * k <= high]
            if rotates
            else [0]
            for q, low, high, rotates in zip(start, drive.lower, drive.upper, drive.is_rotation, strict=True)
        ]
        known: dict[tuple[float, ...], Array] = {}
        for row in sorted(itertools.product(*turns), key=lambda row: sum(map(abs, row))):
            relative = tuple(np.round(np.diff(drive.matrix_theta @ np.array(row)), 6).tolist())
            if any(relative) and max(map(abs, relative)) <= MOST_WINDINGS:
                known.setdefault(relative, start + 2 * np.pi * np.array(row))
        return [known[key] for key in sorted(known, key=lambda key: sum(map(abs, key)))[:MOST_WOUND]]

    def _of_windings(self) -> Before | None:
        """The next whole turns that lead to another equilibrium; others are put off."""
        while self.wound:
            joints = self.wound.pop(0)[None]
            if self.usual is None:
                self.usual = self._arrived(joints[:0])
            usual, wound = self.usual, self._arrived(joints)
            same = usual is not None and wound is not None and np.linalg.norm(usual - wound) < OTHER_M
            released = self.friction == "released"
            before = Before(joints, without_friction=released, oscillates=self.friction == "oscillated")
            if not same:
                return replace(before, elsewhere=True)
            if not released:
                self.late.append(before)
        return self.late.pop(0) if self.late else None

    def _arrived(self, joints: Array) -> Array | None:
        """(3,) the tip at the start after joints (H, m), without friction; None where no equilibrium is reached."""
        history = self.frictionless.history(options=COARSE)
        rows = np.vstack([joints, self.case.way.joints[:1]])
        try:
            path = history.follow(*self.case.robot.drive.collars(rows))
        except CtrplanError:
            return None
        self._count(rows[-2:], "search", COARSE_SHARE)
        return path.position_m[-1] if path.status[-1] < Status.FAILED else None

    def _note(self, results: list[WorstFigure]) -> None:
        """What counts: on the judge's mesh; predictions on the coarse one, where certificates make them."""
        self.case.note([f for f in results if f.accuracy == ("search" if f.claim == "predicted" else self.mesh)])

    def _drawn(self) -> Before | None:
        """Every second time a start that the scenario allows, then whole turns; else turns, or the worst ones with
        other amplitudes. None where the scenario allows nothing else.
        """
        number, self.number = self.number, self.number + 1
        if number % 2 == 0 or self.friction != "unknown":
            if self.queue and (number % 4 == 0 or not (self.wound or self.late)):
                return self.queue.pop(0)
            if (before := self._of_windings()) is not None:
                return before
            if self.queue:
                return self.queue.pop(0)
            if self.friction != "unknown":
                self.is_done = True
                return None
        if self.kept and self.rng.random() < KEPT:
            _, worst = list(self.kept.values())[number % len(self.kept)]
            if len(worst.joints):
                turns = worst.joints - self.case.way.joints[0]
                return replace(worst, joints=self._turned(turns * self.rng.uniform(0.6, 1.5, turns.shape)))
        none = np.zeros(self.case.pairs)
        return Before(self._turned(self._turns(*(LARGE_DEG if number % 4 < 2 else SMALL_DEG))), tuple(none.tolist()))

    def _turns(self, low_deg: float, high_deg: float) -> Array:
        """(H, m) joint motions: some turns of amplitudes between the two, of all joints or of neighbours against each
        other.
        """
        count = int(self.rng.integers(1, MOST_TURNS + 1))
        amplitude = np.radians(np.exp(self.rng.uniform(np.log(low_deg), np.log(high_deg), (count, 1))))
        rotates = self.case.robot.drive.is_rotation
        share = self.rng.uniform(-1, 1, (count, len(rotates)))
        if self.rng.integers(2):
            relative = np.cumsum(self.rng.choice((-1.0, 1.0), (count, self.case.robot.n)), axis=1)
            share = np.linalg.lstsq(self.case.robot.drive.matrix_theta, relative.T, rcond=None)[0].T
        turns: Array = np.where(rotates, amplitude * share, 0.0)
        return turns

    def _turned(self, turns: Array) -> Array:
        """(H, m) joints that turns (H, m) away from the start reach within limits; a robot on a branch begins there."""
        drive, start = self.case.robot.drive, self.case.way.joints[:1]
        joints: Array = np.clip(start + turns, drive.lower, drive.upper)
        return joints if self.case.robot.guide is None else np.vstack([start, joints])

    def _end(self) -> float:
        """How far the way is followed: to its end, or to where little clearance was found."""
        tight = self.case.worst.get("clearance")
        if self.number <= 2 * self.starts or tight is None:
            return 1.0
        return (1.0, tight.place, float(self.rng.random() ** 2))[self.number % 3]

    def _driven(self, before: Before, end: float, mesh: Accuracy, looks: tuple[float, ...] = ()) -> list[WorstFigure]:
        """Findings along the way until `end`."""
        case = self.case
        tight = case.worst.get("clearance")
        seen = {end, *looks, *([tight.place] if tight is not None and tight.place <= end else [])}
        if before.elsewhere and not looks:
            seen |= {float(x) for x in self.grid if x <= end}
        elif case.plan.scenario.anatomy and not looks:
            seen |= {float(x) for x in self.rng.choice(self.grid, 2) if x <= end}
        places = np.unique([0.0, *self.grid[self.grid <= end], *seen])
        robot = self.frictionless if before.without_friction else case.robot
        history = begun_histories(robot, [before.start], mesh)[0]
        try:
            self._approach(history, before, mesh)
            result = self._followed(history, before, places, seen, mesh)
        except (SolverError, CtrplanError):  # there is no equilibrium to come from, or tubes that do not nest
            return []
        return [replace(f, accuracy=mesh) for f in result]

    def _approach(self, history: History, before: Before, mesh: Accuracy) -> None:
        rows = np.array([*before.joints, self.case.way.joints[0]])
        theta, l = self.case.robot.drive.collars(rows)  # noqa: E741 (as in the equations)
        path = history.follow(theta, l)
        self._count(np.vstack([rows, rows[:1]]) if len(rows) == 1 else rows, mesh)
        has_left = self.case.robot.guide is not None and np.nansum(path.snaps) > 0  # its branch
        if path.status[-1] >= Status.FAILED or has_left:
            raise SolverError("the start is not reached")
        if before.oscillates:
            swing = np.radians(OSCILLATION_DEG)[:, None] * np.arange(self.case.robot.n)
            history.follow(
                theta[-1] + (-1.0) ** np.arange(len(swing))[:, None] * swing, np.tile(l[-1], (len(swing), 1))
            )

    def _followed(
        self, history: History, before: Before, places: Array, seen: set[float], mesh: Accuracy
    ) -> list[WorstFigure]:
        case, begin = self.case, 0
        results: list[WorstFigure] = []
        phi = before.phi(case.pairs)
        commanded = case.way.commanded(np.interp(places, case.way.place, case.way.time_s), case.middle)
        theta, l = case.robot.drive.reached(commanded[:, : case.robot.n], commanded[:, case.robot.n :])  # noqa: E741
        self._count(np.array([case.way.joints_at(place) for place in places]), mesh)
        case.work += 2 * len(places)
        free = case.robot.mechanics.tips_with_friction(theta, l, np.zeros((len(places), case.pairs)), accuracy=mesh)
        for k in [k for k, place in enumerate(places) if place in seen]:
            path = history.follow(theta[begin : k + 1], l[begin : k + 1])
            self.snaps += int(np.nan_to_num(path.snaps).sum())
            off = np.linalg.norm(path.position_m - free.position_m[begin : k + 1], axis=1)
            results += self._tips(path.position_m, off, places[begin : k + 1], before)
            if path.status[-1] == Status.FAILED:
                break
            if case.plan.scenario.anatomy:
                shape = history.advance(theta[k], l[k]).shape
                results += case.of_shape(shape, None, float(places[k]), phi, before=before.joints)
            begin = k + 1
        return [replace(figure, began=before.began) for figure in results]

    def _tips(self, tips: Array, off: Array, places: Array, before: Before) -> list[WorstFigure]:
        """The worst against the bound, and against the certificate's own prediction where it simulated the same."""
        case, claims = self.case, ["bound", "worst bound", *([] if len(before.joints) else ["predicted"])]
        results, phi = [], before.phi(case.pairs)
        for claim in claims:
            excess = np.array([d - case.stated(claim, p) for d, p in zip(off, places, strict=True)])
            if np.isfinite(excess).any():
                k = int(np.nanargmax(excess))
                results.append(case.finding(claim, float(off[k]), float(places[k]), phi, tips[k], before=before.joints))
        return results

    def _count(self, joints: Array, mesh: Accuracy, share: float = 1.0) -> None:
        steps = np.abs(np.diff(joints, axis=0)) / np.where(
            self.case.robot.drive.is_rotation, STEPPED.rotation_rad, STEPPED.translation_m
        )
        self.case.work += int(share * STEP_WORK[mesh] * (np.ceil(steps.max(axis=1, initial=0.0)).sum() + 1))
