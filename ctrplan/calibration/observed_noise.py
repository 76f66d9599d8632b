"""What measurements show of their own noise, without any model of the robot.

Repeats are poses of one configuration that were approached alike: a model says the same of them, whatever it lacks.
Standstills are poses of a log between which no joint moved. Third differences are those of four poses of a log at even
times: a smooth motion leaves little of them, white noise of sigma leaves sqrt(20) sigma. Fourth differences leave less
of a motion and sqrt(70) sigma of noise: the smaller of the two counts.

That misses what a tracker's filter takes away and what changes slowly; what a robot file states may be a data sheet's.
Each is a lower bound, and the largest counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import ROUNDING_M, Array
from ctrplan.calibration.residuals import NO_TANGENT_SIGMA, PAPER, Noise
from ctrplan.errors import InputError
from ctrplan.measurement.approach import friction_state, last_directions, rest_began
from ctrplan.measurement.measurements import LONGEST_LAG_S, Measurements
from ctrplan.robot.observer_histories import SAME_PHI
from ctrplan.robot.robot import Robot

LEAST_SPARE = 20  # repeats beyond the first of their kind: the noise is then known to about 10 %
LEAST_WINDOWS = 100  # of differences, which overlap
STILL_POSES = 5  # of a standstill that count as one kind: what changes more slowly is no noise
FAR = 4.5  # times the typical distance of a repeat from its mean, beyond which one says nothing about noise
UNEVEN = 0.1  # of the time between two poses, by which it may differ from the next
LEAST_RAD = 1e-8  # smaller ones are a held value, as lengths below ROUNDING_M are
MEDIAN = 0.6745  # of the size of a Gaussian number
SURE = 3.0  # standard deviations or errors, which chance does not make


@dataclass(frozen=True)
class ObservedNoise:
    """Noise that data show, how, and the share by which it may be too large by chance."""

    noise: Noise  # of tangents that of nobody's measurement, 1 deg, where the data have none
    by: str  # in words, plural
    doubt: float


def observed_noises(data: Measurements) -> Iterator[ObservedNoise]:
    """Whatever of the three the data have enough of; of tips, or where none were measured of a marker."""
    data = _of_one_point(data)
    if not data.is_stream:
        yield from _within(data, repeats(data), "repeated poses")
        return
    yield from _within(data, standstills(data), "poses at standstills")
    windows = even_windows(data)
    if len(windows) >= LEAST_WINDOWS:
        turned = windows[data.given[windows, 3].all(axis=1)]
        noise = _noise(
            min(_of_differences(data.position_m, windows, order) for order in (3, 4)),
            min(_of_differences(data.tangent, turned, order) for order in (3, 4)) * np.sqrt(3 / _axes(data)),
            data,
        )
        if noise is not None:
            yield ObservedNoise(noise, f"third differences of {len(windows)} poses", SURE * np.sqrt(2 / len(windows)))


def _of_one_point(data: Measurements) -> Measurements:
    """Poses of the tip, or of the marker that was seen most often with all coordinates, its noise that of a tip."""
    if not data.has_markers:
        return data
    whole = data.given[:, :3].all(axis=1)
    point = 0 if np.any(data.seen_marker == 0) else int(np.argmax(np.bincount(data.seen_marker[whole], minlength=1)))
    of = data.subset(whole & (data.seen_marker == point))
    if of.noise_ratio is None or point == 0:
        return of
    return replace(of, position_m=of.position_m / of.noise_ratio[:, None])


def repeats(data: Measurements) -> NDArray[np.int_]:
    """(K,) number that poses share which have configuration, last directions and friction state in common."""
    states = np.round(friction_state(data) / SAME_PHI).astype(np.int64)
    marks = np.column_stack([data.configuration, last_directions(data).astype(np.int64), states])
    number: NDArray[np.int_] = np.unique(marks, axis=0, return_inverse=True)[1].ravel()
    return number


def standstills(data: Measurements) -> NDArray[np.int_]:
    """(K,) number that a few consecutive poses share between which no joint moved, once a late tracker has settled."""
    began = rest_began(data)
    time_s = np.arange(len(began)) * LONGEST_LAG_S / 2 if data.time_s is None else data.time_s
    settled = (time_s - time_s[began] > LONGEST_LAG_S)[data.rows]
    part = (data.rows - began[data.rows]) // STILL_POSES
    alone = np.arange(data.count) + data.rows.max() + 1  # a kind of its own
    marks = np.column_stack([began[data.rows], np.where(settled, part, alone)])
    number: NDArray[np.int_] = np.unique(marks, axis=0, return_inverse=True)[1].ravel()
    return number


def even_windows(data: Measurements) -> NDArray[np.int_]:
    """(W, 5) five consecutive poses each, at even times in one run; the slower half of them."""
    if data.count < 5:
        return np.zeros((0, 5), np.int_)
    windows = np.arange(data.count - 4)[:, None] + np.arange(5)
    rows = data.rows[windows]
    fits = np.all(np.diff(rows, axis=1) == 1, axis=1) & (data.sequence[rows[:, 0]] == data.sequence[rows[:, 4]])
    if data.time_s is not None:
        steps = np.diff(data.time_s[rows], axis=1)
        fits &= (np.ptp(steps, axis=1) <= UNEVEN * steps.mean(axis=1)) & (steps.min(axis=1) > 0)
    windows = np.asarray(windows[fits])
    moved = np.linalg.norm(np.diff(data.position_m[windows], axis=1), axis=2).sum(axis=1)
    slower: NDArray[np.int_] = windows[moved <= np.median(moved)] if len(windows) else windows
    return slower


def spread(vectors: Array, kind: NDArray[np.int_], axes: int) -> float:
    """Standard deviation of each of `axes` coordinates of vectors (K, 3) within kinds (K,); far ones are left out."""
    count: Array = np.bincount(kind).astype(np.float64)
    used = count[kind] > 1
    while True:
        count = np.asarray(np.bincount(kind, weights=used), dtype=np.float64)
        means = np.stack([np.bincount(kind, weights=used * column) for column in vectors.T], axis=1)
        away = vectors - (means / np.maximum(count, 1)[:, None])[kind]
        share = np.maximum(1 - 1 / np.maximum(count, 1), 0.5)[kind]  # of the variance, the rest is the mean's
        distance = np.linalg.norm(away, axis=1) / np.sqrt(share)
        far = used & (distance > FAR * np.median(distance[used]))
        if not far.any():
            spare = float(np.sum(np.maximum(count - 1, 0)))
            return float(np.sqrt(np.sum(away[used] ** 2) / (axes * spare)))
        used &= ~far


def _within(data: Measurements, kind: NDArray[np.int_], what: str) -> Iterator[ObservedNoise]:
    spare = len(kind) - len(np.unique(kind))
    if spare < LEAST_SPARE:
        return
    turned = data.given[:, 3]
    tangent_rad = spread(np.nan_to_num(data.tangent[turned]), kind[turned], _axes(data)) if turned.any() else 0.0
    noise = _noise(spread(data.position_m, kind, 3), tangent_rad, data)
    if noise is not None:
        yield ObservedNoise(noise, f"{spare} {what}", SURE / np.sqrt(6 * spare))


def _axes(data: Measurements) -> int:
    """About which the tangents tell rotations."""
    return 2 if data.given[:, 4].any() else 1


def _of_differences(vectors: Array, windows: NDArray[np.int_], order: int) -> float:
    """Standard deviation of white noise on each coordinate of vectors (K, 3) whose differences are typically so large.

    Coordinates that were not measured count as without noise.
    """
    if not len(windows):
        return 0.0
    weights = np.array([comb(order, k) * (-1) ** k for k in range(order + 1)], dtype=np.float64)
    differences = np.einsum("wkx,k->wx", np.nan_to_num(vectors)[windows[:, : order + 1]], weights)
    return float(np.sqrt(np.mean(np.median(np.abs(differences), axis=0) ** 2)) / MEDIAN / np.linalg.norm(weights))


def _noise(position_m: float, tangent_rad: float, data: Measurements) -> Noise | None:
    """None where the values were held, which says nothing."""
    if position_m < ROUNDING_M:
        return None
    return Noise(position_m, max(tangent_rad, LEAST_RAD) if data.has_tangents else PAPER.tangent_rad)


def noise_floor(robot: Robot, data: Measurements) -> tuple[Noise, str]:
    """Noise, and a sentence about it where it is not as stated. Raises InputError where neither file nor data have it.

    The noise of tangents does not matter where data have none.
    """
    stated, shown = robot.measurement, list(observed_noises(data))
    if stated is None and not shown:
        rule = (
            "is missing: state position_sigma_mm and tangent_sigma_deg, or measure at least "
            f"{LEAST_SPARE} poses again, approached the same way ({_too_little(data)})"
        )
        raise InputError(rule, file=robot.path, key="measurement")
    if stated is None:
        return _of_data(shown, data.has_tangents)
    tangent_rad = stated.tangent_sigma_rad
    if tangent_rad is None and data.has_tangents:
        if not shown:
            raise InputError(NO_TANGENT_SIGMA, file=robot.path, key="measurement.tangent_sigma_deg")
        tangent_rad = max(observed.noise.tangent_rad for observed in shown)
    floor = Noise(stated.position_sigma_m, PAPER.tangent_rad if tangent_rad is None else tangent_rad)
    return _enlarged(floor, shown, data.has_tangents)


def _too_little(data: Measurements) -> str:
    if data.is_stream:
        return "a continuous motion has none, and this one is too short or too uneven in time to show its noise"
    kind = repeats(data)
    return f"these data have {len(kind) - len(np.unique(kind))}"


def _of_data(shown: Sequence[ObservedNoise], has_tangents: bool) -> tuple[Noise, str]:
    """The largest that the data show."""
    noise = Noise(
        max(observed.noise.position_m for observed in shown), max(observed.noise.tangent_rad for observed in shown)
    )
    by = " and ".join(observed.by for observed in shown)
    return noise, f"The robot file states no noise; {by} say {_words(noise, has_tangents)}."


def _enlarged(stated: Noise, shown: Sequence[ObservedNoise], has_tangents: bool) -> tuple[Noise, str]:
    """The stated noise, or what data show where it is clearly more."""
    noise, by = stated, list[str]()
    for observed in shown:
        factors = observed.noise.position_m / stated.position_m, observed.noise.tangent_rad / stated.tangent_rad
        if max(factors[: 1 + has_tangents]) > 1 + observed.doubt:
            tangent_rad = max(noise.tangent_rad, observed.noise.tangent_rad) if has_tangents else noise.tangent_rad
            noise = Noise(max(noise.position_m, observed.noise.position_m), tangent_rad)
            by.append(observed.by)
    if not by:
        return stated, ""
    more = f"{' and '.join(by)} say {_words(noise, has_tangents)}, the file states {_words(stated, has_tangents)}"
    return noise, f"The noise is larger than stated: {more}."


def _words(noise: Noise, has_tangents: bool) -> str:
    tangent = f" and {math.degrees(noise.tangent_rad):.3g} deg" if has_tangents else ""
    return f"{noise.position_m * 1e3:.3g} mm{tangent}"
