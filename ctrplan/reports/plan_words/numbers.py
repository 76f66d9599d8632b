"""Numbers for people: about three digits, with their unit."""

from __future__ import annotations

import math

LEAST = 1e-4  # of which Python would write a power of ten


def millimetres(length_m: float) -> str:
    """A length for people, about three digits."""
    return f"{digits(length_m * 1e3)} mm"


def degrees(angle_rad: float) -> str:
    """An angle for people."""
    return f"{digits(math.degrees(angle_rad))}°"


def digits(value: float) -> str:
    """Three digits or so, never in powers of ten where a plain number does; a question mark for what is not finite."""
    if not math.isfinite(value):
        return "?"
    if value == 0 or abs(value) >= 0.1:
        return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(abs(value) or 1))))}f}"
    return f"{value:.2g}" if abs(value) >= LEAST else f"{value:.5f}"
