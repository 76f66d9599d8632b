"""Calibrates a robot's friction law on a few simulated histories, once: the result is kept on disk by content hash."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, InputError, SolverError
from ctrplan.mechanics.friction import FrictionLaw, tip_deviations
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import nesting_inequalities
from ctrplan.mechanics.walk import PathDensity, PathLimits
from ctrplan.storage import cache as field_cache
from ctrplan.storage.output_folder import write_atomically

if TYPE_CHECKING:
    from ctrplan.drive.drive import Drive
    from ctrplan.robot.robot import Robot

HISTORIES = 8
LEGS = 5
TURN_RAD, SLIDE_M = 2.0, 15e-3  # largest motion of a leg
DENSITY = PathDensity(rotation_rad=0.2, translation_m=2e-3, motion_m=10e-3, near_m=10e-3)
STABILITY = 0.1  # least; nearer to a snap there is no law
ATTEMPTS = 15  # random paths tried per history wanted
LOADINGS_RAD = np.geomspace(0.03, 6.0, 60)  # looked through for each pair
ARRAYS, ERRORS = ("loading_rad", "release_m"), ("error_rms_m", "error_p95_m", "deviation_rms_m")  # what is stored
PROBES = 16  # joint values by which effects of the drive are told apart
VERSION = 2  # of the law: rises when what is stored means something else

logger = logging.getLogger(__name__)
_known: WeakKeyDictionary[Robot, FrictionLaw] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class SimulatedPath:
    """A history sampled at K configurations, with the tips of the corners there."""

    theta_b: Array  # (K, n)
    l_b: Array  # (K, n)
    tip_m: Array  # (K, 3) simulated
    frictionless_m: Array  # (K, 3)
    corner_tip_m: Array  # (K, 2 ** (n - 1), 3)


def friction_law(robot: Robot) -> FrictionLaw:
    """How rotations load and translations release each pair of a robot.

    Known since it was asked for before, from the cache, or calibrated on simulated histories now: a second or so.
    """
    own = robot.unguided
    if own not in _known:
        _known[own] = _stored_or_fitted(own)
    return _known[own]


def _stored_or_fitted(robot: Robot) -> FrictionLaw:
    key = _digest(robot)
    stored = _load(key)
    if stored is not None:
        return stored
    law = fit(robot, simulated_paths(robot, HISTORIES, np.random.default_rng(0)))
    _store(key, law)
    return law


def simulated_paths(robot: Robot, count: int, rng: np.random.Generator) -> list[SimulatedPath]:
    """Histories of random legs, rotations, translations and both, that start free of friction and do not snap."""
    paths: list[SimulatedPath] = []
    for _ in range(ATTEMPTS * count):
        if len(paths) == count:
            break
        path = _simulate(robot, _random_waypoints(robot, rng))
        if path is not None:
            paths.append(path)
    return paths


def fit(robot: Robot, paths: list[SimulatedPath]) -> FrictionLaw:
    """The law nearest to the simulated tips; one that never releases if there is nothing to learn from."""
    pairs = robot.n - 1
    if not paths or not pairs:
        return FrictionLaw(np.full(pairs, LOADINGS_RAD[0]), np.full(pairs, np.inf))
    radius = np.array([tube.outer_diameter_m / 2 for tube in robot.tubes[1:]])
    every = np.repeat(LOADINGS_RAD[:, None], pairs, axis=1)
    trial = FrictionLaw(every, radius * every)
    start = np.zeros((len(LOADINGS_RAD), pairs))
    states = [trial.follow(path.theta_b, path.l_b, start) for path in paths]  # (K, loadings, pairs) each
    chosen = np.full(pairs, len(LOADINGS_RAD) // 2)
    for _ in range(2):
        for pair in range(pairs):
            costs = []
            for k in range(len(LOADINGS_RAD)):
                chosen[pair] = k
                costs.append(np.mean(np.hypot(_misses(paths, states, chosen), 1e-4)))  # outliers count once
            chosen[pair] = int(np.argmin(costs))
    misses = _misses(paths, states, chosen)
    away = np.concatenate([np.linalg.norm(path.tip_m - path.frictionless_m, axis=1) for path in paths])
    return FrictionLaw(
        loading_rad=LOADINGS_RAD[chosen],
        release_m=radius * LOADINGS_RAD[chosen],
        error_rms_m=float(np.sqrt(np.mean(misses**2))),
        error_p95_m=float(np.quantile(misses, 0.95)),
        deviation_rms_m=float(np.sqrt(np.mean(away**2))),
    )


def misses(law: FrictionLaw, path: SimulatedPath) -> Array:
    """(K,) [m] distances of the law's tips from the simulated ones along a path that starts free of friction."""
    states = law.follow(path.theta_b, path.l_b, np.zeros(path.theta_b.shape[1] - 1))
    return _distances(path, states)


def _misses(paths: list[SimulatedPath], states: list[Array], chosen: Array) -> Array:
    pairs = np.arange(len(chosen))
    return np.concatenate([_distances(path, phi[:, chosen, pairs]) for path, phi in zip(paths, states, strict=True)])


def _distances(path: SimulatedPath, phi: Array) -> Array:
    predicted = path.frictionless_m + tip_deviations(path.corner_tip_m, path.frictionless_m, phi)
    distance: Array = np.linalg.norm(predicted - path.tip_m, axis=1)
    return distance


def _simulate(robot: Robot, joints: Array) -> SimulatedPath | None:
    """The history along waypoints (K, m) of actuated joints; None where it snaps, fails or comes near to that."""
    theta_b, l_b = robot.drive.collars(joints)
    try:
        walk = robot.mechanics.check_path(theta_b, l_b, density=DENSITY, limits=PathLimits(stability=STABILITY))
        end = walk.segment[-1] + walk.fraction[-1]
        if walk.status.max() >= Status.UNSTABLE or end < len(joints) - 1:
            return None
        at = walk.segment + walk.fraction
        rows = np.stack([np.interp(at, np.arange(len(joints)), column) for column in joints.T], axis=1)
        theta_b, l_b = robot.drive.collars(rows)
        history = robot.history().follow(theta_b, l_b)
    except (InputError, SolverError):
        return None
    if history.snaps.any() or np.any(history.status >= Status.UNSTABLE):
        return None
    return SimulatedPath(theta_b, l_b, history.position_m, walk.tip_m, walk.corner_tip_m)


def _random_waypoints(robot: Robot, rng: np.random.Generator) -> Array:
    """(LEGS + 1, m) joint values from a random start, nested where limits and luck allow."""
    drive, (G, h) = robot.drive, nesting_inequalities(robot.tubes, tips_in_order=True)
    low, high = _ranges(drive)
    points = [_nested(rng.uniform(low, high, (200, len(low))), robot, G, h)]
    for _ in range(LEGS):
        kind = rng.integers(3)  # rotation, translation, both
        moved = np.where(drive.is_rotation, kind != 1, kind != 0)
        moved &= rng.random(len(low)) < 0.6
        reach = np.where(drive.is_rotation, TURN_RAD, SLIDE_M) * moved
        tries = np.clip(points[-1] + rng.uniform(-reach, reach, (200, len(low))), drive.lower, drive.upper)
        points.append(_nested(tries, robot, G, h))
    return np.array(points)


def _ranges(drive: Drive) -> tuple[Array, Array]:
    """(m,), (m,) lowest and highest value of each joint, of unlimited rotations once round."""
    unlimited = drive.is_unlimited
    return np.where(unlimited, -np.pi, drive.lower), np.where(unlimited, np.pi, drive.upper)


def _nested(joints: Array, robot: Robot, G: Array, h: Array) -> Array:
    """The first row whose tubes nest, or else the one that comes nearest to it."""
    excess = (robot.drive.collars(joints)[1] @ G.T - h).max(axis=1)
    row: Array = joints[np.argmax(excess <= 1e-9) if np.any(excess <= 1e-9) else np.argmin(excess)]
    return row


def _digest(robot: Robot) -> str:
    drive = robot.drive
    numbers = (robot.clearance_m, robot.friction, drive.home_theta_rad, drive.home_l_m, drive.lower, drive.upper)
    content = [repr((VERSION, robot.tubes, robot.loads)).encode()]
    content += [np.ascontiguousarray(x).tobytes() for x in (*numbers, drive.matrix_theta, drive.matrix_l)]
    if drive.terms:  # functions, known by what they do
        joints = np.random.default_rng(0).uniform(*_ranges(drive), (PROBES, len(drive.joints)))
        content += [np.ascontiguousarray(x).tobytes() for x in drive.collars(joints)]
    return hashlib.sha256(b"|".join(content)).hexdigest()


def _path(key: str) -> Path | None:
    directory = field_cache.cache_directory()
    return None if directory is None else directory / "friction_laws" / f"{key}.json"


def _load(key: str) -> FrictionLaw | None:
    """The stored law; None when there is none that can be trusted."""
    path = _path(key)
    if path is None:
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["sha256"] != _seal(content["law"]):
            raise ValueError("content does not match its hash")
        loading, release = (np.array(content["law"][name], dtype=np.float64) for name in ARRAYS)
        return FrictionLaw(loading, release, *(float(content["law"][name]) for name in ERRORS))
    except OSError:
        return None
    except (ValueError, TypeError, KeyError) as error:
        logger.warning("cached friction law %s is damaged and will be calibrated again (%s)", path, error)
        return None


def _seal(law: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(law, sort_keys=True).encode()).hexdigest()


def _store(key: str, law: FrictionLaw) -> None:
    """Keeps a law; not being able to is no error."""
    path = _path(key)
    if path is None:
        return
    try:
        os.makedirs(path.parent, exist_ok=True)
        content = {name: np.asarray(getattr(law, name)).tolist() for name in (*ARRAYS, *ERRORS)}
        write_atomically(path, json.dumps({"sha256": _seal(content), "law": content}))
    except (OSError, CtrplanError) as error:
        logger.info("friction law not cached: %s", error)
