"""What remains beside a model: how large it is, how long it lasts, and what it goes along with.

An error that goes along with a quantity is a zero-mean Gaussian process of it. Residuals R (K, D) are compared over
such processes by their evidence, the size of the noise being unknown,

    -K D / 2 log |C^-1/2 R|^2 - D / 2 log |C|,  C = (1 - a) I + a G + s^2 k,

G one for two poses of the same configuration, k the process, and all shares a, sizes s and lengths of k as probable as
each other.
How much of a remainder belongs to each of several processes, their most probable variances say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import SHARES, SIZES, decay
from ctrplan.diagnosis.usable_poses import thinning
from ctrplan.diagnosis.verdict import shown
from ctrplan.measurement.approach import clock, friction_state, last_directions
from ctrplan.measurement.measurements import Measurements

ROUNDS = 100  # in which variances of a remainder's parts come nearer to the most probable ones: a budget
WILD = 3.0  # times the median norm of residuals: longer ones are shortened to it, for a few wild poses are no trend
ROUNDED_RAD = 1e-9  # by which an angle may fall short of zero without coming out as a full turn
JOINTS = "joints together"
ROOM_M = 0.05  # of translation, that counts as much as a radian, or as a friction state or direction
QUARTERS = 4.0  # of the experiment, or of a quantity's range, that count as much as a radian each
LENGTHS = (0.4, 1.0)  # [rad] over which a process changes: three waves a turn, and one
LEAST_MODE = 0.02  # of the largest: modes of a process that are smaller are left out


@dataclass(frozen=True)
class Remainder:
    """What nothing in the catalogue explains. Shares are of its variance, the noise's taken out."""

    rms_m: float  # of the distance, noise taken out
    memory: float | None  # [s] after which it has forgotten itself; None for poses at rest
    of_configuration: float  # share that a configuration has whenever it comes back
    of_history: float  # share that depends on how it was reached besides
    of_time: float  # share that changes with the time of the experiment besides
    place: str  # where it is, as a sentence
    memory_in_rows: bool = False  # of data without times

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "rms_mm": round(self.rms_m * 1e3, 4),
            ("memory_rows" if self.memory_in_rows else "memory_s"): self.memory and round(self.memory, 3),
            "of_configuration": round(self.of_configuration, 3),
            "of_history": round(self.of_history, 3),
            "of_time": round(self.of_time, 3),
            "where": self.place,
        }

    @property
    def sentence(self) -> str:
        """Size, memory and shares."""
        unit = "rows" if self.memory_in_rows else "s"
        lasting = "" if self.memory is None else f", which last {self.memory:.2g} {unit}"
        shares = [
            f"{100 * share:.0f} % {what}"
            for share, what in (
                (self.of_configuration, "belong to the configuration"),
                (self.of_history, "to how it was reached"),
                (self.of_time, "to the order of the rows" if self.memory_in_rows else "to the time"),
            )
            if share > 0.005
        ]
        fixed = f"Of their variance {', '.join(shares)}." if shares else "They go with nothing that comes back."
        return f"{self.rms_m * 1e3:.2f} mm remain (rms, noise taken out){lasting}. {fixed}"


def shares(error_m: Array, data: Measurements, floor_m: float, memory: float) -> tuple[float, float, float]:
    """Shares of configuration, history and time in errors (K, 3) of poses, beside noise of a size floor_m.

    On a continuous motion what is forgotten after a `memory`, in s or in rows, is a fourth part beside these.
    """
    some = np.arange(data.count)[:: thinning(data.count)]
    data, error_m = data.subset(some), error_m[some]
    kernels = {name: np.exp(-square / 2) for name, square in input_distances(data)}
    if data.is_stream:
        same_run = data.run[:, None] == data.run
        forgotten = [decay(clock(data), max(memory, np.finfo(float).tiny)) * same_run]
        parts = [kernels["joints"], kernels["history"], kernels["time"], *forgotten]
    else:
        same = (data.configuration[:, None] == data.configuration).astype(float)
        parts = [(same + kernels["joints"]) / 2, np.eye(data.count), kernels["time"]]
    variances = most_probable_variances(error_m * np.sqrt(3) / floor_m, parts)
    configuration, history, time = (variances[:3] / max(float(variances.sum()), np.finfo(float).tiny)).tolist()
    return configuration, history, time


def most_probable_variances(r: Array, correlations: Sequence[Array]) -> Array:
    """(P,) variances of processes with correlations (K, K) each, beside noise of variance 1, in residuals (K, D).

    By minorisation and maximisation of the evidence (Zhou and others 2019), which never lowers it.
    """
    variances = np.full(len(correlations), float(np.mean(r**2)) / len(correlations))
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(
            np.eye(len(r)) + sum(v * correlation for v, correlation in zip(variances, correlations, strict=True))
        )
        seen = inverse @ r
        drawn = np.array([(seen * (correlation @ seen)).sum() for correlation in correlations])
        spread = r.shape[1] * np.array([(inverse * correlation).sum() for correlation in correlations])
        variances = variances * np.sqrt(drawn / np.maximum(spread, np.finfo(float).tiny))
    return variances


@dataclass(frozen=True)
class Trend:
    """How probable it is that residuals go along with a quantity, and the share of their variance that then does."""

    quantity: str
    share: float
    probability: float


@dataclass(frozen=True, eq=False)
class Place:
    """Where the disagreement is."""

    trends: tuple[Trend, ...]  # of quantities, the most probable first
    sentence: str
    rms_m: float  # of the model's errors


def quantities(data: Measurements) -> Mapping[str, Array]:
    """What each pose comes with, (K,) each."""
    rows, n = data.rows, data.n
    results: dict[str, Array] = {}
    for i in range(1, n):
        turn = data.theta_commanded[rows, i] - data.theta_commanded[rows, i - 1]
        results[f"{ANGLE}tube {i + 1} against tube {i}"] = np.mod(turn + ROUNDED_RAD, 2 * np.pi)
        results[f"direction of approach of tubes {i} and {i + 1}"] = friction_state(data)[:, i - 1]
    for i in range(n):
        results[f"translation of tube {i + 1}"] = data.l_commanded[rows, i]
        results[f"{ROTATION}tube {i + 1}"] = data.theta_commanded[rows, i]
    for k, axis in enumerate("xyz"):
        results[f"{axis} of the tip"] = data.position_m[:, k]
    if data.time_s is not None:
        results["time"] = data.time_s[rows]
    results |= {name: values[rows] for name, values in data.more.items()}
    return {name: values for name, values in results.items() if _differs(values)}


ANGLE, ROTATION = "angle of ", "commanded rotation of "  # how quantities begin that come again after a turn


def localise(
    data: Measurements,
    r: Array,
    group: NDArray[np.int_],
    error_m: Array,
    floor_m: float,
    opening: str = "After calibration",
) -> Place:
    """From whitened residuals (K, 5) and distances (K,) of the calibrated model, or of another that `opening` names.

    That residuals go along with nothing is as probable a priori as that they go along with a quantity or with all
    joints together, which are as probable as each other.
    """
    known, some = quantities(data), np.arange(len(r))[:: thinning(len(r))]
    squares = {name: _square(values[some], name.startswith((ANGLE, ROTATION))) for name, values in known.items()}
    squares[JOINTS] = next(square for name, square in input_distances(data) if name == "joints")[np.ix_(some, some)]
    same = group[some, None] == group[some]
    roots = [np.linalg.cholesky(a * same + (1 - a) * np.eye(len(some))) for a in SHARES[:-1]]  # the last has no noise
    measured = _bounded(r)[some][:, r.any(axis=0)]
    alone = np.array([_evidences(measured, np.zeros((len(some), 0)), root)[0] for root in roots])
    weights, amounts = [float(_mean(alone))], [0.0]
    for square in squares.values():
        modes = [kernel_modes(square / length**2) for length in LENGTHS]
        values = np.array([_evidences(measured, one_length, root) for one_length in modes for root in roots])
        size = SIZES[np.unravel_index(int(values.argmax()), values.shape)[1]]
        weights.append(float(_mean(values.ravel())) - np.log(len(squares)))
        amounts.append(float(size**2 / (1 + size**2)))
    nothing, *probabilities = np.exp(np.array(weights) - logsumexp(weights)).tolist()
    trends = [Trend(*entry) for entry in zip(squares, amounts[1:], probabilities, strict=True)]
    ranked = sorted(trends, key=lambda trend: -trend.probability)
    rms_m = float(np.sqrt(np.mean(error_m**2)))
    start = f"{opening} tips are {rms_m * 1e3:.2f} mm off (rms, noise {floor_m * 1e3:.2f} mm)"
    if not ranked or nothing >= ranked[0].probability:
        sentence = f"{start}; the rest goes along with none of {len(known)} quantities looked at."
    else:
        is_shared = SHARES[int(alone.argmax())] > 0.5
        kind = "is shared by all approaches of a configuration" if is_shared else "differs between approaches"
        sentence = f"{start}; the error goes along with {_along(ranked, known, error_m)}, and mostly {kind}."
    return Place(tuple(trend for trend in ranked if trend.quantity != JOINTS), sentence, rms_m)


def _along(ranked: Sequence[Trend], known: Mapping[str, Array], error_m: Array) -> str:
    """The most probable quantities, of which one goes along with probability 1/2 at least, and errors over each."""
    parts, total = list[str](), 0.0
    for trend in ranked:
        parts.append(f"the {trend.quantity}, {shown(trend.probability)}")
        if trend.quantity != JOINTS:
            values = known[trend.quantity]
            quarters = np.array_split(np.argsort(values)[: np.isfinite(values).sum()], 4)
            sizes = [float(np.sqrt(np.mean(error_m[part] ** 2))) * 1e3 for part in quarters if len(part)]
            parts[-1] += f" ({min(sizes):.2f} to {max(sizes):.2f} mm rms over its range)"
        total += trend.probability
        if total >= 1 / 2:
            break
    return " or ".join(parts)


def _differs(values: Array) -> bool:
    """Whether a quantity (K,), blank where NaN, tells poses apart."""
    given = values[np.isfinite(values)]
    return len(given) > 0 and (len(given) < len(values) or bool(np.ptp(given) > 1e-6))


def _square(values: Array, is_angle: bool) -> Array:
    """(K, K) [rad^2] squares of distances in a quantity (K,): chords of angles, and as many radians a range.

    Blanks are as near to each other, and as far from all else, as can be.
    """
    apart = values[:, None] - values
    given = values[np.isfinite(values)]
    square = 4 * np.sin(apart / 2) ** 2 if is_angle else (QUARTERS * apart / max(float(np.ptp(given)), 1e-12)) ** 2
    blank = ~np.isfinite(values)
    return np.where(np.isfinite(square), square, np.where(blank[:, None] & blank, 0.0, np.inf))


def _evidences(r: Array, modes: Array, root: Array) -> Array:
    """(S,) their logarithms with a process of modes (K, m) of every size, beside noise with a root (K, K)."""
    white, over = (solve_triangular(root, values, lower=True) for values in (r, modes))
    values, vectors = np.linalg.eigh(over.T @ over)
    along = (((over @ vectors).T @ white) ** 2).sum(axis=1)
    square = SIZES[:, None] ** 2
    left = (white**2).sum() - (square * along / (1 + square * values)).sum(axis=1)
    volume = np.log1p(square * np.maximum(values, 0.0)).sum(axis=1) / 2 + np.log(np.diag(root)).sum()
    evidences: Array = -r.size / 2 * np.log(np.maximum(left, np.finfo(float).tiny)) - r.shape[1] * volume
    return evidences


def _mean(logarithms: Array) -> float:
    """Logarithm of a mean."""
    return float(logsumexp(logarithms) - np.log(len(logarithms)))


def _bounded(r: Array) -> Array:
    """Residuals (K, 5) none of which is much longer than most."""
    norm = np.linalg.norm(r, axis=1)
    bounded: Array = r * np.minimum(1.0, WILD * np.median(norm) / np.maximum(norm, 1e-12))[:, None]
    return bounded


def square_distances(data: Measurements, poses: Sequence[int]) -> Array:
    """(B, B) [rad^2] of configurations, each given by a pose: a chord for a rotation, 50 mm count as a radian."""
    rows = data.rows[list(poses)]
    theta, l = data.theta_commanded[rows], data.l_commanded[rows]  # noqa: E741
    turns = np.hstack([theta[:, :1], np.diff(theta, axis=1)])
    place = np.hstack([np.sin(turns), np.cos(turns), l / ROOM_M])
    square: Array = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    return square


def input_distances(data: Measurements) -> Iterator[tuple[str, Array]]:
    """Squares (K, K) of distances of poses in the inputs of a process, in radians or what counts as much."""
    joints, time = square_distances(data, range(data.count)), clock(data)
    yield "joints", joints
    history = np.hstack([friction_state(data), last_directions(data)])
    yield "history", joints + ((history[:, None] - history) ** 2).sum(axis=2)
    yield "time", (QUARTERS * (time[:, None] - time) / max(float(np.ptp(time)), 1e-9)) ** 2
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
    turns = {f"theta_{i + 1}": theta[:, i] for i in range(data.n)}
    turns |= {f"turn_{i + 1}": theta[:, i] - theta[:, i - 1] for i in range(1, data.n) if np.ptp(theta[:, i - 1])}
    yield from ((name, 4 * np.sin((angle[:, None] - angle) / 2) ** 2) for name, angle in turns.items())
    for i in range(data.n):
        yield f"l_{i + 1}", _square(l[:, i], is_angle=False)


def kernel_modes(square: Array) -> Array:
    """(K, m) of a process that changes over a radian, or what counts as much."""
    values, vectors = np.linalg.eigh(np.exp(-square / 2))
    kept = values > LEAST_MODE * values[-1]
    modes: Array = vectors[:, kept] * np.sqrt(values[kept])
    return modes
