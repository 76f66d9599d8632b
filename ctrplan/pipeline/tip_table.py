"""Tips, their frames and markers of many configurations with clearance and friction, their derivatives, and
registration.

They take a whole shape for every pose, hardly move during a fit, and a diagnosis makes hundreds of fits to the same
poses: frames found for another one serve as long as tips point to within 1 deg where they did, and collars as well.
With a sensor 3 mm off the tube's axis that is 0.05 mm. What is remembered goes with the measurements.

Tips come with exact derivatives. The core differentiates no other points: markers are points of whole shapes, and
`ParametricChain` differences them.

The rigid motion that brings measured positions nearest to the tips and markers of the robot file without friction
(Kabsch 1976), far ones left out. It takes the place of a registration, not of a fit: base_misalignment or frame_shift
beside it take up what a better model moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, read_only
from ctrplan.base.long_work import cores
from ctrplan.drive.legs import LINE_TOLERANCE, Collars
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.core_arrays import Near, TipMemory
from ctrplan.mechanics.shapes import Accuracy, Shape, Status, points_on_tubes
from ctrplan.mechanics.tube import Loads, Tube, is_in_order, moved_to_nest
from ctrplan.robot.robot import Robot

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

NESTED_M = 1e-8  # collars and tips out of order by less do not matter
MOST_REMEMBERED = 64  # tables of 0.4 MB: fits ask again where others began and ended, a third of all a diagnosis asks


@dataclass(frozen=True, eq=False)
class TipTable:
    """K tips; derivatives for P names."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    sound: NDArray[np.bool_]  # (K,) whether the solve converged on an equilibrium
    failed: NDArray[np.bool_]  # (K,) whether it did not converge at all: the tip is that of the last iterate
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)


@dataclass(frozen=True, eq=False)
class FrictionCorrection:
    """What the rule of friction states leaves out of K poses, at the parameters for which it was asked."""

    phi: Array | None  # (K, n - 1) circumferential friction states of a simulated history, where that is followed
    shift_m: Array | float = 0.0  # (K, 3) more, of positions
    turn: Array | float = 0.0  # (K, 3) more, of tangents

    def states_of(self, poses: NDArray[np.bool_]) -> FrictionCorrection:
        """The friction states of some of the poses (K,) alone."""
        return FrictionCorrection(None if self.phi is None else self.phi[poses])


def tip_table(
    robot: Robot,
    theta_b: Array,
    l_b: Array,
    phi: Array,
    names: Sequence[str] = (),
    accuracy: Accuracy = "search",
    near: Near | None = None,
) -> TipTable:
    """Tips at (K, n) [rad], (K, n) [m] in friction states (K, n - 1); names as in `parameters`, or theta_b.1, l_b.1.

    near: solutions near which those of the rows, by their places, are sought.
    """
    rubbing, inside = robot.friction[:, 1] > 0, nested(robot, l_b)
    fresh = {f"contact.{i + 1}.friction_coefficient" for i in np.flatnonzero(~rubbing)}
    of_friction, others = ([name for name in names if (name in fresh) is asked] for asked in (True, False))
    rows = np.hstack([theta_b, inside, phi * rubbing])
    if of_friction and others:  # without friction its state matters to derivatives by friction alone
        whole = _columns(robot, rows, others, accuracy, near)
        more = _columns(robot, np.hstack([theta_b, inside, phi]), of_friction, accuracy, near)
        order = [(others + of_friction).index(name) for name in names]
        by = (np.concatenate([getattr(whole, key), getattr(more, key)], axis=2)[:, :, order] for key in BY)
        table = TipTable(whole.position_m, whole.tangent, whole.sound, whole.failed, *by)
    else:
        table = _columns(robot, np.hstack([theta_b, inside, phi]) if of_friction else rows, names, accuracy, near)
    return replace(table, sound=table.sound & is_in_order(robot.tubes, l_b, NESTED_M))


BY = ("position_by", "tangent_by")
_NEAR: WeakKeyDictionary[Measurements, TipMemory] = WeakKeyDictionary()  # a fit asks for the same poses of like robots


def _columns(robot: Robot, rows: Array, names: Sequence[str], accuracy: Accuracy, near: Near | None) -> TipTable:
    """The table of rows (K, 3 n - 1) of collars and friction states."""
    first, back = distinct(rows)
    at = near and (near[0], np.array(near[1])[first].tolist())
    table = _solved(_TipRequest.of(robot, rows[first], accuracy), robot, tuple(names), at)
    return TipTable(*(getattr(table, key)[back] for key in TipTable.__dataclass_fields__))


def distinct(rows: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """The numbers (D,) of rows (K, c) that differ, and which of them each is (K,)."""
    rounded = np.round(rows / LINE_TOLERANCE) * LINE_TOLERANCE
    _, first, back = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return first, back.ravel()


def nested(robot: Robot, l_b: Array) -> Array:
    """Base translations (K, n) with those that do not nest moved to where they do."""
    return moved_to_nest(robot.tubes, l_b)


def held(robot: Robot, theta: Array, l: Array, off: Array | None = None) -> tuple[Array, Array]:  # noqa: E741
    """Where the drive holds collars (K, n) [rad], [m] that nest: commanded to theta, l, and `off` (2 G n,) by play."""
    theta_b, l_b = robot.drive.reached(theta, l, off)
    return theta_b, nested(robot, l_b)


@dataclass(frozen=True)
class _TipRequest:
    """What decides on tips: the numbers of the mechanics, and rows (D, 3 n - 1) of collars and friction states."""

    tubes: tuple[Tube, ...]
    loads: Loads
    pairs: bytes
    rows: bytes
    accuracy: Accuracy

    @classmethod
    def of(cls, robot: Robot, rows: Array, accuracy: Accuracy) -> _TipRequest:
        pairs = np.hstack([robot.clearance_m, robot.friction[:, 1]]).tobytes()
        return cls(robot.tubes, robot.loads, pairs, rows.tobytes(), accuracy)


@dataclass(eq=False)
class _Remembered:
    """Tips that were solved, and their derivatives (D, 3) by the names that were asked so far."""

    tips: TipTable | None = None  # without names
    by: dict[str, tuple[Array, Array]] = field(default_factory=dict)  # of position and tangent


@lru_cache(MOST_REMEMBERED)
def _remembered(request: _TipRequest) -> _Remembered:
    return _Remembered()


def _solved(request: _TipRequest, robot: Robot, names: tuple[str, ...], near: Near | None) -> TipTable:
    known = _remembered(request)
    missing = tuple(name for name in dict.fromkeys(names) if name not in known.by)
    if known.tips is None or missing:
        n = robot.n
        theta_b, l_b, phi = np.split(np.frombuffer(request.rows).reshape(-1, 3 * n - 1), [n, 2 * n], axis=1)
        tips = robot.mechanics.tips_with_friction(
            theta_b, l_b, phi, parameters=missing, accuracy=request.accuracy, near=near
        )
        failed = tips.status == Status.FAILED
        none = np.zeros((len(failed), 3, 0))
        known.tips = TipTable(
            tips.position_m, tips.tangent, ~failed & (tips.status != Status.UNSTABLE), failed, none, none
        )
        by = np.nan_to_num(tips.position_by), np.nan_to_num(tips.tangent_by)  # NaN where no joint moves by itself
        known.by |= {name: (by[0][:, :, k], by[1][:, :, k]) for k, name in enumerate(missing)}
    if not names:
        return known.tips
    position_by, tangent_by = (np.stack([known.by[name][k] for name in names], axis=2) for k in range(2))
    return replace(known.tips, position_by=position_by, tangent_by=tangent_by)


NEAR_RAD, NEAR_M, NEAR_STATE = np.radians(1.0), 0.3e-3, 0.1  # that tangents, collars, friction states may have moved
MOST = 4  # of the same poses, elsewhere


@dataclass(frozen=True, eq=False)
class _TipResult:
    tangent: Array  # (K, 3)
    collars: Collars
    phi: Array  # (K, n - 1)
    x: Array  # (K, 3)

    def serves(self, collars: Collars, phi: Array, tangent: Array) -> bool:
        """Whether nothing has moved far."""
        return bool(
            np.abs(self.tangent - tangent).max(initial=0.0) <= NEAR_RAD
            and np.abs(self.collars.theta - collars.theta).max(initial=0.0) <= NEAR_RAD
            and np.abs(self.collars.l - collars.l).max(initial=0.0) <= NEAR_M
            and np.abs(self.phi - phi).max(initial=0.0) <= NEAR_STATE
        )


_FOUND: WeakKeyDictionary[Measurements, list[_TipResult]] = WeakKeyDictionary()


def remembered_tip_x(data: Measurements, robot: Robot, collars: Collars, phi: Array, tangent: Array) -> Array:
    """(K, 3) x axes of K poses in friction states (K, n - 1), whose tangents are (K, 3)."""
    known = _FOUND.setdefault(data, [])
    for result in known:
        if result.serves(collars, phi, tangent):
            return result.x
    theta_b, l_b, rubbing = collars.theta, nested(robot, collars.l), phi * (robot.friction[:, 1] > 0)
    first, back = distinct(np.hstack([theta_b, l_b, rubbing]))
    rows = zip(theta_b[first], l_b[first], rubbing[first], strict=True)
    x = read_only(np.array([robot.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows])[back])
    known.insert(0, _TipResult(tangent, collars, phi, x))
    del known[MOST:]
    return x


def on_body(robot: Robot, data: Measurements) -> NDArray[np.bool_]:
    """(K,) poses of markers that are not the robot's tip itself."""
    elsewhere = np.array([False, *(not marker.is_tip(robot.n) for marker in robot.markers)])
    result: NDArray[np.bool_] = elsewhere[data.seen_marker]
    return result


def markers_on(robot: Robot, shape: Shape, l_b: Array) -> tuple[Array, Array]:
    """(M, 3) [m] and unit tangents (M, 3) of the robot's markers on a shape with collars at l_b (n,) [m]."""
    return points_on_tubes(
        [shape.tubes[marker.tube - 1] for marker in robot.markers], _places_m(robot) + _bases(robot, l_b)
    )


def _places_m(robot: Robot) -> Array:
    """(M,) arc lengths [m] of the markers from the bases of their tubes."""
    return np.array([marker.along_m(robot.tubes[marker.tube - 1].length_m) for marker in robot.markers])


def _bases(robot: Robot, l_b: Array) -> Array:
    """(M,) [m] where the bases of the markers' tubes are, with collars at l_b (n,) [m]."""
    return l_b[[marker.tube - 1 for marker in robot.markers]]


def point_table(
    robot: Robot,
    data: Measurements,
    collars: Collars,
    phi: Array,
    names: Sequence[str] = (),
    accuracy: Accuracy = "search",
) -> TipTable:
    """The measured points at collars (K, n), in friction states (K, n - 1); derivatives of tips only, else zero."""
    body = on_body(robot, data)
    near = (_NEAR.setdefault(data, TipMemory()), np.flatnonzero(~body).tolist()) if accuracy == "search" else None
    tips = tip_table(robot, collars.theta[~body], collars.l[~body], phi[~body], names, accuracy, near)
    if not body.any():
        return tips
    result = TipTable(
        np.empty((data.count, 3)), np.empty((data.count, 3)), *np.zeros((2, data.count), bool),
        *np.zeros((2, data.count, 3, len(names))),
    )  # fmt: skip
    markers = _marker_table(robot, data.seen_marker[body], collars.theta[body], collars.l[body], phi[body], accuracy)
    for name in TipTable.__dataclass_fields__:
        getattr(result, name)[~body] = getattr(tips, name)
        if not name.endswith("by"):
            getattr(result, name)[body] = getattr(markers, name)
    return result


def _marker_table(
    robot: Robot, marker: NDArray[np.int_], theta_b: Array, l_b: Array, phi: Array, accuracy: Accuracy
) -> TipTable:
    """Markers (K,) by number; a shape serves all that were seen on it."""
    inside = nested(robot, l_b)
    first, back = distinct(np.hstack([theta_b, inside, phi]))
    shapes = _shapes(robot, theta_b[first], inside[first], phi[first], accuracy)
    failed = np.array([shape.status == Status.FAILED for shape in shapes])[back]
    sound = ~failed & np.array([shape.status != Status.UNSTABLE for shape in shapes])[back]
    tube = np.array([given.tube - 1 for given in robot.markers])[marker - 1]
    tubes = [shapes[k].tubes[i] for k, i in zip(back.tolist(), tube.tolist(), strict=True)]
    at = inside[np.arange(len(marker)), tube] + _places_m(robot)[marker - 1]
    position, tangent = points_on_tubes(tubes, at)
    lost = ~np.isfinite(position).all(axis=1)
    position[lost], tangent[lost] = 0.0, [0.0, 0.0, 1.0]
    return TipTable(position, tangent, sound & ~lost & is_in_order(robot.tubes, l_b, NESTED_M), failed | lost, *_no(2))


def _shapes(robot: Robot, theta_b: Array, l_b: Array, phi: Array, accuracy: Accuracy) -> list[Shape]:
    """Shapes of D configurations, on every core: the core solves without Python's lock."""
    solve = partial(robot.mechanics.solve, accuracy=accuracy)
    with ThreadPoolExecutor(min(cores(), len(theta_b))) as pool:
        return list(pool.map(solve, theta_b, l_b, phi))


def _no(count: int) -> Array:
    return np.zeros((count, 0, 3, 0))


LEAST_POSES = 4
SPREAD_M = 1e-3  # of positions across their line, below which they say nothing about a rotation about it
KEPT = 0.9  # of the poses, the nearest ones
ROUNDS = 3


def registered(robot: Robot, data: Measurements, frames: Mapping[int, str]) -> Measurements:
    """The poses of some frames, number -> name, in the robot's frame, with a note each. Raises InputError."""
    position, tangent, notes = data.position_m.copy(), data.tangent.copy(), []
    for number, name in frames.items():
        poses = data.frames[data.rows] == number
        model = _believed_m(robot, data.subset(poses))
        good = np.isfinite(model).all(axis=1)
        if good.sum() < LEAST_POSES:
            raise InputError(f"has {good.sum()} poses, too few to find its place: at least {LEAST_POSES}", key=name)
        turn, shift, rms_m = _motion(position[poses][good], model[good], name, data.file)
        position[poses] = turn.apply(position[poses]) + shift
        tangent[poses] = turn.apply(tangent[poses])
        notes.append(
            f"{data.file}: the frame of {name} is not known: its poses were moved to where the robot file has the "
            f"tips, {rms_m * 1e3:.2f} mm off (rms). A fit needs base_misalignment or frame_shift besides."
        )
    return replace(data, position_m=position, tangent=tangent, warnings=(*data.warnings, *notes)) if notes else data


def _believed_m(robot: Robot, data: Measurements) -> Array:
    """(K, 3) [m] where the robot file has the measured points in the middle of friction; NaN where it has none.

    Clearance, loads and everything else that the file says of the mechanics are in it: what it left out would turn the
    frame.
    """
    collars, phi = Collars(*_collars(robot, data)), np.zeros((data.count, robot.n - 1))
    table = point_table(robot, data, collars, phi)
    return np.where(table.failed[:, None], np.nan, table.position_m)


def _collars(robot: Robot, data: Measurements) -> tuple[Array, Array]:
    commanded = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    return commanded if data.of_collars else robot.collars(*commanded)


def _motion(measured: Array, model: Array, name: str, file: str | None) -> tuple[Rotation, Array, float]:
    """Turn and shift [m] that bring measured positions (K, 3) to those of the model, and the rms [m] that is left."""
    from scipy.spatial.transform import Rotation  # slow to import

    kept = np.arange(len(measured))
    for _ in range(ROUNDS):
        middle, aim = measured[kept].mean(axis=0), model[kept].mean(axis=0)
        if np.linalg.svd(model[kept] - aim, compute_uv=False)[1] < SPREAD_M * np.sqrt(len(kept)):
            raise InputError("has its tips on one line, which says nothing about its rotation", file=file, key=name)
        turn = Rotation.align_vectors(model[kept] - aim, measured[kept] - middle)[0]
        shift = aim - turn.apply(middle)
        off = np.linalg.norm(turn.apply(measured) + shift - model, axis=1)
        kept = np.argsort(off)[: max(LEAST_POSES, int(KEPT * len(off)))]
    return turn, shift, float(np.sqrt(np.mean(off**2)))
