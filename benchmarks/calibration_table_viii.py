"""Table VIII's shape on simulated data: does friction in the model halve the largest error, as in the paper?

Data: the Table VII robot with its friction, approached from four directions (the friction corners) at an 8 x 8 x 8 grid
of relative rotations and extensions; stable ones of a 4 x 4 x 4 subset calibrate, the rest evaluate. Noise 1.4 mm
and 0.5 deg as of ten independent samples. Models: zero clearance (standard), clearance, clearance with friction; all
calibrated with the paper's weights from Table II's nominal values.

    python benchmarks/calibration_table_viii.py [--every K]   # K: evaluate every K-th of the 450 configurations
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from ctrplan.calibration.calibrate import calibrate
from ctrplan.files.robot_file import load_robot
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.tip_table import tip_table
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot

ROBOTS = Path(__file__).parents[1] / "scenarios" / "robots"
NOISE_M, NOISE_RAD = 1.4e-3 / np.sqrt(3) / np.sqrt(10), np.radians(0.5) / np.sqrt(10)
QUARTER = np.pi / 2
PARAMETERS = [
    *(f"tube.{t}.section.{s}.curvature_{axis}_per_m" for t, s in ((1, 1), (2, 2), (3, 2)) for axis in "xy"),
    "tube.2.bending_stiffness_Nm2",
    "tube.3.bending_stiffness_Nm2",
    *(f"tube.{t}.poisson_ratio" for t in (1, 2, 3)),
]
FRICTION = ["contact.1.friction_coefficient", "contact.2.friction_coefficient"]


def grid(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (512, 3), translations (512, 3), and whether each belongs to the 4 x 4 x 4 subset."""
    turns = np.arange(8) * np.pi / 4
    places = np.linspace(-120.4e-3, -34e-3, 8)
    rows = [((0.0, a, a + b), (0.0, -17e-3, place)) for a, b, place in itertools.product(turns, turns, places)]
    subset = [i % 2 == j % 2 == k % 2 == 0 for i, j, k in itertools.product(range(8), repeat=3)]
    theta, l = (np.array(part) for part in zip(*rows, strict=True))  # noqa: E741
    return theta, l, np.array(subset)


def approached(theta: np.ndarray, l: np.ndarray) -> Measurements:  # noqa: E741
    """Every configuration from the four directions, by 90 degrees of relative rotation of each pair."""
    rows, places, runs = [], [], []
    for goal, place in zip(theta, l, strict=True):
        for signs in itertools.product((1, -1), repeat=2):
            turn = QUARTER * np.concatenate([[0.0], np.cumsum(signs)])
            rows += [goal - turn, goal]
            places += [place, place]
            runs += [len(runs) // 2] * 2
    last = np.arange(1, len(rows), 2)
    nothing = np.zeros((len(last), 3))
    return Measurements(np.array(runs), np.array(rows), np.array(places), last, nothing, nothing)


def measured(robot: Robot, data: Measurements, rng: np.random.Generator) -> Measurements:
    """Tips of the robot with friction and noise; poses that could not be solved are left out."""
    rows = data.rows
    tips = tip_table(
        robot, data.theta_commanded[rows], data.l_commanded[rows], friction_state(data), accuracy="certificate"
    )
    position = tips.position_m + NOISE_M * rng.standard_normal(tips.position_m.shape)
    tangent = tips.tangent + np.cross(NOISE_RAD * rng.standard_normal(tips.tangent.shape), tips.tangent)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    whole = replace(data, position_m=position, tangent=tangent)
    sound = np.array([tips.sound[data.configuration == c].all() for c in data.configuration])
    return whole.subset(sound)


def errors(position: np.ndarray, tangent: np.ndarray, data: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Distances [mm] and angles [deg]."""
    cosine = np.clip(np.sum(tangent * data.tangent, axis=1), -1, 1)
    return np.linalg.norm(position - data.position_m, axis=1) * 1e3, np.degrees(np.arccos(cosine))


def standard_model(robot: Robot, fitted: Measurements, tested: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """The zero-clearance model, calibrated with the same weights."""

    def tips(p: np.ndarray, data: Measurements) -> tuple[np.ndarray, np.ndarray]:
        moved = with_values(robot, dict(zip(PARAMETERS, p, strict=True)))
        position, tangent, _ = moved.mechanics.tips(data.theta_commanded[data.rows], data.l_commanded[data.rows])
        return position, tangent

    def residual(p: np.ndarray) -> np.ndarray:
        position, tangent = tips(p, fitted)
        turned = np.degrees(np.cross(tangent, fitted.tangent))
        return np.hstack([(position - fitted.position_m) * 1e3, turned]).ravel()

    start = np.array([value_of(robot, name) for name in PARAMETERS])
    lowest = {"poisson_ratio": -0.95, "bending_stiffness_Nm2": 1e-3}
    low = [lowest.get(name.rsplit(".", 1)[-1], -np.inf) for name in PARAMETERS]
    found = least_squares(residual, start, x_scale=0.1 * np.abs(start) + 0.1, bounds=(low, np.inf), max_nfev=60)
    return errors(*tips(found.x, tested), tested)


def clearance_model(
    robot: Robot, fitted: Measurements, tested: Measurements, second: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Clearance, and friction in a second pass where its coefficients are named."""
    found = calibrate(robot, fitted, PARAMETERS, second_pass=second, weighting="paper", held_out=0.0)
    prediction = ParametricChain(found.robot, tested, []).predict(np.zeros(0), derivatives=False)
    return errors(prediction.position_m, prediction.tangent, tested)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=1, metavar="K")
    every = parser.parse_args().every
    truth = load_robot(ROBOTS / "three_tube_calibrated.toml")
    nominal = load_robot(ROBOTS / "three_tube.toml", [f"contact.{i}.friction_coefficient=0" for i in (1, 2)])
    theta, l, subset = grid(truth)  # noqa: E741
    rng = np.random.default_rng(0)
    fitted = measured(truth, approached(theta[subset], l[subset]), rng)
    rest = np.flatnonzero(~subset)[::every]
    tested = measured(truth, approached(theta[rest], l[rest]), rng)
    print(
        f"{fitted.count} poses to calibrate, {tested.count} to evaluate; noise {NOISE_M * np.sqrt(3) * 1e3:.2f} mm rms"
    )
    print("| model | mean pos. (mm) | max pos. (mm) | mean tan. (deg) | max tan. (deg) | paper: mean, max (mm) |")
    print("|---|---|---|---|---|---|")
    rows = {
        "standard": (standard_model(nominal, fitted, tested), "4.1, 11.5"),
        "clearance": (clearance_model(nominal, fitted, tested, []), "3.7, 11.6"),
        "friction": (clearance_model(nominal, fitted, tested, FRICTION), "2.2, 5.9"),
    }
    for name, ((position, tangent), paper) in rows.items():
        cells = f"{position.mean():.2f} | {position.max():.1f} | {tangent.mean():.2f} | {tangent.max():.1f}"
        print(f"| {name} | {cells} | {paper} |")


if __name__ == "__main__":
    main()
