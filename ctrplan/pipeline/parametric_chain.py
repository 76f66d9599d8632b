"""The chain as a function of the parameters of its terms, with derivatives: what fits and the diagnosis ask.

The mechanics differentiate tips exactly. Clock, drive and sensor are a few lines of arithmetic each: finite differences
of them are joined by the chain rule. Markers on the body are differenced from the parameter to the sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.collars import Collars
from ctrplan.effects.effect import Effect, Parameter
from ctrplan.effects.of_file import NOTES
from ctrplan.errors import InputError
from ctrplan.experiment.friction_states import friction_state, last_directions
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.chain import Acting, Chain, taken_along
from ctrplan.pipeline.installed import with_chain
from ctrplan.pipeline.point_table import on_body, point_table
from ctrplan.pipeline.remembered_slopes import remembered
from ctrplan.pipeline.tip_table import TipTable, nested
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot
from ctrplan.sensor.poses import Poses, frames_along

DRIVEN_ALREADY = "the file has the joints of the collars, the drive's effects are in them"
STEP = 1e-4  # of a parameter's prior, for the stages that are arithmetic
COARSE_STEP = 0.005  # of a parameter's prior, where the mechanics are differenced


@dataclass(frozen=True, eq=False)
class Term:
    """An effect with some of its parameters at work; the others stay as the robot file has them, or neutral."""

    effect: Effect
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """The effect's."""
        return self.effect.name

    @property
    def key(self) -> str:
        """Name and parameters: tells variants of an effect apart."""
        return f"{self.name}[{','.join(parameter.name for parameter in self.parameters)}]"


def term(effect: Effect, names: Sequence[str], robot: Robot) -> Term:
    """An effect with the named parameters at work; priors lie around the values that the robot file has."""
    given = robot.effects.get(effect.name, {})
    known = {parameter.name: parameter for parameter in effect.parameters(robot.ideal or robot)}
    for name in names:
        if name in given:
            known[name] = replace(known[name], neutral=float(given[name]), start=float(given[name]))
    return Term(effect, tuple(known[name] for name in names))


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the sensor should read at K poses, and derivatives by the P parameters of all terms."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    sound: NDArray[np.bool_]  # (K,)
    failed: NDArray[np.bool_]  # (K,) without a solution: position and tangent are those of the last iterate
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)

    def subset(self, poses: NDArray[np.bool_]) -> Prediction:
        """Some of the poses only, given by a mask (K,)."""
        return Prediction(*(getattr(self, name)[poses] for name in Prediction.__dataclass_fields__))


class ParametricChain:
    """Robot and terms along the waypoints of measurements. Parameter vectors (P,) are SI, term after term."""

    def __init__(self, robot: Robot, data: Measurements, terms: Sequence[Term]) -> None:
        """terms: effects, with the parameters that vary; effects in the robot file act besides, at their values."""
        self.robot, self.data, self.terms = robot, data, tuple(terms)
        self.parameters = tuple(p for t in self.terms for p in t.parameters)
        self.si = np.array([p.si for p in self.parameters])
        self.neutral = np.array([p.neutral for p in self.parameters]) * self.si
        self.prior = np.array([p.prior for p in self.parameters]) * self.si
        self.lower = np.array([p.lower for p in self.parameters]) * self.si
        self.upper = np.array([p.upper for p in self.parameters]) * self.si
        self.correction: tuple[Array, Array] | None = None  # (K, 3) each: what a finer mesh adds to position, tangent
        self.followed_phi: Array | None = None  # (K, n - 1) friction states of a simulated history, not of the rule
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
        chain.correction, chain.followed_phi = self.correction, self.followed_phi
        return chain

    @property
    def start(self) -> Array:
        """(P,) where a fit starts."""
        start: Array = np.array([p.neutral if p.start is None else p.start for p in self.parameters]) * self.si
        return start

    def slices(self) -> list[slice]:
        """Where each term's parameters stand."""
        ends = np.cumsum([len(t.parameters) for t in self.terms]).tolist()
        return [slice(end - len(t.parameters), end) for end, t in zip(ends, self.terms, strict=True)]

    def values(self, p: Array) -> list[dict[str, float]]:
        """Per term, parameter -> value, SI."""
        return [
            {q.name: float(v) for q, v in zip(t.parameters, p[s], strict=True)}
            for t, s in zip(self.terms, self.slices(), strict=True)
        ]

    def at(self, p: Array) -> Chain:
        """The chain with its parameters at `p`: first the file's own numbers, then the effects.

        An effect that the file has too acts once, where the file has it, with the file's values of what does not vary.
        """
        effects, of_file = {given.effect.name: given for given in self._in_file.acting}, []
        for t, values in zip(self.terms, self.values(p), strict=True):
            if t.effect.of_the_file:
                of_file.append((t.effect, values))
            else:
                held = effects[t.name].values if t.name in effects else {}
                effects[t.name] = Acting(t.effect, {**held, **values})
        return Chain(self._ideal(of_file), tuple(effects.values()))

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
                held = {key: value for key, value in tables.get(t.name, {}).items() if key not in NOTES}
                fitted = {q.name: values[q.name] / q.si for q in t.parameters}
                tables[t.name] = held | fitted | dict(t.effect.stated(values))
        return with_chain(replace(self.robot, effects=tables), chain)

    def robot_at(self, p: Array) -> Robot:
        """The robot with every effect of the mechanics in it; its drive is ideal."""
        return self.at(p).mechanics

    def collars(self, p: Array) -> Collars:
        """Where the collars of the K poses stand."""
        return self.at(p).collars(self.data, self._directions)

    def friction_state(self, p: Array) -> Array:
        """(K, n - 1) circumferential share of the Coulomb limit of each pair."""
        chain = self.at(p)
        if self.followed_phi is not None:
            return self.followed_phi * chain.friction_share(self.data)
        plain = self._plain_phi if np.isinf(chain.release_m) else friction_state(self.data, chain.release_m)
        return plain * chain.friction_share(self.data)

    def predict(self, p: Array, *, derivatives: bool = True) -> Prediction:
        """Poses at parameters (P,), in the order of the terms."""
        chain = self.at(p)
        robot, collars, phi = chain.mechanics, chain.collars(self.data, self._directions), self.friction_state(p)
        staged = self._stages()
        names, numbers_by = self._numbers(p) if derivatives else ([], np.zeros((0, 0)))
        joints = self._joint_names() if derivatives and (staged["drive"] or staged["clock"]) else []
        changes = chain.changing(self.data)
        table = self._table(robot, collars, phi, [*names, *joints], changes)
        position, tangent = _followed(table, changes)
        coarse_m = position
        if self.correction is not None:
            position, tangent = position + self.correction[0], _unit(tangent + self.correction[1])
        poses = Poses(position, frames_along(tangent, self._tip_x(chain, collars, phi, tangent)))
        seen = chain.seen(poses, collars, self.data)
        by = np.zeros((len(position), 6, len(self.parameters) if derivatives else 0))
        if derivatives:
            upstream = np.concatenate([table.position_by, table.tangent_by], axis=1)
            by += upstream[:, :, : len(names)] @ numbers_by
            self._joint_columns(p, upstream[:, :, len(names) : len(names) + len(joints)], by)
            self._changing_columns(p, upstream[:, :, len(names) + len(joints) :], list(changes), by)
            self._release_columns(p, robot, collars, table, by)
            self._body_columns(p, coarse_m, by)
            self._sensor_columns(p, poses, collars, seen, by)
        return Prediction(seen.position, seen.frame[:, :, 2], table.sound, table.failed, by[:, :3], by[:, 3:])

    @cached_property
    def _directions(self) -> Array:
        return last_directions(self.data)

    @cached_property
    def _plain_phi(self) -> Array:
        return friction_state(self.data)

    def _stages(self) -> dict[str, list[int]]:
        """Per stage, positions of its parameters in the vector."""
        places: dict[str, list[int]] = {"clock": [], "drive": [], "mechanics": [], "sensor": []}
        for t, s in zip(self.terms, self.slices(), strict=True):
            places[t.effect.stage] += range(s.start, s.stop)
        return places

    def _joint_names(self) -> list[str]:
        return [f"{kind}.{i + 1}" for kind in ("theta_b", "l_b") for i in range(self.data.n)]

    def _numbers(self, p: Array) -> tuple[list[str], Array]:
        """Names of the robot's numbers (N,) that the parameters change, and their derivatives (N, P)."""
        chain = self.at(p)
        terms = zip(self.terms, self.values(p), strict=True)
        of_file = (t.effect.mechanics(values, chain.ideal) for t, values in terms if t.effect.of_the_file)
        of_effects = (given.effect.mechanics(given.values, chain.ideal) for given in chain.of_stage("mechanics"))
        names = sorted({name for named in (*of_file, *of_effects) for name in named})

        def numbers(p: Array) -> Array:
            robot = self.at(p).mechanics
            return np.array([value_of(robot, name) for name in names])

        by = np.zeros((len(names), len(self.parameters)))
        for j in self._stages()["mechanics"]:
            by[:, j] = np.nan_to_num(self._difference(numbers, p, j))
        changed = np.flatnonzero(by.any(axis=1)).tolist()
        return [names[k] for k in changed], by[changed]

    def _joint_columns(self, p: Array, upstream: Array, by: Array) -> None:
        """Of clock and drive, (K, 6, 2 n) the tips by the collars."""

        def joints(p: Array) -> Array:
            collars = self.collars(p)
            return np.hstack([collars.theta, collars.l])

        staged = self._stages()
        for j in (*staged["clock"], *staged["drive"]):
            by[:, :, j] = np.einsum("kcj,kj->kc", upstream, self._difference(joints, p, j))

    def _changing_columns(self, p: Array, upstream: Array, names: Sequence[str], by: Array) -> None:
        """Of numbers that differ from pose to pose, (K, 6, C) the tips by them."""
        if not names:
            return

        def changes(p: Array) -> Array:
            return np.column_stack(list(self.at(p).changing(self.data).values()))

        for t, s in zip(self.terms, self.slices(), strict=True):
            if t.effect.overrides("changing"):
                for j in range(s.start, s.stop):
                    by[:, :, j] += np.einsum("kcj,kj->kc", upstream, self._difference(changes, p, j))

    def _release_columns(self, p: Array, robot: Robot, collars: Collars, table: TipTable, by: Array) -> None:
        """Friction states change by differences of whole solves: few effects have them."""
        for t, s in zip(self.terms, self.slices(), strict=True):
            if any(map(t.effect.overrides, ("friction_release_m", "friction_share"))) and robot.friction.any():
                for j in range(s.start, s.stop):
                    moved, h = p.copy(), COARSE_STEP * self.prior[j]
                    h = h if p[j] + h <= self.upper[j] else -h
                    moved[j] += h
                    other = point_table(robot, self.data, collars, self.friction_state(moved))
                    by[:, :3, j] = (other.position_m - table.position_m) / h
                    by[:, 3:, j] = (other.tangent - table.tangent) / h

    def _body_columns(self, p: Array, here_m: Array, by: Array) -> None:
        """Of markers, now at (K, 3) [m], by differences of whole solves: the core differentiates tips alone."""
        if not self._body.any():
            return
        places, chain = self._stages(), self._body_chain
        chain.followed_phi = None if self.followed_phi is None else self.followed_phi[self._body]
        here = here_m[self._body]
        names = [(t.key, q.name) for t in self.terms for q in t.parameters]
        for j in (*places["clock"], *places["drive"], *places["mechanics"]):
            column = partial(chain.differenced, p, j, here)
            by[self._body, :3, j] = remembered(self.data, names[j], here, float(p[j]), float(self.prior[j]), column)

    def differenced(self, p: Array, j: int, here: Array) -> Array:
        """(K, 3) derivatives by parameter j of measured points that are at (K, 3) [m], before plate and sensor."""
        by, left = np.zeros((len(here), 3)), np.ones(len(here), bool)
        for h in COARSE_STEP * self.prior[j] * np.array([1.0, -1.0]):  # one way, or the other where it is barred
            moved = p.copy()
            moved[j] += h
            if left.any() and self.lower[j] <= moved[j] <= self.upper[j]:
                there, open_way = self.before_sensor(moved)
                by[left] = ((there - here) / h)[left]
                left = left & ~open_way
        return by

    def before_sensor(self, p: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where the measured points (K, 3) [m] are at parameters (P,), before plate and sensor, on the coarse mesh.

        And (K,) whether that is an equilibrium of collars that nest.
        """
        chain = self.at(p)
        collars, changes = chain.collars(self.data, self._directions), chain.changing(self.data)
        table = self._table(chain.mechanics, collars, self.friction_state(p), [], changes)
        return _followed(table, changes)[0], table.sound

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
        """The same of these poses alone."""
        return ParametricChain(self.robot, self.data.subset(self._body), self.terms)

    def _sensor_columns(self, p: Array, poses: Poses, collars: Collars, seen: Poses, by: Array) -> None:
        chain = self.at(p)
        if not chain.of_stage("sensor") and chain.plate_turn(collars) is None:
            return
        turning = [j for t, s in zip(self.terms, self.slices(), strict=True) if t.effect.overrides("plate_turn")
                   for j in range(s.start, s.stop)]  # fmt: skip
        direct = {*self._stages()["sensor"], *turning}
        h = 1e-5  # m and rad alike
        turned = chain.turned(poses, collars)
        for j in range(by.shape[2]):
            if j in direct and j not in turning:
                by[:, :, j] = self._difference(lambda p: _stacked(self.at(p).sensor(turned, self.data)), p, j)
            elif j in direct:
                by[:, :, j] = self._difference(lambda p: _stacked(self.at(p).seen(poses, collars, self.data)), p, j)
            else:
                size = max(float(np.abs(by[:, :, j]).max()), 1e-12)
                step = h / size * by[:, :, j]
                moved = Poses(
                    poses.position + step[:, :3],
                    frames_along(_unit(poses.frame[:, :, 2] + step[:, 3:]), poses.frame[:, :, 0]),
                )
                by[:, :, j] = (_stacked(chain.seen(moved, collars, self.data)) - _stacked(seen)) * size / h

    def _difference(self, of: Callable[[Array], Array], p: Array, j: int) -> Array:
        """Central difference of a cheap stage, one-sided at a bound."""
        h = STEP * self.prior[j]
        up, down = p.copy(), p.copy()
        up[j], down[j] = min(p[j] + h, self.upper[j]), max(p[j] - h, self.lower[j])
        difference: Array = (of(up) - of(down)) / (up[j] - down[j])
        return difference

    def _tip_x(self, chain: Chain, collars: Collars, phi: Array, tangent: Array) -> Array:
        """(K, 3) x axis of the innermost tube's frame at the tip; solved once, for it hardly moves during a fit.

        Without a sensor that is fixed to the tube any direction across the tangent will do.
        """
        if not chain.turns_with_tip:
            across: Array = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
            return across
        if self._across is None:
            robot = chain.mechanics
            rows = zip(collars.theta, nested(robot, collars.l), phi, strict=True)
            self._across = np.array([robot.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows])
        return self._across


def _followed(table: TipTable, changes: Mapping[str, Array]) -> tuple[Array, Array]:
    """Positions and tangents (K, 3) of a table whose last derivatives are by numbers that change by (K,) each."""
    if not changes:
        return table.position_m, table.tangent
    by, amount = len(changes), np.column_stack(list(changes.values()))
    position = table.position_m + np.einsum("kxc,kc->kx", table.position_by[:, :, -by:], amount)
    return position, _unit(table.tangent + np.einsum("kxc,kc->kx", table.tangent_by[:, :, -by:], amount))


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def _stacked(poses: Poses) -> Array:
    return np.hstack([poses.position, poses.frame[:, :, 2]])
