"""Does the file mean what it says? Columns are read in other ways, with the robot as its file has it, before any fit.

Every gross fault that laboratories make leaves the uncalibrated robot centimetres off, and one other reading of the
columns a few millimetres. Residuals of an uncalibrated robot are smooth: they are worth about a dozen independent
numbers, whatever the count of poses. With the prior that one file in a hundred is misread, shared among some forty
readings, another reading is believed where it leaves less than half of the error, and half of what tips that heed no
joint would leave.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

BETTER = 2.0  # times the error as read over that of another reading: 12 log 2 = 8.3 against prior odds of 4000 to 1
MOST_POSES = 60  # that are read again: gross faults show in every one
LEAST_POSES = 6  # of which a frame of six numbers leaves something
BASE_RAD, BASE_M = np.radians(15.0), 15e-3  # by which a base is off, or drifts in an experiment, as an effect (prior)
ALIKE = 1.3  # times the error of the best reading, with which a plainer one is told instead
ORDERS, SEED = 100, 3  # of the rows, none of which fits as well where tips heed the joints: chance is 1 in 100
SAME = 0.02  # of the error, by which readings differ that no data tell apart, as mirrored tips and mirrored rotations
POWERS = {
    10.0: "10 times too small",
    0.1: "10 times too large",
    1e3: "1000 times too small",
    1e-3: "1000 times too large",
}

Joints = tuple[Array, Array]


@dataclass(frozen=True)
class Reading:
    """Another reading of the columns that explains what the file as read does not."""

    what: str  # a sentence
    columns: tuple[str, ...]  # that are concerned
    rms_before_mm: float  # of the uncalibrated robot, as read
    rms_after_mm: float

    @property
    def sentence(self) -> str:
        """What a person should do first."""
        if not self.columns:
            return f"{self.what[:1].upper()}{self.what[1:]}."
        known = math.isfinite(self.rms_before_mm)
        before = f"instead of {self.rms_before_mm:.3g} mm" if known else "and as they stand no robot has such joints"
        return (
            f"{self.what[:1].upper()}{self.what[1:]} ({', '.join(self.columns)}): read so, the uncalibrated robot is "
            f"{self.rms_after_mm:.3g} mm off (rms) {before}."
        )

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json and calibration.json."""
        rms = {
            name: round(value, 4) if math.isfinite(value := getattr(self, name)) else None
            for name in ("rms_before_mm", "rms_after_mm")
        }
        return {"what": self.what, "columns": list(self.columns)} | rms


LARGEST_STEP_RAD = np.radians(270.0)  # between two poses at rest, by which few drives turn and many logs wrap


def how_taken(data: Measurements) -> list[str]:
    """Sentences about how poses were taken, where rows alone say so: each of one file, none measured on the way."""
    if data.is_stream:
        return []
    rows, runs = data.rows, data.sequence[data.rows]
    at_once = (np.diff(rows) == 1) & (np.diff(runs) == 0)
    theta = data.theta_commanded[rows]
    moved = np.abs(np.diff(theta, axis=0)).max(axis=1) > 0 if len(theta) > 1 else np.zeros(0, bool)
    if not (at_once & moved).sum() > len(rows) / 2:
        return []
    sentences = [
        "Every row is taken for a pose at rest, to which the robot was driven from the row before; a mapping file says "
        "otherwise with at_rest = false."
    ]
    steps = np.abs(np.diff(theta, axis=0))
    wide = np.argwhere((steps > LARGEST_STEP_RAD) & at_once[:, None])
    if len(wide):
        k, i = wide[0].tolist()
        where = f"Between rows {rows[k] + 1} and {rows[k + 1] + 1} rotation {i + 1} changes by"
        sentences.append(
            f"{where} {np.degrees(steps[k, i]):.0f} deg ({len(wide)} such steps). If the log wraps rotations, say "
            "so in a mapping file with rotations: friction heeds the way."
        )
    return sentences


@dataclass(frozen=True, eq=False)
class _Again:
    """A way to read: what it says, its columns, joints and positions as they would be, and another robot."""

    what: str
    columns: tuple[str, ...]
    joints: Callable[[Array, Array], Joints] = lambda theta, x: (theta, x)  # noqa: E731
    position: Callable[[Array], Array] = lambda p: p  # noqa: E731
    robot: Callable[[Robot], Robot] = lambda robot: robot  # noqa: E731
    rows: int = 0  # by how many measured rows poses belong to later joints


def read_again(robot: Robot, data: Measurements) -> tuple[Reading, ...]:
    """What is misread, the plainest reading first; nothing where the file means what it says, or says too little.

    A second fault is sought beside the first one.
    """
    tips = data.of_tips()
    whole = np.isfinite(tips.position_m).all(axis=1)
    tips = tips.subset(np.flatnonzero(whole))
    if tips.count < 3:
        return ()
    kept = np.unique(np.linspace(0, tips.count - 1, min(tips.count, MOST_POSES)).round().astype(int))
    constant = float(np.sqrt(np.mean(np.sum((tips.position_m - tips.position_m.mean(axis=0)) ** 2, axis=1))))
    file, results = _File(robot, tips, kept, ()), list[Reading]()
    for _ in range(2):
        before = file.rms_m(_Again("", ()))
        fault = _best(file, min(before, constant))
        if fault is None:
            break
        way, after = fault
        file = replace(file, done=(*file.done, way))
        results.append(Reading(way.what, way.columns, 1e3 * before, 1e3 * after))
    if not results and (unrelated := _unrelated(file, constant)):
        results.append(unrelated)
    return tuple(results)


def _unrelated(file: _File, constant: float) -> Reading | None:
    """Says that the tips heed no joint: in the best frame, other orders of the rows fit the robot as well.

    Asked where the joints should have moved the tips about as far as they moved.
    """
    measured, model = file.pairs(_Again("", ()))
    if len(model) < max(LEAST_POSES, 0.8 * len(file.kept)):
        return None
    should = float(np.sqrt(np.mean(np.sum((model - model.mean(axis=0)) ** 2, axis=1))))
    if should * BETTER < constant:
        return None
    rng = np.random.default_rng(SEED)
    own = _registered_m(measured, model)
    if own < min(_registered_m(measured, model[rng.permutation(len(model))]) for _ in range(ORDERS)):
        return None
    as_well = f"put in any other order they fit the robot as well, {1e3 * own:.3g} mm off (rms) in the best frame"
    return Reading(
        f"the tips heed no joint: {as_well}. These are not the joints of these poses", (), 1e3 * own, 1e3 * own
    )


def _registered_m(measured: Array, model: Array) -> float:
    """Rms distance [m] of tips (M, 3) in the frame that suits them best."""
    turn, shift = _motion(measured, model)
    return float(np.sqrt(np.mean(np.sum((measured @ turn.T + shift - model) ** 2, axis=1))))


def refuse_misread(robot: Robot, data: Measurements) -> None:
    """Raises MisreadError, with what the columns seem to mean, where another reading explains the file."""
    if readings := read_again(robot, data):
        raise MisreadError(data, readings)


class MisreadError(NoAnswerError):
    """A file that does not mean what it says: nothing was fitted to it."""

    def __init__(self, data: Measurements, readings: tuple[Reading, ...]) -> None:
        """readings: that explain the file together, the plainest first."""
        self.data, self.readings = data, readings
        sentences = " ".join(reading.sentence for reading in readings)
        rule = "Nothing was fitted; --as-read fits it as it stands."
        super().__init__(f"{data.file or 'measurements'}: {sentences} {rule}")


def _best(file: _File, before: float) -> tuple[_Again, float] | None:
    """The plainest of the readings that explain what is not explained so far, where `before` is left [m]."""
    errors = [(way, file.rms_m(way)) for way in _readings(file.robot)]
    least = min(e for _, e in errors)
    if least * BETTER < before:
        alike = [(way, e) for way, e in errors if e <= ALIKE * least]
        same = [way.what for way, e in alike[1:] if abs(e - alike[0][1]) < SAME * least][:2]
        return replace(alike[0][0], what=", or ".join([alike[0][0].what, *same])), alike[0][1]
    if len(file.kept) < LEAST_POSES:
        return None
    own, where = file.registered(_Again("", ()))
    if own * BETTER < min(before, file.displaced_m(own)):
        framed = [own, *(file.registered(way)[0] for way in _readings(file.robot))]
        least = min(framed)
        if least * BETTER < own:  # both: another frame and another reading, of which the frame is told first
            own = next(e for e in framed if e <= ALIKE * least)
        moved = _Again(
            f"positions are in another frame than the robot's, {where}",
            ("x_m", "y_m", "z_m"),
            position=file.mover(),
        )
        return moved, own
    return None


def _readings(robot: Robot) -> Iterator[_Again]:
    """Plain ones first."""
    n = robot.n
    theta = tuple(f"theta_{i}_rad" for i in range(1, n + 1))
    slide = tuple(f"l_{i}_m" for i in range(1, n + 1))
    tip = ("x_m", "y_m", "z_m")
    for i in range(n):
        yield _Again(f"rotation {i + 1} has the other sign", (theta[i],), _turned(i, -1.0))
    yield _Again("all rotations have the other sign", theta, lambda t, x: (-t, x))
    for i in range(1, n):
        yield _Again(f"rotation {i + 1} is logged relative to tube {i}", (theta[i],), _added(i))
    if n > 2:
        yield _Again(
            "rotations are logged relative to the next outer tube", theta[1:], lambda t, x: (np.cumsum(t, axis=1), x)
        )
        yield _Again(
            "rotations are logged relative to tube 1",
            theta[1:],
            lambda t, x: (np.hstack([t[:, :1], t[:, 1:] + t[:, :1]]), x),
        )
    angles = {
        180 / np.pi: "57.3 times too small",
        np.pi / 180: "in degrees",
        2 * np.pi: "in turns",
        np.pi: "in half turns",
    }
    for factor, words in (angles | {10.0: POWERS[10.0], 0.1: POWERS[0.1]}).items():
        yield _Again(f"rotations are {words}", theta, _all_turned(factor))
    for i in range(n if n > 1 else 0):
        for factor in (np.pi / 180, 180 / np.pi):
            yield _Again(f"rotation {i + 1} is {angles[factor]}", (theta[i],), _turned(i, factor))
    for i in range(n):
        for factor, words in ((2.0, "half"), (0.5, "twice")):
            yield _Again(f"rotation {i + 1} is {words} of what the tube turns", (theta[i],), _turned(i, factor))
    yield _Again("all rotations are half of what the tubes turn", theta, _all_turned(2.0))
    yield _Again("all rotations are twice what the tubes turn", theta, _all_turned(0.5))
    for i in range(n):
        yield _Again(f"translation {i + 1} has the other sign", (slide[i],), _slid(i, -1.0))
    yield _Again("all translations have the other sign", slide, lambda t, x: (t, -x))
    yield _Again(
        "translations are logged relative to the next outer tube", slide[1:], lambda t, x: (t, np.cumsum(x, axis=1))
    )
    for factor, words in POWERS.items():
        yield _Again(f"translations are {words}", slide, lambda t, x, f=factor: (t, f * x))  # type: ignore[misc]
    for i in range(n if n > 1 else 0):
        for factor in (1e3, 1e-3):
            yield _Again(f"translation {i + 1} is {POWERS[factor]}", (slide[i],), _slid(i, factor))
    for i, j in combinations(range(n), 2):
        yield _Again(f"rotations {i + 1} and {j + 1} are exchanged", (theta[i], theta[j]), _swapped(i, j, True, False))
        yield _Again(
            f"translations {i + 1} and {j + 1} are exchanged", (slide[i], slide[j]), _swapped(i, j, False, True)
        )
    yield _Again("tubes are in the opposite order", (*theta, *slide), lambda t, x: (t[:, ::-1], x[:, ::-1]))
    for rows, words in ((1, "one row late"), (-1, "one row early")):
        yield _Again(f"poses are {words}", tip, rows=rows)
    for factor, words in (POWERS | {1e3: "in kilometres", 1e-3: "in millimetres"}).items():
        yield _Again(f"positions are {words}", tip, position=lambda p, f=factor: f * p)  # type: ignore[misc]
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            if order != (0, 1, 2) or min(signs) < 0:
                shown = ", ".join(f"{'-' if s < 0 else ''}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
                yield _Again(
                    f"the columns of positions are not x, y, z but hold them as ({shown})",
                    tip,
                    position=lambda p, o=order, s=signs: p[:, list(o)] * np.array(s),  # type: ignore[misc]
                )
    for i in range(n):
        for factor, words in POWERS.items():
            yield _Again(
                f"the bending stiffness of tube {i + 1} is {words}", (f"tube.{i + 1}",), robot=_stiffer(i, factor)
            )


def _turned(i: int, factor: float) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (theta * np.where(np.arange(theta.shape[1]) == i, factor, 1.0), x)


def _all_turned(factor: float) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (factor * theta, x)


def _slid(i: int, factor: float) -> Callable[[Array, Array], Joints]:
    return lambda theta, x: (theta, x * np.where(np.arange(x.shape[1]) == i, factor, 1.0))


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
    solved: dict[tuple[bytes, bytes], Array] = field(default_factory=dict)  # tips of the robot as the file has it

    def pairs(self, way: _Again) -> tuple[Array, Array]:
        """(M, 3) [m] measured and predicted tips, read in one more way, where there is an equilibrium."""
        data, read = self.data, self.robot
        theta, l, position = data.theta_commanded[data.rows], data.l_commanded[data.rows], data.position_m  # noqa: E741
        for step in (*self.done, way):
            theta, l = step.joints(theta, l)  # noqa: E741 (as in the equations)
            position, read = step.position(position), step.robot(read)
            if step.rows:
                theta, l, position = _shifted(theta, l, position, step.rows)  # noqa: E741
        kept = self.kept[self.kept < len(position)]
        joints = theta[kept], l[kept]
        theta_b, l_b = joints if data.of_collars else read.collars(*joints)
        inside = nested(read, l_b)
        try:
            model = self._tips(read, theta_b, inside)
        except InputError:  # no tube stands there
            return position[:0], position[:0]
        good = np.isfinite(model).all(axis=1) & (np.abs(l_b - inside).max(axis=1) < BASE_M)
        return position[kept][good], model[good]

    def _tips(self, read: Robot, theta_b: Array, l_b: Array) -> Array:
        """(K, 3) [m]; those of the robot as the file has it once for all readings that leave its joints alone."""
        key = theta_b.tobytes(), l_b.tobytes()
        if read is not self.robot:
            return read.mechanics.tips(theta_b, l_b)[0]
        if key not in self.solved:
            self.solved[key] = read.mechanics.tips(theta_b, l_b)[0]
        return self.solved[key]

    def rms_m(self, way: _Again) -> float:
        """Distance [mm] of the tips from the measured ones; infinite where most poses have no equilibrium."""
        measured, model = self.pairs(way)
        if len(model) < 0.8 * len(self.kept):
            return np.inf
        return float(np.sqrt(np.mean(np.sum((measured - model) ** 2, axis=1))))

    def displaced_m(self, noise_m: float) -> float:
        """Rms error [m] as read beside what effects do to the base: a turn, a shift, and a shift that grows with time.

        Their priors hold them to what effects are, against errors of the size noise_m.
        """
        measured, model = self.pairs(_Again("", ()))
        time = clock(self.data)[self.kept[: len(model)]] if len(model) == len(self.kept) else np.zeros(len(model))
        late = (time - time.min()) / (np.ptp(time) or 1.0)
        cross = np.cross(np.eye(3)[None], model[:, None])  # (M, axis, 3) by which a small turn about an axis moves tips
        shift = np.broadcast_to(np.eye(3), (len(model), 3, 3))
        moves = np.concatenate([BASE_RAD * cross, BASE_M * shift, BASE_M * late[:, None, None] * shift], axis=1)
        J, r = moves.transpose(0, 2, 1).reshape(-1, 9), (measured - model).ravel()
        by = np.linalg.solve(J.T @ J + noise_m**2 / 3 * np.eye(9), J.T @ r)
        return float(np.sqrt(np.sum((r - J @ by) ** 2) / len(model)))

    def registered(self, way: _Again) -> tuple[float, str]:
        """Rms error [m] in the best frame, and where that is."""
        measured, model = self.pairs(way)
        if len(model) < max(LEAST_POSES, 0.8 * len(self.kept)):
            return np.inf, ""
        turn, shift = _motion(measured, model)
        angle = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        off = _registered_m(measured, model)
        moved = float(np.linalg.norm(shift))
        return off, f"turned by {np.degrees(angle):.0f} deg and shifted by {1e3 * moved:.0f} mm"

    def mover(self) -> Callable[[Array], Array]:
        """Positions in the best frame."""
        turn, shift = _motion(*self.pairs(_Again("", ())))
        return lambda p: np.asarray(p @ turn.T + shift)


def _shifted(theta: Array, l: Array, position: Array, rows: int) -> tuple[Array, Array, Array]:  # noqa: E741
    """Poses that stand `rows` rows below the joints that they belong to."""
    if rows > 0:
        return theta[:-rows], l[:-rows], position[rows:]
    return theta[-rows:], l[-rows:], position[:rows]


def _motion(measured: Array, model: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) [m] that bring measured positions to those of the model."""
    middle, aim = measured.mean(axis=0), model.mean(axis=0)
    u, _, v = np.linalg.svd((measured - middle).T @ (model - aim))
    turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    return turn, aim - turn @ middle
