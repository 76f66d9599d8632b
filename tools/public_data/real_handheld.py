"""The handheld robot of github.com/NavidFeizi/Handheld_CTR_Control_ROS_WS as files that ctrplan reads.

    python tools/public_data/real_handheld.py FOLDER OUTPUT
    ctrplan diagnose OUTPUT/robot.toml OUTPUT/training.toml --confirm OUTPUT/confirmation.toml \\
      --set measurement.position_sigma_mm=1 -o OUTPUT/diagnosis

FOLDER holds Joint_Values_RUN.dat and EM_Trajectory_RUN.dat (in the repository's history, Output_Files/Phantom): rows
that belong together, without clock; translations [m] and rotations [rad, wrapped now and then], innermost tube first;
the tip [m] in a frame at the robot's base, no tangent. A second sensor at the base gives that frame, which was set up
anew between runs: each run has a frame of its own, and zeros of its own. OUTPUT gets robot.toml, a mapping file for
each set of runs and a copy of the data, which have no licence: keep them out of any repository. Tubes are those of
controller_node.cpp. Its outer tube has an inner diameter of 1.1448 mm, into which the middle tube of 1.372 mm does not
fit: taken for 1.448 mm.
"""

from __future__ import annotations

import argparse
import math
import shutil
from collections.abc import Sequence
from pathlib import Path

import tomli_w

TRAINING = ("square_1", "helix_1", "hypo_1")
OUTER_MM, INNER_MM = (2.045, 1.372, 0.940), (1.448, 0.965, 0.737)  # outermost first
YOUNG_PA = (74.9122e9, 30e9, 30e9)
STRAIGHT_MM, CURVED_MM = (62.0, 61.0, 151.0), (0.0, 78.0, 58.0)
RADIUS_MM = (math.inf, 95.0, 41.0)


def robot() -> dict[str, object]:
    """The content of robot.toml."""
    tubes = []
    for outer, inner, young, straight, curved, radius in zip(
        OUTER_MM, INNER_MM, YOUNG_PA, STRAIGHT_MM, CURVED_MM, RADIUS_MM, strict=True
    ):
        sections = [{"length_mm": straight, "curvature_x_per_m": 0.0, "curvature_y_per_m": 0.0}]
        if curved:
            sections += [{"length_mm": curved, "curvature_x_per_m": 1e3 / radius, "curvature_y_per_m": 0.0}]
        area_moment_m4 = math.pi / 64 * (outer**4 - inner**4) * 1e-12
        tubes.append(
            {
                "outer_diameter_mm": outer,
                "inner_diameter_mm": inner,
                "bending_stiffness_Nm2": young * area_moment_m4,
                "poisson_ratio": 0.3,
                "section": sections,
            }
        )
    contacts = [{"friction_coefficient": 0.0}, {"friction_coefficient": 0.0}]
    return {"name": "handheld robot of NavidFeizi", "tube": tubes, "contact": contacts}


def mapping(runs: Sequence[str]) -> dict[str, object]:
    """The content of a mapping file for some runs."""
    return {
        "header": False,
        "tubes": "innermost first",
        "rotations": "wrapped",
        "columns": {"l": [1, 2, 3], "theta": [4, 5, 6], "position": [1, 2, 3]},
        "run": [
            {"joints": f"Joint_Values_{run}.dat", "poses": f"EM_Trajectory_{run}.dat", "tracker": run, "homing": run}
            for run in runs
        ],
    }


def convert(folder: Path, output: Path) -> None:
    """Writes robot.toml and the mapping files, and copies the data."""
    output.mkdir(parents=True, exist_ok=True)
    runs = sorted(path.stem.removeprefix("Joint_Values_") for path in folder.glob("Joint_Values_*.dat"))
    for run in runs:
        for kind in ("Joint_Values", "EM_Trajectory"):
            shutil.copyfile(folder / f"{kind}_{run}.dat", output / f"{kind}_{run}.dat")
    (output / "robot.toml").write_text(tomli_w.dumps(robot()))
    (output / "training.toml").write_text(tomli_w.dumps(mapping(TRAINING)))
    (output / "confirmation.toml").write_text(tomli_w.dumps(mapping([run for run in runs if run not in TRAINING])))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    convert(arguments.folder, arguments.output)
