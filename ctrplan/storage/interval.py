"""What makes two numbers of a file the interval of a value."""

from __future__ import annotations

import math
from typing import Any

ROUNDING = 1e-6  # relative, of values and ends written with a few digits


def interval_fault(ends: Any, value: float) -> str:
    """The rule that `ends` break as an interval around `value`, as the end of a sentence; empty if they don't."""
    is_pair = isinstance(ends, (list, tuple)) and len(ends) == 2
    if not is_pair or not all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in ends):
        return "must be an interval [low, high] of two numbers"
    low, high = float(ends[0]), float(ends[1])
    if not (math.isfinite(low) and math.isfinite(high)):
        return "must be an interval of finite numbers"
    if low > high:
        return "must be an interval [low, high] with low <= high"
    slack = ROUNDING * max(abs(low), abs(high), abs(value))
    if not low - slack <= value <= high + slack:
        return f"must contain its value, {value:.6g}"
    return ""
