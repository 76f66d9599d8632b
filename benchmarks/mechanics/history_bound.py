"""Is the friction bound a bound? Random histories against the corners at every configuration they visit."""

import itertools
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from common import ROBOTS, table, tube

from ctrplan import Robot, Status, load_robot, robot_from_dict
from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import Accuracy

PAIR, THREE = (load_robot(ROBOTS / f"{name}.toml") for name in ("table_5_pair", "three_tube"))
PAIR_L_M = np.array([0.0, -0.0604])  # curved part of the inner tube half extended
HISTORIES = 1000  # of each robot
LEGS = (3, 10)
MOST_TURN_RAD = 4 * np.pi
SAMPLE_RAD, SAMPLE_M = np.radians(20.0), 6e-3
INNER_L_M = {2: (-0.1034, -0.0170), 3: (-0.1204, -0.0340)}  # range of the innermost tube's base
LABELLED = (("pair (Table V)", PAIR), ("three tubes (Table II)", THREE))
Row = tuple[object, ...]
WALKED = 8  # samples before a violation
SLACK_SHARE, SLACK_M = 0.01, 0.05e-3


def norm_mm(vectors: Array) -> Array:
    """(...,) lengths in mm of (..., 3) in m."""
    length: Array = 1e3 * np.linalg.norm(vectors, axis=-1)
    return length


def random_path(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array]:
    """Waypoints (K, n), (K, n): legs of rotation, translation or both."""
    n, low, high = robot.n, *INNER_L_M[robot.n]
    turn = np.concatenate([[0.0], np.cumsum(rng.uniform(-np.pi, np.pi, n - 1))])
    l_b = np.array([0.0, -0.017, -0.034])[:n]
    l_b[-1] = rng.uniform(low, high)
    waypoints = [(turn, l_b)]
    for _ in range(rng.integers(LEGS[0], LEGS[1] + 1)):
        kind = rng.integers(3)
        turn, l_b = waypoints[-1][0].copy(), waypoints[-1][1].copy()
        if kind != 1:
            turn[1:] += np.cumsum(rng.uniform(-MOST_TURN_RAD, MOST_TURN_RAD, n - 1) * rng.uniform(0, 1, n - 1))
        if kind != 0:
            l_b[-1] = rng.uniform(low, high)
        waypoints.append((turn, l_b))
    return np.array([turn for turn, _ in waypoints]), np.array([l_b for _, l_b in waypoints])


def sampled(turns: Array, l_b: Array) -> tuple[Array, Array]:
    """The path with waypoints at most SAMPLE_RAD and SAMPLE_M apart."""
    out = [(turns[0], l_b[0])]
    for k in range(len(turns) - 1):
        far = max(np.abs(turns[k + 1] - turns[k]).max() / SAMPLE_RAD, np.abs(l_b[k + 1] - l_b[k]).max() / SAMPLE_M)
        for part in np.linspace(0, 1, max(1, int(np.ceil(far))) + 1)[1:]:
            out.append((turns[k] + part * (turns[k + 1] - turns[k]), l_b[k] + part * (l_b[k + 1] - l_b[k])))
    return np.array([turn for turn, _ in out]), np.array([shift for _, shift in out])


def walk(robot: Robot, start: tuple[float, ...], theta_b: Array, l_b: Array, tally: Counter[str]) -> list[int]:
    """Simulates one history; rows that are beyond the bound. Where the frictionless robot is unstable there is none."""
    found = robot.history(start).follow(theta_b, l_b)
    bounds = robot.bound_many(theta_b, l_b, threads=1)
    simulated = found.status != Status.FAILED
    promised = simulated & (bounds.status != Status.UNSTABLE) & np.isfinite(bounds.position_m)
    deviation_m = norm_mm(found.position_m - bounds.tip_m) * 1e-3
    beyond = promised & (deviation_m > (1 + SLACK_SHARE) * bounds.position_m + SLACK_M)
    tally["configurations"] += int(promised.sum())
    tally["without a bound"] += int((simulated & ~promised).sum())
    tally["beyond"] += int(beyond.sum())
    tally["snaps"] += int(np.nansum(found.snaps))
    tally["failed"] += int(not simulated.all())
    return np.flatnonzero(beyond).tolist()


def judge(
    robot: Robot, start: tuple[float, ...], theta_b: Array, l_b: Array, row: int, accuracy: Accuracy
) -> tuple[str, float, float]:
    history = robot.history(start, accuracy=accuracy)
    history.follow(theta_b[:row], l_b[:row])
    tip_m = history.advance(theta_b[row], l_b[row]).shape.tip_m
    free = history.tip_beside([0.0] * (robot.n - 1))
    corners = np.array([history.tip_beside(signs) for signs in itertools.product((1.0, -1.0), repeat=robot.n - 1)])
    bound_mm, deviation_mm = float(np.nanmax([*norm_mm(corners - free), 0.0])), float(norm_mm(tip_m - free))
    if np.isnan(free).any():
        elsewhere = robot.bound(theta_b[row], l_b[row], accuracy=accuracy)
        away_mm = float(norm_mm(tip_m - elsewhere.frictionless.tip_m))
        return "branch held by friction", away_mm, elsewhere.position_m * 1e3
    if deviation_mm <= (1 + SLACK_SHARE) * bound_mm + SLACK_M * 1e3:
        return "other branch", deviation_mm, bound_mm
    if np.isnan(corners).any():
        return "branch without all corners", deviation_mm, bound_mm
    return "beyond the corners", deviation_mm, bound_mm


def seen_on_the_way(robot: Robot, theta_b: Array, l_b: Array, row: int, deviation_mm: float) -> str:
    """What the planner's walk along the end of the way says, each of its solutions starting from the one before."""
    first = max(0, row - WALKED)
    walk = robot.mechanics.check_path(theta_b[first : row + 1], l_b[first : row + 1])
    if np.isin(walk.status, [Status.UNSTABLE, Status.FAILED]).any():
        return "snaps without friction"
    bound_mm = float(walk.position_m[-1]) * 1e3
    within = deviation_mm <= (1 + SLACK_SHARE) * bound_mm + SLACK_M * 1e3
    return f"{bound_mm:.2f} mm" if within else f"missed, {bound_mm:.2f} mm"


def examine(label: str, robot: Robot, count: int) -> tuple[Row, list[Row]]:
    """A row on one robot's histories, and a row for every violation."""
    tally, found, listed = Counter[str](), Counter[str](), list[Row]()
    for number in range(count):
        rng = np.random.default_rng((robot.n, number))
        start = tuple(rng.choice([0.0, 1.0, -1.0], robot.n - 1).tolist())
        theta_b, l_b = sampled(*random_path(robot, rng))
        for row in walk(robot, start, theta_b, l_b, tally):
            cause, *values = judge(robot, start, theta_b, l_b, row, "search")
            if cause == "beyond the corners":
                again, *values = judge(robot, start, theta_b, l_b, row, "certificate")
                cause = cause if again == cause else "discretisation"
            found[cause] += 1
            seen = seen_on_the_way(robot, theta_b, l_b, row, values[0])
            listed.append((label, number, row, cause, *(f"{value:.2f}" for value in values), seen))
    kinds = ", ".join(f"{number} {cause}" for cause, number in found.most_common()) or "none"
    faults, held = found["beyond the corners"] + found["discretisation"], found["branch held by friction"]
    off = tally["beyond"] / tally["configurations"], faults / (tally["configurations"] - held)
    counts = (tally[name] for name in ("configurations", "failed", "snaps"))
    shares = (f"{100 * (1 - share):.3f} %" for share in off)
    return (label, count, *counts, *shares, kinds, tally["without a bound"]), listed


def bound(count: int = HISTORIES) -> None:
    """Random histories on both robots; every violation with its cause."""
    found = [examine(label, robot, count) for label, robot in LABELLED]
    rows, listed = [row for row, _ in found], [row for _, violations in found for row in violations]
    head = "robot | histories | configurations | failed | snaps | within the bound | where their own branch has a bound"
    table("bound", f"{head} | causes of the rest | without a bound", rows)
    table("violations", "robot | history | sample | cause | deviation, mm | bound, mm | walked there", listed)
    said = [str(row[-1]) for row in listed]
    missed, told = sum("missed" in text for text in said), sum("mm" in text for text in said)
    counts = {"the robot snaps without friction too": len(said) - told}
    counts |= {"within the bound walked there": told - missed, "neither": missed}
    table("walked", "a walk along the path says | violations", counts.items())


ROBOTS_DRAWN, TURNS, STEP_RAD = 60, 2, np.radians(15.0)  # of the simulator; a robot's turns end at one configuration
FARTHEST_RAD = np.radians(120.0)
Drawn = tuple[Robot, Any, Array, Array]  # and the simulator's world, and collars


def drawn(n: int, rng: np.random.Generator) -> Drawn | None:
    """A robot of n tubes, its collars; None where it has no bound.

    One to three sections, bent by up to 120 deg; neighbours up to 30 times as stiff; clearances 0.01 to 0.5 mm and at
    most 2 % of the least radius of curvature; friction up to 0.5; 40 to 250 mm long.
    """
    from hidden_effects.contact import Pair
    from hidden_effects.tube import Section, Tube
    from hidden_effects.world import World

    l_b, tip = -np.cumsum(rng.uniform(5e-3, 40e-3, n)), rng.uniform(0.04, 0.12)
    stiff, bent = 10 ** rng.uniform(-2.5, -1.0, n), rng.uniform(0, np.radians(120), n)
    poisson, sections, sharpest = rng.uniform(0.2, 0.5, n), list[tuple[Section, ...]](), list[float]()
    for k in range(n):
        shares = rng.dirichlet(np.ones(int(rng.integers(1, 4))))
        lengths, towards = shares * (tip - l_b[k]), rng.uniform(-np.pi, np.pi, len(shares))
        size = bent[k] * rng.dirichlet(np.ones(len(shares))) / lengths
        size = np.where((rng.random(len(shares)) < 0.3) | (lengths < 5e-3), 0.0, np.minimum(size, 20.0))
        curved = zip(size * np.cos(towards), size * np.sin(towards), strict=True)
        sections.append(
            tuple(Section(float(a), (float(x), float(y))) for a, (x, y) in zip(lengths, curved, strict=True))
        )
        sharpest.append(float(size.max()))
        tip += rng.uniform(2e-3, 40e-3)
    outer_m, inner_m, pairs = [0.5e-3 * rng.uniform(0.6, 1.5)], list[float](), list[Pair]()
    for k in range(n - 1, -1, -1):  # from the innermost tube outwards
        inner_m.append(outer_m[-1] - 0.1e-3)
        if k:
            most = min(0.5e-3, 0.02 / max(sharpest[k], sharpest[k - 1], 1.0))
            gap = float(10 ** rng.uniform(-5, np.log10(most)))
            pairs.append(Pair(gap, float(rng.uniform(0, 0.5)), outer_m[-1] + gap, outer_m[-1]))
            outer_m.append(outer_m[-1] + gap + 0.1e-3)
    outer_m, inner_m, pairs = outer_m[::-1], inner_m[::-1], pairs[::-1]
    world = World(
        tuple(Tube(*row) for row in zip(outer_m, inner_m, stiff.tolist(), poisson.tolist(), sections, strict=True)),
        tuple(pairs),
    )
    tubes = []
    for tube_of in world.tubes:
        bends = ((1e3 * s.length_m, *s.curvature_per_m) for s in tube_of.sections)
        sizes = 2e3 * tube_of.outer_radius_m, 2e3 * tube_of.inner_radius_m, tube_of.bending_stiffness_Nm2
        tubes.append(tube(*sizes, bends, poisson_ratio=tube_of.poisson_ratio))
    contacts = [{"friction_coefficient": p.friction, "clearance_mm": 1e3 * p.clearance_m} for p in pairs]
    robot = robot_from_dict({"name": "drawn", "tube": tubes, "contact": contacts})
    theta = np.cumsum(rng.uniform(-np.pi, np.pi, n))
    bound = robot.bound(theta, l_b, accuracy="certificate")
    each = (bound.frictionless, *bound.corners)
    sound = np.isfinite(bound.position_m) and all(shape.status is Status.CONVERGED for shape in each)
    return (robot, world, theta, l_b) if sound else None


def simulated(robot: Robot, world: Any, theta: Array, l_b: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Tips of the independent rods: in friction states, and after turns whose slip they follow, each ended at theta."""
    from hidden_effects.equilibrium import CORNER_BARRIER, System, corner, tip_pose
    from hidden_effects.friction import SlipHistory
    from hidden_effects.poses import Solver

    pairs, solver = robot.n - 1, Solver(world)
    corners = np.array(list(itertools.product((1.0, -1.0), repeat=pairs)))
    chosen = corners if len(corners) <= 4 else rng.permutation(corners)[:4]
    for phi in [*chosen, *rng.uniform(-1, 1, (2, pairs))]:
        yield solver.pose(theta, l_b, phi)[0]
    for _ in range(TURNS):
        away = rng.uniform(-FARTHEST_RAD, FARTHEST_RAD, pairs)
        way = np.linspace(away, 0.0, int(np.ceil(np.abs(away).max() / STEP_RAD)) + 1)
        history: SlipHistory | None = None
        for by in way:
            system = System(world.tubes, world.pairs, theta + np.append(0.0, np.cumsum(by)), l_b, world.loads)
            free = corner([0.0] * pairs)
            middle = system.solve(system.cold(), free, CORNER_BARRIER, 1e-4)
            if history is None:
                loaded = rng.uniform(-1, 1, pairs)
                history = SlipHistory.begin(system, system.solve(middle, corner(loaded.tolist())), loaded)
                continue
            history = history.moved(system)
            state = system.solve(middle, history)
            history = history.after(system, state)
        yield tip_pose(system, state)[0]


def simulator(count: int = ROBOTS_DRAWN) -> None:
    """Robots that nobody chose: do the tips of another simulator stay within the bound?"""
    from hidden_effects.equilibrium import NoEquilibrium

    rng, tally = np.random.default_rng(47), dict[int, list[tuple[float, float]]]()
    refused, robots, off = Counter[int](), Counter[int](), Counter[int]()
    while sum(robots.values()) < count:
        n = 2 + sum(robots.values()) % 4
        made = drawn(n, rng)
        if made is None:
            refused[n] += 1
            continue
        robot, _, theta, l_b = made
        robots[n] += 1
        bound = robot.bound(theta, l_b, accuracy="certificate")
        try:
            for tip_m in simulated(*made, rng):
                away_mm = float(norm_mm(tip_m - bound.frictionless.tip_m))
                tally.setdefault(n, []).append((away_mm, 1e3 * bound.position_m))
        except (NoEquilibrium, np.linalg.LinAlgError):
            off[n] += 1
    rows = []
    for n, each in sorted(tally.items()):
        excess = np.array([away - most for away, most in each])
        within = [f"{np.sum(excess <= limit)} of {len(excess)}" for limit in (0.0, 0.1)]
        bounds_mm = sorted({most for _, most in each})
        rows.append((n, robots[n], refused[n], off[n], f"{np.median(bounds_mm):.2f}", *within, f"{excess.max():+.2f}"))
    head = "tubes | robots | without a bound | lost by the simulator | median bound, mm | tips within"
    table("simulator", f"{head} | or 0.1 mm beyond | farthest, mm", rows)
