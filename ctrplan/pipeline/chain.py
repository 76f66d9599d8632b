"""The whole chain: commanded waypoints -> clock -> drive -> mechanics -> sensor -> poses, with derivatives.

Every effect is a term of one stage. The mechanics differentiate exactly; clock, drive and sensor are a few lines of
arithmetic each, differentiated by finite differences and joined by the chain rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import Collars, Effect, Parameter
from ctrplan.errors import InputError
from ctrplan.experiment.friction_states import friction_state, last_directions
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.robot_effects import effects_of
from ctrplan.pipeline.tip_table import TipTable, nested, tip_table
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot
from ctrplan.sensor.poses import Poses, frames_along

STEP = 1e-4  # of a parameter's prior, for the stages that are arithmetic
COARSE_STEP = 0.02  # of a parameter's prior, where the mechanics are differenced


@dataclass(frozen=True, eq=False)
class Term:
    """An effect with some of its parameters at work; the others stay neutral."""

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
    """An effect with the named parameters at work."""
    known = {parameter.name: parameter for parameter in effect.parameters(robot)}
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


class Chain:
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
        self._given = [  # the mechanics of these are in the robot already
            (effect, values)
            for effect, values in effects_of(robot)
            if not effect.missing_columns(data.time_s, data.more)
        ]
        self._across: Array | None = None
        for t in self.terms:
            if missing := t.effect.missing_columns(data.time_s, data.more):
                raise InputError(f"needs a column {', '.join(missing)}", file=data.file, key=f"effects.{t.name}")

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

    def robot_at(self, p: Array) -> Robot:
        """The robot with every mechanics term in it."""
        robot = self.robot
        for t, values in zip(self.terms, self.values(p), strict=True):
            if t.effect.stage == "mechanics" and (named := t.effect.mechanics(values, robot)):
                robot = with_values(robot, named)
        return robot

    def collars(self, p: Array) -> Collars:
        """Where the collars of the K poses stand."""
        rows = self.data.rows
        collars = Collars(self.data.theta_b[rows], self.data.l_b[rows])
        for effect, values in self._at_work(p):
            if effect.stage == "clock":
                collars = effect.clock(values, self.data, collars)
        for effect, values in self._at_work(p):
            if effect.stage == "drive":
                collars = effect.drive(values, collars, self._directions)
        return collars

    def measured(self, p: Array, poses: Poses) -> Poses:
        """What the sensor says of poses of the tip."""
        for effect, values in self._at_work(p):
            if effect.stage == "sensor":
                poses = effect.sensor(values, poses, self.data)
        return poses

    def friction_state(self, p: Array) -> Array:
        """(K, n - 1) circumferential share of the Coulomb limit of each pair."""
        release = min((effect.friction_release_m(values) for effect, values in self._at_work(p)), default=np.inf)
        return self._plain_phi if np.isinf(release) else friction_state(self.data, release)

    def predict(self, p: Array, *, derivatives: bool = True) -> Prediction:
        """Poses at parameters (P,), in the order of the terms."""
        robot, collars = self.robot_at(p), self.collars(p)
        staged = self._stages()
        names = self._named(p) if derivatives else []
        joints = self._joint_names() if derivatives and (staged["drive"] or staged["clock"]) else []
        phi = self.friction_state(p)
        table = tip_table(robot, collars.theta, collars.l, phi, [*names, *joints])
        position, tangent = table.position_m, table.tangent
        if self.correction is not None:
            position, tangent = position + self.correction[0], _unit(tangent + self.correction[1])
        poses = Poses(position, frames_along(tangent, self._tip_x(p, robot, collars, phi, tangent)))
        seen = self.measured(p, poses)
        count = len(self.parameters) if derivatives else 0
        by = np.zeros((len(position), 6, count))
        if derivatives:
            upstream = np.concatenate([table.position_by, table.tangent_by], axis=1)
            self._mechanics_columns(p, names, upstream, by)
            self._joint_columns(p, len(names), upstream, by)
            self._release_columns(p, robot, collars, table, by)
            self._sensor_columns(p, poses, seen, by)
        return Prediction(seen.position, seen.frame[:, :, 2], table.sound, table.failed, by[:, :3], by[:, 3:])

    @cached_property
    def _directions(self) -> Array:
        return last_directions(self.data)

    def _at_work(self, p: Array) -> list[tuple[Effect, Mapping[str, float]]]:
        """Effects of the robot file, then those of the terms, with their values."""
        return [*self._given, *((t.effect, v) for t, v in zip(self.terms, self.values(p), strict=True))]

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

    def _named(self, p: Array) -> list[str]:
        """Named numbers of the robot that the mechanics terms set."""
        robot, names = self.robot, set[str]()
        for t, values in zip(self.terms, self.values(p), strict=True):
            if t.effect.stage == "mechanics":
                names |= set(t.effect.mechanics(values, robot))
        return sorted(names)

    def _mechanics_columns(self, p: Array, names: list[str], upstream: Array, by: Array) -> None:
        def named(p: Array) -> Array:
            robot = self.robot_at(p)
            return np.array([value_of(robot, name) for name in names])

        for j in self._stages()["mechanics"]:
            by[:, :, j] = upstream[:, :, : len(names)] @ np.nan_to_num(self._difference(named, p, j))

    def _joint_columns(self, p: Array, first: int, upstream: Array, by: Array) -> None:
        def joints(p: Array) -> Array:
            collars = self.collars(p)
            return np.hstack([collars.theta, collars.l])

        staged = self._stages()
        for j in (*staged["clock"], *staged["drive"]):
            by[:, :, j] = np.einsum("kcj,kj->kc", upstream[:, :, first:], self._difference(joints, p, j))

    def _release_columns(self, p: Array, robot: Robot, collars: Collars, table: TipTable, by: Array) -> None:
        """Friction states change by differences of whole solves: few effects have them."""
        for t, s in zip(self.terms, self.slices(), strict=True):
            if type(t.effect).friction_release_m is not Effect.friction_release_m and robot.friction.any():
                for j in range(s.start, s.stop):
                    moved, h = p.copy(), COARSE_STEP * self.prior[j]
                    moved[j] += h
                    other = tip_table(robot, collars.theta, collars.l, self.friction_state(moved))
                    by[:, :3, j] = (other.position_m - table.position_m) / h
                    by[:, 3:, j] = (other.tangent - table.tangent) / h

    def _sensor_columns(self, p: Array, poses: Poses, seen: Poses, by: Array) -> None:
        if not any(effect.stage == "sensor" for effect, _ in self._at_work(p)):
            return
        staged = self._stages()
        h = 1e-5  # m and rad alike
        for j in range(by.shape[2]):
            if j in staged["sensor"]:
                by[:, :, j] = self._difference(lambda p: _stacked(self.measured(p, poses)), p, j)
            else:
                size = max(float(np.abs(by[:, :, j]).max()), 1e-12)
                step = h / size * by[:, :, j]
                moved = Poses(
                    poses.position + step[:, :3],
                    frames_along(_unit(poses.frame[:, :, 2] + step[:, 3:]), poses.frame[:, :, 0]),
                )
                by[:, :, j] = (_stacked(self.measured(p, moved)) - _stacked(seen)) * size / h

    def _difference(self, of: Callable[[Array], Array], p: Array, j: int) -> Array:
        """Central difference of a cheap stage, one-sided at a bound."""
        h = STEP * self.prior[j]
        up, down = p.copy(), p.copy()
        up[j], down[j] = min(p[j] + h, self.upper[j]), max(p[j] - h, self.lower[j])
        difference: Array = (of(up) - of(down)) / (up[j] - down[j])
        return difference

    def _tip_x(self, p: Array, robot: Robot, collars: Collars, phi: Array, tangent: Array) -> Array:
        """(K, 3) x axis of the innermost tube's frame at the tip; solved once, for it hardly moves during a fit.

        Without a sensor that is fixed to the tube any direction across the tangent will do.
        """
        if not any(effect.turns_with_tip for effect, _ in self._at_work(p)):
            across: Array = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
            return across
        if self._across is None:
            rows = zip(collars.theta, nested(robot, collars.l), phi, strict=True)
            self._across = np.array([robot.solve(*row).tubes[-1].frames[-1, :, 0] for row in rows])
        return self._across


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def _stacked(poses: Poses) -> Array:
    return np.hstack([poses.position, poses.frame[:, :, 2]])
