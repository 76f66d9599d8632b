"""The histories that an observer follows: begun in start states, moved on, joined by others, differentiated.

Histories move on by the robot's own mechanics, in coarse steps as long as nothing is measured. With the first tip
states between the corners join.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.history import History, HistoryPath, Start
from ctrplan.mechanics.history_options import HistoryOptions
from ctrplan.robot.observer.bank import Member, begun, moved
from ctrplan.robot.observer.shared_work import SharedWork
from ctrplan.robot.observer.slow_model import SlowModel
from ctrplan.robot.observer.start_states import start_states

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy

RobotWith = Callable[[Mapping[str, float]], Mechanics]

COARSE = HistoryOptions(state_change=0.1)  # of histories that no tip has told apart yet, docs/observer.md
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
        found = self.threads.each(lambda member: moved(member, theta_b, l_b), self.members)
        left = [member for member in found if member is not None]
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
        found = self._begun(states, *self.at, score)
        for member in found:
            nearest = min(self.members, key=lambda other: float(np.abs(other.phi - member.phi).max(initial=0.0)))
            member.slopes, member.slopes_at = nearest.slopes, nearest.slopes_at
        return found

    def _begun(self, states: Sequence[Array], theta_b: Array, l_b: Array, score: float) -> list[Member]:
        """Of the robot as slow parameters have it by now."""
        slow = self.likeliest.slow if self.members else self._slow.start()
        values = self._slow.simulated(slow)
        mechanics = self._with(values)

        def one(phi: Array) -> Member | None:
            return begun(self._history(mechanics, phi), values, theta_b, l_b, slow, score)

        return [member for member in self.threads.each(one, states) if member is not None]

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
        return History(mechanics, start, accuracy=self._accuracy, options=None if self._is_measured else COARSE)
