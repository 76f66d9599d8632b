"""The noise of the measurement: as the robot file states it, and as the data show it. Never assumed.

What data show of it, `shown_noise.py`, misses what a tracker's filter takes away and what changes slowly; what a file
states may be a data sheet's. Each is a lower bound, and the largest counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ctrplan.calibration.residuals import Noise
from ctrplan.calibration.shown_noise import LEAST_SPARE, ShownNoise, repeats, shown_noises
from ctrplan.calibration.weighting import NO_TANGENT_SIGMA, PAPER
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import Measurements
from ctrplan.robot.robot import Robot


def noise_floor(robot: Robot, data: Measurements) -> tuple[Noise, str]:
    """Noise, and a sentence about it where it is not as stated. Raises InputError where neither file nor data have it.

    Of data without tangents the noise of tangents is of no matter.
    """
    stated, shown = robot.measurement, list(shown_noises(data))
    if stated is None and not shown:
        rule = (
            "is missing: state position_sigma_mm and tangent_sigma_deg, or measure at least "
            f"{LEAST_SPARE} poses again, approached the same way ({_too_little(data)})"
        )
        raise InputError(rule, file=robot.path, key="measurement")
    if stated is None:
        return _of_data(shown, data.has_tangents)
    tangent_rad = stated.tangent_sigma_rad
    if tangent_rad is None and data.has_tangents:
        if not shown:
            raise InputError(NO_TANGENT_SIGMA, file=robot.path, key="measurement.tangent_sigma_deg")
        tangent_rad = max(one.noise.tangent_rad for one in shown)
    floor = Noise(stated.position_sigma_m, PAPER.tangent_rad if tangent_rad is None else tangent_rad)
    return _enlarged(floor, shown, data.has_tangents)


def _too_little(data: Measurements) -> str:
    if data.is_stream:
        return "a continuous motion has none, and this one is too short or too uneven in time to show its noise"
    kind = repeats(data)
    return f"these data have {len(kind) - len(np.unique(kind))}"


def _of_data(shown: Sequence[ShownNoise], has_tangents: bool) -> tuple[Noise, str]:
    """The largest that the data show."""
    found = Noise(max(one.noise.position_m for one in shown), max(one.noise.tangent_rad for one in shown))
    by = " and ".join(one.by for one in shown)
    return found, f"The robot file states no noise; {by} say {_words(found, has_tangents)}."


def _enlarged(stated: Noise, shown: Sequence[ShownNoise], has_tangents: bool) -> tuple[Noise, str]:
    """The stated noise, or what data show where it is clearly more."""
    found, by = stated, list[str]()
    for one in shown:
        factors = one.noise.position_m / stated.position_m, one.noise.tangent_rad / stated.tangent_rad
        if max(factors[: 1 + has_tangents]) > 1 + one.doubt:
            tangent_rad = max(found.tangent_rad, one.noise.tangent_rad) if has_tangents else found.tangent_rad
            found = Noise(max(found.position_m, one.noise.position_m), tangent_rad)
            by.append(one.by)
    if not by:
        return stated, ""
    more = f"{' and '.join(by)} say {_words(found, has_tangents)}, the file states {_words(stated, has_tangents)}"
    return found, f"The noise is larger than stated: {more}."


def _words(noise: Noise, has_tangents: bool) -> str:
    tangent = f" and {math.degrees(noise.tangent_rad):.3g} deg" if has_tangents else ""
    return f"{noise.position_m * 1e3:.3g} mm{tangent}"
