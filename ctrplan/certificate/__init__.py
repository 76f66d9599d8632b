"""The dense recheck of a finished path, and the simulated histories along it."""

from __future__ import annotations
