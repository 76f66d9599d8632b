"""Robots at the ends of what can be made, as contents of files."""

from __future__ import annotations

from typing import Any

import numpy as np


def content(n: int, random: np.random.Generator) -> dict[str, Any]:
    """A robot at the ends of what can be made: stiff and soft tubes, bent up to half round, friction up to 0.5."""
    outer_mm, tubes, tip_mm = 0.4 * 1.5 ** np.arange(n)[::-1], [], random.uniform(20, 100)
    for i in range(n):
        length_mm = tip_mm + 20.0 * i
        bend, towards = (
            random.uniform(0, min(np.pi / length_mm * 1e3, 160 / outer_mm[i])),
            random.uniform(-np.pi, np.pi),
        )
        section = {
            "length_mm": length_mm,
            "curvature_x_per_m": float(bend * np.cos(towards)),
            "curvature_y_per_m": float(bend * np.sin(towards)),
        }
        tubes.append(
            {
                "outer_diameter_mm": float(outer_mm[i]),
                "inner_diameter_mm": float(outer_mm[i] / 1.2),
                "bending_stiffness_Nm2": float(10 ** random.uniform(-3, -1)),
                "poisson_ratio": float(random.uniform(-0.9, 0.5)),
                "collar_length_mm": 1.0,
                "section": [section],
            }
        )
        tip_mm += random.choice([0.01, random.uniform(0.1, 40)])
    contacts = [{"friction_coefficient": float(random.uniform(0, 0.5))} for _ in range(n - 1)]
    return {"name": "made up", "tube": tubes, "contact": contacts}
