"""Following a robot: time per step, and tip errors one step ahead, with an observer and without.

    python benchmarks/run.py observer [--only times|small|log]
    python benchmarks/run.py observer --measured ROBOT.toml LOG.csv [--slow NAME=SIGMA ...] [--set KEY=VALUE ...]

Small motions are of ctrplan's own histories, noise 0.1 mm. The synthetic log comes from the independent generator of
tests/oracles/hidden_effects: three tubes as ctrplan believes them on a continuous motion at 10 Hz, with friction, which
ctrplan is told. It follows the log from row FIRST on, and knows nothing of what was before. Beside the observer: the
frictionless robot, a history that starts released there, and that history corrected by the error of the row before,
which needs no friction state. Held: share of measured coordinates inside the interval of 95 %, noise added in squares,
and half the interval's width. --measured: a log of one's own.
"""

import itertools
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import common
import numpy as np
from common import ROBOTS, table, took

import ctrplan
from ctrplan import Measurements, Robot
from ctrplan.base.arrays import Array
from ctrplan.robot.slow_states import SlowOffset, SlowParameter
from ctrplan.studies.follow import Following, follow

SIZE = 4.0  # times 0.015, about: coefficients of friction
ROWS, FIRST, MOST_ATTEMPTS = 90, 30, 8


def rms_mm(off_m: Array) -> float:
    """Root mean square [mm] over the rows (K,) that have a value."""
    return float(np.sqrt(np.nanmean(np.square(off_m))) * 1e3)


def held(error: Following) -> str:
    """Share of measured coordinates (K, 3) inside the interval, noise added in squares, and its median half width."""
    noise = 1.96 * (error.robot.measurement.position_sigma_m if error.robot.measurement else 0.0)
    middle, half = (error.low_m + error.high_m) / 2, (error.high_m - error.low_m) / 2
    share = (np.abs(error.measured_m - middle) <= np.hypot(half, noise)).mean()
    return f"{100 * share:.0f} %, {1e3 * np.median(half):.2f} mm"


def compared(name: str, robot: Robot, data: Measurements, slow: Sequence[SlowParameter] = ()) -> Iterator[list[object]]:
    """A row of the table; another with slow parameters, if there are any."""
    later = slice(1, None)  # what nobody has seen is expected by nobody
    for slow_ones in [(), slow] if slow else [()]:
        bare, offset = (follow(robot, data, offset=of, slow=slow_ones) for of in (None, SlowOffset(2e-3, 20)))
        cells: list[object] = ["-", "-", "-"]
        if not slow_ones:
            history_off = bare.measured_m - bare.without_m
            same_run = np.diff(bare.data.sequence[bare.data.rows]) == 0
            held_on = np.linalg.norm(np.diff(history_off, axis=0), axis=1)[same_run]
            collars = robot.collars(data.theta_commanded[bare.data.rows], data.l_commanded[bare.data.rows])
            none = np.zeros((len(bare.measured_m), robot.n - 1))
            plain_off = bare.measured_m - robot.mechanics.tips_with_friction(*collars, none).position_m
            off_m = (np.linalg.norm(plain_off, axis=1)[later], bare.error_without_m[later], held_on)
            cells = [f"{rms_mm(of):.3f}" for of in off_m]
        cells += [f"{rms_mm(of.error_m[later]):.3f}" for of in (bare, offset)]
        yield [name + ", slow parameters" * bool(slow_ones), len(bare.measured_m), *cells, held(bare), held(offset)]
        for key, values in bare.parameters.items():
            print(f"{key}: {values[-1, 0]:.4g} +- {1.96 * values[-1, 1]:.2g}", file=sys.stderr)


def translations(n: int, inner_m: Array) -> Array:
    """(K, n) [m] of two or three tubes, of which the innermost one moves."""
    l_b = np.tile([0.0, -0.06] if n == 2 else [0.0, -0.017, -0.06], (len(inner_m), 1))
    l_b[:, -1] += inner_m
    return l_b


def small_motions() -> Iterator[list[object]]:
    """Logs of ctrplan's own histories, which begin loaded: motions too small to wipe out what was before."""
    for name in ("table_5_pair.toml", "three_tube.toml"):
        robot = ctrplan.load_robot(ROBOTS / name, ["measurement.position_sigma_mm=0.1"])
        n, phase = robot.n, np.linspace(0, 4 * np.pi, 80)
        theta = np.outer(1.0 + 0.12 * np.sin(phase), np.arange(n))
        l_b = translations(n, 0.1e-3 * np.sin(3 * phase))
        truth = robot.history([0.7, -0.9][: n - 1]).follow(theta, l_b)
        seen = truth.position_m + 0.1e-3 * np.random.default_rng(n).standard_normal(truth.position_m.shape)
        rows = np.arange(len(theta))
        log = Measurements(0 * rows, theta, l_b, rows, seen, np.full(seen.shape, np.nan))  # one run, all rows measured
        yield from compared(f"small motions, {robot.name}", robot, log)


def synthetic(place: Path) -> Iterator[list[object]]:
    """A log of the independent generator, friction as it is."""
    make_log(place)
    friction = json.loads((place / "truth.json").read_text())["friction"]
    overrides = [f"contact.{i}.friction_coefficient={mu:.6g}" for i, mu in enumerate(friction, start=1)]
    robot = ctrplan.load_robot(place / "robot.toml", overrides)
    data = ctrplan.load_measurements(place / "measurements.csv", robot)
    values = ", ".join(f"{mu:.2f}" for mu in friction)
    yield from compared(f"tubes as believed, friction {values}", robot, since(data, FIRST))


def make_log(place: Path) -> None:
    """ROWS rows of the first continuous motion that keeps an equilibrium, with noise; a minute or so."""
    from hidden_effects import effects, experiment
    from hidden_effects.chain import poses
    from hidden_effects.dataset import measurements_csv, robot_toml, write_folder
    from hidden_effects.equilibrium import NoEquilibrium
    from hidden_effects.noise import add_noise
    from hidden_effects.world import believed

    for attempt in range(MOST_ATTEMPTS):
        rng = np.random.default_rng([2, 23, attempt])
        motion = experiment.continuous_motion(believed(), ROWS, rng)
        world, parameters = effects.apply("friction", believed(), effects.Draw(SIZE, rng, motion.duration_s))
        try:
            found = poses(world, motion)
            break
        except NoEquilibrium:
            continue
    else:
        raise SystemExit("the generator found no equilibrium in any motion")
    rows = measurements_csv(motion, *add_noise(found.p, found.tangent, "gaussian", rng))
    files = {"robot.toml": robot_toml(believed(), "three tubes"), "measurements.csv": rows}
    write_folder(place, files, {"friction": list(parameters.values())})


def since(data: Measurements, begin: int) -> Measurements:
    """The log from a row on, all of whose rows are measured."""
    names = ("sequence", "theta_commanded", "l_commanded", "position_m", "tangent", "time_s", "frame")
    parts = {name: None if (of := getattr(data, name)) is None else of[begin:] for name in names}
    more = {name: values[begin:] for name, values in data.more.items()}
    return replace(data, rows=np.arange(len(data.sequence) - begin), more=more, **parts)


def times() -> Iterator[list[object]]:
    """Steps of 1 deg and 0.1 mm, to and fro: of a bank that no tip tells apart, and of a measured one.

    Processor time, of all threads, and time by the clock, which says nothing where other work is done beside it.
    """
    for name in ("table_5_pair.toml", "three_tube.toml"):
        robot = ctrplan.load_robot(ROBOTS / name)
        friction = [SlowParameter(f"contact.{i}.friction_coefficient", 0.05) for i in range(1, robot.n)]
        for tips, slow in (("not measured", []), ("measured", []), ("measured, slow friction", friction)):
            both = zip(("clock", "processor"), step_times_ms(robot, tips != "not measured", slow), strict=True)
            for kind, values in both:
                yield [robot.name, 9, tips, kind, *(f"{ms:.1f} ms" for ms in values)]


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
            spent[name].append(took(getattr(observer, name), theta[ahead], l_b[ahead], *tip))
    steps, ahead_of = (1e3 * np.array(spent[name]) for name in ("observe", "predict"))
    later = steps[1:]
    rows = np.median(later, axis=0), np.quantile(later, 0.95, axis=0), later.max(axis=0), np.median(ahead_of, axis=0)
    return np.array([*rows, steps[0]]).T.tolist()


OF_TIMES = "robot | histories | tips | time | a step, median | 95 % | longest | predict, median | first step"
OF_ERRORS = "log | rows | frictionless, mm | history, mm | history + last error, mm | observer, mm"
OF_ERRORS += " | observer + offset 2 mm, 20 rows, mm | held | held with offset"


SECTIONS = ("times", "small", "log")


def main() -> None:
    given = common.arguments(__doc__, only=list(SECTIONS), measured=[""], set=[""], slow=[""])
    rows: list[Iterator[list[object]]] = []
    if any(given.measured):
        if len(given.measured) != 2:
            sys.exit("--measured needs two files, ROBOT.toml and LOG.csv")
        own = ctrplan.load_robot(given.measured[0], list(filter(None, given.set)))
        named = [SlowParameter(key, float(sigma)) for key, _, sigma in (of.partition("=") for of in given.slow) if key]
        data = ctrplan.load_measurements(given.measured[1], own)
        only, rows = [], [compared(Path(given.measured[1]).stem, own, data, named)]
    else:
        only = common.chosen(given.only, SECTIONS)
    if "times" in only:
        table("steps", OF_TIMES, times())
    with tempfile.TemporaryDirectory() as scratch:
        rows += [small_motions()] * ("small" in only)
        rows += [synthetic(Path(scratch) / "log")] * ("log" in only)
        if rows:
            table("errors one step ahead", OF_ERRORS, itertools.chain(*rows))
