"""The discrepancy: its whitening, its size and memory found again, and none found in noise."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import Discrepancy, Linearised, decay, of_configurations, of_motion

TIME_S = 0.5 * np.arange(240)
RUN = np.zeros(240, dtype=int)
NOTHING = np.zeros((240, 5, 1))


def drawn(correlation: Array, size: float, seed: int) -> Array:
    """(K, 5) white noise and a discrepancy of some correlation (K, K)."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(correlation + 1e-9 * np.eye(len(correlation)))
    return np.asarray(rng.standard_normal((len(root), 5)) + size * root @ rng.standard_normal((len(root), 5)))


def estimate(r: Array) -> Discrepancy:
    return of_motion(Linearised(r, NOTHING, np.ones(1)), TIME_S, RUN, 120.0)


@pytest.mark.parametrize("memory_s", [1.0, 8.0])
def test_size_and_memory_are_found_again(memory_s: float) -> None:
    found = estimate(drawn(decay(TIME_S, memory_s), 4.0, seed=1))
    assert 2.8 < found.position < 5.7 and 2.8 < found.tangent < 5.7
    assert memory_s / 2.5 < found.memory < 2.5 * memory_s


def test_errors_of_millimetres_are_found_beside_a_tracker_of_micrometres() -> None:
    found = estimate(drawn(decay(TIME_S, 8.0), 400.0, seed=6))
    assert 280 < found.position < 570


def test_noise_has_none() -> None:
    found = estimate(drawn(np.eye(240), 0.0, seed=2))
    assert max(found.position, found.tangent) < 0.4


def test_what_is_not_there_has_no_memory_that_rounding_would_choose() -> None:
    """Residuals too small for noise: every share that approaches may have in common is as probable."""
    configuration, rng = np.repeat(np.arange(12), 5), np.random.default_rng(1)
    for _ in range(20):
        J = 10.0 ** rng.uniform(-3, 6, 4) * rng.standard_normal((60, 5, 4))
        found = of_configurations(Linearised(0.3 * rng.standard_normal((60, 5)), J, np.ones(4)), configuration)
        assert not found.is_there and found.memory == 0.0


def test_whitening_makes_residuals_white_and_can_be_undone() -> None:
    correlation = decay(TIME_S, 5.0)
    found = estimate(drawn(correlation, 4.0, seed=3))
    many = np.stack([drawn(correlation, 4.0, seed) for seed in range(200)], axis=2)
    whitened = found.whitened(many)
    np.testing.assert_allclose(found.coloured(whitened), many, atol=1e-9)
    spread = np.einsum("kcd,jcd->kj", whitened, whitened) / (5 * 200)
    assert abs(np.diag(spread).mean() - 1) < 0.35
    neighbours = np.diag(spread, 1).mean() / np.diag(spread).mean()
    assert abs(neighbours) < 0.15 < 0.8 < np.einsum("kcd,kcd->", many[1:], many[:-1]) / np.sum(many[1:] ** 2)


def test_a_parameter_of_the_model_is_no_discrepancy() -> None:
    """What a free parameter explains is not counted twice."""
    rng = np.random.default_rng(4)
    slow = np.cos(TIME_S / 15)[:, None, None] * np.ones((1, 5, 1))
    r = rng.standard_normal((240, 5)) + 6 * slow[:, :, 0]
    with_it = of_motion(Linearised(r, slow, np.array([1e-2])), TIME_S, RUN, 120.0)
    assert with_it.position < 0.4 and estimate(r).position > 2.0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_share_of_the_configuration_is_found_again(share: float) -> None:
    configuration = np.repeat(np.arange(30), 5)
    correlation = np.where(configuration[:, None] == configuration[None], share, 0.0)
    np.fill_diagonal(correlation, 1.0)
    r = drawn(correlation, 3.0, seed=5)
    found = of_configurations(Linearised(r, np.zeros((150, 5, 1)), np.ones(1)), configuration)
    assert found.memory == pytest.approx(share, abs=0.21) and 2.0 < found.position < 4.5
