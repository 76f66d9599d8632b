"""Surrogates keep the spectrum and the sizes of a residual, and nothing else of it."""

from __future__ import annotations

import numpy as np
from measured_data import pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Linearised, of_configurations
from ctrplan.diagnosis import correlated_bench
from ctrplan.diagnosis.remainder import joint_memory


def test_of_a_motion_keep_the_spectrum_and_lose_the_phases() -> None:
    rng = np.random.default_rng(0)
    r = np.cumsum(rng.standard_normal((200, 5)), axis=0)
    r -= r.mean(axis=0)
    drawn = correlated_bench.of_motion(r, np.zeros(200, dtype=int), 50)
    spectrum = np.abs(np.fft.rfft(r, axis=0))
    np.testing.assert_allclose(
        np.abs(np.fft.rfft(drawn, axis=0))[1:-1], spectrum[1:-1, :, None].repeat(50, 2), rtol=1e-6
    )
    alike = np.einsum("kc,kcd->d", r, drawn) / np.sum(r**2)
    assert abs(alike.mean()) < 0.2 and np.abs(alike).max() < 0.95
    crossed = np.einsum("kid,kjd->dij", drawn, drawn) - (r.T @ r)[None]  # all numbers of a pose by the same phases
    assert np.abs(crossed).max() < 0.05 * np.abs(r.T @ r).max()


def test_of_configurations_keep_what_approaches_share() -> None:
    rng = np.random.default_rng(1)
    configuration = np.repeat(np.arange(20), 5)
    r = np.repeat(rng.standard_normal((20, 5)), 5, axis=0) + 0.1 * rng.standard_normal((100, 5))
    drawn = correlated_bench.of_configurations(r, configuration, 100)
    within = drawn.reshape(20, 5, 5, 100).std(axis=1)
    assert 0.05 < within.mean() < 0.2 and 0.7 < np.mean(drawn**2) / np.mean(r**2) < 1.3
    assert abs(np.einsum("kc,kcd->d", r, drawn).mean() / np.sum(r**2)) < 0.1


def test_of_configurations_are_as_smooth_in_the_joints_as_what_remains() -> None:
    rng = np.random.default_rng(2)
    plan = waypoints(pair_robot(), 24, seed=2)
    turn = np.diff(plan.theta_commanded[plan.rows], axis=1)
    smooth = np.hstack([np.sin(turn), np.cos(turn), np.sin(turn), np.cos(turn), np.sin(turn)]) * 5
    own = 5 * rng.standard_normal((int(plan.configuration.max()) + 1, 5))[plan.configuration]
    for r, is_smooth in ((smooth, True), (own, False)):
        left = alone(r + rng.standard_normal(r.shape))
        rest = of_configurations(left, plan.configuration)
        memory = joint_memory(left, plan, rest)
        assert (memory.smooth > 0.5) == is_smooth
        for drawn in (correlated_bench.of_configurations(left.r, plan.configuration, 60, memory), smooth[:, :, None]):
            near = roughness(drawn, turn[:, 0], plan.configuration)
            assert (near < 0.7) if is_smooth or drawn.shape[2] == 1 else (near > 0.85)


def alone(r: Array) -> Linearised:
    """Residuals (K, 5) that no parameter changes."""
    return Linearised(r, np.zeros((*r.shape, 1)), np.ones(1))


def roughness(r: Array, turn: Array, configuration: Array) -> float:
    """Squared differences of configurations that are next to each other in their turn, over those of all."""
    first = np.unique(configuration, return_index=True)[1]
    means = np.array([r[configuration == number].mean(axis=0) for number in np.unique(configuration)])
    ordered = means[np.argsort(np.mod(turn[first], 2 * np.pi))]
    return float(np.mean(np.diff(ordered, axis=0) ** 2) / (2 * np.var(ordered, axis=0).mean()))


def test_what_a_memory_takes_out_it_puts_back() -> None:
    plan = waypoints(pair_robot(), 12)
    left = alone(3 * np.random.default_rng(3).standard_normal((plan.count, 5)))
    memory = joint_memory(left, plan, of_configurations(left, plan.configuration))
    means = np.random.default_rng(4).standard_normal((12, 5))
    np.testing.assert_allclose(memory.coloured(memory.whitened(means)), means, atol=1e-9)
