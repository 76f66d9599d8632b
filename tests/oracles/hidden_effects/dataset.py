"""Folders in the format of measured data: robot.toml as the user believes it, measurements.csv, truth.json."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from hidden_effects.experiment import Experiment
from hidden_effects.noise import POSITION_SIGMA_M, TANGENT_SIGMA_RAD
from hidden_effects.tube import Array
from hidden_effects.world import Room, World


def robot_toml(world: World, name: str, *, tangents: bool = True) -> str:
    """The world's tubes as a robot file, frictionless; terms of a stage have no place in it."""
    lines = [f'name = "{name}"', ""]
    for tube, withdrawn in zip(world.tubes, world.withdrawn, strict=True):
        lines += [
            "[[tube]]",
            f"outer_diameter_mm = {2e3 * tube.outer_radius_m:.6g}",
            f"inner_diameter_mm = {2e3 * tube.inner_radius_m:.6g}",
            f"bending_stiffness_Nm2 = {tube.bending_stiffness_Nm2:.6g}",
            f"poisson_ratio = {tube.poisson_ratio:.6g}",
            *(["retractable = true"] if withdrawn else []),
        ]
        for section in tube.sections:
            lines += [
                "[[tube.section]]",
                f"length_mm = {1e3 * section.length_m:.6g}",
                f"curvature_x_per_m = {section.curvature_per_m[0]:.6g}",
                f"curvature_y_per_m = {section.curvature_per_m[1]:.6g}",
            ]
        lines.append("")
    lines += ["[[contact]]", "friction_coefficient = 0.0", ""] * len(world.pairs)
    lines += [
        "[measurement]",
        f"position_sigma_mm = {1e3 * POSITION_SIGMA_M:.6g}",
        *([f"tangent_sigma_deg = {np.rad2deg(TANGENT_SIGMA_RAD):.6g}"] if tangents else []),
        "",
    ]
    return "\n".join(lines)


def measurements_csv(experiment: Experiment, p: Array, tangent: Array | None, room: Room | None = None) -> str:
    """One row per joint waypoint; the pose (6 numbers, 3 without tangents) stays empty where nothing was measured.

    The temperature of the room is logged at every waypoint.
    """
    motion, n = experiment.motion, experiment.motion.theta.shape[1]
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    joints = [f"theta_{i + 1}_rad" for i in range(n)] + [f"l_{i + 1}_m" for i in range(n)]
    columns = ["x_m", "y_m", "z_m", *([] if tangent is None else ["tx", "ty", "tz"])]
    out.writerow(["sequence", "time_s", *joints, *columns, *(["temperature_C"] if room else [])])
    pose = iter(p if tangent is None else np.hstack([p, tangent]))
    for k in range(len(motion.time_s)):
        row = [f"{v:.6f}" for v in (*motion.theta[k], *motion.l[k])]
        tail = [""] * len(columns)
        if experiment.measured[k]:
            values = next(pose)
            tail = [*(f"{v:.7f}" for v in values[:3]), *(f"{v:.6f}" for v in values[3:])]
        warm = [f"{room.temperature_C(motion.time_s[k]):.2f}"] if room else []
        out.writerow([int(motion.sequence[k]), f"{motion.time_s[k]:.1f}", *row, *tail, *warm])
    return text.getvalue()


def write_folder(folder: Path, files: dict[str, str], truth: dict[str, Any]) -> None:
    """All files, truth.json last: a folder that has it is complete."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    unfinished = folder / "truth.json.part"
    unfinished.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    os.replace(unfinished, folder / "truth.json")
