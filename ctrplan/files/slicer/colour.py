"""Colours as Slicer's files have them."""

from __future__ import annotations


def rgb(colour: str) -> list[float]:
    """Red, green and blue in [0, 1] of "#RRGGBB"."""
    return [round(int(colour[k : k + 2], 16) / 255, 4) for k in (1, 3, 5)]
