"""Rows drawn for the keys that have a distribution: at random, or as Sobol' and Morris plan a sensitivity analysis."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.study_entries import DrawsEntry, VaryEntry

EXTRA = "pip install 'ctrplan[study]'"
LEVELS = 4  # of Morris' grid


def drawn(varied: Sequence[VaryEntry], draws: DrawsEntry) -> Array:
    """(K, keys) in the units of the keys. Raises InputError without SALib for the two plans."""
    if draws.method == "random":
        share = np.random.default_rng(draws.seed).random((draws.count, len(varied)))
        return np.column_stack([_quantile(vary, share[:, k]) for k, vary in enumerate(varied)])
    check_salib(draws.method)
    for vary in varied:
        if draws.method == "morris" and vary.distribution in ("normal", "lognormal"):
            rule = f"{vary.distribution} has no ends, which the levels of morris need: uniform or triangular"
            raise InputError(rule, key=vary.key)
    rows: Array
    if draws.method == "sobol":
        from SALib.sample import sobol

        rows = sobol.sample(problem(varied), draws.count, calc_second_order=False, seed=draws.seed)
    else:
        from SALib.sample import morris

        rows = morris.sample(problem(varied), draws.count, num_levels=LEVELS, seed=draws.seed)
    return rows


def problem(varied: Sequence[VaryEntry]) -> dict[str, Any]:
    """What SALib calls the problem."""
    kinds = {"uniform": "unif", "normal": "norm", "lognormal": "lognorm", "triangular": "triang"}
    return {
        "num_vars": len(varied),
        "names": [vary.key for vary in varied],
        "bounds": [_bounds(vary) for vary in varied],
        "dists": [kinds[vary.distribution or ""] for vary in varied],
    }


def check_salib(method: str) -> None:
    """Raises InputError without SALib."""
    if find_spec("SALib") is None:
        raise InputError(f"needs SALib: {EXTRA}", key="draws.method", value=method)


def _bounds(vary: VaryEntry) -> list[float]:
    """Parameters of a distribution as SALib takes them; a lognormal's mean and sigma are of the logarithm."""
    if vary.distribution in ("normal", "lognormal"):
        return [vary.mean or 0.0, vary.sigma or 1.0]
    low, high = vary.low or 0.0, vary.high or 0.0
    if vary.distribution == "uniform":
        return [low, high]
    return [low, high, ((vary.mode or 0.0) - low) / (high - low)]


def _quantile(vary: VaryEntry, share: Array) -> Array:
    """Values below which shares (K,) of a distribution lie."""
    from scipy import stats

    low, high = vary.low or 0.0, vary.high or 0.0
    if vary.distribution == "uniform":
        return np.asarray(low + (high - low) * share)
    if vary.distribution == "triangular":
        return np.asarray(stats.triang.ppf(share, ((vary.mode or 0.0) - low) / (high - low), low, high - low))
    normal = np.asarray(stats.norm.ppf(share, vary.mean or 0.0, vary.sigma or 1.0))
    return np.exp(normal) if vary.distribution == "lognormal" else normal
