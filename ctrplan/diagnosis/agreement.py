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


def contradiction(verdict: Verdict, gap: Gap, place: Place) -> str:
    """What contradicts a verdict that says that a model agrees with the measurements, as a sentence; empty if nothing.

    On the poses kept aside it is the error with the effects, beyond noise and what the fitted parameters leave open:
    few poses do not settle an effect of many parameters. Where none is missing, it is on the others that without any.
    """
    if verdict == "partial" and gap.after.rms_m >= gap.before.rms_m:
        off = f"{gap.before.rms_m * 1e3:.2f} mm off (rms) without them and {gap.after.rms_m * 1e3:.2f} mm with them"
        return f"The figures contradict the effects found: on the poses kept aside tips are {off}."
    if verdict in ("partial", "unexplained"):
        return ""
    shown = {"the poses kept aside": (gap.after.rms_m, gap.spread_m)}
    if verdict == "no_missing_effect":
        shown["the poses that were fitted"] = place.rms_m, 0.0
    for where, (rms_m, open_m) in shown.items():
        if not times_noise(rms_m, math.hypot(gap.floor_m, open_m)) <= LARGEST_REST:
            left_open = f", parameters leave {open_m * 1e3:.2f} mm open" if open_m > LEAST_TOLD * gap.floor_m else ""
            off = f"tips are {rms_m * 1e3:.2f} mm off (rms), the noise is {gap.floor_m * 1e3:.2f} mm{left_open}"
            return f"The figures contradict it: on {where} {off}."
    return ""
