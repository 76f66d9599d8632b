"""The histories that an observer follows: begun in start states, moved on, weighted by measured tips, joined by
others.

Histories move on by the robot's own mechanics, in coarse steps as long as nothing is measured. With the first tip
states between the corners join.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.history import History, HistoryPath, Start
from ctrplan.mechanics.shapes import LONG_STEPS, Status
from ctrplan.robot.slow_states import Slow, SlowModel

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Accuracy

SAME_M, SAME_RAD, SAME_PHI = 1e-6, 1e-4, 1e-3  # tips, tangents and friction of histories that have become one
LEAST_WEIGHT = 1e-6  # below which a history is given up


@dataclass(eq=False)
class Member:
    """A history, where it stands, and how well it agrees with what was measured."""

    history: History
    position_m: Array  # (3,)
    tangent: Array  # (3,)
    phi: Array  # (n - 1,)
    slow: Slow  # offset and parameters, if this history is the true one
    score: float  # logarithm of its probability, but for what all have in common
    values: Array  # (P,) of the parameters that the history is simulated with, less those of the robot file
    slopes: Array  # (3, P) derivatives of the tip by the parameters
    slopes_at: Array  # (2 n + n - 1,) collars and friction they are of

    @property
    def expected_m(self) -> Array:
        """(3,) where the tip would be measured."""
        return self.position_m + self.slow.moved_m(self.slopes, self.values)


def new_member(history: History, values: Array, theta_b: Array, l_b: Array, slow: Slow, score: float) -> Member | None:
    """A member at collars (n,) [rad], (n,) [m]; None without an equilibrium there."""
    blank, no_slopes = np.zeros(3), np.zeros((3, len(values)))
    return moved(Member(history, blank, blank, blank, slow, score, values, no_slopes, np.zeros(0)), theta_b, l_b)


def moved(member: Member, theta_b: Array, l_b: Array) -> Member | None:
    """The member after moving there; None where no equilibrium is found."""
    path = followed(member.history, theta_b[None], l_b[None])
    if path is None:
        return None
    member.position_m, member.tangent, member.phi = path.position_m[-1], path.tangent[-1], path.phi[-1]
    return member


def followed(history: History, theta_b: Array, l_b: Array) -> HistoryPath | None:
    """The history along (K, n) [rad], (K, n) [m]; None where no equilibrium is found on the way."""
    try:
        path = history.follow(theta_b, l_b)
    except SolverError:  # none to begin with
        return None
    return path if path.status[-1] < Status.FAILED else None


def probed(history: History, theta_b: Array, l_b: Array) -> HistoryPath | None:
    """The path of a history that stays where it is, otherwise as `followed`."""
    here = history.save()
    path = followed(history, theta_b, l_b)
    history.restore(here)
    return path


def weights(members: list[Member]) -> Array:
    """(H,) probabilities, of sum 1."""
    score: Array = np.array([member.score for member in members])
    share = np.exp(score - score.max())
    total: Array = share / share.sum()
    return total


def tidied(members: list[Member]) -> list[Member]:
    """Without those that nothing speaks for, and one for all that have become the same."""
    share = weights(members)
    kept: list[Member] = []
    for k in np.argsort(-share, kind="stable").tolist():
        member = members[k]
        if share[k] < LEAST_WEIGHT:
            continue
        alike = next((other for other in kept if _coincide(member, other)), None)
        if alike is None:
            kept.append(member)
        else:
            alike.score = float(np.logaddexp(alike.score, member.score))
    return kept


def _coincide(a: Member, b: Member) -> bool:
    return bool(
        np.all(np.abs(a.position_m - b.position_m) < SAME_M)
        and np.all(np.abs(a.tangent - b.tangent) < SAME_RAD)
        and np.all(np.abs(a.phi - b.phi) < SAME_PHI)
        and np.all(np.abs(a.expected_m - b.expected_m) < 2 * SAME_M)
    )


MOST_CORNERS = 32  # of five pairs; of more pairs as many are drawn
LEAST_SPACING = 0.25  # of a state, which friction can be told apart by


def start_states(pairs: int, members: int, rng: np.random.Generator) -> list[Array]:
    """Shares (P,) of the Coulomb limit: released, every sign corner, and others of a grid, `members` of them or more.

    With the corners of many pairs there are more. A single tube has one state.
    """
    if pairs == 0:
        return [np.zeros(0)]
    results = [np.zeros(pairs), *_corners(pairs, rng)]
    levels = max(3, _levels_within(members, pairs))
    between = [np.array(state) for state in itertools.islice(itertools.product(_grid(levels), repeat=pairs), 10_000)]
    rng.shuffle(between)  # of a grid that is not used whole, any
    taken = {tuple(state) for state in results}
    for state in between:
        if len(results) < members and tuple(state) not in taken:
            results.append(state)
    return results


def states_nearby(phi: Array, count: int, spread: float, rng: np.random.Generator) -> list[Array]:
    """`count` states (P,), half of them near phi (P,), the others anywhere."""
    near = np.clip(phi + spread * rng.standard_normal((count, len(phi))), -1, 1)
    anywhere = rng.uniform(-1, 1, (count, len(phi)))
    return [near[k] if k % 2 == 0 else anywhere[k] for k in range(count)]


def _corners(pairs: int, rng: np.random.Generator) -> list[Array]:
    if 2**pairs <= MOST_CORNERS:
        return [np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=pairs)]
    return list(np.unique(rng.choice([1.0, -1.0], (MOST_CORNERS, pairs)), axis=0))


def _levels_within(members: int, pairs: int) -> int:
    """Odd number of levels per pair whose grid has at most `members` states."""
    levels = min(int((members + 1e-9) ** (1 / pairs)), round(2 / LEAST_SPACING) + 1)
    return levels - (levels + 1) % 2


def _grid(levels: int) -> list[float]:
    return [float(level) + 0.0 for level in np.linspace(-1, 1, levels)]


Item = TypeVar("Item")
Done = TypeVar("Done")


class SharedWork:
    """Threads that live as long as their observer, for a step is too short to start some."""

    def __init__(self) -> None:
        """Without any until there is something to share."""
        self._pool: ThreadPoolExecutor | None = None
        self._threads = 0

    def each(self, work: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
        """work(item) of every item, in order. Items are independent, so that threads change no answer."""
        threads = cores()
        if threads < 2 or len(items) < 2:
            return [work(item) for item in items]
        if self._pool is None or self._threads != threads:
            self._pool, self._threads = ThreadPoolExecutor(threads, "observer"), threads
        return list(self._pool.map(work, items))

    def parts(self, count: int) -> list[slice]:
        """`count` rows as one slice for each thread."""
        shares = max(1, min(count, cores()))
        ends = [count * k // shares for k in range(shares + 1)]
        return [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]


RobotWith = Callable[[Mapping[str, float]], Mechanics]

STALE = np.array([0.1, 2e-3, 0.25])  # rad, m and friction state, after which derivatives by parameters are taken anew


class Histories:
    """Histories of one robot where it stands now; `members` may be taken away, `begin` makes others."""

    def __init__(
        self, robot_with: RobotWith, accuracy: Accuracy, slow: SlowModel, most: int, rng: np.random.Generator
    ) -> None:
        """robot_with: the mechanics with slow parameters so much off the file's; most: that are begun."""
        self.mechanics, self.members = robot_with({}), list[Member]()
        self.at: tuple[Array, Array] | None = None  # collars (n,) [rad], (n,) [m]
        self._robot_with, self._accuracy, self._slow, self._most, self._rng = robot_with, accuracy, slow, most, rng
        self.threads = SharedWork()
        self._waiting: list[Array] = []  # states that join with the first tip
        self._is_measured = False

    @property
    def likeliest(self) -> Member:
        """The one that agrees best with what was measured."""
        return max(self.members, key=lambda member: member.score)

    @property
    def total_score(self) -> float:
        """Logarithm of the sum of all probabilities."""
        return float(np.logaddexp.reduce([member.score for member in self.members]))

    def move(self, theta_b: Array, l_b: Array) -> bool:
        """Moves every history to collars (n,), (n,); whether all had to begin again. Raises SolverError if none can."""
        result = self.threads.each(lambda member: moved(member, theta_b, l_b), self.members)
        left = [member for member in result if member is not None]
        anew = not left and self.at is not None
        if not left:
            states = start_states(self.mechanics.n - 1, self._most, self._rng)
            ends = [state for state in states if np.all(np.abs(state) == 1) or not state.any()]
            self._waiting = [state for state in states if not any(state is end for end in ends)]
            left = self._begun(ends, theta_b, l_b, 0.0)
        if not left:
            self.members = []
            raise SolverError("no friction state has an equilibrium at these joints")
        for member in left:
            member.slow = self._slow.after_step(member.slow)
        self.members, self.at = left, (theta_b, l_b)
        self.renew_slopes()
        return anew

    def begin(self, states: Sequence[Array], score: float) -> list[Member]:
        """Histories from states, where the robot stands, with the derivatives of the nearest one for the time being."""
        assert self.at is not None
        result = self._begun(states, *self.at, score)
        for member in result:
            nearest = min(self.members, key=lambda other: float(np.abs(other.phi - member.phi).max(initial=0.0)))
            member.slopes, member.slopes_at = nearest.slopes, nearest.slopes_at
        return result

    def _begun(self, states: Sequence[Array], theta_b: Array, l_b: Array, score: float) -> list[Member]:
        """Begins histories of the robot as slow parameters have it by now."""
        slow = self.likeliest.slow if self.members else self._slow.start()
        values = self._slow.simulated(slow)
        mechanics = self._with(values)

        def begun_in(phi: Array) -> Member | None:
            return new_member(self._history(mechanics, phi), values, theta_b, l_b, slow, score)

        return [member for member in self.threads.each(begun_in, states) if member is not None]

    def join_waiting(self) -> None:
        """With the first tip steps become fine, and states between the corners join."""
        if not self._is_measured:
            self._is_measured = True
            for member in self.members:
                fine = self._history(self._with(member.values))
                fine.restore(member.history.save())
                member.history = fine
        if self._waiting:
            count = len(self.members) + len(self._waiting)
            joined = self.begin(self._waiting, self.total_score - math.log(count))
            self._differentiate(joined)
            self.members, self._waiting = self.members + joined, []

    def of_the_file(self, member: Member) -> History:
        """A member's history; of the robot as the file has it, from the same friction, if it is of another."""
        if not member.values.any():
            return member.history
        assert self.at is not None
        own = History(self.mechanics, np.clip(member.phi, -1, 1), accuracy=self._accuracy)
        own.follow(*(row[None] for row in self.at))
        return own

    def renew_slopes(self) -> None:
        """Derivatives by the slow parameters where those known are of elsewhere by now.

        Of all that are of twice as far away, or else of the likeliest, so that no small step takes longer than others.
        """
        if not self._slow.names:
            return
        away = {member: self._away(member, self._here(member)) for member in self.members}
        overdue = [member for member, far in away.items() if far > 2]
        stale = [member for member, far in away.items() if far > 1]
        self._differentiate(overdue or sorted(stale, key=lambda member: -member.score)[:1])

    def _differentiate(self, members: Sequence[Member]) -> None:
        if members and self._slow.names:
            n, rows = self.mechanics.n, np.array([self._here(member) for member in members])
            shares = [rows[part] for part in self.threads.parts(len(rows))]
            slopes = self.threads.each(
                lambda share: self._slow.slopes(self.mechanics, *np.split(share, [n, 2 * n], axis=1)), shares
            )
            for member, at, of in zip(members, rows, np.concatenate(slopes), strict=True):
                member.slopes, member.slopes_at = of, at

    def _here(self, member: Member) -> Array:
        """(2 n + n - 1,) collars and friction of a member."""
        assert self.at is not None
        return np.concatenate([*self.at, member.phi])

    def ahead(self, member: Member, path: HistoryPath, theta_b: Array, l_b: Array) -> Array:
        """(K, 3, P) derivatives of a member's tips along its path, through collars (K, n), (K, n)."""
        if self._slow.names and self._away(member, np.hstack([theta_b, l_b, path.phi])) > 1:
            return self._slow.slopes(self.mechanics, theta_b, l_b, path.phi)
        return np.broadcast_to(member.slopes, (len(theta_b), *member.slopes.shape))

    def _away(self, member: Member, at: Array) -> float:
        """How far a member is from where its derivatives are of, over what is near; at (2 n + n - 1,) or K of them."""
        n = self.mechanics.n
        limit = np.repeat(STALE, [n, n, n - 1])
        return float(np.max(np.abs(at - member.slopes_at) / limit)) if len(member.slopes_at) else math.inf

    def _with(self, values: Array) -> Mechanics:
        """The robot with slow parameters values (P,) off the file's."""
        return self._robot_with(dict(zip(self._slow.names, values.tolist(), strict=True)))

    def _history(self, mechanics: Mechanics, start: Start = "released") -> History:
        return History(mechanics, start, accuracy=self._accuracy, options=None if self._is_measured else LONG_STEPS)
