"""Is a certified motion ever hit? Scenes at the edge of what friction reaches, judged by brute force.

    python benchmarks/run.py certificate_hunt [--scenes 1000] [--first 0] [--processes 2] [--seed 1] [--only N]

Scene by scene: one of seven robots (two, three and four tubes, loose and tight clearance), a short motion from a random
configuration, one sphere, rod or plate. In half of the scenes, "between", it stands beside a body in a random friction
state between the corners, up to 1.5 mm within it, and yet 0.2 mm clear of frictionless and corner shapes where such a
place is found; in the others, "random", it stands somewhere beside the frictionless body, farther off. `certify` walks
the motion. Four judges look for a hit, with the distances of `ctrplan.audit`:

- grid: bodies at 5 places of the motion; 401 friction states of one pair, 41 x 41 of two, 9 x 9 x 9 of three;
- contacts: friction that differs along the contacts of each pair, in 8 parts: at the same places 150 states of random
  extremes, and 150 with random parts of the worst state of the grid at an extreme;
- histories: 10 simulations of small turns back and forth (1 to 30 deg) before the start, followed along the motion;
- branches: 6 simulations of large turns (30 to 180 deg) before the start, which lead to other equilibria, if there are.

Everything is looked at on the coarse mesh; what comes within 1.5 mm of the obstacle, of a grid the 200 worst states, is
solved again on the certificate mesh, which decides. A tip beyond the bound is one by more than 0.3 mm and 2 %, what
meshes differ by. Scenes that are refused, and that a state of the grid comes within 1 mm of, are not simulated.

Results are kept scene by scene in build/certificate_hunt.jsonl, where another run goes on. --only prints all that is
known of a scene. Every scene depends on the seed and its number alone.
"""

import itertools
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import common
import numpy as np
import trimesh
from common import ROBOTS, ROOT, table, tube

from ctrplan import Capsule, CtrplanError, Mesh, Robot, Scenario, Sphere, load_robot, robot_from_dict
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shape import PartShape
from ctrplan.audit.body import RawAnatomy, body_of
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import certify
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.scenario.joint_space import JointSpace, bare_scenario

RESULTS = ROOT / "build" / "certificate_hunt.jsonl"
GRID = {1: 401, 2: 41, 3: 9}  # states along a pair
PLACES, HISTORIES, BRANCHES = 5, 10, 6
SMALL_DEG, LARGE_DEG = (1.0, 30.0), (30.0, 180.0)
UNEVEN, PARTS = 150, 8  # states of friction that differs along contacts, and parts of each contact
MOST_FINE = 200  # states of a place, the worst on the coarse mesh
NEAR_M = 1.5e-3  # on the coarse mesh, within which the fine one decides
APART_M = 1e-3  # of every state: a certificate should not refuse such a scene
BEYOND_M, BEYOND_SHARE = 0.3e-3, 0.02
TURN_RAD, SLIDE_M = 0.2, 3e-3
CLEAR_M = {"between": 0.2e-3, "random": 1e-3}  # of frictionless and corner shapes, in the middle of the motion
MOST_DRAWN = 200  # obstacles, until one leaves these shapes so much
JUDGES = ("grid", "contacts", "histories", "branches")


@cache
def robots() -> dict[str, Robot]:
    """By what is special about them."""
    three = ROBOTS / "three_tube.toml"
    clearances = [f"contact.{k}.clearance_mm={{}}" for k in (1, 2)]
    return {
        "pair, Table I": load_robot(ROBOTS / "table_1_pair.toml"),
        "pair, Table V": load_robot(ROBOTS / "table_5_pair.toml"),
        "pair, loose": load_robot(ROBOTS / "table_5_pair.toml", ["contact.1.clearance_mm=0.12"]),
        "three tubes": load_robot(three),
        "three tubes, tight": load_robot(three, [c.format(0.015) for c in clearances]),
        "three tubes, loose": load_robot(three, [c.format(0.1) for c in clearances]),
        "four tubes": _four_tubes(),
    }


def _four_tubes() -> Robot:
    """Each curved in its last 60 mm, the inner ones more; clearances of 0.05 mm."""
    tubes = []
    for k, (curvature, stiffness) in enumerate(((3.0, 0.08), (5.0, 0.05), (8.0, 0.025), (14.0, 0.01))):
        outer, sections = 2.9 - 0.45 * k, ((60 + 40 * k, 0, 0), (60, 0, curvature))
        tubes.append(tube(outer, outer - 0.35, stiffness, sections))
    return robot_from_dict({"name": "four tubes", "tube": tubes, "contact": [{"friction_coefficient": 0.2}] * 3})


@dataclass(frozen=True, eq=False)
class Case:
    """A motion (2, m) beside an obstacle."""

    name: str
    kind: str
    obstacle: str
    scenario: Scenario
    way: Array


@dataclass
class Result:
    """What came of a scene; lengths in mm."""

    number: int
    robot: str
    kind: str
    obstacle: str
    certified: bool = False
    problem: str = ""
    claimed_mm: float | None = None
    true_mm: float | None = None  # of the grid; None where a state had no solution
    least_mm: dict[str, float] = field(default_factory=dict)  # by judge
    where: dict[str, Any] = field(default_factory=dict)  # by judge: place, and friction state or joints before
    beyond_bound_mm: float = 0.0  # of a simulated tip


def case(number: int, seed: int) -> Case:
    """The scene of a number."""
    rng = np.random.default_rng([seed, number])
    name, robot = list(robots().items())[number % len(robots())]
    kind = ("between", "random")[number // len(robots()) % 2]
    space = JointSpace.of_robot(robot)
    while True:
        drawn = space.sample(rng, 20)  # not every draw nests
        if not len(drawn):
            continue
        start = drawn[0]
        step = np.where(robot.drive.is_rotation, TURN_RAD, SLIDE_M) * rng.uniform(-1, 1, len(start))
        way = np.array([start, start + step])
        if space.allowed(way):
            break
    collars, least = robot.drive.collars(way.mean(axis=0)), CLEAR_M[kind]
    for _ in range(MOST_DRAWN):
        obstacle = ("sphere", "rod", "plate")[int(rng.integers(3))]
        part = AnatomyPart(_beside(robot, collars, kind, obstacle, rng))
        if _corner_room(robot, collars, part) >= least:
            break
    return Case(name, kind, obstacle, replace(bare_scenario(robot), anatomy=(part,), start=way[0]), way)


def _beside(
    robot: Robot, collars: tuple[Array, Array], kind: str, obstacle: str, rng: np.random.Generator
) -> PartShape:
    """An obstacle beside, or a little within, a body in a friction state; or farther off the frictionless one."""
    between = kind == "between"
    phi = rng.uniform(-1, 1, (1, robot.n - 1)) * between
    body = robot.mechanics.friction_bodies(*collars, phi)
    place = len(body.radius_m) - 1 - int(rng.integers(len(body.radius_m) // 2 + 1))
    side = rng.standard_normal(3)
    side /= np.linalg.norm(side)
    away = rng.uniform(-1.5e-3, 2.5e-3) if between else rng.uniform(2e-3, 15e-3)
    return _obstacle(obstacle, body.point_m[0, place], side, float(body.radius_m[place]) + away, rng)


def _corner_room(robot: Robot, collars: tuple[Array, Array], part: AnatomyPart) -> float:
    """Least clearance [m] of the frictionless and the corner shapes: what no certificate overlooks."""
    phi = np.array([np.zeros(robot.n - 1), *itertools.product((1.0, -1.0), repeat=robot.n - 1)])
    rooms, _ = _rooms(robot, collars, phi, RawAnatomy.of([part]), "search", 0.5e-3)
    return float(rooms.min())


def _obstacle(kind: str, point: Array, side: Array, away: float, rng: np.random.Generator) -> PartShape:
    """What stands `away` [m] from a point, on one side of it."""
    radius = rng.uniform(0.3e-3, 2e-3)
    across = np.cross(side, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    center = point + (away + radius) * side
    if kind == "sphere":
        return Sphere(center, radius)
    if kind == "rod":
        return Capsule(center - 10e-3 * across, center + 10e-3 * across, radius)
    box = trimesh.creation.box((12e-3, 12e-3, 2 * radius))
    axes = np.column_stack([across, np.cross(side, across), side])
    return Mesh(box.vertices @ axes.T + center, box.faces)


def judged(number: int, seed: int) -> Result:
    """A scene certified and judged."""
    given = case(number, seed)
    result = Result(number, given.name, given.kind, given.obstacle)
    try:
        certificate = certify(given.scenario, given.way)
    except CtrplanError as error:
        result.problem = str(error)
        return result
    result.certified, result.problem = certificate.valid, next(iter(certificate.problems), "")
    result.claimed_mm = 1e3 * certificate.min_clearance_m
    anatomy = RawAnatomy.of(given.scenario.anatomy)
    _grid(given, anatomy, result)
    if not result.certified and result.least_mm["grid"] < 1e3 * APART_M:
        return result  # it is refused, and rightly so: nothing more is asked
    if result.where:
        _contacts(given, anatomy, result, np.random.default_rng([seed, number, 3]))
    rng = np.random.default_rng([seed, number, 2])
    for judge, count, degrees in (("histories", HISTORIES, SMALL_DEG), ("branches", BRANCHES, LARGE_DEG)):
        for _ in range(count):
            before = _turns(given, degrees, rng)
            _simulated(given, anatomy, result, judge, before, certificate.worst_bound_m)
    return result


def _grid(given: Case, anatomy: RawAnatomy, result: Result) -> None:
    pairs = given.scenario.robot.n - 1
    grid, unsolved = np.array(list(itertools.product(np.linspace(-1, 1, GRID[pairs]), repeat=pairs))), False
    for share, rooms, solved, _ in _looked_at(given, anatomy, grid):
        unsolved |= not solved.all()
        k = int(np.argmin(rooms))
        if 1e3 * rooms[k] < result.least_mm.get("grid", np.inf):
            result.least_mm["grid"] = 1e3 * float(rooms[k])
            result.where["grid"] = {"share": share, "phi": grid[k].tolist()}
    result.true_mm = None if unsolved else result.least_mm.get("grid", np.inf)


def _contacts(given: Case, anatomy: RawAnatomy, result: Result, rng: np.random.Generator) -> None:
    shape = (UNEVEN, PARTS, given.scenario.robot.n - 1)
    extremes = rng.choice((-1.0, 1.0), (2, *shape))
    worst = np.array(result.where["grid"]["phi"])
    phi = np.concatenate([extremes[0], np.where(rng.random(shape) < rng.random((UNEVEN, 1, 1)), extremes[1], worst)])
    for share, rooms, _, near in _looked_at(given, anatomy, phi):
        least = 1e3 * float(rooms[near].min(initial=np.inf))
        if least < result.least_mm.get("contacts", np.inf):
            result.least_mm["contacts"], result.where["contacts"] = least, {"share": share}


def _looked_at(given: Case, anatomy: RawAnatomy, phi: Array) -> Iterator[tuple[float, Array, Array, Array]]:
    """Share of the motion, least clearances (S,) [m] of states, inf without a solution, which are solved on the coarse
    mesh, and rows of those that are solved on the fine one.
    """
    robot = given.scenario.robot
    for share in np.linspace(0, 1, PLACES).tolist():
        collars = robot.drive.collars(given.way[0] + share * (given.way[1] - given.way[0]))
        rooms, solved = _rooms(robot, collars, phi, anatomy, "search", 1e-3)
        everywhere = solved.copy()
        near = np.argsort(rooms)[:MOST_FINE]
        near = near[solved[near] & (rooms[near] < NEAR_M)]
        if len(near):
            rooms[near], solved[near] = _rooms(robot, collars, phi[near], anatomy, "certificate", 0.3e-3)
        rooms[~solved] = np.inf
        yield share, rooms, everywhere, near


def _rooms(
    robot: Robot, collars: tuple[Array, Array], phi: Array, anatomy: RawAnatomy, mesh: Accuracy, spacing_m: float
) -> Any:
    """(S,) least clearance [m], and whether each state was solved."""
    bodies = robot.mechanics.friction_bodies(*collars, phi, spacing_m=spacing_m, accuracy=mesh)
    rooms = anatomy.room(bodies.point_m.reshape(-1, 3)).reshape(len(phi), -1) - bodies.radius_m
    return rooms.min(axis=1), bodies.solved.copy()


def _turns(given: Case, degrees: tuple[float, float], rng: np.random.Generator) -> Array:
    """(H, m) joints before the start: turns of neighbours against each other, or of any joints."""
    drive, count = given.scenario.robot.drive, int(rng.integers(1, 5))
    amplitude = np.radians(np.exp(rng.uniform(*np.log(degrees), (count, 1))))
    share = rng.uniform(-1, 1, (count, len(drive.joints)))
    if rng.integers(2):
        relative = np.cumsum(rng.choice((-1.0, 1.0), (count, given.scenario.robot.n)), axis=1)
        share = np.linalg.lstsq(drive.matrix_theta, relative.T, rcond=None)[0].T
    turns = np.where(drive.is_rotation, amplitude * share, 0.0)
    return np.clip(given.way[0] + turns, drive.lower, drive.upper)


def _simulated(given: Case, anatomy: RawAnatomy, result: Result, judge: str, before: Array, bound_m: float) -> None:
    """A history on the coarse mesh; once more on the fine one where it comes near, or beyond the bound."""
    for mesh in ("search", "certificate"):
        found = _driven(given, anatomy, before, mesh)
        if found is None:
            return
        room, share, off = found
        beyond = off - bound_m
        if mesh == "search" and room > NEAR_M and beyond < BEYOND_M:
            return
    if 1e3 * room < result.least_mm.get(judge, np.inf):
        result.least_mm[judge] = 1e3 * room
        result.where[judge] = {"share": share, "before": before.tolist()}
    if beyond > BEYOND_M + BEYOND_SHARE * bound_m and 1e3 * beyond > result.beyond_bound_mm:
        result.beyond_bound_mm = 1e3 * beyond
        result.where["bound"] = {"before": before.tolist()}


def _driven(given: Case, anatomy: RawAnatomy, before: Array, mesh: Accuracy) -> tuple[float, float, float] | None:
    """Least clearance [m] along the motion and its share there, and the largest deviation of the tip [m]."""
    robot = given.scenario.robot
    history = robot.history(accuracy=mesh)
    shares = np.linspace(0, 1, PLACES)
    least, at, off = np.inf, 0.0, 0.0
    try:
        history.follow(*robot.drive.collars(np.array([*before, given.way[0]])))
        for share in shares:
            step = history.advance(*robot.drive.collars(given.way[0] + share * (given.way[1] - given.way[0])))
            body = body_of(robot, step.shape)
            room = float((anatomy.room(body.point_m) - body.radius_m).min())
            least, at = min((least, at), (room, float(share)))
            off = max(off, step.deviation_m)
    except CtrplanError:  # no equilibrium to come from, or tubes that do not nest
        return None
    return least, at, off


def known(file: Path, seed: int) -> dict[int, Result]:
    """Results of earlier runs."""
    rows = [row["result"] for row in common.kept(file) if row["seed"] == seed]
    return {row["number"]: Result(**row) for row in rows}


def print_table(results: list[Result]) -> None:
    """Counts by robot and kind, and of all."""
    rows = []
    groups = [(name, kind) for name in robots() for kind in ("between", "random")]
    for name, kind in [*groups, ("all", "between"), ("all", "random")]:
        mine = [r for r in results if name in (r.robot, "all") and r.kind == kind]
        sure = [r for r in mine if r.certified]
        hits = [sum(r.least_mm.get(judge, np.inf) < 0 for r in sure) for judge in JUDGES]
        beyond = sum(r.beyond_bound_mm > 0 for r in sure)
        clear = [r for r in mine if r.true_mm is not None and min(r.true_mm, *r.least_mm.values()) > 1e3 * APART_M]
        share = f"{100 * sum(r.certified for r in clear) / len(clear):.1f} %" if clear else "-"
        excess = max((r.claimed_mm - min(r.least_mm.values()) for r in sure if r.least_mm), default=np.nan)
        rows.append((name, kind, len(mine), len(sure), *hits, beyond, len(clear), share, f"{excess:.2f}"))
    hit = " | ".join(f"hit by {judge}" for judge in JUDGES)
    head = f"robot | kind | scenes | certified | {hit} | beyond the bound | 1 mm clear | of these certified"
    table("scenes", f"{head} | largest excess, mm", rows)


def broken(results: list[Result]) -> Iterator[str]:
    """A line for each certified scene that something breaks."""
    for r in results:
        if r.certified and (min([*r.least_mm.values(), 1.0]) < 0 or r.beyond_bound_mm > 0):
            hits = ", ".join(f"{judge} {mm:.2f} mm" for judge, mm in r.least_mm.items() if mm < 0)
            bound = f", {r.beyond_bound_mm:.2f} mm beyond the bound" if r.beyond_bound_mm > 0 else ""
            yield f"scene {r.number} ({r.robot}, {r.kind}, {r.obstacle}), claimed {r.claimed_mm:.2f} mm: {hits}{bound}"


def main() -> None:
    given = common.arguments(__doc__, scenes=1000, first=0, processes=2, seed=1, only=int, file=RESULTS)
    if given.only is not None:
        print(json.dumps(asdict(judged(given.only, given.seed)), indent=2))
        return
    results = known(given.file, given.seed)
    wanted = [number for number in range(given.first, given.scenes) if number not in results]
    with ProcessPoolExecutor(given.processes) as pool:
        for result in pool.map(judged, wanted, itertools.repeat(given.seed)):
            results[result.number] = result
            common.keep(given.file, {"seed": given.seed, "result": asdict(result)})
    print_table(list(results.values()))
    print("\n".join(broken(list(results.values()))))
