"""What was commanded and measured: joint paths, poses of the tip, sensors, and how each pose was approached."""

from __future__ import annotations
