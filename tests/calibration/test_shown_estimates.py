"""Numbers of a fit for a reader have the digits that their intervals carry."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.calibration.estimates import Estimate


@pytest.mark.parametrize(
    ("value", "half", "shown", "interval"),
    [
        (0.321347, 0.0633, "0.321", "0.258 to 0.385"),
        (0.0760123, 0.0000372, "0.076012", "0.075975 to 0.076050"),
        (8.9812, 0.17, "8.98", "8.81 to 9.15"),
        (123.4567, 45.6, "123", "78 to 169"),
        (12345.6, 4000.0, "12346", "8346 to 16346"),
    ],
)
def test_digits_are_those_of_the_interval(value: float, half: float, shown: str, interval: str) -> None:
    found = Estimate(value, (value - half, value + half))
    assert (found.shown, found.shown_ci95) == (shown, interval)


def test_rounding_is_small_beside_the_interval() -> None:
    rng = np.random.default_rng(1)
    for value, half in zip(rng.standard_normal(200) * 10, 10.0 ** rng.uniform(-5, 3, 200), strict=True):
        found = Estimate(value, (value - half, value + half))
        assert abs(float(found.shown) - value) < 0.06 * half or half > 10


def test_an_interval_of_no_width_leaves_four_digits() -> None:
    assert Estimate(0.123456, (0.123456, 0.123456)).shown == "0.1235"
