"""Units of files and screens, in SI."""

from __future__ import annotations

import math

MM_PER_M = 1e3
MILLIMETRE = 1e-3  # m
DEGREE = math.pi / 180  # rad
