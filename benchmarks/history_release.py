"""How much rotation loads a pair, and how much translation releases it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from history_page import COLOURS, PAIR, THREE, draw, norm_mm, panels, present, table

from ctrplan.base.arrays import Array
from ctrplan.robot.robot import Robot

TURNS_DEG = np.array([2, 5, 10, 15, 20, 30, 45, 60, 90, 120])
SHIFTS_MM = np.array([0.1, 0.25, 0.5, 1, 2, 3, 5, 10, 15])


@dataclass(frozen=True)
class Case:
    """A configuration; the innermost pair turns or translates."""

    label: str
    robot: Robot
    theta_deg: tuple[float, ...]
    inner_l_mm: float

    @property
    def place(self) -> tuple[Array, Array]:
        l_mm = np.array([0.0, -17.0, -34.0][: self.robot.n])
        l_mm[-1] = self.inner_l_mm
        return np.radians(self.theta_deg), 1e-3 * l_mm

    @property
    def loaded(self) -> tuple[float, ...]:
        """The innermost pair in its corner, others released."""
        return (*(0.0,) * (self.robot.n - 2), 1.0)


CASES = (
    Case("pair, 60 deg", PAIR, (0, 60), -60.4),
    Case("pair, 120 deg", PAIR, (0, 120), -60.4),
    Case("pair, opposed (180 deg)", PAIR, (0, 180), -60.4),
    Case("three tubes, aligned and 60 deg", THREE, (0, 0, 60), -70.0),
    Case("three tubes, 60 and 40 deg", THREE, (0, 60, 100), -60.0),
    Case("three tubes, opposed (0 and 180 deg)", THREE, (0, 0, 180), -62.8),
)


def corner_m(case: Case) -> tuple[Array, float]:
    """The frictionless tip at the configuration and how far the loaded one is from it [m]."""
    place = case.place
    free_m = case.robot.solve(*place, 0.0, accuracy="certificate").tip_m
    tip_m = case.robot.solve(*place, case.loaded, accuracy="certificate").tip_m
    return free_m, float(np.linalg.norm(tip_m - free_m))


def loading(case: Case) -> Array:
    """(T,) share of the corner's deviation after the inner tube has turned by TURNS_DEG from a released state."""
    (theta_b, l_b), (free_m, full_m) = case.place, corner_m(case)
    shares = []
    for turn in np.radians(TURNS_DEG):
        before = theta_b.copy()
        before[-1] -= turn
        history = case.robot.history(accuracy="certificate")
        found = history.follow([before, theta_b], [l_b, l_b])
        shares.append(norm_mm(found.position_m[-1] - free_m) * 1e-3 / full_m)
    return np.array(shares)


def releasing(case: Case) -> Array:
    """(T,) share of the corner's deviation left after translating by SHIFTS_MM from a loaded state, the worse way."""
    (theta_b, l_b), (free_m, full_m) = case.place, corner_m(case)
    shares = np.zeros((2, len(SHIFTS_MM)))
    for row, sign in enumerate((1, -1)):
        for k, shift_mm in enumerate(SHIFTS_MM):
            before = l_b.copy()
            before[-1] -= sign * 1e-3 * shift_mm
            history = case.robot.history(case.loaded, accuracy="certificate")
            found = history.follow([theta_b, theta_b], [before, l_b])
            shares[row, k] = norm_mm(found.position_m[-1] - free_m) * 1e-3 / full_m
    return shares.max(axis=0)


def release(write: bool) -> None:
    """Loading against degrees of rotation and release against mm of translation."""
    figure, axes = panels(1, 2, (12, 4.6))
    rows = []
    for k, case in enumerate(CASES):
        loaded, left, (_, full_m) = loading(case), releasing(case), corner_m(case)
        axes[0, 0].plot([0, *TURNS_DEG], [0, *100 * loaded], color=COLOURS[k], marker=".", label=case.label)
        axes[0, 1].plot([0, *SHIFTS_MM], [100, *100 * left], color=COLOURS[k], marker=".", label=case.label)
        at = (
            dict(zip(TURNS_DEG.tolist(), 100 * loaded, strict=True)),
            dict(zip(SHIFTS_MM.tolist(), 100 * left, strict=True)),
        )
        shares = [f"{at[0][turn]:.0f} %" for turn in (10, 30, 45, 90)] + [f"{at[1][mm]:.1f} %" for mm in (0.5, 2, 10)]
        rows.append((case.label, f"{full_m * 1e3:.2f} mm", *shares))
    axes[0, 0].axhline(95, color="0.6", ls=":")
    axes[0, 1].axhline(10, color="0.6", ls=":")
    axes[0, 0].set_xlabel("rotation of the inner tube from a released state (deg)")
    axes[0, 0].set_ylabel("tip deviation, % of the corner's")
    axes[0, 1].set_xlabel("translation of the inner tube from a loaded state (mm)")
    axes[0, 1].set_ylabel("tip deviation left, % of the corner's")
    axes[0, 0].legend(frameon=False, fontsize=9)
    draw("release", figure, write)
    head = ("configuration", "corner", "10 deg", "30 deg", "45 deg", "90 deg", "left after 0.5 mm", "2 mm", "10 mm")
    present("release", table(head, rows), write=False)  # printed only
