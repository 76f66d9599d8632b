"""What certificates allow for, against what is found: meshes, friction states between samples.

    python benchmarks/run.py allowances meshes [--count 40] [--clearances-mm 0.3 1 3]
    python benchmarks/run.py allowances between [--legs 12]

meshes: how far bodies and bounds of both meshes are from the model of exact geometry, for random configurations of the
shipped robots, with their own clearances between tubes and with wider ones: the largest distance of a body point
(frictionless and corner shapes, at the tip where meshes have different points), the most that a bound is short, and
the allowances of the certificate, in mm. Exact geometry is compared with that of FINER times as many elements, at the
tip. Shapes more than BRANCH_M apart are other equilibria, counted by themselves.

between: how far interpolated friction states are from solved ones. Random legs from random joints of the scenarios'
robots: samples between those that certificates solve are taken from their neighbours, on both meshes, and solved for
comparison. Samples where a state has no equilibrium, or another one than its neighbours, are counted by themselves.
"""

import itertools
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, get_args

import common
import numpy as np
from common import ROBOTS, SCENARIOS, table

import ctrplan
from ctrplan import Robot, Scenario, load_robot
from ctrplan.base.arrays import Array
from ctrplan.certificate.friction_states import LOOK_EVERY, bound_allowance_m, mesh_allowance_m
from ctrplan.certificate.sample_states import SampleStates, StatesBetween
from ctrplan.certificate.variants import Variants
from ctrplan.certificate.walked_piece import walked
from ctrplan.mechanics.shapes import Accuracy, FrictionBodies
from ctrplan.scenario.joint_space import JointSpace

NAMES = ("three_tube", "table_1_pair", "table_4_pair", "table_5_pair")
BRANCH_M = 5e-3
FINER = 3.0


def bound_m(bodies: FrictionBodies) -> float:
    """Largest distance of a corner's tip from the frictionless one."""
    tips = bodies.point_m[:, -1]
    return float(np.linalg.norm(tips[1:] - tips[0], axis=1).max())


def apart_m(exact: FrictionBodies, found: FrictionBodies) -> float:
    """Largest distance of bodies, of their tips where their points differ."""
    if exact.point_m.shape != found.point_m.shape:
        return float(np.linalg.norm(exact.point_m[:, -1] - found.point_m[:, -1], axis=1).max())
    return float(np.linalg.norm(exact.point_m - found.point_m, axis=2).max())


def errors(robot: Robot, mesh: Accuracy, count: int) -> Array:
    """(K, 2) [m] distance of bodies, and what the bound is short by."""
    corners = itertools.product((1.0, -1.0), repeat=robot.n - 1)
    states, rows = np.array([(0.0,) * (robot.n - 1), *corners]), []
    for q in JointSpace.of_robot(robot).sample(np.random.default_rng(2), count):
        if mesh == "exact":
            solve = partial(robot.mechanics.solve, *robot.drive.collars(q), accuracy="exact")
            with suppress(ctrplan.CtrplanError):
                pairs = [(solve(np.array(phi), refinement=FINER), solve(np.array(phi))) for phi in states[:2]]
                if not any(shape.status for pair in pairs for shape in pair):
                    rows.append((max(np.linalg.norm(finer.tip_m - own.tip_m) for finer, own in pairs), 0.0))
            continue
        exact, found = (
            robot.mechanics.friction_bodies(*robot.drive.collars(q), states, accuracy=accuracy)
            for accuracy in ("exact", mesh)
        )
        if exact.solved.all() and found.solved.all():
            rows.append((apart_m(exact, found), bound_m(exact) - bound_m(found)))
    return np.array(rows).reshape(-1, 2)


Rows = Iterator[tuple[object, ...]]


def meshes(given: Any) -> Rows:
    for name, clearance_mm in itertools.product(NAMES, [None, *given.clearances_mm]):
        plain = load_robot(ROBOTS / f"{name}.toml")
        wider = [] if clearance_mm is None else [f"contact.{k}.clearance_mm={clearance_mm}" for k in range(1, plain.n)]
        robot = load_robot(ROBOTS / f"{name}.toml", wider)
        for mesh in get_args(Accuracy):
            found = errors(robot, mesh, given.count)
            same = found[found[:, 0] < BRANCH_M]
            apart, short = same.max(axis=0, initial=0.0) * 1e3
            allowed = mesh_allowance_m(robot, mesh) * 1e3, bound_allowance_m(robot, mesh) * 1e3
            cells = f"{apart:.2f} ({allowed[0]:.2f})", f"{short:.2f} ({allowed[1]:.2f})"
            yield name, str(clearance_mm or "own"), mesh, len(found), len(found) - len(same), *cells


STATES = 12  # random ones of every sample
GRANTED_M = 5e-6
TURN_DEG, PUSH_MM = 20.0, 5.0  # of a leg at most


def leg(scenario: Scenario, rng: np.random.Generator) -> Array:
    """(2, m) joints at both ends: rotations and translations of random size, within limits."""
    space = JointSpace.of(scenario)
    start = space.sample(rng, 1)
    most = np.where(space.drive.is_rotation, np.radians(TURN_DEG), PUSH_MM * 1e-3)
    return np.concatenate([start, space.projected(start + rng.uniform(-1, 1, start.shape) * most, start)])


def of_leg(scenario: Scenario, rng: np.random.Generator, accuracy: Accuracy) -> list[tuple[float, float]]:
    """Largest error [m], and the most that one is beyond what is taken off [m], by sample."""
    way = leg(scenario, rng)
    piece = walked(Variants.of(scenario, way), JointSpace.of(scenario), 0, way, "search")
    count, found = len(piece.l_b), []
    solved = [SampleStates(scenario, piece, k, "search") for k in range(count)]
    for k in range(count):
        if k % LOOK_EVERY == 0:
            continue
        first, last = k - k % LOOK_EVERY, min(k - k % LOOK_EVERY + LOOK_EVERY, count - 1)
        own = SampleStates(scenario, piece, k, accuracy)
        share = (k - first) / max(last - first, 1)
        between = StatesBetween(own.known, (solved[first], solved[last]), share, accuracy != "search")
        states = [tuple(row) for row in rng.uniform(-1, 1, (STATES, scenario.robot.n - 1)).tolist()]
        guessed, true = between(states), own(states)
        error = np.array([np.linalg.norm(a.body_m - b.body_m, axis=1) for a, b in zip(guessed, true, strict=True)])
        doubt = np.array([a.doubt_m for a in guessed])
        found.append((float(error.max()), float((error - doubt).max())))
    return found


def of_different_robots() -> Iterator[Scenario]:
    """The first scenario of each robot that has friction states."""
    seen: set[str] = set()
    for file in sorted(SCENARIOS.glob("*.toml")):
        scenario = ctrplan.load_scenario(file)
        if scenario.robot.n > 1 and scenario.robot.friction.any() and str(scenario.robot.path) not in seen:
            seen.add(str(scenario.robot.path))
            yield scenario


def between(given: Any) -> Rows:
    for scenario, accuracy in itertools.product(of_different_robots(), ("search", "certificate")):
        rng = np.random.default_rng(0)
        found = np.array([row for _ in range(given.legs) for row in of_leg(scenario, rng, accuracy)]).reshape(-1, 2)
        same = np.all(np.isfinite(found), axis=1) & (found[:, 0] < BRANCH_M)
        error, beyond = found[same].max(axis=0) * 1e3
        name, share = Path(scenario.robot.path or "").stem, 100 * np.mean(found[same, 1] > GRANTED_M)
        counts = int(same.sum()), int(np.sum(~same))
        yield name, accuracy, *counts, f"{error:.3f}", f"{beyond:.3f}", f"{share:.1f} %"


def main() -> None:
    of_bodies = "robot | clearance, mm | mesh | solved | other equilibria | bodies, mm (allowed)"
    of_states = "robot | mesh | samples | other equilibria | error, mm | beyond what is taken off, mm | of samples"
    known = {
        "meshes": ("meshes", f"{of_bodies} | bounds short, mm (allowed)", meshes),
        "between": ("friction states between samples", of_states, between),
    }
    given = common.arguments(__doc__, ("section", known), count=40, clearances_mm=[0.3, 1.0, 3.0], legs=12)
    title, head, rows = known[given.section]
    table(title, head, rows(given))
