"""How far tips were off on the poses that the selection saw, solved once before a diagnosis is written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.pose_errors import distances
from ctrplan.calibration.unsolved import excused
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.reports.diagnosis_page.signatures import Signature, signatures


@dataclass(frozen=True, eq=False)
class SelectionErrors:
    """Distances [m] of measured from predicted tips; NaN where one of the models has no solution."""

    calibrated_m: Array  # (K,) without effects
    with_effects_m: Array  # (K,)
    signatures: tuple[Signature, ...]  # of the verdict's effects


def selection_errors(found: Diagnosis) -> SelectionErrors:
    """Predicts every pose of the selection with the calibrated model, with its effects, and without each of them."""
    data = found.base.fit.chain.data
    solved = ~(excused(found.base.failed) | excused(found.chosen.failed))
    fits = (found.base.fit, found.chosen.fit)
    predictions = (fit.chain.predict(fit.p, derivatives=False) for fit in fits)
    before, after = (np.where(solved, distances(prediction, data), np.nan) for prediction in predictions)
    return SelectionErrors(before, after, signatures(found))
