"""Following a robot: time per step, and tip errors one step ahead, with an observer and without.

    python benchmarks/run.py observer [--only times|small|logs] [--sets N]
    python benchmarks/run.py observer --measured ROBOT.toml LOG.csv [--slow NAME=SIGMA ...]

Small motions are of ctrplan's own histories, noise 0.1 mm. Synthetic logs come from the independent generator of
tests/oracles/hidden_effects: three tubes on a continuous motion at 10 Hz, with friction, of tubes as ctrplan believes
them or a little different. ctrplan is told the friction, or that times --friction-factor. It follows a log from row
--from on, and knows nothing of what was before. Beside the observer: the frictionless robot, a history that starts
released there, and that history corrected by the error of the row before, which needs no friction state. Held: share of
measured coordinates inside the interval of 95 %, noise added in squares, and half the interval's width.
--measured: a log of one's own. --logs keeps the synthetic ones, which take a minute each.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import common
import numpy as np
from common import ROBOTS

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot
from ctrplan.robot.slow_states import SlowOffset, SlowParameter
from ctrplan.studies.follow import Following, follow

SIZES = (2.0, 4.0)  # times 0.015, about: coefficients of friction
ROWS, MOST_ATTEMPTS = 90, 8


def rms_mm(off_m: Array) -> float:
    """Root mean square [mm] over the rows (K,) that have a value."""
    return float(np.sqrt(np.nanmean(np.square(off_m))) * 1e3)


def held(error: Following) -> str:
    """Share of measured coordinates (K, 3) inside the interval, noise added in squares, and its median half width."""
    noise = 1.96 * (error.robot.measurement.position_sigma_m if error.robot.measurement else 0.0)
    middle, half = (error.low_m + error.high_m) / 2, (error.high_m - error.low_m) / 2
    share = (np.abs(error.measured_m - middle) <= np.hypot(half, noise)).mean()
    return f"{100 * share:.0f} %, {1e3 * np.median(half):.2f} mm"


def compared(name: str, robot: Robot, data: Measurements, slow: Sequence[SlowParameter] = ()) -> None:
    """One row of the table; another with slow parameters, if there are any."""
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
    print(f"{held(bare)} | {held(offset)} |", flush=True)
    if slow:
        bare, offset = (follow(robot, data, offset=of, slow=slow) for of in (None, SlowOffset(2e-3, 20)))
        cells[3:] = [rms_mm(bare.error_m[later]), rms_mm(offset.error_m[later])]
        print(f"| {name}, slow parameters | {len(bare.measured_m)} | - | - | - | ", end="")
        print(" | ".join(f"{cell:.3f}" for cell in cells[3:]) + f" | {held(bare)} | {held(offset)} |")
        for key, values in bare.parameters.items():
            print(f"{key}: {values[-1, 0]:.4g} +- {1.96 * values[-1, 1]:.2g}")


def translations(n: int, inner_m: Array) -> Array:
    """(K, n) [m] of two or three tubes, of which the innermost one moves."""
    l_b = np.tile([0.0, -0.06] if n == 2 else [0.0, -0.017, -0.06], (len(inner_m), 1))
    l_b[:, -1] += inner_m
    return l_b


def logged(theta: Array, l_b: Array, seen: Array) -> tuple[Array, ...]:
    """One run of joints and tips, every row measured."""
    count = len(theta)
    return np.zeros(count, int), theta, l_b, np.arange(count), seen, np.full(seen.shape, np.nan)


def header() -> None:
    """Header of the table of errors."""
    names = ["frictionless", "history", "history + last error", "observer", "observer + offset 2 mm, 20 rows"]
    print("| log | rows | " + " | ".join(f"{name}, mm" for name in names) + " | held | held with offset |")
    print("|" + " --- |" * 9)


def small_motions() -> None:
    """Logs of ctrplan's own histories, which begin loaded: motions too small to wipe out what was before."""
    noise = ["measurement.position_sigma_mm=0.1"]
    for name in ("table_5_pair.toml", "three_tube.toml"):
        robot = ctrplan.load_robot(ROBOTS / name, noise)
        n, phase = robot.n, np.linspace(0, 4 * np.pi, 80)
        theta = np.outer(1.0 + 0.12 * np.sin(phase), np.arange(n))
        l_b = translations(n, 0.1e-3 * np.sin(3 * phase))
        truth = robot.history([0.7, -0.9][: n - 1]).follow(theta, l_b)
        seen = truth.position_m + 0.1e-3 * np.random.default_rng(n).standard_normal(truth.position_m.shape)
        compared(f"small motions of a history, {robot.name}", robot, Measurements(*logged(theta, l_b, seen)))


def synthetic(folder: Path, sets: int, begin: int, factor: float) -> None:
    """Logs of the independent generator, friction as it is but for the factor; every second one of another robot."""
    for k in range(sets):
        of_another = bool(k % 2)
        place = folder / f"log_{k}"
        if not (place / "truth.json").exists():
            make_log(place, SIZES[k // 2 % len(SIZES)], k, of_another)  # of the first motion with equilibria
        friction = json.loads((place / "truth.json").read_text())["friction"]
        overrides = [f"contact.{i}.friction_coefficient={factor * mu:.6g}" for i, mu in enumerate(friction, start=1)]
        robot = ctrplan.load_robot(place / "robot.toml", overrides)
        data = ctrplan.load_measurements(place / "measurements.csv", robot)
        values = ", ".join(f"{mu:.2f}" for mu in friction)
        name = f"{'tubes a little different' if of_another else 'tubes as believed'}, friction {values}"
        compared(name, robot, since(data, begin))


def make_log(place: Path, size: float, number: int, of_another: bool) -> None:
    """ROWS rows of the first continuous motion that keeps an equilibrium, with noise; a minute or so."""
    from hidden_effects import effects, experiment
    from hidden_effects.chain import poses
    from hidden_effects.dataset import measurements_csv, robot_toml, write_folder
    from hidden_effects.equilibrium import NoEquilibrium
    from hidden_effects.noise import add_noise
    from hidden_effects.world import believed, draw_ordinary

    for attempt in range(MOST_ATTEMPTS):
        rng = np.random.default_rng([number, 23, attempt])
        motion = experiment.continuous_motion(believed(), ROWS, rng)
        world = draw_ordinary(believed().n, rng).of(believed()) if of_another else believed()
        world, parameters = effects.apply("friction", world, effects.Draw(size, rng, motion.duration_s))
        try:
            found = poses(world, motion)
            break
        except NoEquilibrium:
            continue
    else:
        raise SystemExit("the generator found no equilibrium in any motion")
    table = measurements_csv(motion, *add_noise(found.p, found.tangent, "gaussian", rng))
    files = {"robot.toml": robot_toml(believed(), "three tubes"), "measurements.csv": table}
    write_folder(place, files, {"friction": list(parameters.values())})


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
    """Steps of 1 deg and 0.1 mm, to and fro: of a bank that no tip tells apart, and of a measured one.

    Processor time, of all threads, and time by the clock, which says nothing where other work is done beside it.
    """
    print("| robot | histories | tips | time | a step, median | 95 % | longest | predict, median | first step |")
    print("|" + " --- |" * 9)
    for name in ("table_5_pair.toml", "three_tube.toml"):
        robot = ctrplan.load_robot(ROBOTS / name)
        friction = [SlowParameter(f"contact.{i}.friction_coefficient", 0.05) for i in range(1, robot.n)]
        for tips, slow in (("not measured", []), ("measured", []), ("measured, slow friction", friction)):
            for kind, values in zip(
                ("processor", "clock"), step_times_ms(robot, tips != "not measured", slow), strict=True
            ):
                print(f"| {robot.name} | 9 | {tips} | {kind} | " + " | ".join(f"{ms:.1f} ms" for ms in values) + " |")


def step_times_ms(robot: Robot, measured: bool, slow: Sequence[SlowParameter] = ()) -> list[list[float]]:
    """Median, 95 % and longest of a step's time, median of a prediction's, the first step's; both ways to measure."""
    n, phase = robot.n, np.arange(60.0)
    turn = np.where(phase < 30, phase, 60 - phase)
    theta = np.outer(1.0 + np.radians(turn), np.arange(n) > 0)
    l_b = translations(n, 0.1e-3 * turn)
    tips = robot.history(np.full(n - 1, 0.4)).follow(theta, l_b).position_m
    observer = robot.observer(0.1e-3, slow=slow)
    spent: dict[str, list[tuple[float, float]]] = {"observe": [], "predict": []}
    for k in range(len(turn)):
        for name in ("observe", "predict"):
            ahead = min(k + (name == "predict"), len(turn) - 1)
            tip = [tips[k]] if measured and name == "observe" else []
            began = time.process_time(), time.perf_counter()
            getattr(observer, name)(theta[ahead], l_b[ahead], *tip)
            spent[name].append((time.process_time() - began[0], time.perf_counter() - began[1]))
    steps, ahead_of = (1e3 * np.array(spent[name]) for name in ("observe", "predict"))
    later = steps[1:]
    rows = np.median(later, axis=0), np.quantile(later, 0.95, axis=0), later.max(axis=0), np.median(ahead_of, axis=0)
    return np.array([*rows, steps[0]]).T.tolist()


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("--only", choices=["times", "small", "logs"])
    parser.add_argument("--slow", action="append", default=[], metavar="NAME=SIGMA", help="with --measured")
    parser.add_argument("--sets", type=int, default=4)
    parser.add_argument("--from", type=int, default=30, dest="begin")
    parser.add_argument("--friction-factor", type=float, default=1.0)
    parser.add_argument("--logs", type=Path, help="folder for the synthetic logs")
    parser.add_argument("--measured", nargs=2, metavar=("ROBOT.toml", "LOG.csv"))
    parser.add_argument("--set", action="append", default=[], dest="overrides", help="with --measured")
    arguments = parser.parse_args()
    if arguments.measured:
        own = ctrplan.load_robot(arguments.measured[0], arguments.overrides)
        pairs = (text.split("=") for text in arguments.slow)
        named = [SlowParameter(key, float(sigma)) for key, sigma in pairs]
        header()
        compared(Path(arguments.measured[1]).stem, own, ctrplan.load_measurements(arguments.measured[1], own), named)
    if not arguments.measured and arguments.only in (None, "times"):
        times()
    if not arguments.measured and arguments.only in (None, "small", "logs"):
        header()
        if arguments.only != "logs":
            small_motions()
        if arguments.only != "small":
            with tempfile.TemporaryDirectory() as scratch:
                folder = arguments.logs or Path(scratch)
                synthetic(folder, arguments.sets, arguments.begin, arguments.friction_factor)
