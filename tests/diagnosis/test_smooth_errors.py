"""Smooth errors of poses: what they say of tangents, of numbers that are missing, of the time, and of densities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import pair_robot, waypoints
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised, Spectrum, highest_of, log_means
from ctrplan.calibration.residuals import Noise, compared, residuals
from ctrplan.diagnosis.unknown_errors import SmoothError, at_rest, of_motion
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import SensorPrediction

ROBOT, COUNT = pair_robot(), 9
RNG = np.random.default_rng(4)
TANGENT = Rotation.random(COUNT, rng=RNG).apply([0.0, 0.0, 1.0])
PRECISION = np.array([1.0, 0.2])


def logged(tangent: Array = TANGENT, position_m: Array | None = None) -> Measurements:
    plan = waypoints(ROBOT, COUNT, seed=2)
    return replace(
        plan,
        theta_commanded=plan.theta_commanded[:COUNT],
        l_commanded=plan.l_commanded[:COUNT],
        sequence=np.zeros(COUNT, dtype=int),
        rows=np.arange(COUNT),
        time_s=0.5 * np.arange(COUNT),
        is_stream=True,
        position_m=np.zeros((COUNT, 3)) if position_m is None else position_m,
        tangent=tangent,
    )


def axes_of(data: Measurements) -> Array:
    return np.cross(TANGENT[:, None], compared(TANGENT, data.tangent)[1])


def fit_of(data: Measurements) -> Linearised:
    r, J = RNG.standard_normal((COUNT, 5)), RNG.standard_normal((COUNT, 5, 2))
    return Linearised(r * data.given, J * data.given[:, :, None], PRECISION)


def test_a_small_rotation_of_the_tracker_is_the_same_number_about_the_axes_of_every_tangent() -> None:
    """Residuals of a small rotation are its components along the axes."""
    turn = 1e-4 * np.array([0.7, -1.1, 0.4])
    data = logged(Rotation.from_rotvec(turn).apply(TANGENT))
    sound, none = np.ones(COUNT, bool), np.zeros((COUNT, 3, 0))
    predicted = SensorPrediction(np.zeros((COUNT, 3)), TANGENT, sound, ~sound, none, none)
    found = residuals(data, predicted, Noise(1.0, 1.0), np.arange(COUNT))
    assert found.r[:, 3:] == pytest.approx(axes_of(data) @ turn, abs=1e-8)


@pytest.mark.parametrize("number", range(17))
def test_the_evidence_is_the_density_with_the_error_in_the_covariance(number: int) -> None:
    data = logged()
    error, fit = of_motion(data, axes_of(data))[number], fit_of(data)
    spectrum, dense = error.spectrum(fit), []
    pairs = [(9, 4), (3, 12)]
    for pair in pairs:
        dense.append(log_density(fit, data, dense_correlation(data, number), *sizes_of(spectrum, *pair)))
    found = [float(spectrum.evidences(*pair)) / 2 for pair in pairs]
    assert found[0] - found[1] == pytest.approx(dense[0] - dense[1], rel=1e-9)


@pytest.mark.parametrize("scale", [0.5, 5.0, 500.0])
@pytest.mark.parametrize("number", [0, 8, 14])
def test_the_search_over_sizes_finds_the_highest_evidence_and_lines_through_it_leave_nothing_out(
    number: int, scale: float
) -> None:
    data = logged()
    error, fit = of_motion(data, axes_of(data))[number], fit_of(data)
    fit = replace(fit, r=scale * fit.r)
    every, spectrum = error.spectrum(fit), error.spectrum(fit)
    grid = np.array([every.evidences(p, slice(None)) for p in range(len(every.position.size))])
    highest, position, tangent = spectrum.highest()
    p, t = np.unravel_index(int(grid.argmax()), grid.shape)
    assert highest == pytest.approx(grid.max(), abs=1e-9)
    assert (position, tangent) == sizes_of(spectrum, int(p), int(t))
    means = sum(logsumexp(line / 2) - np.log(len(line)) for line in (grid[:, t], grid[p]))
    assert log_means([spectrum], [(highest, position, tangent)])[0] / 2 == pytest.approx(means - highest / 2, abs=1e-9)
    assert spectrum.of_residuals(fit.r, error.position, error.tangent).highest() == (highest, position, tangent)


def test_kinds_of_errors_are_searched_together_as_each_alone() -> None:
    data = logged()
    fit, errors = fit_of(data), of_motion(data, axes_of(data))
    alone = [error.spectrum(fit) for error in errors]
    peaks = [spectrum.highest() for spectrum in alone]
    means = [log_means([spectrum], [peak])[0] for spectrum, peak in zip(alone, peaks, strict=True)]
    together = [error.spectrum(fit) for error in errors]
    together.append(errors[0].spectrum(fit).of([0]))  # of one parameter less
    found = highest_of(together)
    np.testing.assert_allclose(found[:-1], peaks, rtol=1e-9)
    np.testing.assert_allclose(log_means(together[:-1], found[:-1]), means, rtol=1e-9)
    assert found[-1] == pytest.approx(together[-1].of([0]).highest(), rel=1e-9)


def sizes_of(spectrum: Spectrum, position: int, tangent: int) -> tuple[float, float]:
    return float(spectrum.position.size[position]), float(spectrum.tangent.size[tangent])


@pytest.mark.parametrize("number", range(15))
def test_so_it_is_of_poses_at_rest(number: int) -> None:
    """Configurations alone, eight that go along with the joints, six with the time; approaches share a part."""
    late = 0.5 * np.arange(COUNT) + np.where(np.arange(COUNT) < COUNT - 1, 0.0, 36.0)  # 40 s, half a second a step
    data = replace(logged(), is_stream=False, time_s=late, sequence=np.repeat([0, 1, 2, 3, 4], [2, 2, 2, 2, 1]))
    theta, slides = data.theta_commanded.copy(), data.l_commanded.copy()
    theta[1:8:2], slides[1:8:2] = theta[:8:2], slides[:8:2]
    data = replace(data, theta_commanded=theta, l_commanded=slides)
    assert len(np.unique(data.configuration)) == 5
    error, fit, share = at_rest(data, 0.7, axes_of(data))[number], fit_of(data), 0.7
    one = data.configuration[:, None] == data.configuration
    if number == 0:
        correlation = share * one + (1 - share) * np.eye(COUNT)
    elif number < 9:
        q, length = [(q, length) for q in (0.7, 1.0) for length in (0.6, 1.0, 1.5, 2.5)][number - 1]
        smooth = np.exp(-0.5 * square_distances_of(data) / length**2)
        correlation = share * ((1 - q) * one + q * smooth) + (1 - share) * np.eye(COUNT)
    else:
        assert data.time_s is not None
        apart = data.time_s[:, None] - data.time_s
        correlation = np.exp(-0.5 * (apart / np.geomspace(2.0, 20.0, 6)[number - 9]) ** 2)
    spectrum = error.spectrum(fit)
    pairs = [(9, 4), (3, 12)]
    found = [float(spectrum.evidences(*pair)) / 2 for pair in pairs]
    dense = [log_density(fit, data, correlation, *sizes_of(spectrum, *pair)) for pair in pairs]
    assert found[0] - found[1] == pytest.approx(dense[0] - dense[1], rel=1e-9)


@pytest.mark.parametrize("what", ["a coordinate", "a component of the tangent", "tangents", "some of each"])
def test_what_was_not_measured_does_not_count(what: str) -> None:
    position, tangent = np.zeros((COUNT, 3)), TANGENT.copy()
    if what == "a coordinate":
        position[:, 1] = np.nan
    elif what == "a component of the tangent":
        tangent[:, 2] = np.nan
    elif what == "tangents":
        tangent[:] = np.nan
    else:
        position[[1, 4], 0], tangent[[2, 4]], tangent[7, 0] = np.nan, np.nan, np.nan
    data = logged(tangent, position)
    errors, fit = of_motion(data, axes_of(data)), fit_of(data)
    for number in (1, 8, 14):
        spectrum = errors[number].spectrum(fit)
        pairs = [(9, min(4, len(spectrum.tangent.size) - 1)), (3, 0)]
        found = [float(spectrum.evidences(*pair)) / 2 for pair in pairs]
        correlation = dense_correlation(data, number)
        dense = [log_density(fit, data, correlation, *sizes_of(spectrum, *pair)) for pair in pairs]
        assert found[0] - found[1] == pytest.approx(dense[0] - dense[1], rel=1e-9)


def log_density(fit: Linearised, data: Measurements, correlation: Array, position: float, tangent: float) -> float:
    """Log density of the measured numbers, with the covariance of every pair written out."""
    axes = axes_of(data)
    covariance = np.eye(5 * COUNT)
    for i in range(COUNT):
        for j in range(COUNT):
            block = np.zeros((5, 5))
            block[:3, :3] = position**2 * correlation[i, j] * np.eye(3)
            block[3:, 3:] = tangent**2 * correlation[i, j] * axes[i] @ axes[j].T
            covariance[5 * i : 5 * i + 5, 5 * j : 5 * j + 5] += block
    J, kept = fit.J.reshape(-1, 2), data.given.ravel()
    covariance += J @ np.diag(1 / PRECISION) @ J.T
    return float(multivariate_normal.logpdf(fit.r.ravel()[kept], cov=covariance[np.ix_(kept, kept)]))


def dense_correlation(data: Measurements, number: int) -> Array:
    """(K, K) six that are forgotten, six smooth in time, five smooth in the joints; 9 poses half a second apart."""
    assert data.time_s is not None
    apart = np.abs(data.time_s[:, None] - data.time_s)
    if number < 6:
        return np.exp(-apart / np.geomspace(0.5, 2.0, 6)[number])
    if number < 12:
        return np.exp(-0.5 * (apart / np.geomspace(2.0, 8.0, 6)[number - 6]) ** 2)
    return np.exp(-0.5 * square_distances_of(data) / (0.3, 0.6, 1.0, 1.5, 2.5)[number - 12] ** 2)


def square_distances_of(data: Measurements) -> Array:
    """(K, K) [rad^2] a chord for a rotation, 50 mm count as a radian."""
    theta, slides = data.theta_commanded, data.l_commanded / 0.05
    turn = theta - np.column_stack([np.zeros(COUNT), theta[:, :-1]])
    square = sum(2 - 2 * np.cos(turn[:, None, k] - turn[None, :, k]) for k in range(theta.shape[1]))
    square += ((slides[:, None] - slides) ** 2).sum(axis=2)
    return np.asarray(square)


def test_errors_of_different_runs_go_along_with_the_joints_alone() -> None:
    data = replace(logged(), sequence=np.repeat([0, 1], [4, 5]))
    errors = of_motion(data, axes_of(data))
    apart = [_between(error, 4) for error in errors]
    assert max(apart[:12]) < 1e-12 < min(apart[14:])


def _between(error: SmoothError, first: int) -> float:
    """The largest correlation of positions of one run with those of the other."""
    ((_, block),) = error.position
    correlation = (block.vectors * block.values) @ block.vectors.T
    return float(np.abs(correlation[:first, first:]).max())


def test_errors_are_the_same_whatever_the_clock_counts_in() -> None:
    """A log without times counts its rows, and a long one has poses that are far apart."""
    data = logged()
    assert data.time_s is not None
    for other in (replace(data, time_s=60 * data.time_s), replace(data, time_s=None)):
        for one, same in zip(of_motion(data, axes_of(data)), of_motion(other, axes_of(data)), strict=True):
            assert _between(one, 4) == pytest.approx(_between(same, 4), rel=1e-9)
