"""Weighted histories of one robot, moved together, and told apart by measured tips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import SolverError
from ctrplan.mechanics.shapes import Status
from ctrplan.robot.observer.slow_model import Slow

if TYPE_CHECKING:
    from ctrplan.mechanics.history import History, HistoryPath

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


def begun(history: History, values: Array, theta_b: Array, l_b: Array, slow: Slow, score: float) -> Member | None:
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


def asked(history: History, theta_b: Array, l_b: Array) -> HistoryPath | None:
    """As `followed`, of a history that stays where it is."""
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
        alike = next((other for other in kept if _are_one(member, other)), None)
        if alike is None:
            kept.append(member)
        else:
            alike.score = float(np.logaddexp(alike.score, member.score))
    return kept


def _are_one(a: Member, b: Member) -> bool:
    return bool(
        np.all(np.abs(a.position_m - b.position_m) < SAME_M)
        and np.all(np.abs(a.tangent - b.tangent) < SAME_RAD)
        and np.all(np.abs(a.phi - b.phi) < SAME_PHI)
        and np.all(np.abs(a.expected_m - b.expected_m) < 2 * SAME_M)
    )
