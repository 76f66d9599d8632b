"""What bounds take beside the three-tube robot's solves: more tubes, calls from Python, inverse kinematics.

    python benchmarks/run.py bound_calls [times] [extremes] [threads] [tracking] [ways]

times: time and peak memory of one bound for 2 to 12 tubes. extremes: what the extreme corners miss of all of them.
threads: 10,000 bounds and 400 motions on two threads against one, by the clock and in seconds of the processor.
tracking: a step of `TipTracker` at 20 Hz on a circle, a line, through a lumen to its wall. ways: all ways to a point.
"""

import itertools
import multiprocessing
import resource
import time
from collections.abc import Iterator
from typing import Any

import common
import numpy as np
from common import ROBOTS, SCENARIOS, took, tube

import ctrplan
from ctrplan import CtrplanError, Robot, robot_from_dict

MOST_TUBES = 12
CONFIGURATIONS = 40  # per number of tubes, for what extremes miss
COLLAR_MM = 5.0


def nested_robot(n: int, friction: float = 0.2) -> Robot:
    """A robot of n curved tubes, each stiffer than the one within."""
    tubes = []
    for out in range(n - 1, -1, -1):
        sections = (30 + 15 * (n - 1 - out), 0, 0), (40, 0, 5 + 1.5 * (n - 1 - out))
        tubes.append(tube(1.0 + 0.5 * out, 0.7 + 0.5 * out, 0.01 * 1.6**out, sections, collar_length_mm=COLLAR_MM))
    return robot_from_dict({"tube": tubes, "contact": [{"friction_coefficient": friction}] * (n - 1)})


def anywhere(n: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Collars (n,) [rad], (n,) [m], tubes 5 to 10 mm behind each other."""
    apart = random.uniform(COLLAR_MM, 2 * COLLAR_MM, n) * 1e-3
    return random.uniform(-np.pi, np.pi, n), -np.concatenate([[0.0], np.cumsum(apart[1:])])


def measured(n: int, corners: str, line: Any) -> None:
    """Sends time [s], peak memory above that before [MB] and the corners of one bound; in a process of its own."""
    robot = nested_robot(n)
    theta_b, l_b = anywhere(n, np.random.default_rng(n))
    robot.zero_clearance(theta_b, l_b)
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    try:
        found = robot.bound(theta_b, l_b, corners=corners)
    except CtrplanError as refusal:
        line.send(str(refusal))
        return
    took, peak = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line.send((took, (peak - before) / 1024, len(found.corners), found.position_m * 1e3))


def times() -> Iterator[list[object]]:
    """A row per number of tubes."""
    for n in range(2, MOST_TUBES + 1):
        cells: list[object] = [n]
        for corners in ("all", "extreme"):
            here, there = multiprocessing.Pipe()
            process = multiprocessing.get_context("spawn").Process(target=measured, args=(n, corners, there))
            process.start()
            found = here.recv()
            process.join()
            is_refused = isinstance(found, str)
            cells += ["refused", "", "", ""] if is_refused else "{2} {0:.3f} {1:.0f} {3:.3f}".format(*found).split()
        yield cells


def extremes() -> Iterator[tuple[object, ...]]:
    """By how much the bound by extremes falls short of that over all corners."""
    for n in range(3, 7):
        random, short = np.random.default_rng(n), []
        for _ in range(CONFIGURATIONS):
            robot = nested_robot(n, friction=random.uniform(0.05, 0.4))
            q = anywhere(n, random)
            whole, part = (robot.bound(*q, corners=corners) for corners in ("all", "extreme"))  # type: ignore[arg-type]
            short.append([1 - part.position_m / whole.position_m, 1 - part.tangent_rad / whole.tangent_rad])
        worst = 100 * np.nanmax(short, axis=0)
        same = np.mean(np.nanmax(short, axis=1) < 1e-6)
        yield n, len(short), f"{worst[0]:.4f}", f"{worst[1]:.4f}", f"{100 * same:.0f} %"


ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")
MANY, MOTIONS = 10_000, 400
TRIES = 3  # in alternation, of which the best counts: whoever else uses the machine only makes it slower


def threads() -> Iterator[tuple[str, ...]]:
    """Seconds and their ratios; the clock shows a gain only where two cores are free."""
    random = np.random.default_rng(1)
    turn = random.uniform(-np.pi, np.pi, (MANY, 3))
    l_b = np.tile([0.0, -0.017, -0.0628], (MANY, 1)) - np.outer(random.uniform(0, 0.02, MANY), [0, 0, 1.0])
    scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
    drive = scenario.robot.drive
    ends = scenario.start + random.uniform(-0.3, 0.3, (2, MOTIONS, len(drive.joints))) * drive.is_rotation

    def motions(count: int) -> object:
        return ctrplan.MotionChecker(scenario).motions(*ends, threads=count)

    for name, call in {"bounds": lambda count: ROBOT.bounds(turn, l_b, threads=count), "motions": motions}.items():
        least = np.min([[took(call, count) for count in (1, 2)] for _ in range(TRIES)], axis=0)
        yield name, *(f"{x:.2f}" for x in (*least[:, 0], least[0, 0] / least[1, 0], *least[:, 1]))


LED = np.array([0.3, -0.4, 0.9, -0.04])  # joints where tracks in free space begin
POINTS = 150
PAST_THE_WALL_M = 12e-3


def tracks() -> dict[str, tuple[Any, Any, Any]]:
    """Robot or scenario, joints (m,) at the start and points (K, 3) by name; through the lumen at 2/3 of full speed."""
    common.end_searches_by_count()
    tip = frictionless(ROBOT, LED[None])[0]
    turn, way = np.linspace(0, 2.4, POINTS), np.linspace(0, 1, POINTS)
    circle = tip + 6e-3 * np.stack([np.cos(turn) - 1, np.sin(turn), 0 * turn], axis=1)
    straight = tip + way[:, None] * np.array([8e-3, -6e-3, 6e-3])
    scenario = ctrplan.load_scenario(SCENARIOS / "vessel.toml", ["planner.time_s=1"])
    corners, drive = ctrplan.plan(scenario, seed=0).waypoints, scenario.robot.drive
    legs = [corners[:1]]
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        count = int(np.ceil(30 * (np.abs(b - a) / drive.max_velocity).max()))
        legs.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    lumen = scenario.located(frictionless(scenario.robot, np.concatenate(legs)))
    wall = lumen[-1] + np.linspace(0, 1, POINTS // 2)[:, None] * np.array([0, PAST_THE_WALL_M, 0])
    return {
        "circle": (ROBOT, LED, circle),
        "line": (ROBOT, LED, straight),
        "vessel": (scenario, corners[0], lumen),
        "vessel, into the wall": (scenario, corners[-1], wall),
    }


def frictionless(robot: Robot, joints: Any) -> Any:
    """(K, 3) tips [m] at joints (K, m), robot's frame."""
    states = np.zeros((len(joints), robot.n - 1))
    return robot.mechanics.tips_with_friction(*robot.drive.collars(joints), states).position_m


def tracking() -> Iterator[tuple[str, ...]]:
    """Milliseconds of a processor a step, the best of TRIES for each, and what the steps did."""
    for (name, (given, begin, points)), friction in itertools.product(tracks().items(), (None, "released")):
        least_ms, steps = np.full(len(points), np.inf), []
        for _ in range(TRIES):
            tracker, steps, spent_ms = ctrplan.TipTracker(given, begin, friction=friction), [], []
            for point in points:
                begun = time.process_time()
                steps.append(tracker.step(point))
                spent_ms.append(1e3 * (time.process_time() - begun))
            least_ms = np.minimum(least_ms, spent_ms)
        left = 1e3 * float(np.percentile([step.tip_error_m for step in steps], 95))
        reached = f"{sum(step.status == 'reached' for step in steps)} of {len(steps)}"
        milliseconds = (f"{x:.1f}" for x in (*np.percentile(least_ms, [50, 95]), least_ms.max()))
        room = f"{1e3 * min(step.clearance_m for step in steps):.2f}"
        yield name, "unknown" if friction is None else "followed", *milliseconds, reached, f"{left:.3f}", room


WAYS = ("vessel", "ventricle", "heart_chamber", "airway", "sinus", "ribs", "biopsy_tour", "deploy")


def ways() -> Iterator[tuple[object, ...]]:
    """Seconds of a processor, the least of TRIES, for all ways to the goal of a scenario, and their branches."""
    for name in WAYS:
        scenario, spent = ctrplan.load_scenario(SCENARIOS / f"{name}.toml"), []
        for _ in range(TRIES):
            begun = time.process_time()
            result = ctrplan.inverse_kinematics(scenario, scenario.targets[0].tip_m)
            spent.append((time.process_time() - begun, took(lambda: result.branches)[1]))  # noqa: B023 (called at once)
        least = (f"{x:.3f}" for x in np.min(spent, axis=0))
        yield name, *least, len(result.configurations), len(result.valid), len(set(result.branches))


WHAT = "{0}: corners | {0}: time, s | {0}: memory, MB | {0}: bound, mm"
SECTIONS: dict[str, common.Table] = {
    "times": ("bounds of many tubes", f"tubes | {WHAT.format('all')} | {WHAT.format('extreme')}", times),
    "extremes": (
        "extreme corners",
        "tubes | configurations | largest shortfall of position, % | of tangent, % | exactly the same",
        extremes,
    ),
    "threads": (
        "threads",
        "what | one thread, s | two threads, s | times as fast | one, processor s | two, processor s",
        threads,
    ),
    "tracking": (
        "tracking",
        "track | friction | median ms | 95 % ms | largest ms | reached | 95 % left, mm | least clearance, mm",
        tracking,
    ),
    "ways": ("ways", "scenario | ways, s | their branches, s | configurations | valid | branches", ways),
}


def main() -> None:
    common.sections(common.arguments(__doc__, ("sections*", SECTIONS)).sections, SECTIONS)
