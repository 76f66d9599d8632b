"""The chain as a function of the parameters of its terms, with derivatives: what fits and the diagnosis evaluate.

A column is asked anew once any point has moved by a third of a millimetre, or the parameter itself by a tenth of its
prior. Until then it is off by about 1 %, which delays Gauss and Newton and does not lead them elsewhere: the residuals
are exact. What is remembered goes with the measurements.

The mechanics differentiate tips exactly. Clock, drive and sensor are a few lines of arithmetic each: finite differences
of them are joined by the chain rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import Effect, Parameter
from ctrplan.effects.learned.learned import FILE_NOTES
from ctrplan.errors import InputError
from ctrplan.measurement.approach import friction_state, last_directions
from ctrplan.measurement.measurements import Measurements, Poses, frames_along
from ctrplan.pipeline.chain import Acting, Chain, taken_along, with_chain
from ctrplan.pipeline.term import SensorPrediction, Term, TermValues
from ctrplan.pipeline.tip_table import NEAR_M, FrictionCorrection, TipTable, on_body, point_table, remembered_tip_x
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot

STEP = 1e-4  # of a parameter's prior, for the stages that are arithmetic
COARSE_STEP = 0.005  # of a parameter's prior, where the mechanics are differenced
MOVE = 1e-5  # [m] and [rad] alike, of what a sensor is shown
NEAR_SHARE = 0.1  # of its prior that a parameter may have moved since
MOST = 3  # columns of one parameter, at other places


class Parametric(Protocol):
    """Terms along the waypoints of measurements."""

    data: Measurements
    terms: tuple[Term, ...]
    parameters: tuple[Parameter, ...]
    prior: Array
    lower: Array
    upper: Array

    def stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""

    def of_effects_with(self, *hooks: str) -> list[int]:
        """Positions of the parameters of effects that have any of these methods of their own."""

    def values(self, p: Array) -> list[dict[str, float]]:
        """Per term, parameter -> value, SI."""

    def at(self, p: Array) -> Chain:
        """The chain with its parameters at (P,)."""

    def before_last(self, p: Array) -> tuple[Robot, Mapping[str, float]]:
        """The robot without the last of the mechanics that change it, and the numbers that this gives, by name."""

    def collars(self, p: Array) -> Collars:
        """Where the collars of the K poses stand."""

    def friction_state(self, p: Array) -> Array:
        """(K, n - 1) friction states."""


class StageColumns:
    """At parameters (P,): what a table of tips has to be asked for, and columns (K, 6, P) of position and tangent."""

    def __init__(self, of: Parametric, p: Array) -> None:
        """of: the chain; p: the parameters."""
        self.of, self.p, self.chain = of, p, of.at(p)
        self.numbers, self._numbers_by = self._by_number()
        staged = of.stages()
        kinds = ("theta_b", "l_b") if staged["drive"] or staged["clock"] else ()
        self.joints = [f"{kind}.{i + 1}" for kind in kinds for i in range(of.data.n)]

    @property
    def names(self) -> list[str]:
        """What tips are differentiated by."""
        return [*self.numbers, *self.joints]

    def of_tips(self, table: TipTable, collars: Collars, by: Array) -> None:
        """Columns of clock, drive and mechanics; the last of the table are by numbers that differ from pose to pose."""
        upstream, first = np.concatenate([table.position_by, table.tangent_by], axis=1), len(self.numbers)
        last = first + len(self.joints)
        by += upstream[:, :, :first] @ self._numbers_by
        self._joint_columns(upstream[:, :, first:last], by)
        self._changing_columns(upstream[:, :, last:], by)
        self._release_columns(collars, table, by)

    def of_what_is_seen(self, poses: Poses, collars: Collars, seen: Poses, by: Array) -> None:
        """Columns of plate and sensor, through which all columns so far are taken."""
        chain = self.chain
        if not chain.of_stage("sensor") and chain.plate_turn(collars) is None:
            return
        at, data = self.of.at, self.of.data
        turning, sensing = self.of.of_effects_with("plate_turn"), self.of.stages()["sensor"]
        self._sensor_columns(chain.turned(poses, collars), by)
        for j in turning:
            by[:, :, j] = self._difference(lambda p: _stacked(at(p).seen(poses, collars, data)), j)
        others = [j for j in range(by.shape[2]) if j not in (*turning, *sensing)]
        by[:, :, others] = self._by_pose(poses, collars, seen) @ by[:, :, others]

    def _by_pose(self, poses: Poses, collars: Collars, seen: Poses) -> Array:
        """(K, 6, 6) what is seen of each pose by its position and its tangent, by forward differences."""
        here, steps = _stacked(seen), MOVE * np.eye(6)
        moved = (self.chain.seen(_moved(poses, step), collars, self.of.data) for step in steps)
        return np.stack([(_stacked(there) - here) / MOVE for there in moved], axis=2)

    def _sensor_columns(self, poses: Poses, by: Array) -> None:
        """Columns of the sensor's own parameters; effects before theirs act once, and the last may know its columns."""
        data, sensing, before = self.of.data, self.chain.of_stage("sensor"), dict[str, tuple[int, Poses]]()
        for k, acting in enumerate(sensing):
            before[acting.effect.name] = k, poses
            known = acting.effect.sensor_by(acting.values, poses)
            poses = acting.effect.sensor(acting.values, poses, data)
        names = [(t.name, q.name) for t in self.of.terms for q in t.parameters]
        for j in self.of.stages()["sensor"]:
            effect, name = names[j]
            first, given = before[effect]

            def read(p: Array, j: int = j, name: str = name, first: int = first, given: Poses = given) -> Array:
                own = Acting(sensing[first].effect, {**sensing[first].values, name: float(p[j])})
                return _stacked(Chain(self.chain.ideal, (own, *sensing[first + 1 :])).sensor(given, data))

            is_known = first + 1 == len(sensing) and name in known
            by[:, :, j] = known[name] if is_known else self._difference(read, j)

    def _by_number(self) -> tuple[list[str], Array]:
        """Names of the robot's numbers (N,) that the parameters change, and their derivatives (N, P)."""
        chain, ideal = self.chain, self.chain.ideal
        terms = zip(self.of.terms, self.of.values(self.p), strict=True)
        of_file = (t.effect.mechanics(values, ideal) for t, values in terms if t.effect.of_the_file)
        of_effects = (given.effect.mechanics(given.values, ideal) for given in chain.of_stage("mechanics"))
        names = sorted({name for named in (*of_file, *of_effects) for name in named})

        def numbers(p: Array) -> Array:
            robot, last = self.of.before_last(p)
            return np.array([last[name] if name in last else value_of(robot, name) for name in names])

        by = np.zeros((len(names), len(self.of.parameters)))
        for j in self.of.stages()["mechanics"]:
            by[:, j] = np.nan_to_num(self._difference(numbers, j))
        changed = np.flatnonzero(by.any(axis=1)).tolist()
        return [names[k] for k in changed], by[changed]

    def _joint_columns(self, upstream: Array, by: Array) -> None:
        """Columns of clock and drive, (K, 6, 2 n) the tips by the collars."""

        def joints(p: Array) -> Array:
            return np.hstack([(collars := self.of.collars(p)).theta, collars.l])

        staged = self.of.stages()
        for j in (*staged["clock"], *staged["drive"]):
            by[:, :, j] = np.einsum("kcj,kj->kc", upstream, self._difference(joints, j))

    def _changing_columns(self, upstream: Array, by: Array) -> None:
        """Columns of numbers that differ from pose to pose, (K, 6, C) the tips by them."""
        if not upstream.shape[2]:
            return

        def changes(p: Array) -> Array:
            return np.column_stack(list(self.of.at(p).changing(self.of.data).values()))

        for j in self.of.of_effects_with("changing"):
            by[:, :, j] += np.einsum("kcj,kj->kc", upstream, self._difference(changes, j))

    def _release_columns(self, collars: Collars, table: TipTable, by: Array) -> None:
        """Friction states change by differences of whole solves: few effects have them."""
        robot = self.chain.mechanics
        if not robot.friction.any():
            return
        for j in self.of.of_effects_with("friction_release_m", "friction_share"):
            moved, h = self.p.copy(), COARSE_STEP * self.of.prior[j]
            h = h if self.p[j] + h <= self.of.upper[j] else -h
            moved[j] += h
            other = point_table(robot, self.of.data, collars, self.of.friction_state(moved))
            by[:, :, j] = np.hstack([other.position_m - table.position_m, other.tangent - table.tangent]) / h

    def _difference(self, value: Callable[[Array], Array], j: int) -> Array:
        """Central difference of a cheap stage, one-sided at a bound."""
        p, h = self.p, STEP * self.of.prior[j]
        up, down = p.copy(), p.copy()
        up[j], down[j] = min(p[j] + h, self.of.upper[j]), max(p[j] - h, self.of.lower[j])
        return np.asarray((value(up) - value(down)) / (up[j] - down[j]))


def unit(vectors: Array) -> Array:
    """Vectors (K, 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _moved(poses: Poses, step: Array) -> Poses:
    """Poses displaced and turned by (6,)."""
    along = unit(poses.frame[:, :, 2] + step[3:])
    return Poses(poses.position + step[:3], frames_along(along, poses.frame[:, :, 0]))


def _stacked(poses: Poses) -> Array:
    return np.hstack([poses.position, poses.frame[:, :, 2]])


@dataclass(frozen=True, eq=False)
class _Column:
    here_m: Array  # (K, 3)
    value: float
    by: Array  # (K, 3)


_COLUMNS: WeakKeyDictionary[Measurements, dict[tuple[str, ...], list[_Column]]] = WeakKeyDictionary()


def remembered(
    data: Measurements, name: tuple[str, ...], here_m: Array, value: float, prior: float, solve: Callable[[], Array]
) -> Array:
    """(K, 3) derivatives by a parameter with this value, of points at (K, 3) [m]; `solve` returns those of now."""
    columns = _COLUMNS.setdefault(data, {}).setdefault(name, [])
    for column in columns:
        if abs(column.value - value) <= NEAR_SHARE * prior and np.abs(column.here_m - here_m).max() <= NEAR_M:
            return column.by
    by = solve()
    columns.insert(0, _Column(here_m, value, by))
    del columns[MOST:]
    return by


class Differenced(Protocol):
    """A chain of markers' poses alone."""

    terms: tuple[Term, ...]
    prior: Array
    lower: Array
    upper: Array

    def stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""

    def before_sensor(self, p: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where the points (K, 3) [m] are at parameters (P,), and whether (K,) that is an equilibrium."""


def marker_columns(chain: Differenced, data: Measurements, p: Array, here_m: Array, by: Array) -> Array:
    """(K, 3, P) of markers that are at (K, 3) [m], those of the sensor as they are; `data` remember slopes."""
    places, result = chain.stages(), by.copy()
    names = [(t.key, q.name) for t in chain.terms for q in t.parameters]
    for j in (*places["clock"], *places["drive"], *places["mechanics"]):
        column = partial(_differenced, chain, p, j, here_m)
        result[:, :, j] = remembered(data, names[j], here_m, float(p[j]), float(chain.prior[j]), column)
    return result


def _differenced(chain: Differenced, p: Array, j: int, here_m: Array) -> Array:
    """(K, 3) by parameter j, before plate and sensor."""
    by, left = np.zeros((len(here_m), 3)), np.ones(len(here_m), bool)
    for h in COARSE_STEP * chain.prior[j] * np.array([1.0, -1.0]):  # one way, or the other where it is barred
        moved = p.copy()
        moved[j] += h
        if left.any() and chain.lower[j] <= moved[j] <= chain.upper[j]:
            there, open_way = chain.before_sensor(moved)
            by[left] = ((there - here_m) / h)[left]
            left = left & ~open_way
    return by


DRIVEN_ALREADY = "the file has the joints of the collars, the drive's effects are in them"


class ParametricChain(TermValues):
    """Robot and terms along the waypoints of measurements. Parameter vectors (P,) are SI, term after term."""

    def __init__(self, robot: Robot, data: Measurements, terms: Sequence[Term]) -> None:
        """terms: effects, with the parameters that vary; effects in the robot file act besides, at their values."""
        super().__init__(terms)
        self.robot, self.data = robot, data
        self.correction: FrictionCorrection | None = None  # what a finer mesh or a simulated history knows better
        self._in_file = Chain.of(robot).on(data.time_s, data.more, of_collars=data.of_collars)
        self._across: Array | None = None
        self._last_ideal: tuple[list[tuple[Effect, dict[str, float]]], Robot] | None = None
        for t in self.terms:
            if missing := t.effect.missing_columns(data.time_s, data.more):
                raise InputError(f"needs a column {', '.join(missing)}", file=data.file, key=f"effects.{t.name}")
            if data.of_collars and t.effect.stage == "drive":
                raise InputError(DRIVEN_ALREADY, file=data.file, key=f"effects.{t.name}")

    def with_terms(self, terms: Sequence[Term]) -> ParametricChain:
        """Other terms for the same data, friction as simulated for these."""
        chain = ParametricChain(self.robot, self.data, terms)
        chain.correction = self.correction
        return chain

    def at(self, p: Array) -> Chain:
        """The chain with its parameters at `p`: first the file's own numbers, then the effects.

        An effect that the file has too acts once, where the file has it, with the file's values of what does not vary.
        """
        of_file, effects = self._given(p)
        return Chain(self._ideal(of_file), tuple(effects))

    def _given(self, p: Array) -> tuple[list[tuple[Effect, dict[str, float]]], list[Acting]]:
        """The file's own numbers at parameters (P,), and the effects that act."""
        effects = {given.effect.name: given for given in self._in_file.acting}
        of_file: list[tuple[Effect, dict[str, float]]] = []
        for t, values in zip(self.terms, self.values(p), strict=True):
            if t.effect.of_the_file:
                of_file.append((t.effect, values))
            else:
                present = effects[t.name].values if t.name in effects else {}
                effects[t.name] = Acting(t.effect, {**present, **values})
        return of_file, list(effects.values())

    def before_last(self, p: Array) -> tuple[Robot, Mapping[str, float]]:
        """The robot without the last of the mechanics that change it, and the numbers that this gives, by name."""
        of_file, acting = self._given(p)
        steps = [*of_file, *((given.effect, given.values) for given in acting if given.effect.stage == "mechanics")]
        robot, last = self._in_file.ideal, dict[str, float]()
        for k, (effect, values) in enumerate(steps):
            if k == len(of_file):
                robot, last = self._ideal(of_file), {}
            robot, last = with_values(robot, last) if last else robot, {}
            last = dict(effect.mechanics(values, robot))
        return robot, last

    def _ideal(self, of_file: list[tuple[Effect, dict[str, float]]]) -> Robot:
        """With the file's own numbers; the last one is kept, for derivatives by other parameters leave it as it is."""
        known = self._last_ideal
        if known is not None and known[0] == of_file:
            return known[1]
        ideal = self._in_file.ideal
        for effect, values in of_file:
            if named := effect.mechanics(values, ideal):
                ideal = with_values(ideal, named)
        self._last_ideal = of_file, ideal
        return ideal

    def installed_at(self, p: Array) -> Robot:
        """The robot with its parameters at `p`, its effects at work: as if read from the file that a fit writes."""
        chain, tables = self.at(p), dict(self.robot.effects)
        for t, values in zip(self.terms, self.values(p), strict=True):
            if t.effect.of_the_file:
                tables |= taken_along(tables, self.robot, t.effect.mechanics(values, self._in_file.ideal))
            else:
                present = {key: value for key, value in tables.get(t.name, {}).items() if key not in FILE_NOTES}
                fitted = {q.name: values[q.name] / q.si for q in t.parameters}
                tables[t.name] = present | fitted | dict(t.effect.stated(values))
        return with_chain(replace(self.robot, effects=tables), chain)

    def robot_at(self, p: Array) -> Robot:
        """The robot with every effect of the mechanics in it; its drive is ideal."""
        return self.at(p).mechanics

    def collars(self, p: Array) -> Collars:
        """Where the collars of the K poses stand."""
        return self._collars(self.at(p))

    def _collars(self, chain: Chain) -> Collars:
        return chain.collars(self.data, last_directions(self.data))

    def friction_state(self, p: Array) -> Array:
        """(K, n - 1) circumferential share of the Coulomb limit of each pair."""
        chain = self.at(p)
        if self.correction is not None and self.correction.phi is not None:
            return self.correction.phi * chain.friction_share(self.data)
        return friction_state(self.data, chain.release_m) * chain.friction_share(self.data)

    def predict(self, p: Array, *, derivatives: bool = True) -> SensorPrediction:
        """Poses at parameters (P,), in the order of the terms."""
        chain = self.at(p)
        robot, collars, phi = chain.mechanics, self._collars(chain), self.friction_state(p)
        columns = StageColumns(self, p) if derivatives else None
        changes = chain.changing(self.data)
        table = self._table(robot, collars, phi, columns.names if columns else [], changes)
        position, tangent = _followed(table, changes)
        coarse_m = position
        if self.correction is not None:
            position, tangent = position + self.correction.shift_m, unit(tangent + self.correction.turn)
        poses = Poses(position, frames_along(tangent, self._tip_x(chain, collars, phi, tangent)))
        seen = chain.seen(poses, collars, self.data)
        by = np.zeros((len(position), 6, len(self.parameters) if derivatives else 0))
        if columns:
            columns.of_tips(table, collars, by)
            self._of_markers(p, coarse_m, by)
            columns.of_what_is_seen(poses, collars, seen, by)
        return SensorPrediction(seen.position, seen.frame[:, :, 2], table.sound, table.failed, by[:, :3], by[:, 3:])

    def before_sensor(self, p: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where the measured points (K, 3) [m] are at parameters (P,), before plate and sensor, on the coarse mesh.

        And (K,) whether that is an equilibrium of collars that nest.
        """
        chain = self.at(p)
        collars, changes = self._collars(chain), chain.changing(self.data)
        table = self._table(chain.mechanics, collars, self.friction_state(p), [], changes)
        return _followed(table, changes)[0], table.sound

    def _of_markers(self, p: Array, here_m: Array, by: Array) -> None:
        """Derivatives of markers, now at (K, 3) [m], by differences of whole solves."""
        if self._body.any():
            chain = self._body_chain
            chain.correction = self.correction and self.correction.states_of(self._body)
            by[self._body, :3] = marker_columns(chain, self.data, p, here_m[self._body], by[self._body, :3])

    def _table(
        self, robot: Robot, collars: Collars, phi: Array, names: Sequence[str], changes: Mapping[str, Array]
    ) -> TipTable:
        """The measured points; the last derivatives are those by numbers that change from pose to pose."""
        table = point_table(robot, self.data, collars, phi, [*names, *changes])
        for k, (name, amount) in enumerate(changes.items() if self._body.any() else (), start=len(names)):
            h = float(np.abs(amount).max()) or 1.0
            other = point_table(with_values(robot, {name: value_of(robot, name) + h}), self.data, collars, phi)
            table.position_by[self._body, :, k] = (other.position_m - table.position_m)[self._body] / h
        return table

    @cached_property
    def _body(self) -> NDArray[np.bool_]:
        """(K,) poses of markers that are not the tip."""
        return on_body(self.robot, self.data)

    @cached_property
    def _body_chain(self) -> ParametricChain:
        """The chain of these poses alone."""
        return ParametricChain(self.robot, self.data.subset(self._body), self.terms)

    def _tip_x(self, chain: Chain, collars: Collars, phi: Array, tangent: Array) -> Array:
        """(K, 3) x axis of the innermost tube's frame at the tip; found once, for it hardly moves during a fit.

        Without a sensor that is fixed to the tube any direction across the tangent will do.
        """
        if not chain.turns_with_tip:
            return np.asarray(np.eye(3)[np.argmin(np.abs(tangent), axis=1)])
        if self._across is None:
            self._across = remembered_tip_x(self.data, chain.mechanics, collars, phi, tangent)
        return self._across


def _followed(table: TipTable, changes: Mapping[str, Array]) -> tuple[Array, Array]:
    """Positions and tangents (K, 3) of a table whose last derivatives are by numbers that change by (K,) each."""
    if not changes:
        return table.position_m, table.tangent
    by, amount = len(changes), np.column_stack(list(changes.values()))
    position = table.position_m + np.einsum("kxc,kc->kx", table.position_by[:, :, -by:], amount)
    return position, unit(table.tangent + np.einsum("kxc,kc->kx", table.tangent_by[:, :, -by:], amount))
