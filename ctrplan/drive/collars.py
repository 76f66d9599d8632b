"""Collars: where the drive holds the tubes' bases."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Collars:
    """Base rotations theta (K, n) [rad] and base translations l (K, n) [m], outermost tube first.

    An ideal drive puts them where they are commanded.
    """

    theta: Array
    l: Array  # noqa: E741 (as in the equations)
