"""The bound looked up instead of solved: a grid over the joint coordinates that matter, built once per robot.

Common rotation turns the result and nothing else, so that the coordinates are the rotation of each tube against its
outer neighbour and the base translations that the drive moves. The grid serves the search; certificates use the model.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import PROGRESS, Flag, Made, checked
from ctrplan.base.arrays import Array
from ctrplan.base.version import __version__
from ctrplan.errors import CtrplanError, InputError
from ctrplan.mechanics.bound_lookup import FieldLookup
from ctrplan.mechanics.tube import Loads, nests
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits, PathSamples
from ctrplan.storage import cache as field_cache

if TYPE_CHECKING:
    from ctrplan.base.long_work import Progress
    from ctrplan.robot.robot import Robot

STEPS = [(15.0, 2.5), (20.0, 5.0), (30.0, 10.0), (45.0, 20.0)]  # deg, mm: the first that is small enough
MOST_POINTS = 30_000  # about 40 s on two cores
MOST_BYTES = 1_000_000_000
CHUNK = 256
TRIALS = 400  # random configurations at which the interpolation is compared with the model
QUANTILE = 0.99  # of the errors found there, added to every bound
UNUSED = "is not used, `ctrplan field` builds it again"
FORMAT = 2  # rises when what is stored means something else


@dataclass(frozen=True)
class Axis:
    """One coordinate of the grid: rotation of tube `tube` (from 0) against its outer one, or base translation."""

    tube: int
    rotation: bool
    lower: float  # rad or m
    step: float
    count: int


@dataclass(frozen=True)
class FieldError:
    """Interpolation error against the model at random configurations between the grid's points."""

    margin_m: float  # the 99 % quantile: added to every bound and envelope
    largest_m: float  # a looked-up bound lies below the true one by at most this less the margin
    uncovered: float  # share of configurations next to unstable or unsolved ones, which the grid does not answer

    @property
    def answers_nothing(self) -> bool:
        """Whether no configuration that was tried has an answer, so that there are no errors either."""
        return self.uncovered == 1


@dataclass(frozen=True, eq=False)
class BoundTable:
    """A grid of bounds, stabilities and shapes of a robot; answers as `Mechanics.check_path` does."""

    robot: Robot
    axes: tuple[Axis, ...]
    values: NDArray[np.float32]  # (points, numbers per point), last axis fastest
    error: FieldError
    key: str  # hash of the robot and the axes

    @cached_property
    def median_m(self) -> float:
        """[m] of the bounds in it, where it has any."""
        known = self.values[self.values[:, FieldLookup.VALID] > 0].astype(np.float64)
        return float(np.median(FieldLookup.entries(known).position_m)) if len(known) else 0.0

    @cached_property
    def lookup(self) -> FieldLookup:
        """The core's view of the grid."""
        return FieldLookup(self.robot.mechanics, [_given(axis) for axis in self.axes], self.values, self.error.margin_m)

    def check_path(
        self, theta_b: Array, l_b: Array, field: Field | None, *, density: PathDensity, limits: PathLimits
    ) -> PathSamples:
        """Walks the straight lines between configurations (K, n), (K, n) by lookup; see `Mechanics.check_path`.

        A sample next to configurations that the grid has no answer for has the status FAILED.
        """
        return self.lookup.check_path(theta_b, l_b, field, density=density, limits=limits)


@checked(robot=Made("Robot"), progress=PROGRESS, build=Flag(), keep=Flag())
def tabulated_bounds(
    robot: Robot, *, progress: Progress | None = None, build: bool = True, keep: bool = False
) -> BoundTable | None:
    """The robot's field: from the cache if it is there, else built, with `progress` told the finished share.

    None where it is not in the cache and `build` is False. Raises InputError where even a coarse grid is too large, and
    for robots to which common rotation or the drive does more than such a grid knows of. With `keep` raises
    CtrplanError where a field that was built can't be kept; else it is not.
    """
    _check_coordinates(robot)
    axes = choose_axes(robot)
    key = _key(robot, axes)
    points = math.prod(axis.count for axis in axes)
    shape = (points + 1, FieldLookup.NUMBERS)  # the last row holds the error
    table = field_cache.load(key, shape, "will be rebuilt" if build else UNUSED)
    if table is None:
        if not build:
            return None
        if keep and (refused := field_cache.trouble()):  # before minutes are spent on it
            raise CtrplanError(f"the bound field could not be kept: {refused}.")
        table = _solve(robot, axes, progress)
        refused = field_cache.store(key, table)
        if keep and refused:
            raise CtrplanError(f"the bound field was built but not kept: {refused}.")
    margin, largest, uncovered = (float(x) for x in table[-1, :3])
    return BoundTable(robot, axes, table[:-1], FieldError(margin, largest, uncovered), key)


def known_table(robot: Robot) -> BoundTable | None:
    """The robot's field if it has been built before and knows anything."""
    try:
        table = tabulated_bounds(robot, build=False)
    except InputError:  # no grid answers for it
        return None
    return None if table is None or table.error.answers_nothing else table


def _check_coordinates(robot: Robot) -> None:
    """Raises InputError unless rotations against the outer tube and base translations say all about a shape."""
    rule = ""
    if robot.loads != Loads():
        rule = "has loads with a direction of their own, which common rotation does not turn along"
    elif robot.drive.terms:
        rule = "has effects of the drive, after which collars stand elsewhere than a grid over the joints says"
    if rule:
        raise InputError(f"{rule}: there is no bound field for it, plan without", **_named(robot))


def choose_axes(robot: Robot) -> tuple[Axis, ...]:
    """The coordinates that matter and their steps. Raises InputError, with the size, where no step is coarse enough."""
    points = size = 0
    for rotation_deg, translation_mm in STEPS:
        axes = (*_rotations(robot, math.radians(rotation_deg)), *_translations(robot, translation_mm * 1e-3))
        points = math.prod(axis.count for axis in axes)
        size = 4 * points * FieldLookup.NUMBERS
        if points <= MOST_POINTS and size <= MOST_BYTES:
            return axes
    rule = (
        f"its bound field would have {points:,} points ({size / 1e9:.1f} GB) over {len(axes)} coordinates, plan without"
    )
    raise InputError(rule, **_named(robot))


def _named(robot: Robot) -> dict[str, Any]:
    """What an InputError calls the robot."""
    return {"file": robot.path, "key": "robot", "value": robot.name}


def _rotations(robot: Robot, step: float) -> list[Axis]:
    turns = robot.drive.matrix_theta
    count = round(2 * math.pi / step)
    return [
        Axis(i, True, -math.pi, 2 * math.pi / count, count)
        for i in range(1, robot.n)
        if not np.array_equal(turns[i], turns[i - 1])
    ]


def _translations(robot: Robot, step: float) -> list[Axis]:
    """One axis per group of tubes that the drive moves alike."""
    moves, axes, seen = robot.drive.matrix_l, [], list[Array]()
    for i in range(robot.n):
        if not moves[i].any() or any(np.array_equal(moves[i], row) for row in seen):
            continue
        seen.append(moves[i])
        moved = moves[i] != 0
        ends = moves[i, moved] * np.stack([robot.drive.lower[moved], robot.drive.upper[moved]])
        low, high = (float(robot.drive.home_l_m[i] + side.sum()) for side in (ends.min(axis=0), ends.max(axis=0)))
        count = max(2, math.ceil((high - low) / step) + 1)
        axes.append(Axis(i, False, low, (high - low) / (count - 1), count))
    return axes


def _collars(robot: Robot, axes: tuple[Axis, ...], coordinates: Array) -> tuple[Array, Array]:
    """Base rotations and translations (K, n) of grid coordinates (K, axes), tube 1 turned to zero."""
    home_theta, home_l = robot.drive.home_theta_rad, robot.drive.home_l_m
    relative = np.tile(np.diff(home_theta, prepend=home_theta[0]), (len(coordinates), 1))
    l_b = np.tile(home_l, (len(coordinates), 1))
    for k, axis in enumerate(axes):
        if axis.rotation:
            relative[:, axis.tube] = coordinates[:, k]
            continue
        alike = [i for i in range(robot.n) if np.array_equal(robot.drive.matrix_l[i], robot.drive.matrix_l[axis.tube])]
        l_b[:, alike] = home_l[alike] + (coordinates[:, k] - home_l[axis.tube])[:, None]
    return np.cumsum(relative, axis=1), l_b


def _solve(robot: Robot, axes: tuple[Axis, ...], progress: Progress | None) -> NDArray[np.float32]:
    grids = np.meshgrid(*[axis.lower + axis.step * np.arange(axis.count) for axis in axes], indexing="ij")
    coordinates = np.stack([grid.ravel() for grid in grids], axis=1)
    table = np.zeros((len(coordinates) + 1, FieldLookup.NUMBERS), np.float32)
    theta_b, l_b = _collars(robot, axes, coordinates)
    mirrors = _mirrors(axes) if _is_planar(robot) else np.arange(len(coordinates))
    solved = np.flatnonzero(nests(robot.tubes, l_b) & (np.arange(len(coordinates)) <= mirrors))
    for first in range(0, len(solved), CHUNK):
        rows = solved[first : first + CHUNK]
        table[rows] = robot.mechanics.field_entries(theta_b[rows], l_b[rows])
        if progress is not None:
            progress(min(1.0, (first + len(rows)) / (len(solved) + TRIALS)))
    table[mirrors[solved]] = np.where(mirrors[solved, None] == solved[:, None], 1, FieldLookup.MIRROR) * table[solved]
    table[np.isnan(table).any(axis=1)] = 0  # unsolved points have no shape
    table[-1, :3] = _measure(robot, axes, table[:-1])
    if progress is not None:
        progress(1.0)
    return table


def _is_planar(robot: Robot) -> bool:
    """Whether turning all tubes the other way gives the mirrored shape: all curved in one plane, and round."""
    sections = [section for tube in robot.tubes for section in tube.sections]
    round_tubes = all(tube.ovality == 0 for tube in robot.tubes)
    return round_tubes and all(section.curvature_x_per_m == 0 for section in sections)


def _mirrors(axes: tuple[Axis, ...]) -> NDArray[np.int_]:
    """For each grid point that with all rotations reversed."""
    indices = np.meshgrid(*[np.arange(axis.count) for axis in axes], indexing="ij")
    reversed_ = [(-index) % axis.count if axis.rotation else index for axis, index in zip(axes, indices, strict=True)]
    return np.ravel_multi_index(reversed_, [axis.count for axis in axes]).ravel()


def _measure(robot: Robot, axes: tuple[Axis, ...], values: NDArray[np.float32]) -> tuple[float, float, float]:
    """Margin, largest error and uncovered share from random configurations."""
    rng = np.random.default_rng(0)
    spans = [axis.step * (axis.count if axis.rotation else axis.count - 1) for axis in axes]
    coordinates = np.array([axis.lower for axis in axes]) + rng.random((TRIALS, len(axes))) * spans
    theta_b, l_b = _collars(robot, axes, coordinates)
    inside = nests(robot.tubes, l_b)
    theta_b, l_b = theta_b[inside], l_b[inside]
    exact = robot.mechanics.field_entries(theta_b, l_b)
    found = FieldLookup(robot.mechanics, [_given(axis) for axis in axes], values, 0.0).sample(theta_b, l_b)
    covered = (found.valid > 0) & (exact[:, FieldLookup.VALID] > 0)
    true = FieldLookup.entries(exact)
    short = np.maximum(true.position_m - found.position_m, 0)
    # a corner's point is as far from the looked-up centreline as its envelope and the centreline's own error together
    outside = np.linalg.norm(true.points_m - found.points_m, axis=2) + true.envelope_m - found.envelope_m
    errors = np.maximum(short, outside.max(axis=1))[covered]
    if not errors.size:
        return 0.0, 0.0, 1.0
    return float(np.quantile(errors, QUANTILE)), float(errors.max()), float(1 - covered.mean())


def _given(axis: Axis) -> tuple[int, bool, float, float, int]:
    return axis.tube, axis.rotation, axis.lower, axis.step, axis.count


def _key(robot: Robot, axes: tuple[Axis, ...]) -> str:
    content = {
        "robot": repr((robot.tubes, robot.clearance_m.tolist(), robot.friction.tolist(), robot.loads)),
        "axes": [_given(axis) for axis in axes],
        "home": [robot.drive.home_theta_rad.tolist(), robot.drive.home_l_m.tolist()],
        "moves": [robot.drive.matrix_theta.tolist(), robot.drive.matrix_l.tolist()],  # which tubes move together
        "numbers": FieldLookup.NUMBERS,
        "version": [__version__, FORMAT],
        "trials": [TRIALS, QUANTILE],
    }
    return "bound-" + hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
