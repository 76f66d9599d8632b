"""The observer: a robot followed step by step, by the friction states that agree with its measured tips.

A bank of histories starts released, in every corner of signs and between, and moves on by the robot's own mechanics.
Each measured tip weighs them by its likelihood; weights forget, as errors of neighbouring rows are no news. Histories
that have become the same are merged. Where measured tips are farther off than noise explains, friction states near the
likeliest one and elsewhere join the bank. A slow offset is estimated per history, in closed form (Rao-Blackwell).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import SEED, Choice, Made, Whole, checked
from ctrplan.base.arrays import Array, numbers
from ctrplan.errors import InputError, SolverError
from ctrplan.mechanics.core_arrays import joint_row, joint_rows
from ctrplan.mechanics.history import History
from ctrplan.robot.observer.bank import Member, begun, followed, moved, tidied, weights
from ctrplan.robot.observer.estimate import Observed, TipEstimate, estimate
from ctrplan.robot.observer.slow_offset import SlowOffset
from ctrplan.robot.observer.start_states import start_states, states_nearby
from ctrplan.robot.observer.state import ObservedHistory, ObserverState
from ctrplan.sensor.noise import SensorNoise

if TYPE_CHECKING:
    from ctrplan.drive.drive import Drive
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.mechanics.core import Mechanics

MEMORY = 20  # steps after which a measured tip counts for 1/e
NEWS = 1 - 1 / MEMORY
GROSS = 4.0  # times the noise's variance, of a coordinate: beyond what chance does in one row of a hundred
SURPRISE = 3.0  # times the noise's variance unexplained, from which other friction states are tried
TRIED_AT_ONCE = 2  # in a step, so that steps take no longer
TRIED_SHARE = 0.1  # of the probability, given to them
NEAR = 0.3  # standard deviation of those near the likeliest
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
        mechanics: Mechanics,
        drive: Drive,
        *,
        noise: SensorNoise,
        offset: SlowOffset,
        members: int,
        seed: int,
        accuracy: Accuracy,
    ) -> None:
        """As `Robot.observer` has them."""
        self._mechanics, self._drive, self._accuracy = mechanics, drive, accuracy
        self._noise, self._offset, self._most = noise, offset, members
        self._rng = np.random.default_rng(seed)
        self._members: list[Member] = []
        self._at: tuple[Array, Array] | None = None
        self._variance = offset.sigma_m**2  # of the offset, the same in every history
        self._unexplained = 0.0  # m^2, of a coordinate, mean of the last steps
        self._left = 0.0  # m^2, of a coordinate, by the last step
        self._wait, self._pause = 0, 0  # steps until other friction states are tried again, and after that
        self._spare = History(mechanics, accuracy=accuracy)

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
            self._weigh(seen, along)
        return Observed(
            expected=expected,
            tip=self._estimate(),
            friction=weights(self._members) @ np.array([member.phi for member in self._members]),
            histories=len(self._members),
            unexplained_m=math.sqrt(self._unexplained),
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
        kept = self._offset.kept ** np.arange(1, len(l_b) + 1)[:, None]
        for member, share in zip(self._members, weights(self._members), strict=True):
            self._spare.restore(member.history.save())
            path = followed(self._spare, theta_b, l_b)
            if path is not None:
                found.append((path.position_m + kept * member.offset_m, path.tangent, share))
        if not found:
            raise SolverError("no equilibrium was found along the path")
        position, along, shares = (np.array(part) for part in zip(*found, strict=True))
        ahead = estimate(position, along, shares / shares.sum(), self._known_to(self._variances_ahead(len(l_b))))
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
            histories=tuple(ObservedHistory(m.history.save(), self._accuracy, m.phi.copy()) for m in chosen),
            weight=share[kept] / share[kept].sum(),
            offset_m=share @ np.array([member.offset_m for member in self._members]),
        )

    def _move(self, theta_b: Array, l_b: Array) -> bool:
        """Moves every history; whether all had to begin again."""
        left = [member for member in self._members if moved(member, theta_b, l_b)]
        anew = not left and self._at is not None
        if not left:
            left = self._begin(start_states(self._mechanics.n - 1, self._most, self._rng), theta_b, l_b, 0.0)
        if not left:
            self._members = []
            raise SolverError("no friction state has an equilibrium at these joints")
        for member in left:
            member.offset_m = self._offset.kept * member.offset_m
        self._variance = self._offset.variance_after(self._variance)
        self._members, self._at = left, (theta_b, l_b)
        return anew

    def _begin(self, states: list[Array], theta_b: Array, l_b: Array, score: float) -> list[Member]:
        offset = (
            weights(self._members) @ np.array([m.offset_m for m in self._members]) if self._members else np.zeros(3)
        )
        found = (
            begun(History(self._mechanics, phi, accuracy=self._accuracy), theta_b, l_b, offset, score) for phi in states
        )
        return [member for member in found if member is not None]

    def _weigh(self, seen: Array, along: Array | None) -> None:
        """Probabilities, offsets, and what stays unexplained, after a tip seen at (3,)."""
        sigma2 = self._noise.position_sigma_m**2
        off2 = [float(np.sum((seen - m.position_m - m.offset_m) ** 2)) for m in self._members]
        noise2 = sigma2 + self._unexplained
        for member, squared in zip(self._members, off2, strict=True):
            member.score = NEWS * member.score - squared / (2 * (self._variance + noise2))
            if along is not None and self._noise.tangent_sigma_rad is not None:
                turned = float(np.sum(np.cross(along, member.tangent) ** 2))
                member.score -= turned / (2 * self._noise.tangent_sigma_rad**2 * noise2 / sigma2)
        surplus = float(weights(self._members) @ np.array(off2)) / 3 - self._variance - sigma2
        self._unexplained = max(0.0, NEWS * self._unexplained + (1 - NEWS) * surplus)
        gain = self._variance / (self._variance + noise2)
        for member in self._members:
            member.offset_m = member.offset_m + gain * (seen - member.position_m - member.offset_m)
        self._variance *= 1 - gain
        self._members = tidied(self._members)
        left = float(np.sum((seen - self._estimate().position_m) ** 2)) / 3  # the bank may be too coarse for this noise
        self._left = left if left > GROSS * sigma2 else 0.0
        if not (self._left or self._unexplained > SURPRISE * sigma2):
            self._pause = self._wait = 0
        elif self._wait > 0:
            self._wait -= 1
        else:  # less and less often, where it is not friction that is missing
            self._try_others()
            self._wait, self._pause = self._pause, min(2 * self._pause + 1, MEMORY)

    def _try_others(self) -> None:
        """Friction states beside those that are followed, in the place of the least likely ones."""
        if self._mechanics.n < 2:
            return
        count = min(TRIED_AT_ONCE, self._most)
        likeliest = max(self._members, key=lambda member: member.score)
        total = float(np.logaddexp.reduce([member.score for member in self._members]))
        states = states_nearby(likeliest.phi, count, NEAR, self._rng)
        assert self._at is not None
        joined = self._begin(states, *self._at, total + math.log(TRIED_SHARE / count))
        kept = sorted(self._members, key=lambda member: -member.score)[: max(1, self._most - len(joined))]
        self._members = kept + joined

    def _estimate(self) -> TipEstimate:
        position = np.array([member.position_m + member.offset_m for member in self._members])
        along = np.array([member.tangent for member in self._members])
        return estimate(position, along, weights(self._members), self._known_to(self._variance))

    def _known_to(self, offset_variance: Array | float) -> Array | float:
        """Variance [m^2] of a coordinate of a history's tip, if it is the true one."""
        least = self._noise.position_sigma_m**2  # what the bank is too coarse for can't be told from a row's noise
        return offset_variance + max(self._unexplained, self._left, least)

    def _variances_ahead(self, count: int) -> Array:
        found = [self._variance]
        for _ in range(count):
            found.append(self._offset.variance_after(found[-1]))
        return np.array(found[1:])

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
