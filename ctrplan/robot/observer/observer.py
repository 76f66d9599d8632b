"""The observer: a robot followed step by step, by the friction states that agree with its measured tips.

A bank of histories starts released and in every corner of signs, and moves on by the robot's own mechanics, in coarse
steps as long as nothing is measured. With the first tip states between join. Each measured tip weighs histories by its
likelihood; weights forget, as errors of neighbouring rows are no news. Histories that have become the same are merged.
Where measured tips are farther off than noise explains, friction states near the likeliest one and elsewhere join the
bank. A slow offset and named parameters are estimated per history, by a Kalman filter (`slow_model.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import SEED, Choice, Made, Whole, checked
from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.core_arrays import joint_row, joint_rows
from ctrplan.mechanics.history import History, HistoryOptions, HistoryPath, Start
from ctrplan.robot.observer.bank import Member, begun, followed, moved, tidied, weights
from ctrplan.robot.observer.estimate import Observed, ParameterEstimate, TipEstimate, estimate
from ctrplan.robot.observer.slow_model import Slow, SlowModel
from ctrplan.robot.observer.slow_offset import SlowOffset
from ctrplan.robot.observer.slow_parameter import SlowParameter
from ctrplan.robot.observer.start_states import start_states, states_nearby
from ctrplan.robot.observer.state import ObservedHistory, ObserverState
from ctrplan.sensor.noise import SensorNoise

if TYPE_CHECKING:
    from ctrplan.drive.drive import Drive
    from ctrplan.mechanics.accuracy import Accuracy

RobotWith = Callable[[Mapping[str, float]], Mechanics]

MEMORY = 20  # steps after which a measured tip counts for 1/e
NEWS = 1 - 1 / MEMORY
GROSS = 4.0  # times the noise's variance, of a coordinate: beyond what chance does in one row of a hundred
SURPRISE = 3.0  # times the noise's variance unexplained, from which other friction states are tried
TRIED_AT_ONCE = 2  # in a step, so that steps take no longer
TRIED_SHARE = 0.1  # of the probability, given to them
NEAR = 0.3  # standard deviation of those near the likeliest
COARSE = HistoryOptions(state_change=0.1)  # of histories that no tip has told apart yet, docs/observer.md
STALE = np.array([0.1, 2e-3, 0.25])  # rad, m and friction state, after which derivatives by parameters are taken anew
MOST_WITH_SLOW = 3  # measured histories beside slow parameters, by which many agree with a tip
OTHERWISE = 0.3  # standard deviations of a slow parameter, by which histories may be simulated with another value
ELSEWHERE = 4  # one in so many of the states tried beside slow parameters is not near the likeliest
KNOWN_SHARE = 0.999  # of the probability, by the histories that `state` keeps


class Observer:
    """A robot that is followed. Made by `Robot.observer`; joints are commanded ones. One thread at a time."""

    @checked(
        noise=Made("SensorNoise"),
        offset=Made("SlowOffset"),
        members=Whole(1, 1000),
        seed=SEED,
        accuracy=Choice("search", "certificate"),
    )
    def __init__(
        self,
        robot_with: RobotWith,
        drive: Drive,
        *,
        noise: SensorNoise,
        offset: SlowOffset,
        slow: Mapping[SlowParameter, float],
        members: int,
        seed: int,
        accuracy: Accuracy,
    ) -> None:
        """As `Robot.observer` has them; `slow` with the values that the robot file has.

        robot_with: the mechanics with slow parameters so much off these values.
        """
        self._robot_with, self._drive, self._accuracy = robot_with, drive, accuracy
        self._mechanics = robot_with({})
        self._noise, self._most = noise, members
        self._slow, self._values = SlowModel(offset, list(slow)), np.array(list(slow.values()), dtype=np.float64)
        self._rng = np.random.default_rng(seed)
        self._members: list[Member] = []
        self._at: tuple[Array, Array] | None = None
        self._waiting: list[Array] = []  # states that join with the first tip
        self._is_measured = False
        self._tries = 0
        self._unexplained = 0.0  # m^2, of a coordinate, mean of the last steps
        self._left = 0.0  # m^2, of a coordinate, by the last step
        self._wait, self._pause = 0, 0  # steps until other friction states are tried again, and after that

    def observe(
        self,
        theta_commanded: ArrayLike,
        l_commanded: ArrayLike,
        position_m: ArrayLike | None = None,
        tangent: ArrayLike | None = None,
    ) -> Observed:
        """Moves on to joints (n,) [rad], (n,) [m], and takes the tip (3,) [m] measured there, if any; tangent (3,).

        Raises InputError, before anything moves, and SolverError where no friction state has an equilibrium.
        """
        theta_b, l_b = self._collars(theta_commanded, l_commanded)
        seen, along = _vector(position_m, "position_m"), _vector(tangent, "tangent")
        if along is not None:
            if seen is None:
                raise InputError("needs a position beside it", key="tangent")
            along = _unit(along)
        anew = self._move(theta_b, l_b)
        expected = self._estimate()
        if seen is not None:
            self._join_waiting()
            self._weigh(seen, along)
        return Observed(
            expected=expected,
            tip=self._estimate(),
            friction=weights(self._members) @ np.array([member.phi for member in self._members]),
            histories=len(self._members),
            unexplained_m=math.sqrt(self._unexplained),
            parameters=self._parameters(),
            started_anew=anew,
        )

    def predict(self, theta_commanded: ArrayLike, l_commanded: ArrayLike) -> TipEstimate:
        """Where the tip would be after a motion to joints (n,) [rad], (n,) [m], or along K of them (K, n).

        The observer stays where it is. Raises InputError, also before the first step, and SolverError.
        """
        self._require_begun()
        single = np.ndim(l_commanded) == 1
        given = (numbers(theta_commanded, "theta_commanded"), numbers(l_commanded, "l_commanded"))
        theta_b, l_b = joint_rows(*self._drive.reached(*map(np.atleast_2d, given)), self._mechanics.n)
        found = []
        for member, share in zip(self._members, weights(self._members), strict=True):
            here = member.history.save()
            path = followed(member.history, theta_b, l_b)
            member.history.restore(here)
            if path is not None:
                moved_m, variance = self._ahead(member, path, theta_b, l_b)
                found.append((path.position_m + moved_m, path.tangent, share, variance))
        if not found:
            raise SolverError("no equilibrium was found along the path")
        position, along, shares, variances = (np.array(part) for part in zip(*found, strict=True))
        ahead = estimate(position, along, shares / shares.sum(), variances)
        return TipEstimate(*(getattr(ahead, name)[0] for name in TipEstimate.__dataclass_fields__)) if single else ahead

    def state(self) -> ObserverState:
        """What is known now; `ctrplan.plan` starts from it. Raises InputError before the first step."""
        self._require_begun()
        share = weights(self._members)
        order = np.argsort(-share, kind="stable")
        kept = order[np.cumsum(share[order]) - share[order] < KNOWN_SHARE]
        chosen = [self._members[k] for k in kept.tolist()]
        assert self._at is not None
        return ObserverState(
            theta_b=self._at[0].copy(),
            l_b=self._at[1].copy(),
            histories=tuple(ObservedHistory(self._own(m).save(), self._accuracy, m.phi.copy()) for m in chosen),
            weight=share[kept] / share[kept].sum(),
            offset_m=share @ np.array([member.slow.mean[:3] for member in self._members]),
            parameters=self._parameters(),
        )

    def _move(self, theta_b: Array, l_b: Array) -> bool:
        """Moves every history; whether all had to begin again."""
        left = [member for member in self._members if moved(member, theta_b, l_b)]
        anew = not left and self._at is not None
        if not left:
            states = start_states(self._mechanics.n - 1, self._most, self._rng)
            ends = [state for state in states if np.all(np.abs(state) == 1) or not state.any()]
            self._waiting = [state for state in states if not any(state is end for end in ends)]
            left = self._begin(ends, theta_b, l_b, 0.0)
        if not left:
            self._members = []
            raise SolverError("no friction state has an equilibrium at these joints")
        for member in left:
            member.slow = self._slow.after_step(member.slow)
        self._members, self._at = left, (theta_b, l_b)
        self._renew_slopes()
        return anew

    def _begin(self, states: list[Array], theta_b: Array, l_b: Array, score: float) -> list[Member]:
        """Histories from states, of the robot as slow parameters have it by now."""
        likeliest = max(self._members, key=lambda member: member.score) if self._members else None
        slow = likeliest.slow if likeliest else self._slow.start()
        values = self._slow.simulated(slow)
        found = (begun(self._history(values, phi), values, theta_b, l_b, slow, score) for phi in states)
        return [member for member in found if member is not None]

    def _history(self, values: Array, start: Start = "released") -> History:
        """Of the robot with slow parameters values (P,) off the file's."""
        mechanics = self._robot_with(dict(zip(self._slow.names, values.tolist(), strict=True)))
        return History(mechanics, start, accuracy=self._accuracy, options=None if self._is_measured else COARSE)

    def _own(self, member: Member) -> History:
        """A member's history; of the robot as the file has it, from the same friction, if it is of another."""
        if not member.values.any():
            return member.history
        assert self._at is not None
        own = History(self._mechanics, np.clip(member.phi, -1, 1), accuracy=self._accuracy)
        own.follow(*(row[None] for row in self._at))
        return own

    def _join_waiting(self) -> None:
        """With the first tip steps become fine, and states between the corners join."""
        assert self._at is not None
        if not self._is_measured:
            self._is_measured = True
            for member in self._members:
                fine = self._history(member.values)
                fine.restore(member.history.save())
                member.history = fine
        if self._waiting:
            count = len(self._members) + len(self._waiting)
            total = float(np.logaddexp.reduce([member.score for member in self._members]))
            self._members = self._members + self._begin(self._waiting, *self._at, total - math.log(count))
            self._waiting = []
            self._renew_slopes()

    def _renew_slopes(self) -> None:
        """Derivatives by the slow parameters, of members without, and of those whose are of elsewhere by now."""
        assert self._at is not None
        if not self._slow.names:
            return
        n = self._mechanics.n
        here = [np.concatenate([*self._at, member.phi]) for member in self._members]
        stale = [k for k, at in enumerate(here) if not self._has_slopes_near(self._members[k], at)]
        if stale:
            rows = np.array([here[k] for k in stale])
            slopes = self._slow.slopes(self._mechanics, *np.split(rows, [n, 2 * n], axis=1))
            for k, of in zip(stale, slopes, strict=True):
                self._members[k].slopes, self._members[k].slopes_at = of, here[k]

    def _has_slopes_near(self, member: Member, at: Array) -> bool:
        """Whether a member's derivatives hold at collars and friction states (2 n + n - 1,), or (K, 2 n + n - 1)."""
        n = self._mechanics.n
        limit = np.repeat(STALE, [n, n, n - 1])
        return len(member.slopes_at) > 0 and bool(np.all(np.abs(at - member.slopes_at) <= limit))

    def _ahead(self, member: Member, path: HistoryPath, theta_b: Array, l_b: Array) -> tuple[Array, Array]:
        """What slow errors displace a member's tips by (K, 3) [m] along its path, and (K, 3) variances of the tips."""
        slow, slopes = member.slow, np.broadcast_to(member.slopes, (len(theta_b), *member.slopes.shape))
        if self._slow.names and not self._has_slopes_near(member, np.hstack([theta_b, l_b, path.phi])):
            slopes = self._slow.slopes(self._mechanics, theta_b, l_b, path.phi)
        moved_m, variance = np.empty((2, len(slopes), 3))
        for k, of in enumerate(slopes):
            slow = self._slow.after_step(slow)
            moved_m[k], variance[k] = slow.moved_m(of, member.values), self._known_to(slow, of, ahead=k)
        return moved_m, variance

    def _parameters(self) -> dict[str, ParameterEstimate]:
        share, first = weights(self._members), slice(3, None)
        means = np.array([member.slow.mean[first] for member in self._members])
        own = np.array([np.diag(member.slow.covariance)[first] for member in self._members])
        mean = share @ means
        sigma = np.sqrt(share @ (own + (means - mean) ** 2))
        rows = zip(self._slow.names, (self._values + mean).tolist(), sigma.tolist(), strict=True)
        return {name: ParameterEstimate(value, spread) for name, value, spread in rows}

    def _weigh(self, seen: Array, along: Array | None) -> None:
        """Probabilities, offsets, and what stays unexplained, after a tip seen at (3,)."""
        sigma2 = self._noise.position_sigma_m**2
        off = [seen - member.expected_m for member in self._members]
        spread = [member.slow.spread_m2(member.slopes) for member in self._members]
        noise2 = sigma2 + self._unexplained
        for member, away, own in zip(self._members, off, spread, strict=True):
            S = own + noise2 * np.eye(3)
            member.score = NEWS * member.score - float(away @ np.linalg.solve(S, away) + np.linalg.slogdet(S)[1]) / 2
            if along is not None and self._noise.tangent_sigma_rad is not None:
                turned = float(np.sum(np.cross(along, member.tangent) ** 2))
                member.score -= turned / (2 * self._noise.tangent_sigma_rad**2 * noise2 / sigma2)
        surplus = [float(away @ away - np.trace(own)) / 3 for away, own in zip(off, spread, strict=True)]
        beyond = float(weights(self._members) @ np.array(surplus)) - sigma2
        self._unexplained = max(0.0, NEWS * self._unexplained + (1 - NEWS) * beyond)
        best = int(np.argmax([member.score for member in self._members]))
        self._slow.learn(off[best], float(np.trace(spread[best])) / 3 + sigma2, NEWS)
        for member, away in zip(self._members, off, strict=True):
            member.slow = self._slow.seen(member.slow, member.slopes, away, noise2)
        self._members = tidied(self._members)[: MOST_WITH_SLOW if self._slow.names else None]
        left = float(np.sum((seen - self._estimate().position_m) ** 2)) / 3  # the bank may be too coarse for this noise
        self._left = left if left > GROSS * sigma2 else 0.0
        if not (self._left or self._unexplained > SURPRISE * sigma2 or self._is_simulated_otherwise()):
            self._pause = self._wait = 0
        elif self._wait > 0:
            self._wait -= 1
        else:  # less and less often, where it is not friction that is missing
            self._try_others()
            self._wait, self._pause = self._pause, min(2 * self._pause + 1, MEMORY)

    def _is_simulated_otherwise(self) -> bool:
        """Whether the likeliest history has other slow parameters than it is found to have, so that slopes mislead."""
        likeliest = max(self._members, key=lambda member: member.score)
        away = np.abs(likeliest.slow.mean[3:] - likeliest.values)
        return bool(np.any((away > OTHERWISE * self._slow.sigma) & self._slow.in_mechanics))

    def _try_others(self) -> None:
        """Friction states beside those that are followed, in the place of the least likely ones."""
        if self._mechanics.n < 2:
            return
        count = min(TRIED_AT_ONCE, self._most)
        likeliest = max(self._members, key=lambda member: member.score)
        total = float(np.logaddexp.reduce([member.score for member in self._members]))
        states = states_nearby(likeliest.phi, count, NEAR, self._rng)
        if self._slow.names:  # in turn, for each takes derivatives besides
            self._tries += 1
            states = [states[self._tries % ELSEWHERE == 0 and count > 1]]
        assert self._at is not None
        joined = self._begin(states, *self._at, total + math.log(TRIED_SHARE / len(states)))
        kept = sorted(self._members, key=lambda member: -member.score)[: max(1, self._most - len(joined))]
        self._members = kept + joined
        self._renew_slopes()

    def _estimate(self) -> TipEstimate:
        position = np.array([member.expected_m for member in self._members])
        along = np.array([member.tangent for member in self._members])
        variance = np.array([self._known_to(member.slow, member.slopes) for member in self._members])
        return estimate(position, along, weights(self._members), variance)

    def _known_to(self, slow: Slow, slopes: Array, ahead: int = 0) -> Array:
        """(3,) variances [m^2] of the coordinates of a history's tip, if it is the true one, so many steps ahead."""
        least = self._noise.position_sigma_m**2  # what the bank is too coarse for can't be told from a row's noise
        own: Array = np.diag(slow.spread_m2(slopes, self._slow.shown_share(ahead)))
        return own + max(self._unexplained, self._left, least)

    def _collars(self, theta_commanded: ArrayLike, l_commanded: ArrayLike) -> tuple[Array, Array]:
        n = self._mechanics.n
        theta_b, l_b = self._drive.reached(joint_row(theta_commanded, n), joint_row(l_commanded, n))
        if refused := self._mechanics.first_refused(theta_b[None], l_b[None]):
            raise InputError(refused[1])
        return theta_b, l_b

    def _require_begun(self) -> None:
        if self._at is None or not self._members:
            raise InputError("knows nothing before its first step", key="observer")


def _vector(values: ArrayLike | None, key: str) -> Array | None:
    if values is None:
        return None
    vector = numbers(values, key)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise InputError("must be three finite numbers", key=key)
    return vector


def _unit(tangent: Array) -> Array:
    length = float(np.linalg.norm(tangent))
    if not 0.5 < length < 2:
        raise InputError(f"must be a unit vector, has length {length:.4g}", key="tangent")
    unit: Array = tangent / length
    return unit
