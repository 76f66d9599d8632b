"""Where plans arrive: beside the bound, hunted by random pasts, and how much turning or sliding erases friction.

    python benchmarks/run.py --write arrival scenarios [NAME ...]
    python benchmarks/run.py arrival queries [--count N]
    python benchmarks/run.py arrival hunt [--pasts N] [--seed N]
    python benchmarks/run.py arrival erasure

scenarios, queries: each planned twice, as it is and without compensation and endings.
hunt: two plans of each robot in free space, with friction coefficients known to 30 %. Each is driven after random pasts
(turns of up to two turns, slides, oscillations) that end at its start, with coefficients anywhere in their intervals
and joints late or too far by up to the drive's tolerance.
erasure: corners of friction and the released state at one configuration, driven one way until their tips agree.
"""

import copy
import itertools
import time
from dataclasses import replace
from typing import Any

import common
import numpy as np
from common import ROBOTS, SCENARIOS, table
from planning_queries import queries

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, NoAnswerError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.storage.toml_document import read_document

BOUND_M = 0.3e-3  # by which a past may leave the bound at the start and still be of its branch
WOUND = 2.5  # times the precurvature of the pair, so that it has a second stable shape
SHARE = 0.3  # by which friction coefficients are uncertain in the hunt


def compared(cases: list[tuple[str, Scenario]]) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name, scenario in cases:
        settings = replace_settings(scenario)
        try:
            began = time.process_time()
            plan = ctrplan.plan(scenario)
            spent_s = time.process_time() - began
            bare = ctrplan.plan(settings, compensated=False)
        except NoAnswerError as error:
            rows.append((name, str(error).rsplit(": ", 1)[-1]))
            continue
        for number, (goal, at, before) in enumerate(
            zip(scenario.targets, plan.certificate.targets, bare.certificate.targets, strict=True), start=1
        ):
            if at.arrival is None or before.arrival is None or goal.tip_m is None:
                continue
            causes = [f"{1e3 * share:.2f} {words}" for words, share in at.arrival.by_cause.told[:2]]
            longer = (plan.certificate.length_mm - bare.certificate.length_mm) if number == 1 else ""
            rows.append(
                (
                    name if len(scenario.targets) == 1 else f"{name}, target {number}",
                    f"{1e3 * goal.tolerance_m:.2f} mm", f"{1e3 * at.bound_m:.2f} mm",
                    f"{1e3 * before.arrival.error_m:.2f} mm", f"{1e3 * at.arrival.error_m:.2f} mm",
                    "yes" if at.arrival.error_m <= goal.tolerance_m else "no", ", ".join(causes),
                    longer if longer == "" else f"{longer:+.0f} mm", f"{spent_s:.1f} s",
                )
            )  # fmt: skip
            print(rows[-1], flush=True)
    return rows


def replace_settings(scenario: Scenario) -> Scenario:
    """The scenario without an ending."""
    from msgspec.structs import replace as with_settings

    return replace(scenario, planner=with_settings(scenario.planner, settle="none"))


HEAD = ("scenario", "tolerance", "bound at the target", "arrival before", "arrival", "within", "largest causes")
HEAD += ("longer by", "processor")


INNERMOST = {
    "outer_diameter_mm": 1.5, "inner_diameter_mm": 1.2, "bending_stiffness_Nm2": 0.007, "poisson_ratio": 0.3,
    "collar_length_mm": 17, "section": [
        {"length_mm": 240, "curvature_x_per_m": 0, "curvature_y_per_m": 0},
        {"length_mm": 80, "curvature_x_per_m": 0, "curvature_y_per_m": 20.0},
    ],
}  # fmt: skip


def robots() -> dict[str, dict[str, Any]]:
    """Contents of robot files by name; the last one is wound: its tubes are bent so much that it has two shapes."""
    files = {"pair": "table_5_pair", "three tubes": "three_tube", "insertion": "three_tube_insertion"}
    result = {name: dict(read_document(ROBOTS / f"{file}.toml").content) for name, file in files.items()}
    three, pair = result["three tubes"], result["pair"]
    joints = [{**joint, "moves": {k: [*v, 0] for k, v in joint["moves"].items()}} for joint in three["joint"]]
    joints.append({"name": "rotate innermost", "moves": {"theta": [0, 0, 0, 1]}})
    joints.append({"name": "translate innermost", "moves": {"l": [0, 0, 0, 1]}, "min_mm": -80, "max_mm": 0})
    four = {**three, "joint": joints, "home": {"l_mm": [0, -17, -34, -51]}, "tube": [*three["tube"], INNERMOST]}
    four["contact"] = [*three["contact"], {"friction_coefficient": 0.2}]
    bent = copy.deepcopy(pair)
    for tube in bent["tube"]:
        for section in tube["section"]:
            section["curvature_y_per_m"] *= WOUND
    return {**result, "four tubes": four, "wound": bent}


def uncertain(content: dict[str, Any]) -> Robot:
    """The robot with friction coefficients known to SHARE."""
    contacts = [dict(contact) for contact in content["contact"]]
    for contact in contacts:
        mu = contact.get("friction_coefficient", 0.2)
        contact["friction_coefficient"] = [mu * (1 - SHARE), mu * (1 + SHARE)]
    return robot_from_dict({**content, "contact": contacts})


def task(robot: Robot, rng: np.random.Generator) -> Scenario:
    """From random joint values to where the tip is at others."""
    bare, space = bare_scenario(robot), JointSpace.of_robot(robot)
    while True:
        a, b = space.sample(rng, 50)[:2]
        shapes = [robot.bound(*robot.drive.collars(q)) for q in (a, b)]
        if all(np.isfinite(s.position_m) and s.frictionless.stability > 0.3 and s.position_m > 1e-3 for s in shapes):
            return replace(bare, start=a, goal=Goal(None, shapes[1].frictionless.tip_m, 1e-3))


def past(robot: Robot, at: Array, rng: np.random.Generator) -> Array:
    """(K, m) corners of a random way that ends at joints (m,)."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    points = [at]
    for _ in range(rng.integers(1, 4)):
        q, kind = points[-1].copy(), rng.integers(4)
        if kind == 0:  # turns of one joint
            q[rng.choice(np.flatnonzero(drive.is_rotation))] += rng.uniform(-4 * np.pi, 4 * np.pi)
        elif kind == 1:  # of all
            q += np.where(drive.is_rotation, rng.uniform(-np.pi, np.pi, len(q)) * rng.choice([0.1, 0.3, 1]), 0.0)
        elif kind == 2:
            q += np.where(drive.is_rotation, 0.0, rng.uniform(-20e-3, 20e-3, len(q)))
        else:  # an oscillation that fades
            turn = np.where(drive.is_rotation, rng.uniform(-1, 1, len(q)), 0.0)
            points += [np.clip(q + (-0.7) ** k * turn, drive.lower, drive.upper) for k in range(6)]
        points.append(np.clip(q, drive.lower, drive.upper))
    ways = [q for q in (*points, *_one_by_one(points[-1], at, rng)) if space.allowed(q)]
    return np.array([*ways, at])


def _one_by_one(a: Array, b: Array, rng: np.random.Generator) -> list[Array]:
    """Joint after joint in random order."""
    q, ways = a.copy(), []
    for joint in rng.permutation(len(q)):
        q = q.copy()
        q[joint] = b[joint]
        ways.append(q)
    return ways if rng.random() < 0.6 else []


def executed(robot: Robot, waypoints: Array, rng: np.random.Generator) -> Array:
    """(K, m) the legs, each joint late by up to the tolerance on the way, and too far at the end of the leg."""
    drive, space = robot.drive, JointSpace.of_robot(robot)
    most = np.where(drive.is_rotation, drive.execution.rotation_rad, drive.execution.translation_m)
    rows = [waypoints[0]]
    for a, b in itertools.pairwise(waypoints):
        way = np.sign(np.where(np.abs(b - a) > 1e-9, b - a, 0.0)) * most
        late = rng.uniform(0, 1, len(a)) * way
        steps = [a + share * (b - a) - late for share in np.linspace(0.1, 0.99, 8)] if np.any(way) else []
        beyond = np.clip(b + rng.uniform(0, 1, len(a)) * way, drive.lower, drive.upper)
        rows += [q for q in (*steps, b, beyond) if space.allowed(q)] + [b]
    return np.array(rows)


def hunted(name: str, content: dict[str, Any], pasts: int, seed: int) -> list[tuple[object, ...]]:
    robot, rng, rows = uncertain(content), np.random.default_rng([seed, len(name)]), []
    while len(rows) < 2:
        scenario = task(robot, rng)
        try:
            plan = ctrplan.plan(scenario, time_s=1.0, seed=seed)
        except NoAnswerError:
            continue
        arrival, start = plan.certificate.arrival, robot.drive.collars(scenario.start)
        assert arrival is not None and scenario.goal.tip_m is not None
        bound = robot.bound(*start)
        seen, other, failed = [], 0, 0
        for _ in range(pasts):
            mu = [rng.uniform(*contact.friction_coefficient) for contact in robot.contacts]
            contacts = [replace(c, friction_coefficient=(m, m)) for c, m in zip(robot.contacts, mu, strict=True)]
            driven = replace(robot, contacts=tuple(contacts)).history("released")
            try:
                before = driven.follow(*robot.drive.collars(past(robot, scenario.start, rng)))
                away_m = np.linalg.norm(before.position_m[-1] - bound.frictionless.tip_m)
                end = driven.follow(*robot.drive.collars(executed(robot, plan.waypoints, rng))).position_m[-1]
            except CtrplanError:
                failed += 1
                continue
            if not away_m <= bound.position_m + BOUND_M:
                other += 1
            else:
                seen.append(float(np.linalg.norm(end - scenario.goal.tip_m)))
        largest, claimed = max(seen, default=np.nan), arrival.error_m
        outside = sum(error > claimed for error in seen)
        lengths = [f"{1e3 * x:.3f} mm" for x in (largest, claimed)]
        bound_mm = f"{1e3 * plan.certificate.goal_bound_m:.2f} mm"
        rows.append((name, len(seen), other, failed, outside, *lengths, f"{largest / claimed:.2f}", bound_mm))
        print(rows[-1], flush=True)
    return rows


def way_to(robot: Robot, theta: Array, l: Array, turn: Array, slide: Array, rows: int) -> tuple[float, list[float]]:  # noqa: E741
    """Largest distance [mm] of tips at first, and shares of the way after which 1 and 0.1 % of it are left."""
    starts = ["released", *itertools.product((1.0, -1.0), repeat=robot.n - 1)]
    share, tips = np.linspace(0, 1, rows + 1)[:, None], []
    for start in starts:
        tips.append(robot.history(start).follow(theta + share * turn, l + share * slide).position_m)
    apart = np.max([np.linalg.norm(a - b, axis=1) for a, b in itertools.combinations(tips, 2)], axis=0)
    last = [np.flatnonzero(apart > left * apart[0]) for left in (0.01, 0.001)]
    return 1e3 * apart[0], [(above[-1] + 1) / rows if above[-1] < rows else np.inf for above in last]


def said(motion: float, unit: str) -> str:
    return f"{motion:.{0 if unit == 'deg' else 1}f} {unit}" if np.isfinite(motion) else "never"


def erasure() -> None:
    rows = []
    pair, three = (read_document(ROBOTS / name).content for name in ("table_5_pair.toml", "three_tube.toml"))
    for angle, mu, gap in (
        (60, 0.2, None),
        (170, 0.2, None),
        (60, 0.5, None),
        (170, 0.5, None),
        (120, 0.2, 0.005),
        (120, 0.2, 0.15),
    ):
        contact = {**pair["contact"][0], "friction_coefficient": mu, **({} if gap is None else {"clearance_mm": gap})}
        robot = robot_from_dict({**pair, "contact": [contact]})
        place = np.array([0, -90e-3])
        what = f"pair, {angle} deg, friction {mu}" + (f", clearance {gap} mm" if gap else "")
        first, left = way_to(robot, np.radians([0, angle]), place, np.zeros(2), np.array([0, 30e-3]), 300)
        rows.append((what, "slide", f"{first:.1f} mm", *(said(30 * x, "mm") for x in left)))
        if gap is None:
            first, left = way_to(robot, np.radians([0, angle]), place, np.radians([0, 180]), np.zeros(2), 360)
            rows.append((what, "turn", f"{first:.1f} mm", *(said(180 * x, "deg") for x in left)))
    robot, at = robot_from_dict(three), (np.radians([0, 60, 40]), np.array([0, -17e-3, -80e-3]))
    moves = {
        "inner slides": ([0, 0, 0], [0, 0, 40e-3]),         "inner turns": ([0, 0, np.pi], [0, 0, 0]),
        "middle and inner turn": ([0, -np.pi, np.pi / 2], [0, 0, 0]),
        "all turn together": ([np.pi] * 3, [0, 0, 0]),
    }  # fmt: skip
    for what, (turn, slide) in moves.items():
        first, left = way_to(robot, *at, np.array(turn), np.array(slide), 200)
        scale, unit = (180, "deg") if any(turn) else (1e3 * max(map(abs, slide)), "mm")
        rows.append(("three tubes", what, f"{first:.1f} mm", *(said(scale * x, unit) for x in left)))
    table("erasure", ("robot", "motion", "apart at first", "1 % is left after", "0.1 %"), rows)


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("section", choices=["scenarios", "queries", "hunt", "erasure"])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--count", type=int, default=46)
    parser.add_argument("--pasts", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.section == "scenarios":
        paths = [p for p in sorted(SCENARIOS.glob("*.toml")) if not given.names or p.stem in given.names]
        table("scenarios", HEAD, compared([(path.stem, ctrplan.load_scenario(path)) for path in paths]))
    elif given.section == "queries":
        table("queries", HEAD, compared([(query.name, query.load([])) for query in queries()[: given.count]]))
    elif given.section == "hunt":
        chosen = {name: content for name, content in robots().items() if not given.names or name in given.names}
        head = (
            "robot",
            "pasts",
            "of another branch",
            "without equilibrium",
            "outside",
            "largest seen",
            "claimed",
            "ratio",
        )
        found = [row for name, content in chosen.items() for row in hunted(name, content, given.pasts, given.seed)]
        table("hunt", (*head, "bound"), found)
    else:
        erasure()
