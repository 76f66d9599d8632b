"""Distances of measured from predicted tips, and their summary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.prediction import Prediction

RESAMPLES, SEED = 400, 2
SPAN_PERCENT = (2.5, 97.5)


@dataclass(frozen=True)
class Errors:
    """3-D distances [m] over poses; the interval of the rms is from resampled configurations."""

    mean_m: float
    rms_m: float
    p95_m: float
    max_m: float
    rms_ci95_m: tuple[float, float]
    poses: int


def distances(prediction: Prediction, data: Measurements) -> Array:
    """(K,) distance [m] of measured from predicted points; from the base where the prediction is not finite.

    Of a marker seen along an axis it is the distance in the plane across.
    """
    seen = data.given[:, :3]
    measured = np.where(seen, data.position_m, 0.0)
    distance = np.linalg.norm(np.where(seen, prediction.position_m, 0.0) - measured, axis=1)
    wrong: Array = np.where(np.isfinite(distance), distance, np.linalg.norm(measured, axis=1))
    return wrong


def summary(error: Array, group: NDArray[np.int_]) -> Errors:
    """Of distances (K,), configurations (K,) resampled whole."""
    numbers = np.unique(group)
    squares = np.array([np.sum(error[group == number] ** 2) for number in numbers])
    counts = np.array([np.sum(group == number) for number in numbers])
    picks = np.random.default_rng(SEED).integers(0, len(numbers), (RESAMPLES, len(numbers)))
    resampled = np.sqrt(squares[picks].sum(axis=1) / counts[picks].sum(axis=1))
    low, high = np.percentile(resampled, SPAN_PERCENT).tolist()
    rms = float(np.sqrt(np.mean(error**2)))
    return Errors(
        float(error.mean()), rms, float(np.percentile(error, 95)), float(error.max()), (low, high), len(error)
    )
