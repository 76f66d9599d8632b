"""The mixed model agrees with its dense Gaussian formulation, and its evidence obeys the laws of probability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.mixed_model import NOISE_SPREAD, Kernel, Loaded, MixedModel, Sizes

K, P = 9, 3


def model_of(seed: int, *, missing: bool = True) -> tuple[MixedModel, Array, Array, Sizes]:
    rng = np.random.default_rng(seed)
    given = np.ones((K, 5), bool)
    if missing:
        given[2, 3:] = given[4, 2] = given[5] = False
    x = rng.normal(size=(K, 2))
    near = np.exp(-((x[:, None] - x) ** 2).sum(axis=2) / 2)
    pairs = (np.arange(K)[:, None] // 3 == np.arange(K) // 3).astype(float)
    kernels = [
        Kernel("near", "position", near),
        Kernel("near too", "tangent", near),
        Kernel("pairs", "position", pairs),
    ]
    loaded = [Loaded("a", rng.normal(size=(K, 5, 2))), Loaded("b", rng.normal(size=(K, 5, 1)))]
    model = MixedModel(given, (0.01 * pairs, 0.02 * pairs), kernels, loaded)
    y, J = rng.normal(size=(K, 5)) * 2, rng.normal(size=(K, 5, P))
    sizes = Sizes(np.array([0.7, 0.0, 0.3]), np.array([0.2, 0.5]), np.array([0.1, -0.2]))
    return model, y, J, sizes


def dense(model: MixedModel, J: Array, sizes: Sizes) -> Array:
    """The covariance (N, N) of what was given, poses after poses."""
    n = len(model.given)
    V = np.zeros((n, 5, n, 5))
    for c in range(5):
        kind = "position" if c < 3 else "tangent"
        part = model.shared[c >= 3] + (1 + sizes.noise[int(c >= 3)]) * np.eye(n)
        for size, kernel in zip(sizes.kernels, model.kernels, strict=True):
            part = part + size * kernel.matrix * (kernel.kind == kind)
        V[:, c, :, c] = part
    for size, part in zip(sizes.loaded, model.loaded, strict=True):
        V += size * np.einsum("kcr,ldr->kcld", part.columns, part.columns)
    V += np.einsum("kcp,ldp->kcld", J, J)
    there = model.given.ravel()
    return V.reshape(5 * n, 5 * n)[np.ix_(there, there)]


def prior(sizes: Sizes) -> float:
    parts = np.concatenate([sizes.kernels, sizes.loaded])
    ratio = np.log1p(sizes.noise) / NOISE_SPREAD
    return float(-np.log1p(parts).sum() - np.where(ratio > 0, np.log1p(ratio**2), ratio**2).sum())


@pytest.mark.parametrize("missing", [True, False])
def test_the_evidence_is_that_of_the_dense_gaussian(missing: bool) -> None:
    model, y, J, sizes = model_of(3, missing=missing)
    V, numbers = dense(model, J, sizes), y[model.given]
    density = -0.5 * (numbers @ np.linalg.solve(V, numbers) + np.linalg.slogdet(2 * np.pi * V)[1])
    assert model.posterior(y, J, sizes, steps=0).evidence == pytest.approx(density + prior(sizes), abs=1e-8)


def test_parameters_are_those_of_generalised_least_squares() -> None:
    model, y, J, sizes = model_of(4)
    V = dense(model, np.zeros((K, 5, 0)), sizes)
    design, numbers = J[model.given], y[model.given]
    precision = design.T @ np.linalg.solve(V, design) + np.eye(P)
    result = model.posterior(y, J, sizes, steps=0)
    np.testing.assert_allclose(result.precision, precision, rtol=1e-9)
    np.testing.assert_allclose(
        result.parameters, np.linalg.solve(precision, design.T @ np.linalg.solve(V, numbers)), rtol=1e-8
    )


def test_away_from_the_mode_the_evidence_is_that_of_laplace() -> None:
    """The density at given parameters times the volume of the posterior."""
    model, y, J, sizes = model_of(5)
    p = np.array([0.4, -1.0, 0.2])
    V, left = dense(model, np.zeros((K, 5, 0)), sizes), (y - J @ p)[model.given]
    joint = -0.5 * (left @ np.linalg.solve(V, left) + np.linalg.slogdet(2 * np.pi * V)[1] + p @ p)
    result = model.posterior(y, J, sizes, steps=0)
    laplace = joint - 0.5 * np.linalg.slogdet(result.precision)[1]
    assert result.at(p) == pytest.approx(laplace + prior(sizes), abs=1e-8)


def test_the_gradient_by_sizes_is_that_of_the_evidence() -> None:
    model, y, J, sizes = model_of(6)
    gradient = model.posterior(y, J, sizes, steps=1).gradient
    vector, h, m = sizes.vector, 1e-5, len(model.kernels)
    for k in range(len(vector)):
        ends = []
        for step in (h, -h) if vector[k] > 0 or k >= len(vector) - 2 else (h, 0.0):
            moved = vector.copy()
            moved[k] += step
            ends.append(model.posterior(y, J, Sizes(moved[:m], moved[m:-2], moved[-2:]), steps=0).evidence)
        width = 2 * h if vector[k] > 0 or k >= len(vector) - 2 else h
        assert gradient[k] == pytest.approx((ends[0] - ends[1]) / width, rel=1e-3, abs=1e-3)


def test_sizes_that_are_found_are_a_maximum() -> None:
    model, y, J, sizes = model_of(7)
    found = model.posterior(y, J, sizes, steps=60)
    for k in range(len(found.sizes.vector)):
        for factor in (0.7, 1.4):
            moved, m = found.sizes.vector.copy(), len(model.kernels)
            moved[k] = factor * (1 + moved[k]) - 1 if k >= len(moved) - 2 else factor * max(moved[k], 0.01)
            there = Sizes(moved[:m], moved[m:-2], np.maximum(moved[-2:], -0.89))
            assert model.posterior(y, J, there, steps=0).evidence < found.evidence + 0.06


def test_the_order_of_poses_is_of_no_matter() -> None:
    model, y, J, sizes = model_of(8)
    order = np.random.default_rng(1).permutation(K)
    square = np.ix_(order, order)
    kernels = [replace(k, matrix=k.matrix[square]) for k in model.kernels]
    loaded = [replace(part, columns=part.columns[order]) for part in model.loaded]
    moved = MixedModel(model.given[order], tuple(s[square] for s in model.shared), kernels, loaded)  # type: ignore[arg-type]
    here, there = model.posterior(y, J, sizes), moved.posterior(y[order], J[order], sizes)
    assert there.evidence == pytest.approx(here.evidence, abs=1e-6)
    np.testing.assert_allclose(there.parameters, here.parameters, atol=1e-6)


def test_evidence_of_data_in_two_parts_is_the_product_of_what_each_says() -> None:
    """p(a, b) = p(a) p(b | a): leaving numbers out is a marginal of the same model."""
    model, y, J, sizes = model_of(9, missing=False)
    V, numbers = dense(model, J, sizes), y.ravel()
    first = np.zeros((K, 5), bool)
    first[: K // 2] = True
    less = MixedModel(first, model.shared, model.kernels, model.loaded)
    a = first.ravel()
    gain = V[np.ix_(~a, a)] @ np.linalg.inv(V[np.ix_(a, a)])
    left, cov = numbers[~a] - gain @ numbers[a], V[np.ix_(~a, ~a)] - gain @ V[np.ix_(a, ~a)]
    conditional = -0.5 * (left @ np.linalg.solve(cov, left) + np.linalg.slogdet(2 * np.pi * cov)[1])
    whole = model.posterior(y, J, sizes, steps=0).evidence
    assert whole == pytest.approx(less.posterior(y, J, sizes, steps=0).evidence + conditional, abs=1e-7)


def test_parts_and_parameters_add_up_to_the_residual() -> None:
    model, y, J, sizes = model_of(10)
    parts = model.explained(y, J, sizes)
    u = model.posterior(y, J, sizes, steps=0).parameters
    V = dense(model, np.zeros((K, 5, 0)), sizes)
    left = np.linalg.solve(V, (y - J @ u)[model.given])
    noise = np.zeros((K, 5))
    noise[model.given] = left
    for c in range(5):
        noise[:, c] = (model.shared[c >= 3] + (1 + sizes.noise[int(c >= 3)]) * np.eye(K)) @ noise[:, c]
    total = sum(parts.values()) + J @ u + noise
    np.testing.assert_allclose(total[model.given], y[model.given], atol=1e-9)


def test_numbers_left_out_are_predicted_with_their_deviation() -> None:
    model, y, J, sizes = model_of(11)
    V = dense(model, J, sizes)
    inverse, numbers = np.linalg.inv(V), y[model.given]
    expected = inverse @ numbers / np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(model.standardised(y, J, sizes)[model.given], expected, atol=1e-8)
