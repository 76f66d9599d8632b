"""Surrogates keep the spectrum and the sizes of a residual, and nothing else of it."""

from __future__ import annotations

import numpy as np

from ctrplan.diagnosis import surrogates


def test_of_a_motion_keep_the_spectrum_and_lose_the_phases() -> None:
    rng = np.random.default_rng(0)
    r = np.cumsum(rng.standard_normal((200, 5)), axis=0)
    r -= r.mean(axis=0)
    drawn = surrogates.of_motion(r, np.zeros(200, dtype=int), 50)
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
    drawn = surrogates.of_configurations(r, configuration, 100)
    within = drawn.reshape(20, 5, 5, 100).std(axis=1)
    assert 0.05 < within.mean() < 0.2 and 0.7 < np.mean(drawn**2) / np.mean(r**2) < 1.3
    assert abs(np.einsum("kc,kcd->d", r, drawn).mean() / np.sum(r**2)) < 0.1
