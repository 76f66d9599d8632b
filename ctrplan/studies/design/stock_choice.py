"""Which tubes of a stock list go into each other, and what a robot's file says of one that was chosen."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ctrplan.errors import InputError
from ctrplan.files.design_entries import MadeEntry, StockEntry

DIAMETERS = ("outer_diameter_mm", "inner_diameter_mm")


class StockChoice:
    """Tubes from outermost to innermost, each by a share from 0 to 1 of those that fit, thickest first."""

    def __init__(self, stock: Sequence[StockEntry], made: MadeEntry, tubes: int) -> None:
        """Raises InputError where no `tubes` of the list fit into each other."""
        self.made, self.tubes = made, tubes
        self.stock = sorted(stock, key=lambda one: (-one.outer_diameter_mm, -one.inner_diameter_mm, one.name))
        self._deepest: dict[str, int] = {}
        if not self._fitting(None, tubes):
            raise InputError(f"has no {tubes} tubes that fit into each other", key="stock")

    def chosen(self, shares: Sequence[float]) -> list[StockEntry]:
        """One tube for each share; whatever the shares are, they nest."""
        found: list[StockEntry] = []
        for k, share in enumerate(shares):
            fitting = self._fitting(found[-1] if found else None, self.tubes - k)
            found.append(fitting[min(int(share * len(fitting)), len(fitting) - 1)])
        return found

    def fits(self, outer: StockEntry, inner: StockEntry) -> bool:
        """Whether one goes into the other, at the ends of their tolerances too."""
        clearance_mm = (outer.inner_diameter_mm - inner.outer_diameter_mm) / 2
        off_mm = (outer.diameter_tolerance_mm + inner.diameter_tolerance_mm) / 2
        return self.made.least_clearance_mm + off_mm <= clearance_mm + 1e-12 <= self.made.most_clearance_mm + 2e-12

    def _fitting(self, outer: StockEntry | None, count: int) -> list[StockEntry]:
        """Those that go into `outer` and leave room for count - 1 more."""
        return [one for one in self.stock if (outer is None or self.fits(outer, one)) and self._depth(one) >= count]

    def _depth(self, outer: StockEntry) -> int:
        """How many tubes there can be from this one inwards."""
        if outer.name not in self._deepest:
            inner = [self._depth(one) for one in self.stock if self.fits(outer, one)]
            self._deepest[outer.name] = 1 + max(inner, default=0)
        return self._deepest[outer.name]


def bending_stiffness_Nm2(outer_diameter_mm: float, inner_diameter_mm: float, youngs_modulus_GPa: float) -> float:
    """E I of a tube [N m^2]."""
    return youngs_modulus_GPa * math.pi / 64 * (outer_diameter_mm**4 - inner_diameter_mm**4) * 1e-3


def tube_keys(stock: StockEntry, i: int, off: dict[str, float]) -> dict[str, float]:
    """What --set is told of tube i (from 1) as made `off` from the stock: diameters [mm], stiffness [%]."""
    outer, inner = (getattr(stock, key) + off.get(key, 0.0) for key in DIAMETERS)
    stiffness = bending_stiffness_Nm2(outer, inner, stock.youngs_modulus_GPa) * (1 + off.get("stiffness", 0.0) / 100)
    stem = f"robot.tube.{i}."
    return {
        f"{stem}outer_diameter_mm": outer,
        f"{stem}inner_diameter_mm": inner,
        f"{stem}bending_stiffness_Nm2": stiffness,
        f"{stem}poisson_ratio": stock.poisson_ratio,
    }
