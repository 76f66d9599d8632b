"""The observer: a robot followed step by step, by the friction states that agree with its measured tips.

A bank of histories starts released and in every corner of signs, and moves on by the robot's own mechanics, in coarse
steps as long as nothing is measured. With the first tip states between join. Each measured tip weighs histories by its
likelihood; weights forget, as errors of neighbouring rows are no news. Histories that have become the same are merged.
Where measured tips are farther off than noise explains, friction states near the likeliest one and elsewhere join the
bank. A slow offset and named parameters are estimated per history, by a Kalman filter (`slow_model.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import MEMBERS, SEED, Choice, Made, checked
from ctrplan.base.arrays import CI95, LEVEL, UNITS_M, Array, numbers, warn_of_degrees
from ctrplan.base.package import of_this_process
from ctrplan.drive.legs import STILL_M, STILL_RAD
from ctrplan.errors import InputError, SolverError
from ctrplan.measurement.measurements import SensorNoise
from ctrplan.mechanics.core_arrays import joint_row, joint_rows
from ctrplan.mechanics.history import HistoryPath
from ctrplan.robot.observer_histories import Histories, Member, RobotWith, probed, states_nearby, tidied, weights
from ctrplan.robot.slow_states import Slow, SlowModel, SlowOffset, SlowParameter, spread_m2

if TYPE_CHECKING:
    from ctrplan.mechanics.core import Mechanics
    from ctrplan.mechanics.history import History, HistoryState
    from ctrplan.mechanics.shapes import Accuracy, HistoryOptions


@dataclass(frozen=True, eq=False)
class TipEstimate:
    """Tips as the tracker would see them without its noise, at one place (3,) or at K of them (K, 3)."""

    position_m: Array  # mean
    low_m: Array  # of each coordinate, the ends of its 95 % interval
    high_m: Array
    tangent: Array  # unit vector, mean


@dataclass(frozen=True)
class ParameterEstimate:
    """A slow parameter, SI."""

    value: float
    sigma: float  # standard deviation


@dataclass(frozen=True, eq=False)
class Observed:
    """What an observer makes of one step."""

    expected: TipEstimate  # before the step's own measurement: one step ahead
    tip: TipEstimate  # after it
    friction: Array  # (n - 1,) circumferential friction state of each pair, mean
    histories: int  # that are still followed
    unexplained_m: float  # what measured tips are off beyond the stated noise, of a coordinate, rms of the last steps
    parameters: Mapping[str, ParameterEstimate]  # the slow ones
    started_anew: bool  # no history found an equilibrium on the way, all were begun again where the robot stands
    set_aside: bool  # the measured tip is farther off than noise and friction explain, and was not taken


def estimate(position_m: Array, tangent: Array, weight: Array, variance: Array) -> TipEstimate:
    """The estimate by H histories' tips (H, 3) or (H, K, 3), probabilities (H,), each coordinate known to a variance
    [m^2].

    The interval extends over the likeliest histories that carry 95 % together, and over 95 % of a normal error.
    """
    order = np.argsort(-weight, kind="stable")
    ordered = weight[order]
    carried = order[np.cumsum(ordered) - ordered < LEVEL]
    likely, beyond = position_m[carried], CI95 * np.sqrt(variance[carried])
    mean_tangent = _mean(weight, tangent)
    return TipEstimate(
        position_m=_mean(weight, position_m),
        low_m=(likely - beyond).min(axis=0),
        high_m=(likely + beyond).max(axis=0),
        tangent=mean_tangent / np.sqrt((mean_tangent * mean_tangent).sum(axis=-1, keepdims=True)),
    )


def _mean(weight: Array, vectors: Array) -> Array:
    """The mean of H vectors (H, 3) or of H rows of K of them (H, K, 3)."""
    mean: Array = (weight @ vectors.reshape(len(weight), -1)).reshape(vectors.shape[1:])
    return mean


@dataclass(frozen=True, eq=False)
class ObservedHistory:
    """One history that agrees with what was measured."""

    state: HistoryState
    accuracy: Accuracy  # mesh of the state
    phi: Array  # (n - 1,) circumferential friction state of each pair, averaged by normal force

    def history(self, mechanics: Mechanics, accuracy: Accuracy, options: HistoryOptions | None = None) -> History:
        """A history that goes on from here, by steps as in `options`.

        On another mesh than that of the state friction starts uniform along each contact, at its average. Raises
        InputError for another robot.
        """
        from ctrplan.mechanics.history import History

        own = History(mechanics, accuracy=self.accuracy, options=options)
        own.restore(self.state)
        if accuracy == self.accuracy:
            return own
        other = History(mechanics, np.clip(self.phi, -1, 1), accuracy=accuracy, options=options)
        other.follow(self.state.theta_b[None], self.state.l_b[None])
        return other


@dataclass(frozen=True, eq=False)
class ObserverState:
    """Where a followed robot stands: H histories that agree with what was measured, and how well."""

    theta_b: Array  # (n,) [rad], collars
    l_b: Array  # (n,) [m]
    histories: tuple[ObservedHistory, ...]  # H, likeliest first
    weight: Array  # (H,) probabilities, of sum 1
    offset_m: Array  # (3,) what was measured is this much off the simulated tips
    parameters: Mapping[str, ParameterEstimate]  # slow ones; plans go by the robot that they are given

    def check(self, mechanics: Mechanics, theta_b: Array, l_b: Array) -> None:
        """Raises InputError unless it is of this robot, with collars at (n,) [rad], (n,) [m]."""
        try:
            self.histories[0].history(mechanics, self.histories[0].accuracy)
        except InputError:
            raise InputError("is of another robot", key="start_state") from None
        off = np.concatenate([np.abs(theta_b - self.theta_b) / STILL_RAD, np.abs(l_b - self.l_b) / STILL_M])
        if off.max() > 1:
            raise InputError("stands at other joints than the scenario's start", key="start_state")


GROSS = 4.0  # times the noise's variance, of a coordinate: beyond chance in one row of a hundred; times sigma: in any
SURPRISE = 3.0  # times the noise's variance unexplained, from which other friction states are tried


class Surprise:
    """Variances [m^2] of a coordinate, of steps that forget; and the pauses between tries, which grow."""

    def __init__(self, sigma_m: float, memory: int) -> None:
        """sigma_m: noise of a coordinate; memory: steps, after which one counts for 1/e."""
        self.noise_m2, self.unexplained_m2 = sigma_m**2, 0.0
        self.left_m2 = 0.0  # by the last step, where it is gross
        self._memory, self._kept = memory, 1 - 1 / memory
        self._wait, self._pause = 0, 0  # steps until other friction states are tried again, and after that

    @property
    def beyond_m2(self) -> float:
        """That a tip has besides what histories and slow errors spread, at least the noise of a row.

        What the histories are too coarse for can't be told from that.
        """
        return max(self.unexplained_m2, self.left_m2, self.noise_m2)

    def learn(self, surplus_m2: float) -> None:
        """From squares by which a step's tip is off beyond what was expected, its noise included."""
        beyond = surplus_m2 - self.noise_m2
        self.unexplained_m2 = max(0.0, self._kept * self.unexplained_m2 + (1 - self._kept) * beyond)

    def after(self, off_m: Array) -> None:
        """What is left (3,) [m] once the step's tip has been weighed."""
        left = float(off_m @ off_m) / 3
        self.left_m2 = left if left > GROSS * self.noise_m2 else 0.0

    def tries_others(self, besides: bool) -> bool:
        """Whether others are to be tried in this step; `besides`: another reason for it.

        Less and less often, where it is not friction that is missing.
        """
        if not (self.left_m2 or self.unexplained_m2 > SURPRISE * self.noise_m2 or besides):
            self._pause = self._wait = 0
            return False
        if self._wait > 0:
            self._wait -= 1
            return False
        self._wait, self._pause = self._pause, min(2 * self._pause + 1, self._memory)
        return True


MEMORY = 20  # steps after which a measured tip counts for 1/e
NEWS = 1 - 1 / MEMORY
TRIED_AT_ONCE = 2  # in a step, so that steps take no longer
TRIED_SHARE = 0.1  # of the probability, given to them
NEAR = 0.3  # standard deviation of those near the likeliest
MOST_WITH_SLOW = 3  # measured histories beside slow parameters, by which many agree with a tip
OTHERWISE = 0.3  # standard deviations of a slow parameter, by which histories may be simulated with another value
ELSEWHERE = 4  # one in so many of the states tried beside slow parameters is not near the likeliest
KNOWN_SHARE = 0.999  # of the probability, by the histories that `state` keeps


class Observer:
    """A robot that is followed. Made by `Robot.observer`; it takes collars. One thread at a time."""

    __reduce__ = of_this_process("make another by Robot.observer and show it the same rows")

    @checked(
        noise=Made("SensorNoise"),
        offset=Made("SlowOffset"),
        members=MEMBERS,
        seed=SEED,
        accuracy=Choice("search", "certificate"),
    )
    def __init__(
        self,
        robot_with: RobotWith,
        *,
        noise: SensorNoise,
        offset: SlowOffset,
        slow: Mapping[SlowParameter, float],
        members: int,
        seed: int,
        accuracy: Accuracy,
        farthest_m: float,
    ) -> None:
        """Arguments as `Robot.observer` has them; `slow` with the values that the robot file has.

        robot_with: the mechanics with slow parameters so much off these values; farthest_m: that a tip may be measured.
        """
        self._farthest_m = farthest_m
        self._accuracy, self._noise, self._most = accuracy, noise, members
        self._slow, self._values = SlowModel(offset, list(slow)), np.array(list(slow.values()), dtype=np.float64)
        self._rng = np.random.default_rng(seed)
        self._bank = Histories(robot_with, accuracy, self._slow, members, self._rng)
        self._surprise = Surprise(noise.position_sigma_m, MEMORY)
        self._tries = 0
        self._set_aside = False  # the tip measured last

    def observe(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        position_m: ArrayLike | None = None,
        tangent: ArrayLike | None = None,
    ) -> Observed:
        """Moves on to collars (n,) [rad], (n,) [m], and takes the tip (3,) [m] measured there, if any; tangent (3,).

        A tip that is farther off than its noise and any friction state explain is set aside; where the next one is,
        too, it is believed. Raises InputError, before anything moves, and SolverError where no friction state has an
        equilibrium.
        """
        warn_of_degrees("theta_b", theta_b)
        theta_b, l_b = self._collars(theta_b, l_b)
        seen, along = _vector(position_m, "position_m"), _vector(tangent, "tangent")
        if seen is not None and (far := float(np.linalg.norm(seen))) > (limit := self._farthest_m):
            unit = ", are these millimetres?" if far * UNITS_M["mm"] <= limit else ""
            rule = f"is {far:g} m from the base, beyond the reach of {limit:.3g} m{unit}"
            raise InputError(rule, key="position_m", value=seen.tolist())
        if along is not None:
            if seen is None:
                raise InputError("needs a position beside it", key="tangent")
            along = _unit(along)
        anew = self._bank.move(theta_b, l_b)
        expected = self._estimate()
        is_out = False
        if seen is not None:
            self._bank.join_waiting()
            is_out = self._set_aside = not self._set_aside and self._is_out(seen)
            if not is_out:
                self._weigh(seen, along)
        return Observed(
            expected=expected,
            tip=self._estimate(),
            friction=weights(self._bank.members) @ np.array([member.phi for member in self._bank.members]),
            histories=len(self._bank.members),
            unexplained_m=math.sqrt(self._surprise.unexplained_m2),
            parameters=self._parameters(),
            started_anew=anew,
            set_aside=is_out,
        )

    def predict(self, theta_b: ArrayLike, l_b: ArrayLike) -> TipEstimate:
        """Where the tip would be after a motion to collars (n,) [rad], (n,) [m], or along K of them (K, n).

        The observer stays where it is. Raises InputError, also before the first step, and SolverError.
        """
        self._require_begun()
        warn_of_degrees("theta_b", theta_b)
        single = np.ndim(l_b) == 1
        theta, l = (np.atleast_2d(numbers(x, key)) for x, key in ((theta_b, "theta_b"), (l_b, "l_b")))  # noqa: E741
        theta, l = joint_rows(theta, l, self._bank.mechanics.n)  # noqa: E741 (as in the equations)
        if not len(l):
            raise InputError("must have a row to predict", key="theta_b")
        results = []
        paths = self._bank.threads.each(lambda member: probed(member.history, theta, l), self._bank.members)
        for member, path, share in zip(self._bank.members, paths, weights(self._bank.members), strict=True):
            if path is not None:
                moved_m, variance = self._ahead(member, path, theta, l)
                results.append((path.position_m + moved_m, path.tangent, share, variance))
        if not results:
            raise SolverError("no equilibrium was found along the path")
        position, along, shares, variances = (np.array(part) for part in zip(*results, strict=True))
        ahead = estimate(position, along, shares / shares.sum(), variances)
        return TipEstimate(*(getattr(ahead, name)[0] for name in TipEstimate.__dataclass_fields__)) if single else ahead

    def state(self) -> ObserverState:
        """What is known now; `ctrplan.plan` starts from it. Raises InputError before the first step."""
        self._require_begun()
        share = weights(self._bank.members)
        order = np.argsort(-share, kind="stable")
        kept = order[np.cumsum(share[order]) - share[order] < KNOWN_SHARE]
        chosen = [self._bank.members[k] for k in kept.tolist()]
        assert self._bank.at is not None
        return ObserverState(
            theta_b=self._bank.at[0].copy(),
            l_b=self._bank.at[1].copy(),
            histories=tuple(
                ObservedHistory(self._bank.of_the_file(m).save(), self._accuracy, m.phi.copy()) for m in chosen
            ),
            weight=share[kept] / share[kept].sum(),
            offset_m=share @ np.array([member.slow.mean[:3] for member in self._bank.members]),
            parameters=self._parameters(),
        )

    def _parameters(self) -> dict[str, ParameterEstimate]:
        share, first = weights(self._bank.members), slice(3, None)
        means = np.array([member.slow.mean[first] for member in self._bank.members])
        own = np.array([np.diag(member.slow.covariance)[first] for member in self._bank.members])
        mean = share @ means
        sigma = np.sqrt(share @ (own + (means - mean) ** 2))
        rows = zip(self._slow.names, (self._values + mean).tolist(), sigma.tolist(), strict=True)
        return {name: ParameterEstimate(value, spread) for name, value, spread in rows}

    def _is_out(self, seen: Array) -> bool:
        """Whether a tip (3,) lies farther from every history, and from what friction may do, than errors known so far.

        A history beyond the bound, on another branch, has as much more room.
        """
        off = [float(np.linalg.norm(seen - member.expected_m)) for member in self._bank.members]
        nearest = self._bank.members[int(np.argmin(off))]
        room = GROSS * math.sqrt(float(self._known_to(nearest.slow, nearest.slopes, ahead=0).max()))
        if min(off) <= room:
            return False
        assert self._bank.at is not None
        bound = self._bank.mechanics.bound(*self._bank.at, accuracy=self._accuracy)
        moved, tip_m = nearest.expected_m - nearest.position_m, bound.frictionless.tip_m
        beyond = max(0.0, float(np.linalg.norm(nearest.position_m - tip_m)) - bound.position_m)
        return bool(min(off) > room + beyond and np.linalg.norm(seen - moved - tip_m) > bound.position_m + room)

    def _weigh(self, seen: Array, along: Array | None) -> None:
        """Probabilities, offsets, and what stays unexplained, after a tip seen at (3,)."""
        members, sigma2, unexplained2 = self._bank.members, self._surprise.noise_m2, self._surprise.unexplained_m2
        off = seen - np.array([member.expected_m for member in members])
        spread = self._spread_m2(members)
        noise2 = sigma2 + unexplained2
        covariance = spread + noise2 * np.eye(3)
        least = (
            np.sum(off * np.linalg.solve(covariance, off[:, :, None])[:, :, 0], axis=1)
            + np.linalg.slogdet(covariance)[1]
        )
        for member, of in zip(members, least.tolist(), strict=True):
            member.score = NEWS * member.score - of / 2
            if along is not None and self._noise.tangent_sigma_rad is not None:
                turned = float(np.sum(np.cross(along, member.tangent) ** 2))
                member.score -= turned / (2 * self._noise.tangent_sigma_rad**2 * noise2 / sigma2)
        own = np.trace(spread, axis1=1, axis2=2)
        self._surprise.learn(float(weights(members) @ (np.sum(off * off, axis=1) - own)) / 3)
        best = int(np.argmax([member.score for member in members]))
        self._slow.learn(off[best], float(own[best]) / 3 + sigma2, NEWS)
        slopes = np.array([member.slopes for member in members])
        result = self._slow.seen([member.slow for member in members], slopes, off, noise2)
        for member, slow in zip(members, result, strict=True):
            member.slow = slow
        self._bank.members = tidied(members)[: MOST_WITH_SLOW if self._slow.names else None]
        expected = weights(self._bank.members) @ np.array([member.expected_m for member in self._bank.members])
        self._surprise.after(seen - expected)  # the histories may be too coarse for this noise
        if self._surprise.tries_others(besides=self._is_simulated_otherwise()):
            self._try_others()

    def _is_simulated_otherwise(self) -> bool:
        """Whether the likeliest history has other slow parameters than it is found to have, so that slopes mislead."""
        likeliest = self._bank.likeliest
        away = np.abs(likeliest.slow.mean[3:] - likeliest.values)
        return bool(np.any((away > OTHERWISE * self._slow.sigma) & self._slow.in_mechanics))

    def _try_others(self) -> None:
        """Friction states beside those that are followed, in the place of the least likely ones."""
        if self._bank.mechanics.n < 2:
            return
        count = min(TRIED_AT_ONCE, self._most)
        states = states_nearby(self._bank.likeliest.phi, count, NEAR, self._rng)
        if self._slow.names:  # in turn, for each takes derivatives besides
            self._tries += 1
            states = [states[self._tries % ELSEWHERE == 0 and count > 1]]
        joined = self._bank.begin(states, self._bank.total_score + math.log(TRIED_SHARE / len(states)))
        kept = sorted(self._bank.members, key=lambda member: -member.score)[: max(1, self._most - len(joined))]
        self._bank.members = kept + joined

    def _estimate(self) -> TipEstimate:
        members = self._bank.members
        position = np.array([member.expected_m for member in members])
        along = np.array([member.tangent for member in members])
        own = self._spread_m2(members, self._slow.shown_share(0)).diagonal(axis1=1, axis2=2)
        variance = own + self._surprise.beyond_m2
        return estimate(position, along, weights(members), variance)

    def _ahead(self, member: Member, path: HistoryPath, theta_b: Array, l_b: Array) -> tuple[Array, Array]:
        """What slow errors displace a member's tips by (K, 3) [m] along its path, and (K, 3) variances of the tips."""
        slow, slopes = member.slow, self._bank.ahead(member, path, theta_b, l_b)
        moved_m, variance = np.empty((2, len(slopes), 3))
        for k, of in enumerate(slopes):
            slow = self._slow.after_step(slow)
            moved_m[k], variance[k] = slow.moved_m(of, member.values), self._known_to(slow, of, ahead=k)
        return moved_m, variance

    def _spread_m2(self, members: list[Member], share: float = 1.0) -> Array:
        """(H, 3, 3) covariances of members' tips by what changes slowly; of the offset's variance a share."""
        covariance = np.array([member.slow.covariance for member in members])
        return spread_m2(covariance, np.array([member.slopes for member in members]), share)

    def _known_to(self, slow: Slow, slopes: Array, ahead: int) -> Array:
        """(3,) variances [m^2] of the coordinates of a history's tip, if it is the true one, so many steps ahead."""
        own: Array = slow.spread_m2(slopes, self._slow.shown_share(ahead)).diagonal()
        return own + self._surprise.beyond_m2

    def _collars(self, theta_b: ArrayLike, l_b: ArrayLike) -> tuple[Array, Array]:
        n = self._bank.mechanics.n
        theta, l = joint_row(theta_b, n), joint_row(l_b, n)  # noqa: E741 (as in the equations)
        if refused := self._bank.mechanics.first_refused(theta[None], l[None]):
            raise InputError(refused[1])
        return theta, l

    def _require_begun(self) -> None:
        if self._bank.at is None or not self._bank.members:
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
