"""Does the file mean what it says? Columns are read in other ways, with the robot as its file has it, before any fit.

Every gross fault that laboratories make leaves the uncalibrated robot centimetres off, and one other reading of the
columns a few millimetres. Residuals of an uncalibrated robot are smooth: they are worth about a dozen independent
numbers, whatever the count of poses. With the prior that one file in a hundred is misread, shared among some hundred
readings, another reading is believed where it leaves less than half of the error, about, and half of what tips that
heed no joint would leave: each beside a base that is off, as its prior has it, and as well where ordinary calibration
helps both. Tangents are asked alike where positions are explained.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import combinations, permutations, product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import error_beside
from ctrplan.calibration.parameters import calibrated_moves
from ctrplan.calibration.residuals import MODEL_POSITION_M, MODEL_TANGENT_RAD
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import POSITION, TANGENT, Measurements, joint_columns
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

NUMBERS = 12  # independent ones that the residuals of an uncalibrated robot are worth
MISREAD = 0.01  # of files (prior), in any of the ways that there are
BETTER = 2.0  # times the error of what explains nothing over that of what explains something
MOST_POSES = 60  # that are read again: gross faults show in every one
LEAST_POSES = 6  # of which a frame of six numbers leaves something
BASE_RAD, BASE_M = np.radians(15.0), 15e-3  # by which a base is off, or drifts in an experiment, as an effect (prior)
ALIKE = 1.3  # times the error of the best reading, with which a plainer one is told instead
SEED = 3  # of orders of the rows, so many that by chance none fits as well in MISREAD of files
SAME = 0.02  # of the error, by which readings differ that no data tell apart, as mirrored tips and mirrored rotations
POWERS = {10.0: "10 times too small", 0.1: "10 times too large"}
POWERS |= {1e3: "1000 times too small", 1e-3: "1000 times too large"}
LENGTHS = {1e-3: "in millimetres", 1e-2: "in centimetres", 0.0254: "in inches", 0.1: POWERS[0.1], 10.0: POWERS[10.0]}
LENGTHS |= {1e3: POWERS[1e3], 25.4: "25.4 times too small", 1 / 25.4: "25.4 times too large"}
ANGLES = {180 / np.pi: "57.3 times too small", np.pi / 180: "in degrees", 2 * np.pi: "in turns"}
ANGLES |= {np.pi: "in half turns", 10.0: POWERS[10.0], 0.1: POWERS[0.1]}
SHIFTS = {1: "one row late", -1: "one row early", 2: "two rows late", -2: "two rows early"}

Joints = tuple[Array, Array]
Pair = tuple[Array, Array]  # measured and predicted
Stood = tuple[Pair, tuple[Robot, Array, Array]]  # poses, and the robot and its collars there


@dataclass(frozen=True)
class Reading:
    """Another reading of the columns that explains what the file as read does not."""

    what: str  # a sentence
    columns: tuple[str, ...]  # that are concerned
    rms_before: float  # of the uncalibrated robot, as read
    rms_after: float
    unit: Literal["mm", "deg"] = "mm"  # of both: of positions or of tangents

    @property
    def sentence(self) -> str:
        """What a person should do first."""
        if not self.columns:
            return f"{self.what[:1].upper()}{self.what[1:]}."
        instead = f"instead of {self.rms_before:.3g} {self.unit}"
        before = instead if math.isfinite(self.rms_before) else "and as they stand no robot has such joints"
        return (
            f"{self.what[:1].upper()}{self.what[1:]} ({', '.join(self.columns)}): read so, the uncalibrated robot is "
            f"{self.rms_after:.3g} {self.unit} off (rms) {before}."
        )

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json and calibration.json."""
        rms = {
            f"{name}_{self.unit}": round(value, 4) if math.isfinite(value := getattr(self, name)) else None
            for name in ("rms_before", "rms_after")
        }
        return {"what": self.what, "columns": list(self.columns)} | rms


AS_IS = np.eye(3)


@dataclass(frozen=True, eq=False)
class _Again:
    """A way to read: what it says, its columns, joints and positions as they would be, and another robot."""

    what: str
    columns: tuple[str, ...]
    joints: Callable[[Array, Array], Joints] = lambda theta, x: (theta, x)  # noqa: E731
    robot: Callable[[Robot], Robot] = lambda robot: robot  # noqa: E731
    rows: int = 0  # by how many measured rows poses belong to later joints
    scale: float = 1.0  # of positions, which are turned and shifted [m] after that
    turn: Array = field(default_factory=lambda: AS_IS)  # (3, 3), by which rows of coordinates are multiplied
    shift: Array | float = 0.0


AS_READ = _Again("", ())


def read_again(robot: Robot, data: Measurements) -> tuple[Reading, ...]:
    """What is misread, the plainest reading first; nothing where the file means what it says, or says too little.

    A second fault is sought beside the first one.
    """
    tips = data.of_tips()
    tips = tips.subset(np.flatnonzero(np.isfinite(tips.position_m).all(axis=1)))
    if tips.count < 4:  # a base that is off takes nine numbers
        return ()
    kept = np.unique(np.linspace(0, tips.count - 1, min(tips.count, MOST_POSES)).round().astype(int))
    file, results = _File(robot, tips, kept, ()), list[Reading]()
    for _ in range(2):
        if (way := _best(file)) is None:
            break
        before, file = file, file.after(way)
        results.append(Reading(way.what + _as_lag(way, tips), way.columns, 1e3 * before.rms_m(), 1e3 * file.rms_m()))
    if not results and (unrelated := _unrelated(file)):
        return (unrelated,)
    if file.are_tangents_alike:
        turned = [way.turn is not AS_IS for way in file.done]
        results = [replace(r, columns=(*r.columns, *TANGENT)) if t else r for r, t in zip(results, turned, strict=True)]
    results += _misdirected(file)
    return tuple(replace(r, columns=tuple(data.columns.get(name, name) for name in r.columns)) for r in results)


def _as_lag(way: _Again, data: Measurements) -> str:
    """Poses of a stream with a clock may belong to other rows because they are stamped late."""
    if not way.rows or not data.is_stream or data.time_s is None:
        return ""
    late_s = way.rows * float(np.median(np.diff(clock(data))))
    return f", or stamped {late_s:.2g} s late, which --as-read leaves to the effect lag"


def _unrelated(file: _File) -> Reading | None:
    """Says that the tips heed no joint: in the best frame, other orders of the rows fit the robot as well.

    Asked where the joints should have moved the tips about as far as they moved.
    """
    measured, model = file.pairs(AS_READ)
    if not file.suffices(model) or _spread(model) * BETTER < _spread(measured):
        return None
    own, rng = _registered_m(measured, model), np.random.default_rng(SEED)
    orders = (model[rng.permutation(len(model))] for _ in range(round(1 / MISREAD)))
    others = [_registered_m(measured, other) for other in orders if (other != model).any()]
    if own < min(others, default=np.inf):
        return None
    as_well = f"put in any other order they fit the robot as well, {1e3 * own:.3g} mm off (rms) in the best frame"
    what = f"the tips heed no joint: {as_well}. These are not the joints of these poses"
    return Reading(what, (), 1e3 * own, 1e3 * own)


def _misdirected(file: _File) -> tuple[Reading, ...]:
    """What is misread of tangents where positions are explained: signs, order or frame, or that they are none.

    Tangents that are none, as another axis of the sensor, have less than half of their length along the tube's.
    """
    measured, model = file.tangents()
    if len(model) < 3 or file.based_m(AS_READ) * BETTER > _spread(file.pairs(AS_READ)[0]):
        return ()

    def based(turn: Array) -> float:
        return error_beside(measured @ turn, model, BASE_RAD, np.empty((len(model), 0, 3)), MODEL_TANGENT_RAD, NUMBERS)

    shown, axes = min(_axes(), key=lambda one: _rms(measured @ one[1] - model))
    before = _rms(measured - model)
    framed = _rms(measured @ _turn(measured, model) - model) if file.suffices(model) else np.inf
    ways = [(f"the columns of tangents are not tx, ty, tz but hold them as {shown}", based(axes))]
    ways.append(("tangents are in another frame than positions", framed))
    for what, after in ways:
        if after <= ALIKE * framed and after * BETTER < min(_spread(measured), based(AS_IS)):
            told = np.degrees(2 * np.arcsin(np.clip([before / 2, after / 2], 0, 1))).tolist()  # of chords
            return (Reading(what, TANGENT, told[0], told[1], "deg"),)
    if (along := float(np.mean(np.sum(measured * model, axis=1)))) * BETTER > 1.0:
        return ()
    away = f"tangents are {np.degrees(np.arccos(along)):.0f} deg from the tube's direction at its tip"
    return (Reading(f"{away}: leave them out where the sensor does not follow the tube", (), np.nan, np.nan),)


def _rms(off: Array) -> float:
    """Root of the mean square length of vectors (M, 3); infinite of none."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else np.inf


def _spread(places: Array) -> float:
    """Rms distance of places (M, 3) from their middle: the error where they heed nothing."""
    return _rms(places - places.mean(axis=0)) if len(places) else np.inf


def _registered_m(measured: Array, model: Array) -> float:
    """Rms distance [m] of tips (M, 3) in the frame that suits them best."""
    turn, shift = _motion(measured, model)
    return _rms(measured @ turn.T + shift - model)


def told_again(robot: Robot, data: Measurements, *, as_read: bool) -> tuple[Reading, ...]:
    """What is misread. Raises MisreadError, which says it, unless such data are to be fitted as they stand."""
    if (readings := read_again(robot, data)) and not as_read:
        raise MisreadError(data, readings)
    return readings


class MisreadError(NoAnswerError):
    """A file that does not mean what it says: nothing was fitted to it."""

    def __init__(self, data: Measurements, readings: tuple[Reading, ...]) -> None:
        """readings: that explain the file together, the plainest first."""
        self.data, self.readings = data, readings
        said = [reading.sentence for reading in readings]
        rule = "Nothing was fitted; --as-read fits it as it stands, as_read=True in Python."
        super().__init__(" ".join([f"{data.file or 'measurements'}:", *said, rule]))


def _best(file: _File) -> _Again | None:
    """The plainest of the readings that explain what is not explained so far."""
    (own, where), each = file.registered(), [(way, file.based_m(way)) for way in _readings(file.robot)]
    errors = [(way, e) for way, e in each if e * BETTER < _spread(file.pairs(way)[0])]
    least = min([own, *(e for _, e in errors)])
    alike = [(way, e) for way, e in errors if e <= ALIKE * least]
    enough = (len(each) / MISREAD) ** (1 / min(NUMBERS, 3 * len(file.kept) - 9))  # prior odds, of what a base leaves
    if alike and all(
        file.based_m(alike[0][0], calibrated=fits) * enough < file.based_m(AS_READ, calibrated=fits)
        for fits in (False, True)
    ):
        same = [way.what for way, e in alike[1:] if abs(e - alike[0][1]) < SAME * least][:2]
        return replace(alike[0][0], what=", or ".join([alike[0][0].what, *same]))
    if own * BETTER < min(file.based_m(AS_READ, calibrated=True), _spread(file.pairs(AS_READ)[0])):
        turn, shift = _motion(*file.pairs(AS_READ))
        what = f"positions are in another frame than the robot's, {where}"
        return _Again(what, POSITION, turn=turn.T, shift=shift)
    return None


def _readings(robot: Robot) -> Iterator[_Again]:
    """Plain ones first."""
    n = robot.n
    theta, slide = map(tuple, joint_columns(n))
    several = range(n if n > 1 else 0)

    def only(i: int, factor: float) -> Array:
        return np.where(np.arange(n) == i, factor, 1.0)

    for i in range(n):
        yield _Again(f"rotation {i + 1} has the other sign", (theta[i],), _times(only(i, -1.0)))
    yield _Again("all rotations have the other sign", theta, _times(-1.0))
    for i in range(1, n):
        yield _Again(f"rotation {i + 1} is logged relative to tube {i}", (theta[i],), _added(i))
    if n > 2:
        own = "rotations are logged relative to"
        yield _Again(f"{own} the next outer tube", theta[1:], lambda t, x: (np.cumsum(t, axis=1), x))
        yield _Again(f"{own} tube 1", theta[1:], lambda t, x: (np.hstack([t[:, :1], t[:, 1:] + t[:, :1]]), x))
    for factor, words in ANGLES.items():
        yield _Again(f"rotations are {words}", theta, _times(factor))
    for i, factor in product(several, (np.pi / 180, 180 / np.pi)):
        yield _Again(f"rotation {i + 1} is {ANGLES[factor]}", (theta[i],), _times(only(i, factor)))
    for i, (factor, words) in product(range(n), ((2.0, "half"), (0.5, "twice"))):
        yield _Again(f"rotation {i + 1} is {words} of what the tube turns", (theta[i],), _times(only(i, factor)))
    yield _Again("all rotations are half of what the tubes turn", theta, _times(2.0))
    yield _Again("all rotations are twice what the tubes turn", theta, _times(0.5))
    for i, quarters in product(several, (2, 1, -1)):
        yield _Again(f"tube {i + 1} is mounted {90 * quarters} deg off", (theta[i],), _mounted(i, quarters))
    for i in range(n):
        yield _Again(f"translation {i + 1} has the other sign", (slide[i],), _times(1.0, only(i, -1.0)))
    yield _Again("all translations have the other sign", slide, _times(1.0, -1.0))
    relative = "translations are logged relative to the next outer tube"
    yield _Again(relative, slide[1:], lambda t, x: (t, np.cumsum(x, axis=1)))
    for factor, words in LENGTHS.items():
        yield _Again(f"translations are {words}", slide, _times(1.0, factor))
    for i, factor in product(several, (1e3, 1e-3)):
        yield _Again(f"translation {i + 1} is {LENGTHS[factor]}", (slide[i],), _times(1.0, only(i, factor)))
    for i, j in combinations(range(n), 2):
        yield _Again(f"rotations {i + 1} and {j + 1} are exchanged", (theta[i], theta[j]), _swapped(i, j, True, False))
        both = f"translations {i + 1} and {j + 1} are exchanged"
        yield _Again(both, (slide[i], slide[j]), _swapped(i, j, False, True))
    yield _Again("tubes are in the opposite order", (*theta, *slide), lambda t, x: (t[:, ::-1], x[:, ::-1]))
    for rows, words in SHIFTS.items():
        yield _Again(f"poses are {words}", POSITION, rows=rows)
    for factor, words in LENGTHS.items():
        yield _Again(f"positions are {words}", POSITION, scale=factor)
    for shown, turn in _axes():
        what = f"the columns of positions are not x, y, z but hold them as {shown.replace('t', '')}"
        yield _Again(what, POSITION, turn=turn)
    for i, (factor, words) in product(range(n), POWERS.items()):
        yield _Again(f"the bending stiffness of tube {i + 1} is {words}", (f"tube.{i + 1}",), robot=_stiffer(i, factor))


def _axes() -> Iterator[tuple[str, Array]]:
    """Every other order and sign of three columns of directions: what they hold, and (3, 3) that puts rows right."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            if order != (0, 1, 2) or min(signs) < 0:
                shown = ", ".join(f"{'-' if s < 0 else ''}t{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
                yield f"({shown})", np.eye(3)[:, list(order)] * np.array(signs)


def _times(turns: Array | float, slides: Array | float = 1.0) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (theta * turns, x * slides)


def _mounted(i: int, quarters: int) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (theta + np.where(np.arange(theta.shape[1]) == i, quarters * np.pi / 2, 0.0), x)


def _added(i: int) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (theta + np.where(np.arange(theta.shape[1]) == i, theta[:, [i - 1]], 0.0), x)


def _swapped(i: int, j: int, turns: bool, slides: bool) -> Callable[[Array, Array], Joints]:
    def read(theta: Array, l: Array) -> Joints:  # noqa: E741
        order = np.arange(theta.shape[1])
        order[[i, j]] = order[[j, i]]
        return theta[:, order] if turns else theta, l[:, order] if slides else l

    return read


def _stiffer(i: int, factor: float) -> Callable[[Robot], Robot]:
    def read(robot: Robot) -> Robot:
        tube = replace(robot.tubes[i], bending_stiffness_Nm2=factor * robot.tubes[i].bending_stiffness_Nm2)
        return replace(robot, tubes=(*robot.tubes[:i], tube, *robot.tubes[i + 1 :]))

    return read


@dataclass(frozen=True, eq=False)
class _File:
    """Tips (K, 3) of a file that the believed robot is asked about, some of which are `kept`, read as in `done`."""

    robot: Robot
    data: Measurements
    kept: NDArray[np.int_]
    done: tuple[_Again, ...]
    solved: dict[tuple[bytes, bytes], Array] = field(default_factory=dict)  # of the robot as the file has it
    stood: dict[_Again, Stood] = field(default_factory=dict)  # in each way

    def after(self, way: _Again) -> _File:
        """The file read so."""
        read = way.robot(self.robot)
        return _File(read, self.data, self.kept, (*self.done, way), self.solved if read is self.robot else {})

    def pairs(self, way: _Again) -> Pair:
        """(M, 3) [m] measured and predicted tips, read in one more way, where there is an equilibrium."""
        measured, model = self._standing(way)[0]
        return measured[:, :3], model[:, :3]

    def tangents(self) -> Pair:
        """(M, 3) of poses all of whose tangent was measured; turned as positions were read where that suits them."""
        measured, model = self._tangents
        return (measured @ self._turn if self.are_tangents_alike else measured), model

    @property
    def are_tangents_alike(self) -> bool:
        """Whether tangents fit better turned as positions have to be."""
        measured, model = self._tangents
        return _rms(measured @ self._turn - model) < _rms(measured - model)

    @property
    def _turn(self) -> Array:
        return reduce(np.matmul, (step.turn for step in self.done), AS_IS)

    @cached_property
    def _tangents(self) -> Pair:
        measured, model = (pose[:, 3:] for pose in self._standing(AS_READ)[0])
        whole = np.isfinite(measured).all(axis=1)
        return measured[whole], model[whole]

    def _standing(self, way: _Again) -> Stood:
        """(M, 6) measured and predicted tips [m] and tangents, and the robot and its collars (M, n) there."""
        if way in self.stood:
            return self.stood[way]
        data, read = self.data, way.robot(self.robot)
        theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
        position, tangent = data.position_m, data.tangent
        for step in (*self.done, way):
            theta, l = step.joints(theta, l)  # noqa: E741 (as in the equations)
            position = step.scale * position @ step.turn + step.shift
            late, early = max(step.rows, 0), max(-step.rows, 0)
            theta, l = (part[early : len(part) - late] for part in (theta, l))  # noqa: E741 (as in the equations)
            position, tangent = (part[late : len(part) - early] for part in (position, tangent))
        kept = self.kept[self.kept < len(position)]
        joints, measured = (theta[kept], l[kept]), np.hstack([position, tangent])[kept]
        theta_b, l_b = joints if data.of_collars else read.collars(*joints)
        inside = nested(read, l_b)
        try:
            model = self._solved(read, theta_b, inside)
        except InputError:  # no tube stands there
            model = np.full_like(measured, np.nan)
        good = np.isfinite(model).all(axis=1) & (np.abs(l_b - inside).max(axis=1) < BASE_M)
        self.stood[way] = (measured[good], model[good]), (read, theta_b[good], inside[good])
        return self.stood[way]

    def _solved(self, read: Robot, theta_b: Array, l_b: Array) -> Array:
        """(K, 6); those of the robot as the file has it once for all readings that leave its joints alone."""
        solved, key = self.solved if read is self.robot else {}, (theta_b.tobytes(), l_b.tobytes())
        if key not in solved:
            solved[key] = np.hstack(read.mechanics.tips(theta_b, l_b)[:2])
        return solved[key]

    def suffices(self, model: Array) -> bool:
        """Whether so many predictions tell something of the file."""
        return len(model) >= max(LEAST_POSES, 0.8 * len(self.kept))

    def rms_m(self) -> float:
        """Distance [m] of the tips from the measured ones; infinite where most poses have no equilibrium."""
        measured, model = self.pairs(AS_READ)
        return _rms(measured - model) if len(model) >= 0.8 * len(self.kept) else np.inf

    def based_m(self, way: _Again, *, calibrated: bool = False) -> float:
        """Size of errors [m] beside what effects do to the base; infinite where most poses do not stand.

        Effects turn the base, shift it, and shift it by more and more with time.
        """
        measured, model = self.pairs(way)
        if len(model) < 0.8 * len(self.kept):
            return np.inf
        time = clock(self.data)[self.kept[: len(model)]] if len(model) == len(self.kept) else np.zeros(len(model))
        late = (time - time.min()) / (np.ptp(time) or 1.0)
        shift = np.broadcast_to(np.eye(3), (len(model), 3, 3))
        moves = [BASE_M * shift, BASE_M * late[:, None, None] * shift]
        if calibrated:
            moves.append(calibrated_moves(*self._standing(way)[1]))
        return error_beside(measured, model, BASE_RAD, np.concatenate(moves, axis=1), MODEL_POSITION_M, NUMBERS)

    def registered(self) -> tuple[float, str]:
        """Rms error [m] in the best frame, and where that is."""
        measured, model = self.pairs(AS_READ)
        if not self.suffices(model):
            return np.inf, ""
        turn, shift = _motion(measured, model)
        angle = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        moved = f"turned by {np.degrees(angle):.0f} deg and shifted by {1e3 * float(np.linalg.norm(shift)):.0f} mm"
        return _registered_m(measured, model), moved


def _motion(measured: Array, model: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) [m] that bring measured positions to those of the model."""
    middle, aim = measured.mean(axis=0), model.mean(axis=0)
    turn = _turn(measured - middle, model - aim).T
    return turn, aim - turn @ middle


def _turn(measured: Array, model: Array) -> Array:
    """(3, 3) by which rows have to be multiplied to come nearest to those of the model (Kabsch 1976)."""
    u, _, v = np.linalg.svd(measured.T @ model)
    turn: Array = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return turn
