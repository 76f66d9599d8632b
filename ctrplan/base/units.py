"""Units of files and screens, in SI."""

from __future__ import annotations

import math

MM_PER_M = 1e3
MILLIMETRE = 1e-3  # m
DEGREE = math.pi / 180  # rad

# What people may write, in files and on the command line: beyond it a value is in another unit.
LONGEST_MM = 1e5
MOST_TURNS_DEG = 360e3  # a thousand turns
