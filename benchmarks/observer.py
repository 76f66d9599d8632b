"""Following a robot: time per step, and tip errors one step ahead, with an observer and without.

    python benchmarks/observer.py [--sets N] [--measured ROBOT.toml LOG.csv]

Synthetic logs come from the independent generator of tests/oracles/hidden_effects: three tubes at 10 Hz with friction, of
a size that the generator draws and ctrplan is told or believes to be another by --friction-factor; 0.1 mm of noise. Every
log starts released, ctrplan follows a part of it from row --from on, whose history it has not seen. Beside the observer: a
history that starts released there, the frictionless robot, and that history corrected by the last row's error, which
needs no friction state at all. With --measured: the same of a log of one's own.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.experiment.measurements import Measurements
from ctrplan.robot.observer.slow_offset import SlowOffset
from ctrplan.robot.robot import Robot
from ctrplan.studies.follow import Following, follow

ORACLES = Path(__file__).resolve().parents[1] / "tests" / "oracles"
ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
SIZES = (1.0, 2.0, 4.0)


def rms_mm(off_m: Array) -> float:
    """Of rows (K,) that have a value."""
    return float(np.sqrt(np.nanmean(np.square(off_m))) * 1e3)


def held(error: Following) -> float:
    """Share of the errors (K, 3) of all coordinates that an interval widened by the noise covers."""
    noise = error.robot.measurement
    wide = 1.96 * (noise.position_sigma_m if noise else 0.0)
    inside = (error.low_m - wide <= error.measured_m) & (error.measured_m <= error.high_m + wide)
    return float(inside.mean())


def compared(name: str, robot: Robot, data: Measurements) -> None:
    """One row of the table."""
    bare = follow(robot, data)
    offset = follow(robot, data, offset=SlowOffset(2e-3, 20))
    history_off = bare.measured_m - bare.without_m
    same_run = np.diff(bare.data.sequence[bare.data.rows]) == 0
    held_on = np.linalg.norm(np.diff(history_off, axis=0), axis=1)[same_run]
    collars = robot.collars(data.theta_commanded[bare.data.rows], data.l_commanded[bare.data.rows])
    plain = robot.mechanics.tips_with_friction(*collars, np.zeros((len(bare.measured_m), robot.n - 1))).position_m
    later = slice(1, None)  # what nobody has seen is expected by nobody
    cells = [
        rms_mm(np.linalg.norm(bare.measured_m - plain, axis=1)[later]),
        rms_mm(bare.error_without_m[later]),
        rms_mm(held_on),
        rms_mm(bare.error_m[later]),
        rms_mm(offset.error_m[later]),
    ]
    print(f"| {name} | {len(bare.measured_m)} | " + " | ".join(f"{cell:.3f}" for cell in cells), end=" | ")
    print(f"{100 * held(bare):.0f} % | {100 * held(offset):.0f} % |", flush=True)


def header() -> None:
    """Of the table of errors."""
    names = ["frictionless", "history", "history + last error", "observer", "observer + offset 2 mm, 20 rows"]
    print("| log | rows | " + " | ".join(f"{name}, mm" for name in names) + " | held | held with offset |")
    print("|" + " --- |" * 9)


def synthetic(sets: int, begin: int, factor: float) -> None:
    """Logs of the independent generator, robot and friction as they are but for the factor."""
    sys.path.insert(0, str(ORACLES))
    from hidden_effects.case import Case, make, write

    for k in range(sets):
        size = SIZES[k % len(SIZES)]
        case = Case(f"f{k}", "single", 1000 + k, (("friction", size),), count=160, continuous=True)
        with tempfile.TemporaryDirectory() as folder:
            write(case, Path(folder))
            parameters = make(case).parameters["friction"]
            overrides = [f"contact.{i}.friction_coefficient={factor * mu:.6g}" for i, mu in friction_of(parameters)]
            robot = ctrplan.load_robot(Path(folder) / case.name / "robot.toml", overrides)
            data = ctrplan.load_measurements(Path(folder) / case.name / "measurements.csv", robot)
        values = ", ".join(f"{mu:.2f}" for _, mu in friction_of(parameters))
        compared(f"synthetic {k + 1}, friction {values}", robot, since(data, begin))


def friction_of(parameters: dict[str, float]) -> list[tuple[int, float]]:
    """Pairs from 1 and their coefficients."""
    return list(enumerate(np.ravel(list(parameters.values())).tolist(), start=1))


def since(data: Measurements, begin: int) -> Measurements:
    """The log from a row on, all of whose rows are measured."""
    rows = slice(begin, None)
    return replace(
        data,
        sequence=data.sequence[rows],
        theta_commanded=data.theta_commanded[rows],
        l_commanded=data.l_commanded[rows],
        rows=np.arange(len(data.sequence) - begin),
        position_m=data.position_m[rows],
        tangent=data.tangent[rows],
        time_s=None if data.time_s is None else data.time_s[rows],
        more={name: values[rows] for name, values in data.more.items()},
        frame=None if data.frame is None else data.frame[rows],
    )


def times() -> None:
    """Wall time of steps of 2 deg and 0.2 mm by number of histories, none of which a measurement rules out."""
    print("| robot | histories | a step, median | 95 % | predict | first step |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in ("table_5_pair.toml", "three_tube.toml"):
        robot = ctrplan.load_robot(ROBOTS / name)
        for members in (9, 25):
            print(
                f"| {robot.name} | {members} | {' | '.join(f'{ms:.1f} ms' for ms in step_times_ms(robot, members))} |"
            )


def step_times_ms(robot: Robot, members: int) -> list[float]:
    """Median and 95 % of a step's time, median of a prediction's, and of the first step's."""
    theta, l_b = np.arange(robot.n) * 1.0, np.array([0.0, -0.017, -0.06][: robot.n] if robot.n > 2 else [0.0, -0.06])
    spent: dict[str, list[float]] = {"step": [], "predict": [], "first": []}

    def timed(kind: str, call: object, *joints: Array) -> None:
        began = time.perf_counter()
        call(*joints)  # type: ignore[operator]
        spent[kind].append(time.perf_counter() - began)

    for _ in range(8):
        observer = robot.observer(0.1e-3, members=members)
        timed("first", observer.observe, theta, l_b)
        for k in range(1, 7):
            turned, moved = theta + np.radians(2.0 * k) * (np.arange(robot.n) > 0), l_b.copy()
            moved[-1] += 0.2e-3 * k
            timed("predict", observer.predict, turned, moved)
            timed("step", observer.observe, turned, moved)
    step, predict, first = (np.array(spent[kind]) * 1e3 for kind in ("step", "predict", "first"))
    return [float(np.median(step)), float(np.quantile(step, 0.95)), float(np.median(predict)), float(np.median(first))]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=3)
    parser.add_argument("--from", type=int, default=40, dest="begin")
    parser.add_argument("--friction-factor", type=float, default=1.0)
    parser.add_argument("--measured", nargs=2, metavar=("ROBOT.toml", "LOG.csv"))
    parser.add_argument("--set", action="append", default=[], dest="overrides", help="with --measured")
    arguments = parser.parse_args()
    if arguments.measured:
        own = ctrplan.load_robot(arguments.measured[0], arguments.overrides)
        header()
        compared(Path(arguments.measured[1]).stem, own, ctrplan.load_measurements(arguments.measured[1], own))
    else:
        times()
        print()
        header()
        synthetic(arguments.sets, arguments.begin, arguments.friction_factor)
