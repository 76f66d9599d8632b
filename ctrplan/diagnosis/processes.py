"""What nobody has named, stage by stage: zero-mean Gaussian processes on the inputs of a stage, seen through the chain.

They are in every model that is compared, so that a name has to beat all of them. They contain what the named effects do
(constants, slopes, first waves): a process from which that was taken would leave it to the effects, whatever its cause.
A process that is missing makes some effect look certain: a case that fails asks for a process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import MODEL_POSITION_M, MODEL_TANGENT_RAD, Noise, compared
from ctrplan.diagnosis.mixed_model import CHANNELS, Kernel, Kind, Loaded, MixedModel
from ctrplan.effects.effect import Effect, Parameter, Values
from ctrplan.effects.learned.inputs import Situation, Target, values
from ctrplan.effects.learned.learned import learned, named
from ctrplan.measurement.approach import clock, friction_state, last_directions
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import SensorPrediction, Term
from ctrplan.robot.robot import Robot

JOINT_MEMORIES_RAD = (0.6, 1.0, 1.8)  # of errors smooth in the joints: of branches, of a gear's period, of a workspace
MM_PER_RAD = 20.0, 60.0  # translations that count as a radian: bends of 20 and of 60 mm radius turn the tip as far
PIECE_M = 0.012  # of a tube along which its precurvature varies: shorter ones move no tip
LEFT_OUT = 0.01  # of a process' variance that its columns may miss
MOST_COLUMNS = 24  # of a factor
MOVES_RAD, MOVES_M = 0.02, 0.5e-3  # a joint that moves less is none of a process' inputs

Linearised = Callable[[Sequence[Term]], tuple[SensorPrediction, Array]]


def smooth_axes(prediction: SensorPrediction, data: Measurements) -> Array:
    """(K, 2, 2) rotations of the tangent's two numbers into axes that change as little as can be between poses.

    These are x and y, taken along by the shortest turn from z to the tangent. Tangents of one number stay as they are.
    """
    t = prediction.tangent
    ahead = 1 / np.maximum(1 + t[:, 2], 0.05)
    x = np.eye(3)[[0]] - (ahead * t[:, 0])[:, None] * (t + np.eye(3)[2])
    y = np.eye(3)[[1]] - (ahead * t[:, 1])[:, None] * (t + np.eye(3)[2])
    plane = compared(t, data.tangent)[1]
    turn = np.stack([x, y], axis=1) @ plane.transpose(0, 2, 1)
    u, _, v = np.linalg.svd(np.where(np.isfinite(turn), turn, np.eye(2)))
    turn = u @ v
    turn[~data.given[:, 3:].all(axis=1)] = np.eye(2)
    return np.asarray(turn)


@dataclass(frozen=True, eq=False)
class Processes:
    """The model of what nobody has named, and columns (K, 5) by a unit of each joint's shift."""

    model: MixedModel
    by_joint: dict[tuple[str, int], Array]  # ("theta" or "l", tube from 1) -> (K, 5) per rad or m


def processes(
    robot: Robot,
    data: Measurements,
    noise: Noise,
    sound: NDArray[np.bool_],
    phi: Array,
    linearised: Linearised,
    arc: Callable[[Robot, Term], Array] | None,
) -> Processes:
    """Of K poses; `linearised` says what the calibrated robot with probing terms predicts, and columns by these.

    sound (K,): poses with a solution; phi (K, n - 1): friction states; arc: columns by a term of a robot cut in pieces.
    """
    made = _Made(robot, data, phi, linearised)
    if not data.of_collars:
        made.drive()
    made.mechanics()
    if arc is not None:
        made.arc(arc)
    made.sensor()
    made.configuration()
    given = data.given & sound[:, None]
    same = np.eye(data.count)
    if not data.is_stream:
        alike = data.configuration * (int(data.seen_marker.max(initial=0)) + 1) + data.seen_marker
        same = (alike[:, None] == alike).astype(float)
    shared = tuple(
        same * share**2 for share in (MODEL_POSITION_M / noise.position_m, MODEL_TANGENT_RAD / noise.tangent_rad)
    )
    kernels = [k for k in (_scaled_kernel(k, given) for k in made.kernels) if k is not None]
    loaded = [part for part in (_scaled_columns(part, given) for part in made.loaded) if part is not None]
    joints = {
        (kind, i): columns[:, :, 0] / (target.kind.prior * target.kind.si)
        for (kind, i), (target, columns) in made.by.items()
        if kind in ("theta", "l")
    }
    return Processes(MixedModel(given, (shared[0], shared[1]), kernels, loaded), joints)


class _Made:
    """Parts as they are added; inputs (K,) of each stage."""

    def __init__(self, robot: Robot, data: Measurements, phi: Array, linearised: Linearised) -> None:
        self.robot, self.data, self.phi, n = robot, data, phi, robot.n
        self.kernels: list[Kernel] = []
        self.loaded: list[Loaded] = []
        self.theta, self.l = data.theta_commanded[data.rows], data.l_commanded[data.rows]
        self.turning = [i for i in range(n) if np.ptp(self.theta[:, i]) > MOVES_RAD]
        self.sliding = [i for i in range(n) if np.ptp(self.l[:, i]) > MOVES_M]
        self.pairs = [i for i in range(1, n) if np.ptp(self.theta[:, i] - self.theta[:, i - 1]) > MOVES_RAD]
        self.travel = [_along(self.l[:, i]) for i in self.sliding]
        self.time = _standard(clock(data) + 1e-9 * np.arange(data.count))
        targets = [Target(kind, i + 1) for kind in ("theta", "l") for i in range(n) if not data.of_collars]
        self.curved = [i for i, tube in enumerate(robot.tubes) if any(s.curvature_per_m for s in tube.sections)]
        targets += [Target(kind, i + 1) for kind in ("curvature", "bend") for i in self.curved]
        targets += [Target("stiffness", i + 1) for i in range(1, n)] + [Target("plate")]
        self.prediction, J = linearised([_probe(on, n) for on in targets])
        widths = np.cumsum([0, *(3 if on.kind.has_axes else 1 for on in targets)])
        self.by = {
            (on.kind_name, on.tube): (on, J[:, :, a:b] * on.kind.prior * on.kind.si)
            for on, a, b in zip(targets, widths, widths[1:], strict=False)
        }

    def column(self, kind: str, i: int) -> Array:
        """(K, 5, axes) by a usual amount of a target; tubes from 0."""
        return self.by[kind, i + 1][1]

    def add(self, name: str, parts: Sequence[tuple[Array, Array]]) -> None:
        """A loaded part of columns (K, 5, c), each times a factor's columns (K, r)."""
        if parts:
            columns = [(b[:, :, :, None] * f[:, None, None, :]).reshape(*b.shape[:2], -1) for b, f in parts]
            self.loaded.append(Loaded(name, np.concatenate(columns, axis=2)))

    def smooth(self, name: str, matrix: Array, kinds: Sequence[Kind] = ("position", "tangent")) -> None:
        """Kernels alike on coordinates."""
        self.kernels += [Kernel(f"{name} of {kind}s", kind, matrix) for kind in kinds]

    def drive(self) -> None:
        """Joints by their own angle, by others', by travel, by the last direction, and walks in time."""
        theta, turning, sliding = self.theta, self.turning, self.sliding
        for i in turning:
            self.add(
                f"drive: tube {i + 1}'s rotation by its own angle",
                [(self.column("theta", i), _waves(theta[:, i], range(2, 7)))],
            )
        others = [_waves(theta[:, j], (1, 2, 3)) for j in turning]
        turns = [_waves(theta[:, j] - theta[:, j - 1], (1, 2, 3)) for j in self.pairs]
        crossed = [
            (self.column("theta", i), f) for i in turning for j, f in zip(turning, others, strict=True) if i != j
        ]
        self.add(
            "drive: rotations by other angles", crossed + [(self.column("theta", i), f) for i in turning for f in turns]
        )
        slopes = {j: _proportional(theta[:, j]) for j in turning}
        self.add(
            "drive: rotations by other rotations' size",
            [(self.column("theta", i), slopes[j]) for i in turning for j in turning if i != j],
        )
        self.add(
            "drive: rotations by translations", [(self.column("theta", i), f) for i in turning for f in self.travel]
        )
        self.add(
            "drive: translations by translations", [(self.column("l", i), f) for i in sliding for f in self.travel]
        )
        self.add(
            "drive: translations by angles",
            [(self.column("l", i), _waves(theta[:, j], (1, 2))) for i in sliding for j in turning],
        )
        way, parts = last_directions(self.data), []
        near = np.ones((self.data.count, self.data.count))
        for i in sliding:
            near = near * _gaussian(_standard(self.l[:, i])[:, None], 1.0)
        for c in range(2 * self.robot.n):
            if np.ptp(way[:, c]) > 1:
                i = c % self.robot.n
                matrix = np.outer(way[:, c], way[:, c]) * near * _wave_kernel(theta[:, i], (1, 2))
                parts.append((self.column("theta" if c < self.robot.n else "l", i), _factor(matrix)))
        self.add("drive: joints by their last direction", parts)
        walk = _walk(self.time)
        self.add("time: rotations that wander", [(self.column("theta", i), walk) for i in range(self.robot.n)])
        self.add("time: translations that wander", [(self.column("l", i), walk) for i in sliding])

    def mechanics(self) -> None:
        """Properties of tubes by joints and by how far tubes lie in each other; friction states; wear."""
        at = Situation(self.theta, self.l, data=self.data, tubes=self.robot.tubes)
        inputs = [*self.travel, *(_waves(self.theta[:, j] - self.theta[:, j - 1], (1, 2)) for j in self.pairs)]
        for j in range(1, self.robot.n) if self.sliding else []:
            overlap = values(f"overlap_{j}", at)
            if overlap is not None and np.ptp(overlap) > 0.5:
                inputs.append(_along(overlap))
        words = {"curvature": "precurvature", "bend": "precurvature across its plane", "stiffness": "stiffness"}
        for kind, word in words.items():
            mine = [i for i in range(self.robot.n) if (kind, i + 1) in self.by]
            self.add(f"mechanics: {word} by joints", [(self.column(kind, i), f) for i in mine for f in inputs])
        near = _gaussian(self._joints(), 1.5)
        loads = [np.outer(x, x) * near for x in self.phi.T if np.ptp(x) > 0.2]
        if loads:
            self.smooth("mechanics: differences between approaches", np.sum(loads, axis=0))
        walk = _walk(self.time)
        wear = [("curvature", i) for i in self.curved] + [("stiffness", i) for i in range(1, self.robot.n)]
        self.add("time: tubes that wear", [(self.column(kind, i), walk) for kind, i in wear])
        turn = [*self.travel, *(_waves(self.theta[:, i], (1, 2)) for i in self.turning)]
        self.add("mechanics: tilt of the plate by joints", [(self.by["plate", 0][1], f) for f in turn])

    def arc(self, columns: Callable[[Robot, Term], Array]) -> None:
        """Precurvature along the tubes, both planes."""
        robot, places = _cut(self.robot)
        effect = _Pieces(robot)
        by = columns(robot, Term(effect, effect.parameters(robot)))
        parts, at = [], 0
        for where in places:
            m = len(where)
            root = _factor(_gaussian(np.array(where)[:, None], PIECE_M))
            for axis in (0, 1):
                parts.append(by[:, :, at + axis : at + 2 * m : 2] @ root)
            at += 2 * m
        self.loaded.append(Loaded("mechanics: precurvature along the tubes", np.concatenate(parts, axis=2)))

    def sensor(self) -> None:
        """Readings by the tip's place, its heading, and other columns."""
        data = self.data
        known = np.isfinite(data.position_m).all(axis=1, keepdims=True)
        place = np.where(known, data.position_m, self.prediction.position_m)
        place = (place - place.mean(axis=0)) / np.maximum(place.std(axis=0), 1e-9)
        self.smooth("sensor: readings by close places", _gaussian(place, 0.8), ("position",))
        self.smooth("sensor: readings by places", _gaussian(place, 2.0), ("position",))
        self.smooth("sensor: readings by heading", _gaussian(self.prediction.tangent, 0.7), ("position",))
        for name, column in data.more.items():
            given = column[data.rows]
            if np.all(np.isfinite(given)) and np.ptp(given) > 1e-9:
                self.smooth(f"sensor: readings by {name}", _gaussian(_standard(given)[:, None], 1.0), ("position",))

    def configuration(self) -> None:
        """Errors that belong to the time, are smooth in the joints, or belong to each configuration."""
        t = clock(self.data) + 1e-9 * np.arange(self.data.count)
        apart, span = np.abs(t[:, None] - t), max(float(np.ptp(t)), 1e-9)
        short = 4 * float(np.median(np.diff(np.sort(t))))
        self.smooth("time: short errors", np.exp(-apart / short))
        self.smooth("time: errors that last", np.exp(-apart / np.sqrt(short * span / 2)))
        self.smooth("time: drifts", np.exp(-((apart / (span / 4)) ** 2) / 2))
        for memory in JOINT_MEMORIES_RAD:
            self.smooth(f"smooth in the joints, {memory:g} rad,", _gaussian(self._joints(), memory))
            if self.pairs:
                self.smooth(f"smooth in relative rotations, {memory:g} rad,", _gaussian(self._relative(), memory))
        number = self.data.configuration
        if len(np.unique(number)) < 0.9 * len(number):
            self.smooth("own errors of configurations", (number[:, None] == number).astype(float))

    def _joints(self) -> Array:
        """(K, 3 n) rotations as chords, translations over 20 mm."""
        return np.hstack([np.cos(self.theta), np.sin(self.theta), self.l * 1e3 / MM_PER_RAD[0]])

    def _relative(self) -> Array:
        """(K, 3 n - 2) relative rotations as chords, translations over 60 mm: what the shape depends on."""
        turns = np.diff(self.theta, axis=1)
        return np.hstack([np.cos(turns), np.sin(turns), self.l * 1e3 / MM_PER_RAD[1]])


def _probe(on: Target, n: int) -> Term:
    effect = learned(on, named(on, "constant"), {}, n)
    effect.name = f"probe_{on.effect_name}"
    return Term(effect, effect.parameters_of())


class _Pieces(Effect):
    """Curvature of pieces of tubes about both axes."""

    name, stage, equation, signature, experiment = "pieces", "mechanics", "", "", ""
    sets_outright = True

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """One for each piece and axis."""
        return tuple(
            Parameter(f"d{axis}_{i}_{k}", 1.0)
            for i, tube in enumerate(self.robot.tubes, start=1)
            for k in range(1, len(tube.sections) + 1)
            for axis in "xy"
        )

    def mechanics(self, values: Values, robot: Robot) -> dict[str, float]:
        """Curvatures of the pieces."""
        changed = {}
        for name, value in values.items():
            axis, i, k = name[1], *map(int, name.split("_")[1:])
            section = self.robot.tubes[i - 1].sections[k - 1]
            own = section.curvature_x_per_m if axis == "x" else section.curvature_y_per_m
            changed[f"tube.{i}.section.{k}.curvature_{axis}_per_m"] = own + value
        return changed


def _cut(robot: Robot) -> tuple[Robot, list[list[float]]]:
    """The robot without effects, its tubes cut into pieces, and the middles [m] of these along each tube."""
    robot = replace(robot.ideal or robot, effects={}, ideal=None)
    tubes, places = [], []
    for tube in robot.tubes:
        sections, where, start = [], [], 0.0
        for section in tube.sections:
            count = min(12, max(1, round(section.length_m / PIECE_M)))
            sections += [replace(section, length_m=section.length_m / count)] * count
            where += [start + (k + 0.5) * section.length_m / count for k in range(count)]
            start += section.length_m
        tubes.append(replace(tube, sections=tuple(sections)))
        places.append(where)
    return replace(robot, tubes=tuple(tubes)), places


def _standard(x: Array) -> Array:
    return np.asarray((x - x.mean()) / max(float(x.std()), 1e-9))


def _gaussian(x: Array, length: float) -> Array:
    """(K, K) of points (K, d)."""
    square = (x**2).sum(axis=1)
    apart = np.maximum(square[:, None] + square - 2 * x @ x.T, 0.0)
    return np.asarray(np.exp(-apart / (2 * length**2)))


def _along(x: Array) -> Array:
    """(K, R) factor of a function of values (K,) that is smooth over their deviation, and one in proportion to them.

    Screws and overlaps act in proportion to travel from home, which is a slope and a constant in one.
    """
    return np.column_stack([_factor(_gaussian(_standard(x)[:, None], 1.0)), _proportional(x)])


def _proportional(x: Array) -> Array:
    """(K, 1) values over the largest one."""
    return np.asarray(x[:, None] / max(float(np.abs(x).max()), 1e-9))


def _wave_kernel(x: Array, orders: Sequence[int]) -> Array:
    f = _waves(x, orders)
    return f @ f.T


def _waves(x: Array, orders: Sequence[int] | range) -> Array:
    """(K, 2 orders) cosines and sines of multiples, with variances in proportion to 1 / order, 1 in all."""
    weights = np.sqrt(np.array([1 / k for k in orders]) / sum(1 / k for k in orders))
    return np.column_stack([w * f(k * x) for k, w in zip(orders, weights, strict=True) for f in (np.cos, np.sin)])


def _walk(t: Array, modes: int = 12) -> Array:
    """(K, modes) factor of a random walk in time that is zero at the first pose, 1 in variance at the last."""
    since = (t - t.min()) / max(float(np.ptp(t)), 1e-9)
    rates = (np.arange(modes) + 0.5) * np.pi
    return np.asarray(np.sqrt(2) * np.sin(np.outer(since, rates)) / rates)


def _factor(matrix: Array) -> Array:
    """(K, R) pivoted Cholesky factor of a positive semidefinite matrix, until little variance is missing."""
    columns: list[Array] = []
    left, whole = np.diag(matrix).copy(), float(np.trace(matrix))
    while left.sum() > LEFT_OUT * whole and len(columns) < MOST_COLUMNS:
        k = int(np.argmax(left))
        known = sum((c * c[k] for c in columns), np.zeros(len(matrix)))
        column = (matrix[:, k] - known) / np.sqrt(left[k])
        columns.append(column)
        left = np.maximum(left - column**2, 0.0)
    return np.column_stack(columns) if columns else np.zeros((len(matrix), 1))


def _scaled_kernel(kernel: Kernel, given: NDArray[np.bool_]) -> Kernel | None:
    there = given[:, list(CHANNELS[kernel.kind])].any(axis=1)
    mean = float(np.diag(kernel.matrix)[there].mean()) if there.any() else 0.0
    return replace(kernel, matrix=kernel.matrix / mean) if mean > 1e-12 else None


def _scaled_columns(part: Loaded, given: NDArray[np.bool_]) -> Loaded | None:
    """With fewer columns where these say nearly the same, mean variance 1 over what was given."""
    flat = part.columns[given]
    mean = float((flat**2).sum(axis=1).mean()) if len(flat) else 0.0
    if mean < 1e-12:
        return None
    values, vectors = np.linalg.eigh(flat.T @ flat)
    order = np.argsort(-values)
    share = np.cumsum(values[order]) / values.sum()
    kept = order[: int(np.searchsorted(share, 1 - LEFT_OUT)) + 1]
    return Loaded(part.name, part.columns @ vectors[:, kept] / np.sqrt(mean))


def friction_states(data: Measurements, phi: Array | None) -> Array:
    """(K, n - 1) as simulated where that is known, as the rule has them elsewhere."""
    ruled = friction_state(data)
    return ruled if phi is None else np.where(np.isfinite(phi), phi, ruled)
