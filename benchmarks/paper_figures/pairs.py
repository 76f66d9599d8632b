"""The pair of Table I at the settings of Section IV, and what an independent solver says of it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import Shape
from ctrplan.robot.robot import Robot

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ROOT / "scenarios" / "robots"
EXACT = json.loads((ROOT / "tests" / "reference" / "pair_values.json").read_text(encoding="utf-8"))["table_I_pair"]

CLEARANCES_MM = (0.01, 0.05, 0.25, 1.0, 3.0)  # the paper names the range and that there are five
FRICTIONS = (0.0, 0.1, 0.2, 0.3, 0.5)  # likewise
OUTER_LENGTH_M, TRANSMISSION_MM = 0.15, 17.0
SMALL_MM = 1e-3  # a transmission that is none


@cache
def pair(clearance_mm: float, mu: float = 0.0, transmission_mm: float = TRANSMISSION_MM) -> Robot:
    """Table I."""
    return load_robot(
        ROBOTS / "table_1_pair.toml",
        [
            f"tube.1.inner_diameter_mm={1 + 2 * clearance_mm}",
            f"tube.1.outer_diameter_mm={1.2 + 2 * clearance_mm}",
            f"contact.1.friction_coefficient={mu}",
            f"tube.2.section.1.length_mm={transmission_mm}",
            "tube.2.collar_length_mm=0",
            f"home.l_mm=[0, {-transmission_mm}]",
        ],
    )


def joints(angle_deg: float, transmission_mm: float = TRANSMISSION_MM) -> tuple[Array, Array]:
    return np.deg2rad([0.0, angle_deg]), 1e-3 * np.array([0.0, -transmission_mm])


def turned(clearance_mm: float, angle_deg: float) -> Shape:
    return pair(clearance_mm).solve(*joints(angle_deg), accuracy="certificate")


def opposed(clearance_mm: float, mu: float = 0.0, transmission_mm: float = TRANSMISSION_MM, phi: float = 1.0) -> Shape:
    robot = pair(clearance_mm, mu, transmission_mm)
    return robot.solve(*joints(180, transmission_mm), phi, accuracy="certificate")


def apart_mm(a: Any, b: Any) -> float:
    return 1e3 * float(np.linalg.norm(np.subtract(a, b)))


def angle_deg(u: Array, v: Array) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)))


def exact(section: str, **keys: float) -> list[dict[str, Any]]:
    return [row for row in EXACT[section] if all(np.isclose(row[key], value) for key, value in keys.items())]
