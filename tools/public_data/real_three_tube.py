"""The public three-tube robot of github.com/hjhdog1/ConcentricTubes as files that ctrplan reads, and how far it is off.

    python tools/public_data/real_three_tube.py FOLDER OUTPUT [--calibrate]

FOLDER holds jointTipTrajectory_measured_short.txt of that repository: at 10 Hz time, three rotations [rad, wrapped] and
translations [mm], outermost tube first, tip [mm] and the axes of a sensor whose x axis points back along the tangent.
OUTPUT gets robot.toml, measurements.toml (a mapping file) and a copy of the data, which have no licence: keep them out
of any repository. Lengths, curvatures and ratios of stiffness are those of CTRFactory.cpp; diameters are not given
there, those of Table II (Ha et al. 2019) stand in. With --calibrate: rms before and after ordinary calibration with the
base free.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import tomli_w

DATA = "jointTipTrajectory_measured_short.txt"
DIAMETERS_MM = ((2.64, 2.39), (2.305, 2.0), (1.85, 1.7))
STIFFNESS_NM2 = 0.05
SECTIONS = (  # length [mm], radius of curvature [mm]
    ((150.0, 265.0),),
    ((17.0, None), (150.0, 265.0)),
    ((184.0, None), (86.3938, 55.0)),
)
STIFFNESS_RATIO = (1.0, 1.0, 2.0 / 7.0)

MAPPING = {
    "header": False,
    "separator": "tab",
    "units": {"theta": "rad", "l": "mm", "position": "mm"},
    "columns": {
        "time": 1,
        "theta": [2, 3, 4],
        "l": [5, 6, 7],
        "position": [8, 9, 10],
        "tangent": ["-11", "-12", "-13"],
    },
    "run": [{"file": DATA}],
}


def robot() -> dict[str, object]:
    """The content of robot.toml."""
    tubes = [
        {
            "outer_diameter_mm": outer,
            "inner_diameter_mm": inner,
            "bending_stiffness_Nm2": STIFFNESS_NM2 * ratio,
            "poisson_ratio": 0.3,
            "section": [
                {"length_mm": mm, "curvature_x_per_m": 0.0, "curvature_y_per_m": 1e3 / radius if radius else 0.0}
                for mm, radius in sections
            ],
        }
        for (outer, inner), ratio, sections in zip(DIAMETERS_MM, STIFFNESS_RATIO, SECTIONS, strict=True)
    ]
    contacts = [{"friction_coefficient": 0.0}, {"friction_coefficient": 0.0}]
    return {"name": "three tubes of hjhdog1/ConcentricTubes", "tube": tubes, "contact": contacts}


def convert(folder: Path, output: Path) -> None:
    """Writes robot.toml and measurements.toml, and copies the data."""
    output.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / DATA, output / DATA)
    (output / "robot.toml").write_text(tomli_w.dumps(robot()))
    (output / "measurements.toml").write_text(tomli_w.dumps(MAPPING))


def calibrated(output: Path) -> None:
    """Prints rms errors before and after calibration on every tenth pose."""
    import numpy as np

    import ctrplan

    believed = ctrplan.load_robot(output / "robot.toml")
    data = ctrplan.load_measurements(output / "measurements.toml", believed)
    for warning in data.warnings:
        print(warning)
    found = ctrplan.calibrate(
        believed, data.subset(np.arange(0, data.count, 10)), ["calibration", "effects.base_misalignment"]
    )
    print(f"{data.count} poses, rms {found.nominal.rms_m * 1e3:.2f} mm as the repository has the robot, ", end="")
    print(f"{found.training.rms_m * 1e3:.2f} mm calibrated without friction, ", end="")
    print(f"{found.held_out.rms_m * 1e3:.2f} mm on poses kept aside" if found.held_out else "")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--calibrate", action="store_true")
    arguments = parser.parse_args()
    convert(arguments.folder, arguments.output)
    if arguments.calibrate:
        calibrated(arguments.output)
