"""The one rule between a verdict's words and its figures: no verdict is greener than the numbers written beside it."""

from __future__ import annotations

import math

from ctrplan.calibration.residuals import MODEL_POSITION_M
from ctrplan.diagnosis.gap import Gap
from ctrplan.diagnosis.localise import Place
from ctrplan.diagnosis.verdict import Verdict

LARGEST_REST = 1.5  # of the noise: rms error with which a model still agrees with measurements
LEAST_TOLD = 0.2  # of the noise: what parameters leave open


def times_noise(rms_m: float, floor_m: float) -> float:
    """An rms error [m] over the noise and the solver's own error."""
    return rms_m / math.hypot(floor_m, math.sqrt(3) * MODEL_POSITION_M)


def largest_rest(tails: float) -> float:
    """Of the noise, whose squares vary `tails` times as much as Gaussian ones: so much less certain is their mean."""
    return math.sqrt(1 + (LARGEST_REST**2 - 1) * math.sqrt(tails))


def contradiction(verdict: Verdict, gap: Gap, place: Place) -> str:
    """What contradicts a verdict that says that a model agrees with the measurements, as a sentence; empty if nothing.

    On the poses kept aside it is the error with the effects, beyond noise and what the fitted parameters leave open:
    few poses do not settle an effect of many parameters, and noise with heavy tails is larger here and smaller there.
    Where none is missing, no tails are allowed for, and the poses that were fitted are asked as well.
    """
    if verdict == "partial" and gap.after.rms_m >= gap.before.rms_m:
        off = f"{gap.before.rms_m * 1e3:.2f} mm off (rms) without them and {gap.after.rms_m * 1e3:.2f} mm with them"
        return f"The figures contradict the effects found: on the poses kept aside tips are {off}."
    if verdict in ("partial", "unexplained"):
        return ""
    is_complete = verdict == "no_missing_effect"
    largest = LARGEST_REST if is_complete else largest_rest(gap.tails)
    shown = {"the poses kept aside": (gap.after.rms_m, math.hypot(gap.floor_m, gap.spread_m), largest)}
    if is_complete:
        shown["the poses that were fitted"] = place.rms_m, gap.floor_m, LARGEST_REST
    for where, (rms_m, expected_m, most) in shown.items():
        if not times_noise(rms_m, expected_m) <= most:
            told = gap.spread_m > LEAST_TOLD * gap.floor_m
            left_open = f", parameters leave {gap.spread_m * 1e3:.2f} mm open" if told else ""
            off = f"tips are {rms_m * 1e3:.2f} mm off (rms), the noise is {gap.floor_m * 1e3:.2f} mm{left_open}"
            return f"The figures contradict it: on {where} {off}."
    return ""
