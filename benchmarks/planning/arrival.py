"""Where plans arrive: beside the bound, hunted by random pasts, and as steps of histories change it.

    python benchmarks/run.py --write arrival scenarios [NAME ...]
    python benchmarks/run.py arrival hunt [--pasts N] [--sets N] [--seed N] [--accuracy MESH] [ROBOT ...]
    python benchmarks/run.py arrival steps [ROBOT ...]

scenarios: each planned twice, as it is and without compensation and endings.
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
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import common
import msgspec
import numpy as np
from common import ROBOTS, SCENARIOS, SHIPPED, finer, table, tube

import ctrplan
from ctrplan import CtrplanError, Goal, NoAnswerError, Robot, Scenario, robot_from_dict
from ctrplan.base.arrays import Array
from ctrplan.mechanics.history import HistoryState
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.prediction import STEP_M, STEP_RAD, predict_end, rows_to_simulate, start_states, step_error
from ctrplan.storage.toml_document import read_document

MERGED_EVERY = 4  # steps of simulation after which states of the hunt are compared
BOUND_M = 0.3e-3  # by which a past may leave the bound at the start and still be of its branch
WOUND = 2.5  # times the precurvature of the pair, so that it has a second stable shape
SHARE = 0.3  # by which friction coefficients are uncertain in the hunt

OF_SCENARIOS = "scenario | tolerance | bound at the target | arrival before | arrival | within | largest causes"


def compared(name: str) -> Iterator[tuple[str, ...]]:
    """A row for each target, with and without ending and compensation; one that says why where there is no plan."""
    scenario = ctrplan.load_scenario(SCENARIOS / f"{name}.toml")
    bare_settings = replace(scenario, planner=msgspec.structs.replace(scenario.planner, settle="none"))
    try:
        began = time.process_time()
        plan = ctrplan.plan(scenario)
        spent_s = time.process_time() - began
        bare = ctrplan.plan(bare_settings, compensated=False)
    except NoAnswerError as error:
        yield name, *[""] * 5, str(error).rsplit(": ", 1)[-1], "", ""
        return
    longer = f"{plan.certificate.length_mm - bare.certificate.length_mm:+.0f} mm"
    targets = zip(scenario.targets, plan.certificate.targets, bare.certificate.targets, strict=True)
    for number, (goal, at, before) in enumerate(targets, start=1):
        if at.arrival is None or before.arrival is None or goal.tip_m is None:
            continue
        causes = ", ".join(f"{1e3 * share:.2f} {words}" for words, share in at.arrival.by_cause.main[:2])
        lengths = (goal.tolerance_m, at.bound_m, before.arrival.error_m, at.arrival.error_m)
        is_green = "yes" if at.arrival.error_m <= goal.tolerance_m else "no"
        label = f"{name}, target {number}" if len(scenario.targets) > 1 else name
        cells = (*(f"{1e3 * x:.2f} mm" for x in lengths), is_green, causes, longer if number == 1 else "")
        yield label, *cells, f"{spent_s:.1f} s"


INNERMOST = tube(1.5, 1.2, 0.007, ((240, 0, 0), (80, 0, 6.0)), collar_length_mm=17)


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
    for section in (section for of in bent["tube"] for section in of["section"]):
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
    last = points[-1].copy()
    for joint in rng.permutation(len(at)):  # back joint after joint in random order, or all at once
        last[joint] = at[joint]
        points.append(last.copy())
    points = points if rng.random() < 0.6 else points[: -len(at)]
    return np.array([*(q for q in points if space.allowed(q)), at])


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


def hunted(name: str, content: dict[str, Any], given: Any) -> Iterator[tuple[object, ...]]:
    """A row for each of two plans."""
    robot, rng, plans = uncertain(content), np.random.default_rng([given.seed, len(name)]), 0
    while plans < 2:
        scenario = task(robot, rng)
        scenario = replace(scenario, planner=msgspec.structs.replace(scenario.planner, time_s=1.0))
        try:
            plan = ctrplan.plan(scenario, seed=given.seed)
        except NoAnswerError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        plans += 1
        arrival, start, count = plan.certificate.arrival, scenario.start, given.pasts // given.sets
        assert arrival is not None and scenario.goal.tip_m is not None
        away_m = robot.bound(*robot.drive.collars(start)).position_m + BOUND_M
        seen, other, failed, different = list[float](), list[float](), 0, 0
        for _ in range(given.sets):
            mu = [rng.uniform(*contact.friction_coefficient) for contact in robot.contacts]
            contacts = [replace(c, friction_coefficient=(m, m)) for c, m in zip(robot.contacts, mu, strict=True)]
            drawn, motion = replace(robot, contacts=tuple(contacts)), executed(robot, plan.waypoints, rng)
            states, others = pasts(drawn, start, count, away_m, rng, given.accuracy)
            tips, apart = driven(drawn, states, motion, given.accuracy)
            failed, different = failed + count - len(states) - len(others), different + apart
            seen += np.linalg.norm(tips - scenario.goal.tip_m, axis=1).tolist()
            if others:
                tips, _ = driven(drawn, others, motion, given.accuracy)
                other += np.linalg.norm(tips - scenario.goal.tip_m, axis=1).tolist()
        largest, claimed = max(seen, default=np.nan), arrival.error_m
        outside, lost = (sum(not error <= claimed for error in errors) for errors in (seen, other))
        lengths = [f"{1e3 * x:.3f} mm" for x in (largest, claimed)]
        counts = len(seen), different, f"{len(other)}, of them outside {lost}" if other else "0", failed, outside
        yield name, *counts, *lengths, f"{largest / claimed:.2f}", f"{1e3 * plan.certificate.goal_bound_m:.2f} mm"


FINEST = 16  # times the steps are divided for what is taken for the truth


def steps_matter(name: str, content: dict[str, Any], plans: int = 4) -> tuple[object, ...]:
    """Over random plans of a robot and every friction state at their starts."""
    robot, rng, off, said = robot_from_dict(content), np.random.default_rng(len(name)), list[float](), list[float]()
    while plans:
        scenario = task(robot, rng)
        try:
            quick = msgspec.structs.replace(scenario.planner, time_s=1.0)
            plan = ctrplan.plan(replace(scenario, planner=quick), seed=0)
        except NoAnswerError:
            continue
        plans -= 1
        samples, starts = plan.certificate.samples, start_states(plan.scenario)
        joints = samples.joints[rows_to_simulate(robot, samples.joints, samples.leg)]
        prediction, ends = predict_end(robot, joints, starts)
        share = step_error(robot, joints, ends, starts)
        for start, tip in zip(starts, prediction.tip_m[:, -1], strict=True):
            path = robot.history(start, options=finer(FINEST)).follow(*robot.drive.collars(joints))  # type: ignore[arg-type]
            off.append(float(np.linalg.norm(path.position_m[-1] - tip)))
            said.append(share)
    lengths = [f"{1e3 * x:.4f} mm" for x in (np.median(off), max(off), np.median(said))]
    return name, len(off), *lengths, int(np.sum(np.array(off) > said))


OF_HUNT = "robot | pasts | states | of another branch | without equilibrium | outside | largest seen | claimed | ratio"
OF_STEPS = "robot | histories | apart from the finest, median | largest | said, median | beyond what is said"


def main() -> None:
    options = {"pasts": 10_000, "sets": 50, "seed": 0, "accuracy": "search"}
    given = common.arguments(__doc__, ("section", ("scenarios", "hunt", "steps")), "names*", **options)
    common.end_searches_by_count()
    files = robots()
    names = common.chosen(given.names, SHIPPED if given.section == "scenarios" else files)
    if given.section == "scenarios":
        table("scenarios", f"{OF_SCENARIOS} | longer by | processor", (row for name in names for row in compared(name)))
    elif given.section == "hunt":
        table("hunt", f"{OF_HUNT} | bound", (row for name in names for row in hunted(name, files[name], given)))
    else:
        table("steps", OF_STEPS, (steps_matter(name, files[name]) for name in names))
