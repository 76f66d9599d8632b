"""Where plans arrive: beside the bound, of queries, hunted by random pasts, and as steps of histories change it.

    python benchmarks/run.py --write arrival scenarios [NAME ...]
    python benchmarks/run.py --write arrival queries [SCENARIO ...]
    python benchmarks/run.py arrival hunt [--pasts N] [--sets N] [--seed N] [--accuracy MESH] [ROBOT ...]
    python benchmarks/run.py arrival steps [ROBOT ...]

scenarios, queries: each planned twice, as it is and without compensation and endings.
hunt: two plans of each robot in free space, with friction coefficients known to 30 %. For each set, coefficients
anywhere in their intervals are drawn, and how inexactly each leg is executed: joints late or too far by up to the
drive's tolerance. A robot with them moves about its start (turns, up to whole ones, slides, oscillations) and comes
back, again and again; every return is a past. The states that it has then are driven along the motion, those that have
become the same once from there on.
steps: what shorter steps of histories change at the ends of such plans, against what arrivals say of it.
"""

import copy
import itertools
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import common
import msgspec
import numpy as np
from common import ROBOTS, SCENARIOS, table
from planning_queries import queries

import ctrplan
from ctrplan.base import long_work
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, NoAnswerError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.history import HistoryOptions, HistoryState
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.prediction import STEP_M, STEP_RAD, predict_end, rows_to_simulate, start_states, step_error
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.storage.toml_document import read_document

long_work.REAL_PER_COUNTED = np.inf  # searches end by work counted, however busy the machine is
MERGED_EVERY = 4  # steps of simulation after which states of the hunt are compared
BOUND_M = 0.3e-3  # by which a past may leave the bound at the start and still be of its branch
WOUND = 2.5  # times the precurvature of the pair, so that it has a second stable shape
SHARE = 0.3  # by which friction coefficients are uncertain in the hunt


@dataclass(frozen=True)
class Compared:
    """A target of a plan, with and without ending and compensation; lengths in mm. `why` says why there is no plan."""

    name: str
    why: str = ""
    tolerance: float = np.nan
    bound: float = np.nan
    before: float = np.nan
    after: float = np.nan
    causes: str = ""
    longer: float = np.nan
    spent_s: float = np.nan
    place: int = 0  # of several targets

    def row(self) -> tuple[object, ...]:
        if self.why:
            return (self.name, *[""] * 5, self.why, "", "")
        name = f"{self.name}, target {self.place}" if self.place else self.name
        lengths = [f"{x:.2f} mm" for x in (self.tolerance, self.bound, self.before, self.after)]
        longer = "" if self.place > 1 else f"{self.longer:+.0f} mm"
        return (name, *lengths, "yes" if self.is_green else "no", self.causes, longer, f"{self.spent_s:.1f} s")

    @property
    def is_green(self) -> bool:
        return self.after <= self.tolerance


HEAD = ("scenario", "tolerance", "bound at the target", "arrival before", "arrival", "within", "largest causes")
HEAD += ("longer by", "processor")


def compared(cases: list[tuple[str, Scenario]]) -> list[Compared]:
    results: list[Compared] = []
    for name, scenario in cases:
        bare_settings = replace(scenario, planner=msgspec.structs.replace(scenario.planner, settle="none"))
        try:
            began = time.process_time()
            plan = ctrplan.plan(scenario)
            spent_s = time.process_time() - began
            bare = ctrplan.plan(bare_settings, compensated=False)
        except NoAnswerError as error:
            results.append(Compared(name, str(error).rsplit(": ", 1)[-1]))
            continue
        targets = zip(scenario.targets, plan.certificate.targets, bare.certificate.targets, strict=True)
        for number, (goal, at, before) in enumerate(targets, start=1):
            if at.arrival is None or before.arrival is None or goal.tip_m is None:
                continue
            causes = ", ".join(f"{1e3 * share:.2f} {words}" for words, share in at.arrival.by_cause.main[:2])
            lengths = (goal.tolerance_m, at.bound_m, before.arrival.error_m, at.arrival.error_m)
            longer = plan.certificate.length_mm - bare.certificate.length_mm
            place = number if len(scenario.targets) > 1 else 0
            results.append(Compared(name, "", *(1e3 * x for x in lengths), causes, longer, spent_s, place))
            print(results[-1].row(), file=sys.stderr, flush=True)
    return results


def by_scenario(results: list[Compared]) -> list[tuple[object, ...]]:
    """A row for each scenario, whose name every query begins with: medians, and the worst in brackets."""
    names, rows = [result.name.split()[0] for result in results], []
    for name in dict.fromkeys(names):
        asked = [result for result, its in zip(results, names, strict=True) if its == name]
        planned = [result for result in asked if not result.why]
        counts = [f"{len(planned)} of {len(asked)}", str(sum(result.is_green for result in planned))]
        values = [[getattr(result, key) for result in planned] for key in ("bound", "before", "after", "longer")]
        lengths = [f"{np.median(of) + 0.0:.2f} ({max(of) + 0.0:.2f}) mm" for of in values if of]
        spent_s = [result.spent_s for result in planned]
        rows.append(
            (name, *counts, *lengths, *([f"{np.median(spent_s):.0f} ({max(spent_s):.0f}) s"] if planned else []))
        )
    return rows


OF_QUERIES = ("scenario", "planned", "within tolerance", "bound at the target", "arrival before", "arrival")
OF_QUERIES += ("longer by", "processor")


INNERMOST = {
    "outer_diameter_mm": 1.5, "inner_diameter_mm": 1.2, "bending_stiffness_Nm2": 0.007, "poisson_ratio": 0.3,
    "collar_length_mm": 17, "section": [
        {"length_mm": 240, "curvature_x_per_m": 0, "curvature_y_per_m": 0},
        {"length_mm": 80, "curvature_x_per_m": 0, "curvature_y_per_m": 6.0},
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


def way(robot: Robot, at: Array, rng: np.random.Generator) -> Array:
    """(K, m) corners of a random way from joints (m,) and back: two in a hundred turn a joint by up to 720 deg."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    points = [at]
    for _ in range(rng.integers(1, 3)):
        q, kind = points[-1].copy(), rng.choice(4, p=[0.02, 0.38, 0.3, 0.3])
        turn = rng.uniform(-1, 1, len(q)) * 10 ** rng.uniform(-2, -0.3)
        if kind == 0:
            q[rng.choice(np.flatnonzero(drive.is_rotation))] += rng.uniform(-4 * np.pi, 4 * np.pi)
        elif kind == 1:
            q += np.where(drive.is_rotation, turn, 0.0)
        elif kind == 2:
            q += np.where(drive.is_rotation, 0.0, rng.uniform(-1, 1, len(q)) * 10 ** rng.uniform(-4, -2.3))
        else:  # an oscillation that fades
            turn = np.where(drive.is_rotation, turn, 0.0)
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


def pasts(
    robot: Robot, at: Array, count: int, away_m: float, rng: np.random.Generator, accuracy: Accuracy = "search"
) -> tuple[list[HistoryState], ...]:
    """States at joints (m,) after pasts, and those more than `away_m` from the frictionless tip: of another branch.

    Every return to the joints ends a past, the moves of which are all those before it. What finds no equilibrium, or
    ends on another branch, is gone back on.
    """
    history, states, others = robot.history("released", accuracy=accuracy), list[HistoryState](), list[HistoryState]()
    history.advance(*robot.drive.collars(at))
    frictionless = robot.solve(*robot.drive.collars(at)).tip_m
    for _ in range(count):
        before = history.save()
        try:
            tip = history.follow(*robot.drive.collars(way(robot, at, rng))).position_m[-1]
        except CtrplanError:
            tip = np.full(3, np.nan)
        if np.linalg.norm(tip - frictionless) <= away_m:
            states.append(history.save())
            continue
        if np.isfinite(tip).all():
            others.append(history.save())
        history.restore(before)
    return states, others


def driven(
    robot: Robot, states: list[HistoryState], corners: Array, accuracy: Accuracy = "search"
) -> tuple[Array, int]:
    """(S, 3) tips after a motion through corners (K, m), and how many states there are; NaN without an equilibrium.

    States that have become the same are driven once from there on.
    """
    steps = [np.abs(np.diff(rows, axis=0)).max(axis=1) for rows in robot.drive.collars(corners)]
    counts = np.ceil(np.maximum(steps[0] / STEP_RAD, steps[1] / STEP_M)).astype(int)
    rows = [
        a + np.linspace(0, 1, n + 1)[1:, None] * (b - a)
        for (a, b), n in zip(itertools.pairwise(corners), counts, strict=True)
    ]
    joints = np.vstack([corners[:1], *rows])
    _, begun = predict_end(robot, joints[:1], states, accuracy)
    states, different = begun or states, len({id(state) for state in begun})
    tips = np.full((len(states), 3), np.nan)
    for begin in range(1, len(joints), MERGED_EVERY):
        prediction, after = predict_end(robot, joints[begin : begin + MERGED_EVERY], states, accuracy)
        if not after:
            return np.array([_end_of(robot, state, joints[begin:], accuracy) for state in states]), different
        tips, states = prediction.tip_m[:, -1], after
    return tips, different


def _end_of(robot: Robot, state: HistoryState, joints: Array, accuracy: Accuracy) -> Array:
    history = robot.history(accuracy=accuracy)
    history.restore(state)
    try:
        return np.asarray(history.follow(*robot.drive.collars(joints)).position_m[-1])
    except CtrplanError:
        return np.full(3, np.nan)


def hunted(
    name: str, content: dict[str, Any], count: int, sets: int, seed: int, accuracy: Accuracy
) -> list[tuple[object, ...]]:
    robot, rng, rows = uncertain(content), np.random.default_rng([seed, len(name)]), []
    while len(rows) < 2:
        scenario = task(robot, rng)
        scenario = replace(scenario, planner=msgspec.structs.replace(scenario.planner, time_s=1.0))
        try:
            plan = ctrplan.plan(scenario, seed=seed)
        except NoAnswerError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        arrival, start = plan.certificate.arrival, scenario.start
        assert arrival is not None and scenario.goal.tip_m is not None
        away_m, seen, other, failed, different = (
            robot.bound(*robot.drive.collars(start)).position_m + BOUND_M,
            [],
            [],
            0,
            0,
        )
        for _ in range(sets):
            mu = [rng.uniform(*contact.friction_coefficient) for contact in robot.contacts]
            contacts = [replace(c, friction_coefficient=(m, m)) for c, m in zip(robot.contacts, mu, strict=True)]
            drawn, motion = replace(robot, contacts=tuple(contacts)), executed(robot, plan.waypoints, rng)
            states, others = pasts(drawn, start, count // sets, away_m, rng, accuracy)
            tips, apart = driven(drawn, states, motion, accuracy)
            failed, different = failed + count // sets - len(states) - len(others), different + apart
            seen += np.linalg.norm(tips - scenario.goal.tip_m, axis=1).tolist()
            if others:
                tips, _ = driven(drawn, others, motion, accuracy)
                other += np.linalg.norm(tips - scenario.goal.tip_m, axis=1).tolist()
        largest, claimed = max(seen, default=np.nan), arrival.error_m
        outside, lost = (sum(not error <= claimed for error in errors) for errors in (seen, other))
        lengths = [f"{1e3 * x:.3f} mm" for x in (largest, claimed)]
        bound_mm = f"{1e3 * plan.certificate.goal_bound_m:.2f} mm"
        others = f"{len(other)}, of them outside {lost}" if other else "0"
        rows.append(
            (name, len(seen), different, others, failed, outside, *lengths, f"{largest / claimed:.2f}", bound_mm)
        )
        print(rows[-1], f"{time.process_time():.0f} s", file=sys.stderr, flush=True)
    return rows


FINEST = 16  # times the steps are divided for what is taken for the truth
OF_STEPS = ("robot", "histories", "apart from the finest, median", "largest", "said, median", "beyond what is said")


def steps_matter(name: str, content: dict[str, Any], plans: int = 4) -> tuple[object, ...]:
    """Over random plans of a robot and every friction state at their starts."""
    robot, rng, off, said = robot_from_dict(content), np.random.default_rng(len(name)), list[float](), list[float]()
    options = HistoryOptions()
    finest = HistoryOptions(
        rotation_rad=options.rotation_rad / FINEST,
        translation_m=options.translation_m / FINEST,
        state_change=options.state_change / FINEST,
    )
    while plans:
        scenario = task(robot, rng)
        try:
            plan = ctrplan.plan(
                replace(scenario, planner=msgspec.structs.replace(scenario.planner, time_s=1.0)), seed=0
            )
        except NoAnswerError:
            continue
        plans -= 1
        samples, starts = plan.certificate.samples, start_states(plan.scenario)
        joints = samples.joints[rows_to_simulate(robot, samples.joints, samples.leg)]
        prediction, ends = predict_end(robot, joints, starts)
        share = step_error(robot, joints, ends, starts)
        for start, tip in zip(starts, prediction.tip_m[:, -1], strict=True):
            path = robot.history(start, options=finest).follow(*robot.drive.collars(joints))  # type: ignore[arg-type]
            off.append(float(np.linalg.norm(path.position_m[-1] - tip)))
            said.append(share)
        print(name, f"{1e3 * max(off):.4f}", f"{1e3 * share:.4f}", file=sys.stderr, flush=True)
    lengths = [f"{1e3 * x:.4f} mm" for x in (np.median(off), max(off), np.median(said))]
    return name, len(off), *lengths, int(np.sum(np.array(off) > said))


OF_HUNT = ("robot", "pasts", "states", "of another branch", "without equilibrium", "outside", "largest seen", "claimed")
OF_HUNT += ("ratio", "bound")


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("section", choices=["scenarios", "queries", "hunt", "steps"])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--pasts", type=int, default=10_000)
    parser.add_argument("--accuracy", choices=["search", "certificate"], default="search", help="mesh of the hunt")
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.section == "scenarios":
        paths = [p for p in sorted(SCENARIOS.glob("*.toml")) if not given.names or p.stem in given.names]
        results = compared([(path.stem, ctrplan.load_scenario(path)) for path in paths])
        table("scenarios", HEAD, [result.row() for result in results])
    elif given.section == "queries":
        chosen = [query for query in queries() if not given.names or query.scenario in given.names]
        results = compared([(query.name, query.load([])) for query in chosen])
        table("queries, each", HEAD, [result.row() for result in results])
        table("queries", OF_QUERIES, by_scenario(results))
    elif given.section == "hunt":
        robots_of = {name: content for name, content in robots().items() if not given.names or name in given.names}
        found = [
            row
            for name, content in robots_of.items()
            for row in hunted(name, content, given.pasts, given.sets, given.seed, given.accuracy)
        ]
        table("hunt", OF_HUNT, found)
    else:
        of_robots = {name: content for name, content in robots().items() if not given.names or name in given.names}
        table("steps", OF_STEPS, [steps_matter(name, content) for name, content in of_robots.items()])
