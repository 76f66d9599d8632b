"""Is a certified motion hit where something stated is uncertain? Scenes of six kinds, judged by brute force.

    python benchmarks/run.py stated_hunt [--scenes 300] [--first 0] [--seed 1] [--only N] [KIND ...]

Kinds: parameters, registration, play, drive terms, late drives, and all of these mixed. Scene by scene: two or three
tubes, a path of one to three legs between random configurations, one obstacle (ball, needle, plate or rough stone of
triangles). Of four scenes one is plain; in one the obstacle moves through three phases, in one the path was edited by
hand (corners anywhere beside it, all joints at once), in one its middle is a target on the way, certified as a tour.
The path is driven by many robots that the file allows: parameters, play and friction at all corners of their intervals
(the most corners that are driven are CORNERS, at random), and inside; the base moved and turned so that each point
comes nearest; late joints in time; at places 2 mm of body motion apart. None of that is the certificate's code: robots
are made from changed files.

The obstacle stands beside a body point of a robot that comes far out, so that the cloud of all bodies is left a
clearance drawn from -1.5 to 0 mm ("hit") or exactly 1 mm ("clear"; scenes where a robot snaps on its way do not count).
Of scenes that are certified a hit is one by more than 0.05 mm on the certificate mesh. Certified ones are looked at
closer by a descent over all numbers from the nearest robots.

Results are kept scene by scene in build/stated_hunt.jsonl; another run goes on there. Every scene depends on the seed
and its number alone.
"""

import copy
import itertools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import common
import numpy as np
import trimesh
from common import ROBOTS, ROOT, table
from scipy.spatial import cKDTree

import ctrplan
from ctrplan import Capsule, CtrplanError, Mesh, Registration, Robot, Scenario, Sphere, Status, robot_from_dict
from ctrplan.anatomy.parts import AnatomyPart, Phases
from ctrplan.anatomy.shape import PartShape
from ctrplan.audit.body import RawAnatomy
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import certify
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.storage.toml_document import read_document

RESULTS = ROOT / "build" / "stated_hunt.jsonl"
KINDS = ("parameters", "registration", "play", "drive terms", "late drives", "mixed")
SETTINGS = ("plain", "moving", "edited", "tour")
ROBOTS_USED = ("three_tube", "three_tube", "table_5_pair", "three_tube_insertion")
APART_M = 2e-3  # motion of the tip between places that are looked at
MOST_PLACES, CORNERS, INSIDE = 60, 128, 10
SLOPE_M = 0.05e-3  # over which distances are differenced
HIT_M = 0.05e-3  # of clearance below zero
HALVINGS = 12  # of a way between places: to half a micrometre
SNAPS_MM = 1.0  # that a robot still moves then
CHI95 = 2.795483  # 95 % of distances of three Gaussian coordinates, in standard deviations


Knob = tuple[tuple[Any, ...], float, float]  # place of an uncertain number in the robot file, from low to high


@dataclass(frozen=True)
class World:
    """What is stated: content of the robot file, its knobs, play (half widths, 2 n) and the registration's sigmas."""

    content: dict[str, Any]
    knobs: tuple[Knob, ...]
    play: Array  # (2 n,) rad, m
    registration: Registration
    delays_s: tuple[float, float]  # of rotations, of translations
    made: dict[bytes, Robot] = field(default_factory=dict)  # robots by shares

    @property
    def robot(self) -> Robot:
        return robot_from_dict(self.content, file=str(ROBOTS / "hunted.toml"))

    def changed(self, share: Array) -> Robot:
        """The robot with its knobs at shares (K,) from -1 to 1 of their intervals, as if the file said so."""
        if (known := self.made.get(share.tobytes())) is not None:
            return known
        content = copy.deepcopy({key: value for key, value in self.content.items() if key != "uncertainty"})
        for (place, low, high), s in zip(self.knobs, share, strict=True):
            at = content
            for key in place[:-1]:
                at = at[key]
            at[place[-1]] = (low + high) / 2 + s * (high - low) / 2
        self.made[share.tobytes()] = robot_from_dict(content, file=str(ROBOTS / "hunted.toml"))
        return self.made[share.tobytes()]


def world(kind: str, rng: np.random.Generator) -> World:
    content = copy.deepcopy(dict(read_document(ROBOTS / f"{rng.choice(ROBOTS_USED)}.toml").content))
    content.pop("uncertainty", None)
    n, knobs, ci95 = len(content["tube"]), list[Knob](), dict[str, list[float]]()
    play, effects, sigma, delays = np.zeros(2 * n), dict[str, Any](), [0.0, 0.0], (0.0, 0.0)
    kinds = [str(k) for k in rng.choice(KINDS[:5], 2, replace=False)] if kind == "mixed" else [kind]
    if "parameters" in kinds:
        for i in rng.permutation(n)[: rng.integers(1, 4)]:
            tube, what = content["tube"][i], rng.integers(3)
            j = max(range(len(tube["section"])), key=lambda j: abs(tube["section"][j]["curvature_y_per_m"]))
            value = tube["section"][j]["curvature_y_per_m"] if what < 2 else tube["bending_stiffness_Nm2"]
            half = abs(value) * rng.uniform(0.02, 0.1 if what < 2 else 0.2)
            low, high = value - half * rng.uniform(0.5, 1), value + half * rng.uniform(0.5, 1)
            if what < 2:
                ci95[f"tube.{i + 1}.section.{j + 1}.curvature_y_per_m"] = [low, high]
                knobs.append((("tube", i, "section", j, "curvature_y_per_m"), low, high))
            else:
                ci95[f"tube.{i + 1}.bending_stiffness_Nm2"] = [low, high]
                knobs.append((("tube", i, "bending_stiffness_Nm2"), low, high))
    if "play" in kinds:
        for i in rng.permutation(n)[: rng.integers(1, n + 1)]:
            degrees = float(rng.uniform(1, 6))
            effects.setdefault("backlash", {})[f"theta_{i + 1}_deg"] = degrees
            play[i] = np.radians(degrees) / 2
    if "drive terms" in kinds:
        i = int(rng.integers(n))
        home_mm = content["home"]["l_mm"][n - 1]
        if rng.integers(2):
            effects["eccentricity"] = {f"sin_{i + 1}_deg": float(rng.uniform(2, 10))}
        else:
            effects[f"learned_theta_{i + 1}"] = {
                "stage": "drive", "acts_on": f"the rotation of tube {i + 1}",
                f"bump_{rng.integers(2, 5)}_of_5_l_{n}_deg": float(rng.uniform(4, 15)),
                "range": {f"l_{n}": [home_mm - rng.uniform(30, 80), home_mm - rng.uniform(0, 20)]},
            }  # fmt: skip
    if "late drives" in kinds:
        delays = (float(rng.uniform(0.1, 0.4)), 0.0) if rng.integers(2) else (0.0, float(rng.uniform(0.1, 0.4)))
        effects["drive_lag"] = {"theta_s": delays[0], "l_s": delays[1]}
    if "registration" in kinds:
        sigma = [float(rng.uniform(0.1, 0.8)) * 1e-3, float(np.radians(rng.uniform(0, 0.6)))]
    content["effects"] = effects
    if ci95:
        content["uncertainty"] = {"ci95": ci95}
    return World(content, tuple(knobs), play, Registration(*sigma), delays)


def path(space: JointSpace, robot: Robot, rng: np.random.Generator) -> Array | None:
    """(K, m) from a stable configuration to another one nearby, by one to three legs; None where none was drawn."""
    for _ in range(40):
        a, b = space.sample(rng, 2)
        b = a + (b - a) * rng.uniform(0.1, 0.4)
        shape = robot.solve(*robot.drive.collars(a))
        if shape.status > 0 or shape.stability < 0.2 or shape.tip_m[2] < 40e-3:
            continue
        corner = np.where(robot.drive.is_rotation, b, a)
        way = np.array([a, b]) if rng.integers(2) else np.array([a, corner, b])
        if robot.mechanics.check_path(*robot.drive.collars(way)).status[-1] < Status.UNSTABLE:
            return way
    return None


def edited(way: Array, space: JointSpace, rng: np.random.Generator) -> Array:
    """The path (K, m) with a corner beside every leg's middle, off by 3 deg and 2 mm at a time (one sigma)."""
    off = np.where(space.drive.is_rotation, np.radians(3), 2e-3) * rng.standard_normal((len(way) - 1, way.shape[1]))
    middles = space.projected((way[:-1] + way[1:]) / 2 + off, fallback=(way[:-1] + way[1:]) / 2)
    return np.insert(way, range(1, len(way)), middles, axis=0)


def driven(w: World, robot: Robot, corners: Array) -> Array:
    """(R, m) joints along the path as the drive has them in time."""
    if not any(w.delays_s):
        pieces = [a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in zip(corners[:-1], corners[1:], strict=True)]
        return np.concatenate(pieces)
    motion = time_parameterise(corners, robot.drive, joinable=True)
    late = np.where(robot.drive.is_rotation, *w.delays_s)
    at = np.arange(0, motion.duration_s + max(w.delays_s) + 0.01, 0.01)
    columns = zip(late, motion.position.T, strict=True)
    return np.array([np.interp(at - delay, motion.time_s, column) for delay, column in columns]).T


def places(robot: Robot, rows: Array) -> Array:
    """(P, m) rows of the way no farther than APART_M of tip motion apart, MOST_PLACES at most."""
    tips = robot.mechanics.tips_with_friction(*robot.drive.collars(rows), np.zeros((len(rows), robot.n - 1))).position_m
    moved = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
    count = int(np.clip(np.ceil(moved[-1] / APART_M), 2, MOST_PLACES))
    return rows[np.searchsorted(moved, np.linspace(0, moved[-1], count)).clip(0, len(rows) - 1)]


@dataclass(frozen=True)
class Draw:
    """One robot that the file allows: knobs, play, and a friction state."""

    knobs: Array
    play: Array
    phi: Array

    def body(self, w: World, joints: Array, spacing_m: float = 2e-3, accuracy: str = "search") -> tuple[Array, Array]:
        """(N, 3) points and (N,) radii, the base where it is said to be; NaN without an equilibrium."""
        robot = w.changed(self.knobs)
        theta_b, l_b = robot.drive.collars(joints)
        n = robot.n
        theta_b, l_b = theta_b + self.play[:n] * w.play[:n], l_b + self.play[n:] * w.play[n:]
        at = robot.mechanics.friction_states(theta_b, l_b, accuracy=accuracy)  # type: ignore[arg-type]
        result = at.bodies(self.phi[None], spacing_m=spacing_m)
        body = result.point_m[0] if result.solved[0] else np.full_like(result.point_m[0], np.nan)
        return body, result.radius_m


def draws(w: World, rng: np.random.Generator) -> list[Draw]:
    """The file's robot, corners of all that is uncertain, and robots inside."""
    n, k, playing = w.robot.n, len(w.knobs), np.flatnonzero(w.play)
    axes = k + len(playing) + n - 1
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=axes)))
    signs = signs if len(signs) <= CORNERS else rng.permutation(signs)[:CORNERS]
    results = [Draw(np.zeros(k), np.zeros(2 * n), np.zeros(n - 1))]
    for row in [*signs, *rng.uniform(-1, 1, (INSIDE, axes))]:
        play = np.zeros(2 * n)
        play[playing] = row[k : k + len(playing)]
        results.append(Draw(row[:k], play, row[k + len(playing) :]))
    return results


def obstacle(center: Array, outward: Array, rng: np.random.Generator) -> PartShape:
    """A ball, a stone, a needle or a plate whose nearest point to what comes from -outward is about `center`."""
    kind, across = rng.integers(4), np.cross(outward, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    radius = rng.uniform(0.3e-3, 4e-3)
    if kind == 0:
        return Sphere(center + radius * outward, radius)
    if kind == 3:
        ball = trimesh.creation.icosphere(subdivisions=1, radius=radius)
        rough = ball.vertices * rng.uniform(0.6, 1.2, (len(ball.vertices), 1))
        return Mesh(rough + center + radius * outward, np.array(ball.faces))
    if kind == 1:
        middle, half = center + 0.1e-3 * outward, rng.uniform(1e-3, 30e-3)
        return Capsule(middle - half * across, middle + half * across, 0.1e-3)
    box = trimesh.creation.box(extents=[8e-3, 8e-3, 1e-3])
    axes = np.stack([across, np.cross(outward, across), outward], axis=1)
    return Mesh(box.vertices @ axes.T + center + 0.5e-3 * outward, np.array(box.faces))


def moving(center: Array, outward: Array, rng: np.random.Generator) -> PartShape:
    """The obstacle in three phases, 3 mm apart (one sigma)."""
    steps, state, phases = np.vstack([np.zeros(3), 3e-3 * rng.standard_normal((2, 3))]), rng.bit_generator.state, []
    for step in steps:
        rng.bit_generator.state = state
        phases.append(obstacle(center + step, outward, rng))
    return Phases(tuple(phases), "avoid", 0.0)


def scene(number: int, seed: int, kinds: tuple[str, ...]) -> dict[str, Any]:
    rng = np.random.default_rng([seed, number])
    kind = kinds[number % len(kinds)]
    w = world(kind, rng)

    def skipped(why: str) -> dict[str, Any]:
        return {"number": number, "kind": kind, "skipped": why}

    try:
        robot = w.robot
    except CtrplanError as error:
        return skipped(str(error))
    bare = replace(bare_scenario(robot), registration=w.registration)
    corners, setting = path(space := JointSpace.of(bare), robot, rng), str(rng.choice(SETTINGS))
    if corners is None:
        return skipped("no path")
    setting = "plain" if setting == "tour" and any(w.delays_s) else setting  # late drives' tours are refused by name
    if setting in ("edited", "tour"):
        corners = edited(corners, space, rng)
    rows = places(robot, driven(w, robot, corners))
    bodies, radii, owner = [], [], []
    every = draws(w, rng)
    for k, joints in enumerate(rows):
        for d, draw in enumerate(every):
            try:
                body, radius = draw.body(w, joints)
            except CtrplanError:
                return skipped("no equilibrium")
            if not np.isfinite(body).all():
                return skipped("no equilibrium")
            bodies.append(body)
            radii.append(radius)
            owner.append(np.full((len(body), 2), (k, d)))
    cloud, radius, own = np.concatenate(bodies), np.concatenate(radii), np.concatenate(owner)
    placed = _placed(w, cloud, radius, own, rng, moving if setting == "moving" else obstacle)
    if placed is None:
        return skipped("no place beside the bodies")
    is_clear, shape = placed
    part = AnatomyPart(shape, "avoid", 0.0)
    case = replace(bare, start=corners[0], goal=replace(bare.goal, joints=corners[-1], tip_m=None), anatomy=(part,))
    began = time.process_time()
    if setting == "tour":
        middle = replace(case.goal, joints=corners[len(corners) // 2], table="target.1")
        certificate = ctrplan.certify(replace(case, via=(middle,)), corners)
    else:
        certificate = certify(case, corners, restart=False)
    spent_s = time.process_time() - began
    least, draw, joints = _nearest(w, case, rows, every, cloud, radius, own)
    result = {
        "number": number, "kind": kind, "setting": setting, "spent_s": spent_s,
        "clear": is_clear, "certified": certificate.valid,
        "stated_mm": 1e3 * certificate.min_clearance_m, "brute_mm": 1e3 * least,
        "problem": next(iter(certificate.problems), ""), "shape": shape.kind,
    }  # fmt: skip
    if certificate.valid:
        result["descended_mm"] = 1e3 * _descended(w, case, joints, draw, rows, rng)
    elif is_clear:
        tips = np.array([body[-1] for body in bodies]).reshape(len(rows), len(every), 3)
        result["leap_mm"] = 1e3 * _leap(w, rows, every, tips)
    return result


def _placed(
    w: World, cloud: Array, radius: Array, own: Array, rng: np.random.Generator, made: Callable[..., PartShape]
) -> tuple[bool, PartShape] | None:
    """An obstacle beside what comes far out; whether the cloud is left 1 mm, else it is hit."""
    middle = cloud[own[:, 1] == 0]  # of the file's robot
    tree, inner = cKDTree(cloud), cKDTree(middle)
    far = inner.query(cloud)[0] * (np.linalg.norm(cloud, axis=1) > 15e-3)
    for _ in range(60):
        weights = far**2 if rng.integers(3) else (np.linalg.norm(cloud, axis=1) > 15e-3).astype(float)
        k = int(rng.choice(len(cloud), p=weights / weights.sum()))
        outward = cloud[k] - middle[inner.query(cloud[k])[1]]
        if np.linalg.norm(outward) < 0.1e-3 or not rng.integers(4):
            outward = rng.standard_normal(3)
        outward /= np.linalg.norm(outward)
        is_clear = bool(rng.integers(2))
        wanted = 1e-3 if is_clear else rng.uniform(-1.5e-3, -0.1e-3)
        state = rng.bit_generator.state
        low, high = -5e-3, 12e-3  # of the obstacle's face beyond the tube's surface at the point
        for _ in range(24):
            at = (low + high) / 2
            rng.bit_generator.state = state
            shape = made(cloud[k] + (radius[k] + at) * outward, outward, rng)
            near = tree.query_ball_point(cloud[k] + (radius[k] + at) * outward, 45e-3)
            room = _room(shape, cloud[near], w) - radius[near]
            if room.min(initial=np.inf) < wanted:
                low = at
            else:
                high = at
        if high > 11.9e-3:
            continue
        base = _room(shape, np.zeros((1, 3)))[0]
        nominal = float((_room(shape, middle) - radius[own[:, 1] == 0]).min())
        if base > 8e-3 and nominal > 0.3e-3:
            return is_clear, shape
    return None


def _room(shape: PartShape, points: Array, w: World | None = None) -> Array:
    """(K,) [m] from points (K, 3) to the obstacle, where the base of a world brings each of them nearest to it."""
    raw = RawAnatomy.of((AnatomyPart(shape, "avoid", 0.0),))
    room = np.asarray(raw.room(points))
    if w is None or w.registration.is_exact or not len(points):
        return room
    shift = CHI95 * w.registration.position_sigma_m
    turn = CHI95 * w.registration.rotation_sigma_rad
    reach = shift + turn * np.linalg.norm(points, axis=1)
    near = np.flatnonzero(room - reach < (room - reach).min() + 1e-3)
    ends = [raw.room(points[near] + side) for side in SLOPE_M * np.vstack([np.eye(3), -np.eye(3)])]
    slope = (np.array(ends[:3]) - np.array(ends[3:])).T / (2 * SLOPE_M)
    room[near] -= shift + turn * np.linalg.norm(np.cross(points[near], slope), axis=1)
    return room


def _clearance(w: World, case: Scenario, joints: Array, draw: Draw, accuracy: str = "certificate") -> float:
    try:
        body, radius = draw.body(w, joints, 0.5e-3, accuracy)
    except CtrplanError:
        return np.inf
    return float((_room(case.anatomy[0].shape, body, w) - radius).min()) if np.isfinite(body).all() else np.inf


def _nearest(
    w: World, case: Scenario, rows: Array, every: list[Draw], cloud: Array, radius: Array, own: Array
) -> tuple[float, Draw, Array]:
    room = _room(case.anatomy[0].shape, cloud, w) - radius
    best: tuple[float, Draw, Array] = (np.inf, every[0], rows[0])
    for k in np.argsort(room)[:200:20]:
        place, d = own[k]
        least = _clearance(w, case, rows[place], every[d])
        if least < best[0]:
            best = least, every[d], rows[place]
    return best


def _leap(w: World, rows: Array, every: list[Draw], tips: Array) -> float:
    """[m] what is left, in ever shorter steps, of the longest way of any tip (P, D, 3) between neighbouring places.

    It is nothing unless the robot snaps there.
    """
    moved = np.linalg.norm(np.diff(tips, axis=0), axis=2)
    k, d = np.unravel_index(int(np.argmax(moved)), moved.shape)
    (a, tip_a), (b, tip_b) = (rows[k], tips[k, d]), (rows[k + 1], tips[k + 1, d])
    for _ in range(HALVINGS):
        middle = (a + b) / 2
        tip = every[d].body(w, middle)[0][-1]
        if np.linalg.norm(tip - tip_a) > np.linalg.norm(tip_b - tip):
            b, tip_b = middle, tip
        else:
            a, tip_a = middle, tip
    return float(np.linalg.norm(tip_b - tip_a))


def _descended(w: World, case: Scenario, joints: Array, draw: Draw, rows: Array, rng: np.random.Generator) -> float:
    """[m] the least clearance that changes of all numbers lead to, one group at a time, 120 tries."""
    place = int(np.argmin(np.abs(rows - joints).sum(axis=1)))
    least, step = _clearance(w, case, joints, draw, "search"), 0.7
    for number in range(120):
        knobs = np.clip(draw.knobs + step * rng.standard_normal(len(draw.knobs)), -1, 1)
        play = np.clip(draw.play + step * rng.standard_normal(len(draw.play)), -1, 1)
        phi = np.clip(draw.phi + step * rng.standard_normal(len(draw.phi)), -1, 1)
        other = int(np.clip(place + rng.integers(-1, 2), 0, len(rows) - 2))
        at = rows[other] + rng.uniform(0, 1) * (rows[other + 1] - rows[other])
        tried = Draw(knobs, play, phi)
        value = _clearance(w, case, at, tried, "search")
        if value < least:
            least, draw, joints, place = value, tried, at, other
        elif number % 20 == 19:
            step *= 0.6
    return _clearance(w, case, joints, draw)


def main() -> None:
    given = common.arguments(__doc__, ("kinds*", KINDS), scenes=300, first=0, seed=1, only=int)
    kinds = tuple(given.kinds) or KINDS
    if given.only is not None:
        print(json.dumps(scene(given.only, given.seed, kinds), indent=1))
        return
    known = common.kept(RESULTS)
    done = {(row["number"], row["seed"]) for row in known}
    for number in range(given.first, given.first + given.scenes):
        if (number, given.seed) in done:
            continue
        result = scene(number, given.seed, kinds)
        known.append({**result, "seed": given.seed})
        common.keep(RESULTS, known[-1])
    rows = []
    for kind in (*kinds, *SETTINGS):
        own = [row for row in known if kind in (row["kind"], row.get("setting")) and "skipped" not in row]
        certified = [row for row in own if row["certified"]]
        hit = [row for row in certified if min(row["brute_mm"], row["descended_mm"]) < -1e3 * HIT_M]
        clear = [row for row in own if row["clear"] and row.get("leap_mm", 0.0) < SNAPS_MM]
        passed = sum(row["certified"] for row in clear)
        seconds = float(np.median([row["spent_s"] for row in own])) if own else np.nan
        rows.append((kind, len(own), len(certified), len(hit), f"{passed} of {len(clear)}", f"{seconds:.1f} s"))
    table("scenes", "kind | scenes | certified | hit | clear by 1 mm and certified | processor", rows)
