"""Residuals left out in closed form, thresholds, adequacy: on linear problems with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import PER_POSE, Noise, Residuals
from ctrplan.diagnosis.adequacy import ChiSquare, adequacy, left_out_probability, outliers, rescaled_noise
from ctrplan.diagnosis.linear_fit import Linear, left_out_residuals

POSES, GROUPS = 120, 24
GROUP = np.repeat(np.arange(GROUPS), POSES // GROUPS)


def problem(parameters: int, seed: int, r: Array | None = None) -> Linear:
    rng = np.random.default_rng(seed)
    J = rng.standard_normal((POSES, PER_POSE, parameters)) * np.logspace(-3, 3, parameters)
    r = rng.standard_normal((POSES, PER_POSE)) if r is None else r
    return Linear(r, J, np.ones(POSES), np.full(parameters, 1e-12), np.zeros(parameters), np.ones((POSES, 5), bool))


def test_leaving_a_group_out_is_the_refit_without_it() -> None:
    fit = problem(4, 0).refitted()
    left = left_out_residuals(fit, GROUP)
    for group in range(GROUPS):
        inside = group == GROUP
        J, r = fit.J.reshape(-1, 4), fit.r.ravel()
        rows = np.repeat(inside, PER_POSE)
        step = np.linalg.lstsq(J[~rows] / np.logspace(-3, 3, 4), r[~rows], rcond=None)[0] / np.logspace(-3, 3, 4)
        np.testing.assert_allclose(left[inside].ravel(), r[rows] - J[rows] @ step, rtol=1e-6, atol=1e-9)


def test_a_step_leaves_residuals_across_the_columns() -> None:
    fit = problem(3, 1).refitted()
    gradient = np.einsum("kcp,kc->p", fit.J, fit.r) / np.logspace(-3, 3, 3)
    np.testing.assert_allclose(gradient, 0, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_adequate_and_structure_is_not(seed: int) -> None:
    nothing = np.zeros(POSES, bool)
    clean = problem(6, seed).refitted()
    left = adequacy(clean, GROUP, nothing)
    assert min(left.total.p, left.between.p, left.within.p) > 1e-3
    assert left.total.dof == pytest.approx(POSES * PER_POSE - 6, abs=1e-6)
    rng = np.random.default_rng(seed)
    shared = 0.8 * rng.standard_normal((GROUPS, PER_POSE))[GROUP]
    spoilt = adequacy(problem(6, seed, rng.standard_normal((POSES, PER_POSE)) + shared).refitted(), GROUP, nothing)
    assert max(spoilt.total.p, spoilt.between.p) < 1e-3 < spoilt.within.p
    assert (
        rescaled_noise(spoilt, Noise(1e-3, 1e-2), np.full(POSES, 2.0), np.full(POSES, PER_POSE))[0] is None
    )  # structure is never taken for larger noise


def test_noise_of_another_size_is_recognised() -> None:
    rng = np.random.default_rng(7)
    r = rng.standard_normal((POSES, PER_POSE)) * [1.6, 1.6, 1.6, 1.0, 1.0]
    left = adequacy(problem(4, 7, r).refitted(), GROUP, np.zeros(POSES, bool))
    found, sentence = rescaled_noise(left, Noise(0.4e-3, 0.01), np.linalg.norm(r, axis=1), np.full(POSES, PER_POSE))
    assert found is not None and "not as stated" in sentence
    assert found.position_m == pytest.approx(1.6 * 0.4e-3, rel=0.08)
    assert found.tangent_rad == pytest.approx(0.01, rel=0.1)


def test_a_small_middle_with_heavy_tails_is_noise_of_the_stated_size() -> None:
    rng = np.random.default_rng(8)
    stated = Noise(0.4e-3, 0.01)
    for scale in (0.6 * np.ones(POSES), np.sqrt(1 / rng.chisquare(3, POSES))):
        r = rng.standard_normal((POSES, PER_POSE)) * scale[:, None]
        far = np.linalg.norm(r, axis=1) > 5.6
        left = adequacy(problem(4, 8, r).refitted(), GROUP, far)
        assert left.total.ratio < 0.8
        found, sentence = rescaled_noise(left, stated, np.linalg.norm(r[~far], axis=1), np.full((~far).sum(), PER_POSE))
        assert (found is None) == bool(np.ptp(scale)) and ("tails" in sentence) == bool(np.ptp(scale))


def test_few_far_poses_are_outliers_and_many_are_a_misfit() -> None:
    norm = np.full(100, 2.0)
    norm[:2] = 9.0
    assert outliers(norm).sum() == 2
    norm[:20] = 9.0
    assert outliers(norm).sum() == 0
    norm[1:] = 2.0
    assert outliers(norm[:20]).sum() == 1  # one far pose is one in a small set, too


@pytest.mark.parametrize("estimated", [False, True])
@pytest.mark.parametrize(("freedom", "most"), [(1e6, 0.03), (8.0, 0.05), (4.0, 0.09)])
def test_a_vault_like_the_selection_agrees_with_it_whatever_the_tails(
    freedom: float, most: float, estimated: bool
) -> None:
    rng, alarms, missed, believing_in_gauss = np.random.default_rng(4), 0, 0, 0
    for _ in range(400):
        scale = np.sqrt((freedom - 2) / rng.chisquare(freedom, 80))  # of Student's t, standard deviation 1
        square = ((rng.standard_normal((80, 5)) * scale[:, None]) ** 2).sum(axis=1)
        left, held_out_set = ChiSquare(float(square[:60].sum()), 300.0), float(square[60:].sum())
        size = left.ratio if estimated else 1.0  # the noise as the selection shows it, or as stated
        norm = np.sqrt(square[:60] / size)
        parts = Residuals(np.zeros((60, 5)), np.zeros((60, 5, 0)), np.ones(60), norm, np.ones((60, 5), bool))
        parts.r[:, 0] = norm
        left = ChiSquare(left.value / size, 300.0)
        chances = [
            left_out_probability(ChiSquare(factor * held_out_set / size, 100.0), left, parts, estimated=estimated)
            for factor in (1.0, 6.25)
        ]
        alarms, missed = alarms + (chances[0] < 0.01), missed + (chances[1] > 0.01)
        believing_in_gauss += ChiSquare(held_out_set / size, 100.0).p < 0.01
    assert alarms / 400 <= most and (freedom > 5 or alarms < 0.7 * believing_in_gauss)
    assert missed / 400 < 0.15  # errors 2.5 times as large do not agree
