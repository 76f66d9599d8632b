"""How finely a robot is discretised, and on what geometry."""

from __future__ import annotations

from typing import Literal

Accuracy = Literal["search", "certificate", "exact"]
"""Mesh error of a tip on the Table III grid: 0.3, 0.05 mm; "exact" also drops the first order in the clearance."""
