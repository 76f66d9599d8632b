"""Does memory stay flat over a long life of one process, what does a plan take, and how does that grow?

    python benchmarks/run.py memory runs [--plans 1000] [--bounds 100000] [--growth 0.05]
    python benchmarks/run.py memory plan [SCENARIO ...]
    python benchmarks/run.py memory growth [spheres] [triangles] [tubes] [targets] [legs]

runs: plans a tiny scenario again and again, each time from the file with another seed, and asks for bounds at random
configurations, one at a time and in batches. Memory in use at the end against that after the first WARM_UP plans (a
twentieth of the bounds); exits with 1 where it grew by such a share. Of glibc; Python's own objects count with
PYTHONMALLOC=malloc. plan: peak memory and CPU time of `ctrplan plan` of each scenario, as a process of its own with
empty caches. growth: seconds by the clock by spheres of an anatomy; of a processor by its triangles (those of a mesh
divided, corners moved by hundredths of a millimetre so that nothing merges), tubes, targets of a tour in free space,
legs of a path.
"""

import contextlib
import copy
import ctypes
import gc
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import common
import numpy as np
import tomli_w
import trimesh
from arrival import robots
from common import ROBOTS, SCENARIOS, SHIPPED, spent, table

import ctrplan
from ctrplan import Goal, robot_from_dict
from ctrplan.certificate.certify import certify
from ctrplan.scenario.joint_space import JointSpace, bare_scenario

NEAR = "goal.joints={'rotate outer' = 6, 'rotate inner' = 10, 'translate inner' = -27}"  # of pair_free.toml
SEARCH_S, ROUGHNESS_MM = 0.1, 0.01  # of a plan; of meshes that are divided
WARM_UP, BATCH, LOOKS = 50, 100, 10  # plans; bounds; at the memory, over a run
SHORT = 0.15  # of the way between random configurations, which is certified


def in_use_MB() -> float:
    """Memory [MB] allocated and not freed: resident memory wanders by 5 % with what the allocator keeps for later."""
    gc.collect()
    told = ctypes.CDLL(None).mallinfo2
    told.restype = type("Sizes", (ctypes.Structure,), {"_fields_": [("all", ctypes.c_size_t * 10)]})
    return (told().all[4] + told().all[7]) / 1e6  # in mappings of their own, and in the heaps


def growth(work: Callable[[int], object], count: int, warm_up: int) -> list[float]:
    """Memory in use [MB] over `count` calls of work(k), k = 0, 1, .., after the warm-up, then at even distances."""
    looks, memory = set(np.linspace(warm_up, count, LOOKS, dtype=int).tolist()), list[float]()
    for k in range(count):
        work(k)
        if k + 1 in looks:
            memory.append(in_use_MB())
    return memory


def plan_again(seed: int) -> None:
    """A plan of a scenario read from its file, its robot made anew; some find nothing in so short a search."""
    scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml", [NEAR, f"planner.time_s={SEARCH_S}"])
    with contextlib.suppress(ctrplan.NoAnswerError):
        ctrplan.plan(scenario, seed=seed)


def bounds_at_random(robot: ctrplan.Robot) -> Callable[[int], None]:
    """A function of the seed that asks for BATCH bounds in one call, and for the first of them once more."""
    space = JointSpace.of_robot(robot)

    def ask(seed: int) -> None:
        theta_b, l_b = robot.drive.collars(space.sample(np.random.default_rng(seed), BATCH))
        robot.bound_many(theta_b, l_b)
        robot.bound(theta_b[0], l_b[0])

    return ask


def runs(plans: int, bounds: int, most: float) -> int:
    several, batches = bounds_at_random(ctrplan.load_robot(ROBOTS / "three_tube.toml")), bounds // BATCH
    found = {
        f"{batches * BATCH:,} bounds, three tubes": growth(several, batches, max(batches // 20, 1)),
        f"{plans:,} plans": growth(plan_again, plans, min(WARM_UP, plans // 2)),
    }
    rows, grown = [], [memory_MB[-1] / memory_MB[0] - 1 for memory_MB in found.values()]
    for (what, (first, *between, last)), share in zip(found.items(), grown, strict=True):
        shown = " ".join(f"{value:.1f}" for value in between)
        rows.append((what, f"{first:.1f} MB", f"{last:.1f} MB", f"{100 * share:+.2f} %", shown))
    table("runs", "run | after the warm-up | at the end | growth | at even distances between, MB", rows)
    return int(max(grown) >= most)


def plan_apart(scenario: str, at_least: int = 0) -> tuple[object, ...]:
    """A row of the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        triangles = prepare(folder, scenario, at_least)
        plan = [sys.executable, "-m", "ctrplan", "plan", str(folder / "scenario.toml"), "-o", str(folder / "out")]
        own = {**os.environ, "CTRPLAN_CACHE_DIR": str(folder / "cache")}
        code, clock_s, processor_s, memory = spent([*plan, "--quiet"], own, subprocess.DEVNULL)
        outcome = "planned and certified" if code == 0 else f"exit code {code}"
        return scenario, f"{triangles:,}", outcome, f"{memory:.0f} MB", f"{processor_s:.0f} s", f"{clock_s:.0f} s"


def prepare(folder: Path, scenario: str, at_least: int) -> int:
    """Writes the scenario with finer meshes, robots beside it; the number of triangles."""
    text, total = (SCENARIOS / f"{scenario}.toml").read_text(encoding="utf-8"), 0
    (folder / "scenario.toml").write_text(text, encoding="utf-8")
    shutil.copytree(ROBOTS, folder / "robots")
    (folder / "meshes").mkdir()
    files = [file for file in sorted((SCENARIOS / "meshes").glob("*.stl")) if f"meshes/{file.name}" in text]
    rng = np.random.default_rng(0)
    for file in files:
        mesh = trimesh.load_mesh(file)
        while len(mesh.faces) * len(files) < at_least:
            mesh = mesh.subdivide()
        mesh.vertices += rng.normal(size=mesh.vertices.shape) * ROUGHNESS_MM * bool(at_least)
        mesh.export(folder / "meshes" / file.name)
        total += len(mesh.faces)
    return total


def with_innermost(content: dict[str, Any], number: int) -> dict[str, Any]:
    """A robot file of four tubes with a fifth one in them."""
    innermost = copy.deepcopy(content["tube"][-1])
    innermost |= {"outer_diameter_mm": 1.1, "inner_diameter_mm": 0.8, "bending_stiffness_Nm2": 0.003}
    innermost["section"][0]["length_mm"] += innermost["collar_length_mm"]
    moves = ({kind: [*by, by[-1] * (kind == "l")] for kind, by in of["moves"].items()} for of in content["joint"])
    joints = [{**joint, "moves": own} for joint, own in zip(content["joint"], moves, strict=True)]  # it slides along
    joints += [{"name": f"rotate tube {number}", "moves": {"theta": [0] * (number - 1) + [1]}}]
    home = [*content["home"]["l_mm"], content["home"]["l_mm"][-1] - innermost["collar_length_mm"]]
    tubes, contacts = [*content["tube"], innermost], [*content["contact"], content["contact"][-1]]
    return {**content, "tube": tubes, "contact": contacts, "joint": joints, "home": {"l_mm": home}}


def by_tubes() -> Iterator[tuple[object, ...]]:
    """The bound at random configurations, and the certificate of short motions in free space."""
    files = robots()
    files["five tubes"] = with_innermost(files["four tubes"], 5)
    for name in ("pair", "three tubes", "four tubes", "five tubes"):
        robot, rng = robot_from_dict(files[name]), np.random.default_rng(1)
        space, samples = JointSpace.of_robot(robot), list[float]()
        configurations = robot.drive.collars(space.sample(rng, 20))
        began = time.process_time()
        for theta_b, l_b in zip(*configurations, strict=True):
            robot.bound(theta_b, l_b)
        bound_s = (time.process_time() - began) / len(configurations[0])
        while len(samples) < 4:
            start, end = space.sample(rng, 2)
            case = replace(bare_scenario(robot), start=start, start_friction="released", start_turns="absolute")
            began = time.process_time()
            certificate = certify(case, np.array([start, start + SHORT * (end - start)]), restart=False)
            if certificate.valid:
                samples.append((time.process_time() - began) / len(certificate.samples.leg))
        yield name, f"{1e3 * bound_s:.2f} ms", f"{1e3 * np.median(samples):.1f} ms"


def by_targets() -> Iterator[tuple[object, ...]]:
    """Plans of tours in free space whose targets are tips of random configurations."""
    for count in (1, 2, 5, 10, 20):
        case = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
        joints = JointSpace.of_robot(case.robot).sample(np.random.default_rng(0), count)
        tips = [case.robot.solve(*case.robot.drive.collars(q)).tip_m for q in joints]
        goals = [replace(case.goal, joints=None, tip_m=tip, name=f"target {k}") for k, tip in enumerate(tips, start=1)]
        case, began = replace(case, via=tuple(goals[:-1]), goal=goals[-1]), time.process_time()
        try:
            outcome = f"{ctrplan.plan(case).certificate.length_mm:.0f} mm"
        except ctrplan.NoAnswerError as error:
            outcome = str(error).rsplit(": ", 1)[-1]
        yield count, outcome, f"{time.process_time() - began:.1f} s"


def by_legs() -> Iterator[tuple[object, ...]]:
    """The certificate of a path that goes to and fro between two configurations of a scenario."""
    plan = ctrplan.plan(ctrplan.load_scenario(SCENARIOS / "vessel.toml", ["planner.time_s=1"]))
    there = plan.waypoints
    for count in (1, 2, 4, 8):
        way = np.vstack([there[:1], *([there[1:], there[-2::-1]] * count)[:count]])
        case, began = replace(plan.scenario, goal=Goal(way[-1], None, 1e-3)), time.process_time()
        certificate = certify(case, way)
        yield len(way) - 1, len(certificate.samples.leg), f"{time.process_time() - began:.1f} s"


def by_triangles() -> Iterator[tuple[object, ...]]:
    """Plans in the vessel, its mesh divided into more and more triangles."""
    return (plan_apart("vessel", count)[1:] for count in (1_000, 10_000, 100_000, 1_000_000))


COUNTS, RADIUS_MM = (10, 1000, 10_000), (0.5, 2.0)  # of spheres
BOX_MM = ((-120, -120, 0), (120, 120, 220))
FREE_MM = 45.0  # around the axis, so that there is a way; the robot still passes some spheres


def among(count: int) -> str:
    """A scenario of the three-tube robot, which turns by 90 degrees, with so many spheres around it."""
    random, spheres = np.random.default_rng(count), list[str]()
    while len(spheres) < count:
        center, radius = random.uniform(*BOX_MM), random.uniform(*RADIUS_MM)
        if np.hypot(*center[:2]) - radius > FREE_MM:
            sizes = f"center_mm = {center.round(3).tolist()}\nradius_mm = {radius:.3f}\n"
            spheres.append(f'[[anatomy]]\nkind = "sphere"\n{sizes}')
    rest = {"rotate outer": 0, "rotate inner": 0, "translate inner": -86.4}
    start, turned = ({**rest, "rotate middle": degrees} for degrees in (0, 90))
    content = {"robot": "three_tube.toml", "start": start, "goal": {"joints": turned}, "planner": {"time_s": 3}}
    return tomli_w.dumps(content) + "".join(spheres)


def by_spheres() -> Iterator[tuple[str, ...]]:
    """Reading a scenario and planning in it, nothing known beforehand; its search takes 3 s."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(ROBOTS / "three_tube.toml", folder)
        os.environ["CTRPLAN_CACHE_DIR"] = name
        for count in COUNTS:
            (folder / "spheres.toml").write_text(among(count))
            begun = time.perf_counter()
            read = ctrplan.load_scenario(folder / "spheres.toml")
            loaded = time.perf_counter()
            valid = ctrplan.plan(read, seed=1).certificate.valid
            yield f"{count:,}", f"{loaded - begun:.1f} s", f"{time.perf_counter() - loaded:.0f} s", str(valid)


OUTCOME = "triangles | outcome | peak memory | CPU time | by the clock"
BY: dict[str, common.Table] = {
    "triangles": ("growth with triangles", OUTCOME, by_triangles),
    "tubes": ("growth with tubes", "robot | bound | certificate, a sample", by_tubes),
    "targets": ("growth with targets", "targets | joint length | CPU time", by_targets),
    "legs": ("growth with legs", "legs | samples | CPU time of the certificate", by_legs),
    "spheres": ("growth with spheres", "spheres | read | plan | certified", by_spheres),
}


def main() -> int:
    given = common.arguments(
        __doc__, ("section", ("runs", "plan", "growth")), "names*", plans=1000, bounds=100_000, growth=0.05
    )
    common.end_searches_by_count()
    if given.section == "runs":
        return runs(given.plans, given.bounds, given.growth)
    if given.section == "growth":
        common.sections(given.names, BY)
    else:
        rows = map(plan_apart, common.chosen(given.names, SHIPPED))
        table("a plan by itself", f"scenario | {OUTCOME}", rows)
    return 0
