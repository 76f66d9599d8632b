"""Measured data: commanded waypoints in the order visited, the poses measured at some of them, and which of these
choose a model.

Format: one row per joint waypoint, between rows all joints move together linearly. SI units, robot's base frame. A pose
is that of the tip, or the position of a marker on the body; of one waypoint there may be several.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Choice, Number, Whole, checked
from ctrplan.base.arrays import Array, numbers
from ctrplan.base.package import shown
from ctrplan.errors import InputError


@dataclass(frozen=True, eq=False)
class Poses:
    """K poses of the sensor: position (K, 3) [m], frame (K, 3, 3) with columns x, y, tangent."""

    position: Array
    frame: Array


def rotation(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    from scipy.spatial.transform import Rotation  # slow to import

    matrix: Array = Rotation.from_rotvec(np.array(vector)).as_matrix()
    return matrix


def moved_rigidly(poses: Poses, turn: Array, shift: Array) -> Poses:
    """Poses turned about the origin of the robot's frame and then shifted; (3,) or one (K, 3) each."""
    R = rotation(np.broadcast_to(turn, poses.position.shape))
    return Poses(np.einsum("kij,kj->ki", R, poses.position) + shift, R @ poses.frame)


def frames_along(tangent: Array, across: Array) -> Array:
    """Frames (K, 3, 3) whose third axis is `tangent` (K, 3), the first as near to `across` (K, 3) as it can be."""
    first = across - np.sum(across * tangent, axis=1, keepdims=True) * tangent
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(tangent, first), tangent], axis=2)


@checked(
    tube=Whole(1, 1000),
    distance_m=Number(0, 10, "m"),
    end=Choice("tip", "base"),
    position_sigma_m=Number(1e-9, 1, "m"),
)
@shown
@dataclass(frozen=True)
class Marker:
    """A marker around a tube, its middle on the tube's centreline, at an arc length from one of the tube's ends."""

    name: str
    tube: int  # from 1, outermost first
    distance_m: float  # along the tube, from its tip or its base
    end: Literal["tip", "base"] = "tip"
    position_sigma_m: float | None = None  # noise of each coordinate; None: that of the tip

    def along_m(self, length_m: float) -> float:
        """Arc length [m] from the base of a tube of this length; a marker stays at its distance if lengths change."""
        return length_m - self.distance_m if self.end == "tip" else self.distance_m

    def is_tip(self, tubes: int) -> bool:
        """Whether it is the tip of the innermost of so many tubes itself."""
        return self.tube == tubes and self.end == "tip" and self.distance_m == 0

    @property
    def columns(self) -> tuple[str, str, str]:
        """Names of its columns in measurements and tables."""
        return f"{self.name}_x_m", f"{self.name}_y_m", f"{self.name}_z_m"


@checked(position_sigma_m=Number(1e-9, 1, "m"), tangent_sigma_rad=Number(1e-8, 3.2, "rad"))
@shown
@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of each coordinate of the tip and of a small rotation of its tangent about each axis.

    A tracker of positions alone has no second one.
    """

    position_sigma_m: float
    tangent_sigma_rad: float | None = None


SAME_ROTATION_RAD = 1e-3  # commanded joints that differ by less are the same configuration
SAME_TRANSLATION_M = 1e-5
STREAMED_SHARE = 0.5  # of the poses, measured on the way between two others: a log of a continuous motion
DENSE = 0.5  # of the spread of all tips, by which tips of a log follow one another; independent ones are 1.4 apart
MOST_ROWS = 20  # that a sentence lists
LONGEST_LAG_S = 0.4  # two clocks that are further apart are no matter of a fit

POSITION, TANGENT = ("x_m", "y_m", "z_m"), ("tx", "ty", "tz")  # columns of tables
LARGEST_RUN = 10**15  # numbers of runs beyond it are not exact
WHOLE_NUMBER = "must be a whole number of at most 15 digits"


def joint_columns(n: int) -> tuple[list[str], list[str]]:
    """Names of the columns of base rotations and base translations, outermost tube first."""
    tubes = range(1, n + 1)
    return [f"theta_{i}_rad" for i in tubes], [f"l_{i}_m" for i in tubes]


WHOLE = ("rows", "sequence", "frame", "homing", "marker")
FINITE = ("theta_commanded", "l_commanded", "time_s", "noise_ratio")
OPTIONAL = ("time_s", "frame", "homing", "marker", "noise_ratio")


def _read(key: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    """The numbers of a field, of this shape if any is given. Raises InputError that names it for others."""
    is_whole = isinstance(values, np.ndarray) and values.dtype.kind == "i"
    array: NDArray[Any] = np.asarray(values) if is_whole else numbers(values, key)
    if shape not in (None, array.shape):
        raise InputError(f"must have shape {shape}, not {array.shape}", key=key)
    if key in FINITE and not np.isfinite(array).all():
        raise InputError("must be finite numbers", key=key)
    if key in WHOLE and not is_whole:
        for k in np.argwhere((array != np.round(array)) | (np.abs(array) > LARGEST_RUN)).tolist():
            raise InputError(WHOLE_NUMBER, key=f"{key}{k}", value=float(array[tuple(k)]))
        return array.astype(int)
    return array


@shown
@dataclass(frozen=True, eq=False)
class Measurements:
    """R waypoints of n tubes, K of them measured; the arrays of poses have K rows, in the order of the waypoints.

    Arrays may be whatever holds numbers, `tangent` None where none was measured. What fits them, or plays them again,
    refuses what no file may say of its robot.
    """

    sequence: NDArray[np.int_]  # (R,) runs, each approached afresh
    theta_commanded: Array  # (R, n) commanded base rotations, rad, not wrapped
    l_commanded: Array  # (R, n) commanded base translations, m
    rows: NDArray[np.int_]  # (K,) the measured waypoints
    position_m: Array  # (K, 3) tip or marker; NaN for coordinates that were not seen, of markers alone
    tangent: Array  # (K, 3) unit tip tangent; NaN where none was measured, one NaN: seen along that axis, `given`
    time_s: Array | None = None  # (R,) clock of the whole experiment
    is_stream: bool = False  # joints and poses logged together on a continuous motion, nothing settles
    more: Mapping[str, Array] = field(default_factory=dict)  # other columns (R,), which effects may need
    file: str | None = None
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    frame: NDArray[np.int_] | None = None  # (R,) number, from 1, of the tracker's frame where it was set up anew
    homing: NDArray[np.int_] | None = None  # (R,) number, from 1, of the drive's homing where it was homed anew
    of_collars: bool = False  # whether joints are those of the collars, so that the drive's effects are in them
    marker: NDArray[np.int_] | None = (
        None  # (K,) number, from 1, of the robot's marker seen, 0: the tip; None: all tips
    )
    noise_ratio: Array | None = None  # (K,) noise of each position over that of a tip's, where they differ
    columns: Mapping[str, str] = field(default_factory=dict)  # names that a laboratory's file has for those of tables

    def __post_init__(self) -> None:
        """Reads its numbers. Raises InputError for arrays that do not go together."""
        read = partial(object.__setattr__, self)
        read("rows", _read("rows", self.rows))
        read("theta_commanded", numbers(self.theta_commanded, "theta_commanded"))
        if self.theta_commanded.ndim != 2:
            rule = "must have a row for every waypoint and a column for every tube"
            raise InputError(f"{rule}, not shape {self.theta_commanded.shape}", key="theta_commanded")
        commanded, waypoints, poses = self.theta_commanded.shape, len(self.theta_commanded), self.rows.size
        if self.tangent is None:  # nobody who calls this has to say it in numbers
            read("tangent", np.full((poses, 3), np.nan))
        shapes = dict.fromkeys(("theta_commanded", "l_commanded"), commanded)
        shapes |= dict.fromkeys(("sequence", "time_s", "frame", "homing"), (waypoints,))
        shapes |= dict.fromkeys(("rows", "marker", "noise_ratio"), (poses,))
        shapes |= dict.fromkeys(("position_m", "tangent"), (poses, 3))
        for name, shape in shapes.items():
            if getattr(self, name) is not None or name not in OPTIONAL:
                read(name, _read(name, getattr(self, name), shape))
        read("more", {name: _read(name, values, (waypoints,)) for name, values in self.more.items()})
        for k in np.flatnonzero((self.rows < 0) | (self.rows >= waypoints)).tolist():
            rule = f"must be a waypoint, from 0 to {waypoints - 1}"
            raise InputError(rule, key=f"rows[{k}]", value=int(self.rows[k]))

    @property
    def n(self) -> int:
        """Number of tubes."""
        return int(self.theta_commanded.shape[1])

    @property
    def count(self) -> int:
        """K, the number of poses."""
        return len(self.rows)

    @property
    def frames(self) -> NDArray[np.int_]:
        """(R,) number, from 1, of the tracker's frame at each waypoint."""
        return np.ones(len(self.sequence), int) if self.frame is None else self.frame

    @property
    def homings(self) -> NDArray[np.int_]:
        """(R,) number, from 1, of the drive's homing at each waypoint."""
        return np.ones(len(self.sequence), int) if self.homing is None else self.homing

    @cached_property
    def seen_marker(self) -> NDArray[np.int_]:
        """(K,) number, from 1, of the marker that each pose is of, 0 for the tip."""
        return np.zeros(self.count, int) if self.marker is None else self.marker

    @property
    def over_tip(self) -> Array:
        """(K, 1) noise of each position over that of a tip's."""
        return np.ones((self.count, 1)) if self.noise_ratio is None else self.noise_ratio[:, None]

    @property
    def has_markers(self) -> bool:
        """Whether any pose is that of a marker."""
        return bool(self.seen_marker.any())

    @cached_property
    def run(self) -> NDArray[np.int_]:
        """(K,) number of each pose's run; a marker's poses are a run of their own."""
        labels = np.column_stack([self.sequence[self.rows], self.seen_marker])
        number: NDArray[np.int_] = np.unique(labels, axis=0, return_inverse=True)[1].ravel()
        return number

    @cached_property
    def given(self) -> NDArray[np.bool_]:
        """(K, 5) which of a pose's five numbers were measured: three of the position, two of the tangent.

        A tangent of two components is its direction in the plane of these two axes, as a camera sees it: one number.
        """
        components = np.isfinite(self.tangent).sum(axis=1)
        seen = np.isfinite(self.position_m)
        given: NDArray[np.bool_] = np.column_stack([seen, components >= 2, components == 3])
        return given

    @property
    def has_tangents(self) -> bool:
        """Whether any pose has more than a position."""
        return bool(self.given[:, 3].any())

    @cached_property
    def configuration(self) -> NDArray[np.int_]:
        """(K,) number of each pose's commanded configuration, whatever way it was approached."""
        scale = np.repeat([SAME_ROTATION_RAD, SAME_TRANSLATION_M], self.n)
        cells = np.round(np.hstack([self.theta_commanded, self.l_commanded])[self.rows] / scale).astype(np.int64)
        _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        return np.asarray(np.argsort(np.argsort(first))[number.ravel()])  # in the order of appearance

    def subset(self, poses: NDArray[np.int_] | NDArray[np.bool_]) -> Measurements:
        """The waypoints with some of the poses only, given by their numbers or a mask (K,)."""
        there = [name for name in ("marker", "noise_ratio") if getattr(self, name) is not None]
        return replace(self, **{name: getattr(self, name)[poses] for name in ("rows", "position_m", "tangent", *there)})

    def are_of(self, other: Measurements) -> NDArray[np.bool_]:
        """(K,) poses that are poses of other measurements, to the last digit: noise makes no two alike."""

        def told(data: Measurements) -> list[bytes]:
            joints = np.hstack([data.theta_commanded, data.l_commanded])[data.rows]
            return [row.tobytes() for row in np.hstack([joints, data.position_m])]

        known = set(told(other)) if other.n == self.n else set[bytes]()
        return np.array([row in known for row in told(self)], bool)

    def of_tips(self) -> Measurements:
        """The poses of the tip alone."""
        return self.subset(self.seen_marker == 0) if self.has_markers else self

    def rows_in_words(self, poses: NDArray[np.bool_]) -> str:
        """Rows of the file, from 1, of some of the poses, mask (K,); the first twenty."""
        rows = (self.rows[poses] + 1).tolist()
        return ", ".join(map(str, rows[:MOST_ROWS])) + (" ..." if len(rows) > MOST_ROWS else "")


def is_streamed(
    sequence: NDArray[np.int_], rows: NDArray[np.int_], joints: Array, position_m: Array | None = None
) -> bool:
    """Whether poses were logged on a continuous motion of the joints (R, 2 n), rather than after settling.

    Poses in the midst of a standstill say neither. A log follows the motion so closely that its tips (K, 3) move by
    little from row to row; tips that jump about were reached one from the other, and came to rest.
    """
    moves = np.abs(np.diff(joints, axis=0, prepend=joints[:1], append=joints[-1:])).max(axis=1) > 0
    measured = np.zeros(len(sequence) + 2, bool)
    measured[rows + 1] = True
    run = np.concatenate([[-1], sequence, [-1]])
    inside = measured[rows] & measured[rows + 2] & (run[rows] == run[rows + 1]) & (run[rows + 2] == run[rows + 1])
    going = moves[rows] | moves[rows + 1]
    if not going.any() or (inside & moves[rows] & moves[rows + 1])[going].mean() <= STREAMED_SHARE:
        return False
    return position_m is None or _is_dense(position_m[np.argsort(rows, kind="stable")])


def _is_dense(position_m: Array) -> bool:
    """Whether tips (K, 3) follow one another by less than they are spread."""
    position_m = position_m[np.isfinite(position_m).all(axis=1)]
    if len(position_m) < 2:
        return True
    spread = float(np.sqrt(np.mean(np.sum((position_m - position_m.mean(axis=0)) ** 2, axis=1))))
    return float(np.median(np.linalg.norm(np.diff(position_m, axis=0), axis=1))) < DENSE * spread


VAULT_SHARE = 0.25
BLOCK_POSES = 10  # of a continuous motion: neighbours are not independent evidence
SEED = 20190417  # the split depends on the data's order alone


@dataclass(frozen=True, eq=False)
class Split:
    """Numbers of the poses that choose, and of those that are kept aside."""

    selection: NDArray[np.int_]  # (S,)
    held_out_set: NDArray[np.int_]  # (V,)


def groups(data: Measurements) -> NDArray[np.int_]:
    """(K,) poses that stand or fall together: configurations, or blocks of a continuous motion."""
    if data.is_stream:
        return np.unique(data.rows, return_inverse=True)[1].ravel() // BLOCK_POSES
    return data.configuration


def split(usable: NDArray[np.bool_], group: NDArray[np.int_]) -> Split:
    """A quarter of the groups, (K,) by number, for the held-out set, the others for the selection."""
    numbers = np.random.default_rng(SEED).permutation(np.unique(group[usable]))
    sealed = int(round(VAULT_SHARE * len(numbers)))
    held_out = np.isin(group, numbers[:sealed]) & usable
    return Split(np.flatnonzero(usable & ~held_out), np.flatnonzero(held_out))
