"""Gross faults made of clean files, and whether each is named first: `python -m banks.misread DIR ...`.

Every folder has robot.toml and measurements.csv. With `--clean` the folders are only asked whether they raise an alarm,
as are `--drawn 90` files, which the package's own model makes of the generator's experiments: robots, up to two effects
of the catalogue and noise are drawn from their priors, a file in five is a continuous motion.
A fault that leaves the uncalibrated robot less than twice as far off as the clean file is none: it is counted apart.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.experiment import approaches, continuous_motion
from hidden_effects.score import Goal
from hidden_effects.tube import Array
from hidden_effects.world import ROBOTS
from scipy.spatial.transform import Rotation

from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.parameters import BaseParameters
from ctrplan.calibration.reading import read_again
from ctrplan.diagnosis.workbench import candidates
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import term
from ctrplan.robot.robot import Robot

File = tuple[Robot, Measurements]
FRAME = Rotation.from_rotvec([0.4, 1.1, -0.7]), np.array([0.03, -0.2, 0.1])  # of a tracker, rad and m
GROSS = 2.0
DRAWN = ("two tubes", "three tubes", "two tubes, withdrawn", "three tubes, withdrawn")


def faults(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, File]]:
    """Kind, words that an answer has to begin with or to offer, and the file with the fault."""
    n, theta, l, p = robot.n, data.theta_commanded, data.l_commanded, data.position_m  # noqa: E741

    def joints(theta: Array = theta, l: Array = l) -> File:  # noqa: E741
        return robot, replace(data, theta_commanded=theta, l_commanded=l)

    def places(position: Array) -> File:
        return robot, replace(data, position_m=position)

    def stiffer(i: int, factor: float) -> File:
        tube = replace(robot.tubes[i], bending_stiffness_Nm2=factor * robot.tubes[i].bending_stiffness_Nm2)
        return replace(robot, tubes=(*robot.tubes[:i], tube, *robot.tubes[i + 1 :])), data

    outer = np.hstack([np.zeros((len(theta), 1)), theta[:, :-1]])
    yield "columns of positions exchanged", "(y, x, z)", places(p[:, [1, 0, 2]])
    yield "a column of positions negated", "(x, y, -z)", places(p * [1, 1, -1])
    yield "positions in millimetres", "positions are in millimetres", places(1e3 * p)
    for i in range(1, n):
        sign = np.where(np.arange(n) == i, -1.0, 1.0)
        yield "sign of a rotation", f"rotation {i + 1} has the other sign", joints(theta * sign)
        half = np.where(np.arange(n) == i, 0.5, 1.0)
        yield "a rotation halved", f"rotation {i + 1} is half of what", joints(theta * half)
    relative = "rotation 2 is logged relative to tube 1" if n == 2 else "relative to the next outer tube"
    yield "rotations relative to the outer tube", relative, joints(theta - outer)
    yield "rotations in degrees", "rotations are in degrees", joints(np.degrees(theta))
    yield "rotations in turns", "rotations are in turns", joints(theta / (2 * np.pi))
    yield "all rotations halved", "all rotations are half of what", joints(theta / 2)
    yield "translations in millimetres", "translations are in millimetres", joints(l=1e3 * l)
    for unit, words in ((0.0254, "in inches"), (0.01, "in centimetres"), (1e3, "1000 times too small")):
        yield "positions in another unit", f"positions are {words}", places(p / unit)
    yield "translations in inches", "translations are in inches", joints(l=l / 0.0254)
    yield "tubes in the opposite order", "tubes are in the opposite order", joints(theta[:, ::-1], l[:, ::-1])
    for rows, words in ((1, "one row late"), (-1, "one row early"), (2, "two rows late"), (-2, "two rows early")):
        yield f"poses {words}", f"poses are {words}", places(np.roll(p, rows, axis=0))
    for i in range(1, n):
        for quarters in (2, 1, -1):
            turn = np.where(np.arange(n) == i, quarters * np.pi / 2, 0.0)
            yield "a tube mounted turned", f"tube {i + 1} is mounted {90 * quarters} deg off", joints(theta - turn)
    if data.has_tangents:
        t = data.tangent
        ways = {"(-tx, -ty, -tz)": -t, "(tz, ty, tx)": t[:, ::-1], "(-tx, ty, tz)": t * [-1, 1, 1]}
        ways |= {"tangents are in another frame": FRAME[0].apply(t), "from the tube's direction": across(t)}
        for words, tangent in ways.items():
            yield "tangents", words, (robot, replace(data, tangent=tangent))
    yield "another frame", "positions are in another frame", places(FRAME[0].apply(p) + FRAME[1])
    yield "another origin", "positions are in another frame", places(p + [0.1, -0.05, 0.02])
    for i in range(n):
        yield "EI ten times too large", f"bending stiffness of tube {i + 1} is 10 times too large", stiffer(i, 10.0)


def loaded(folder: Path) -> File:
    """The robot and the measurements of a folder."""
    robot = load_robot(folder / "robot.toml")
    return robot, load_measurements(folder / "measurements.csv", robot)


def files(folders: Sequence[Path], count: int, seed: int) -> Iterator[tuple[str, Robot, Measurements]]:
    """What is asked, with its name."""
    yield from ((str(folder), *loaded(folder)) for folder in folders)
    with TemporaryDirectory() as folder:
        yield from ((f"drawn {k}", *drawn(k, seed, Path(folder))) for k in range(count))


def drawn(k: int, seed: int, folder: Path) -> File:
    """A file without a fault; drawn again where a pose has no equilibrium."""
    rng, believed = np.random.default_rng([seed, k]), ROBOTS[DRAWN[k % len(DRAWN)]]()
    path = folder / "drawn.toml"
    path.write_text(robot_toml(believed, "drawn"), encoding="utf-8")
    robot = load_robot(path)
    while True:
        plan = continuous_motion(believed, 160, rng) if k % 5 == 4 else approaches(believed, 12, rng)
        ahead = np.tile([0.0, 0.0, 1.0], (int(plan.measured.sum()), 1))
        path.with_suffix(".csv").write_text(measurements_csv(plan, 0.05 * ahead, ahead), encoding="utf-8")
        data = load_measurements(path.with_suffix(".csv"), robot)
        effects = {t.name: t for t in rng.permutation(np.array(candidates(robot, data).terms, object))}
        base = BaseParameters()
        terms = [term(base, [parameter.name for parameter in base.parameters(robot)], robot)]
        chain = ParametricChain(robot, data, [*terms, *list(effects.values())[: k % 3]])
        p = np.clip(chain.neutral + chain.prior * rng.standard_normal(len(chain.prior)), chain.lower, chain.upper)
        try:
            there = chain.predict(p, derivatives=False)
        except InputError:  # no such robot
            continue
        if not there.failed.any():
            break
    noise = noise_floor(robot, data)[0]
    position = there.position_m + noise.position_m * rng.standard_normal(there.position_m.shape)
    tangent = there.tangent + np.cross(noise.tangent_rad * rng.standard_normal(there.tangent.shape), there.tangent)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return robot, replace(data, position_m=position, tangent=tangent)


def across(tangent: Array) -> Array:
    """The directions of another axis of the sensor (K, 3)."""
    other = np.cross(tangent, [1.0, 0.0, 0.0])
    return np.asarray(other / np.linalg.norm(other, axis=1, keepdims=True))


def uncalibrated_m(robot: Robot, data: Measurements) -> float:
    """Rms distance [m] of the tips from those of the robot as its file has it; infinite where it can't stand so."""
    joints = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    try:
        tips = robot.mechanics.tips(*robot.collars(*joints))[0]
    except InputError:  # no tube stands there
        return np.inf
    error = np.linalg.norm(tips - data.position_m, axis=1)
    return float(np.sqrt(np.mean(error**2))) if np.isfinite(error).mean() > 0.8 else np.inf


def turned(data: Measurements) -> Measurements:
    """The robot turned as a whole from one configuration to the next, so that every tube turns."""
    turn = 0.7 * (1 + data.sequence)
    spin: Callable[[Array], Array] = Rotation.from_rotvec(np.outer(turn[data.rows], [0, 0, 1])).apply
    tangent = spin(data.tangent) if data.has_tangents else data.tangent
    theta = data.theta_commanded + turn[:, None]
    return replace(data, theta_commanded=theta, position_m=spin(data.position_m), tangent=tangent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--clean", action="store_true")
    parser.add_argument("--drawn", type=int, default=0, help="clean files that are drawn")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    named, made, small, alarms, seconds = Counter[str](), Counter[str](), Counter[str](), 0, list[float]()
    for folder, robot, data in files(given.folders, given.drawn, given.seed):
        began = time.process_time()
        if told := read_again(robot, data):
            alarms += 1
            print(f"{folder}: {told[0].sentence}", flush=True)
        seconds.append(time.process_time() - began)
        if given.clean:
            continue
        data = turned(data)
        least = GROSS * uncalibrated_m(robot, data)
        for kind, words, (other, read) in faults(robot, data):
            if kind != "tangents" and uncalibrated_m(other, read) < least:
                small[kind] += 1
                continue
            made[kind] += 1
            said = read_again(other, read)
            named[kind] += bool(said and words in said[0].what)
            if not (said and words in said[0].what):
                print(f"{folder}, {kind}, {words}: {said[0].what if said else 'nothing'}", flush=True)
    print("\n| | goal | share | trials | 95 % interval |\n|---|---|---|---|---|")
    print(Goal("clean files with an alarm", "none", alarms, len(seconds)).line())
    for kind in made:
        print(Goal(f"{kind} ({small[kind]} too small)", "", named[kind], made[kind]).line())
    print(Goal("all gross faults, named first", ">= 95 %", named.total(), made.total()).line())
    print(f"\n{np.median(seconds):.2f} s of a processor for a file in the median")


if __name__ == "__main__":
    main()
