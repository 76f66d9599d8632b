"""The public three-tube robot of github.com/hjhdog1/ConcentricTubes as files that ctrplan reads, and how far it is off.

    python tools/public_data/real_three_tube.py FOLDER OUTPUT [--calibrate] [--erasure]

FOLDER holds jointTipTrajectory_measured_short.txt of that repository: at 10 Hz time, three rotations [rad, wrapped] and
translations [mm], outermost tube first, tip [mm] and the axes of a sensor whose x axis points back along the tangent.
OUTPUT gets robot.toml, measurements.toml (a mapping file) and a copy of the data, which have no licence: keep them out
of any repository. Lengths, curvatures and ratios of stiffness are those of CTRFactory.cpp; diameters are not given
there, those of Table II (Ha et al. 2019) stand in. With --calibrate: rms before and after ordinary calibration with the
base free. With --erasure: what slip leaves of friction. The run goes a way and back, so that most joint values are
reached from both sides; half the difference of the tips there is what the past may do. Printed is its share of the
bound, as measured and in a simulation of the run, by how the last millimetre of slip came about.
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


FRICTION, LAG_S = (0.32, 0.136), 0.076  # as `ctrplan diagnose` finds them on this run
SLIP_M = 1e-3  # that is looked back on
SAME_M = 0.2e-3  # by which joints of two rows may differ; turns count as the way of the middle tube's surface


def erasure(output: Path) -> None:
    """Prints, for rows that both passes reach, medians of the half difference over the bound."""
    from dataclasses import replace

    import numpy as np

    import ctrplan

    believed = ctrplan.load_robot(output / "robot.toml")
    data = ctrplan.load_measurements(output / "measurements.toml", believed)
    fitted = ctrplan.calibrate(
        believed, data.subset(np.arange(0, data.count, 10)), ["calibration", "effects.base_misalignment"]
    ).robot
    contacts = [replace(c, friction_coefficient=(mu, mu)) for c, mu in zip(fitted.contacts, FRICTION, strict=True)]
    robot = replace(fitted, contacts=tuple(contacts))
    table = np.loadtxt(output / DATA)
    theta, l = np.unwrap(table[:, 1:4], axis=0), table[:, 4:7] * 1e-3  # noqa: E741
    time_s = table[:, 0]
    tip = np.stack([np.interp(time_s + LAG_S, time_s, x) for x in table[:, 7:10].T * 1e-3], axis=1)
    without = robot.mechanics.tips_with_friction(theta, l, np.zeros((len(theta), robot.n - 1))).position_m
    simulated = robot.history("released").follow(theta, l).position_m
    slip = [np.array([DIAMETERS_MM[1][0], DIAMETERS_MM[2][0]]) / 2e3 * np.diff(theta, axis=1), np.diff(l, axis=1)]
    turned, slid = (np.abs(np.diff(part, axis=0)).sum(axis=1) for part in slip)
    way = np.concatenate([[0.0], np.cumsum(turned + slid)])
    by_turning = np.concatenate([[0.0], np.cumsum(turned)])

    def share(row: int) -> float:
        """How much of the last millimetre of slip before a row was turning."""
        begin = int(np.searchsorted(way, way[row] - SLIP_M))
        return float((by_turning[row] - by_turning[begin]) / max(way[row] - way[begin], 1e-9))

    places, middle = np.hstack([DIAMETERS_MM[1][0] / 2e3 * theta, l]), len(theta) // 2
    rows = []
    for there in range(middle):
        away = np.linalg.norm(places[middle:] - places[there], axis=1)
        back = middle + int(np.argmin(away))
        if min(way[there], abs(way[back] - way[there])) < 2 * SLIP_M or away.min() > SAME_M:
            continue
        halves = [np.linalg.norm((x[there] - without[there]) - (x[back] - without[back])) / 2 for x in (tip, simulated)]
        bound_m = robot.bound(theta[there], l[there]).position_m
        rows.append(((share(there) + share(back)) / 2, *(half / bound_m for half in halves), bound_m))
    found = np.array(rows)
    print("| last millimetre of slip | rows | measured, of the bound | simulated | bound |")
    for name, low, high in (("by turning", 2 / 3, 1.01), ("by both", 1 / 3, 2 / 3), ("by sliding", -0.01, 1 / 3)):
        those = found[(found[:, 0] > low) & (found[:, 0] <= high)]
        if len(those):
            measured, simulation, bound_m = np.median(those[:, 1:], axis=0)
            print(f"| {name} | {len(those)} | {measured:.2f} | {simulation:.2f} | {1e3 * bound_m:.2f} mm |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--erasure", action="store_true")
    arguments = parser.parse_args()
    convert(arguments.folder, arguments.output)
    if arguments.calibrate:
        calibrated(arguments.output)
    if arguments.erasure:
        erasure(arguments.output)
