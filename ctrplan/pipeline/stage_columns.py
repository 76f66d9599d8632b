"""Derivatives of what is measured by the parameters of the chain, stage by stage.

The mechanics differentiate tips exactly. Clock, drive and sensor are a few lines of arithmetic each: finite differences
of them are joined by the chain rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import Parameter
from ctrplan.measurement.measurements import Measurements, Poses, frames_along
from ctrplan.pipeline.chain import Chain
from ctrplan.pipeline.term import Term
from ctrplan.pipeline.tip_table import TipTable, point_table
from ctrplan.robot.named_numbers import value_of

STEP = 1e-4  # of a parameter's prior, for the stages that are arithmetic
COARSE_STEP = 0.005  # of a parameter's prior, where the mechanics are differenced
MOVE = 1e-5  # [m] and [rad] alike, of what a sensor is shown


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
        """Columns of clock, drive and mechanics; the table's last derivatives are by numbers that differ from pose to
        pose.
        """
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
        turned = chain.turned(poses, collars)
        for j in range(by.shape[2]):
            if j in turning:
                by[:, :, j] = self._difference(lambda p: _stacked(at(p).seen(poses, collars, data)), j)
            elif j in sensing:
                by[:, :, j] = self._difference(lambda p: _stacked(at(p).sensor(turned, data)), j)
            else:
                size = max(float(np.abs(by[:, :, j]).max()), 1e-12)
                moved = _moved(poses, MOVE / size * by[:, :, j])
                by[:, :, j] = (_stacked(chain.seen(moved, collars, data)) - _stacked(seen)) * size / MOVE

    def _by_number(self) -> tuple[list[str], Array]:
        """Names of the robot's numbers (N,) that the parameters change, and their derivatives (N, P)."""
        chain, ideal = self.chain, self.chain.ideal
        terms = zip(self.of.terms, self.of.values(self.p), strict=True)
        of_file = (t.effect.mechanics(values, ideal) for t, values in terms if t.effect.of_the_file)
        of_effects = (given.effect.mechanics(given.values, ideal) for given in chain.of_stage("mechanics"))
        names = sorted({name for named in (*of_file, *of_effects) for name in named})

        def numbers(p: Array) -> Array:
            robot = self.of.at(p).mechanics
            return np.array([value_of(robot, name) for name in names])

        by = np.zeros((len(names), len(self.of.parameters)))
        for j in self.of.stages()["mechanics"]:
            by[:, j] = np.nan_to_num(self._difference(numbers, j))
        changed = np.flatnonzero(by.any(axis=1)).tolist()
        return [names[k] for k in changed], by[changed]

    def _joint_columns(self, upstream: Array, by: Array) -> None:
        """Columns of clock and drive, (K, 6, 2 n) the tips by the collars."""

        def joints(p: Array) -> Array:
            collars = self.of.collars(p)
            return np.hstack([collars.theta, collars.l])

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
            by[:, :3, j] = (other.position_m - table.position_m) / h
            by[:, 3:, j] = (other.tangent - table.tangent) / h

    def _difference(self, value: Callable[[Array], Array], j: int) -> Array:
        """Central difference of a cheap stage, one-sided at a bound."""
        p, h = self.p, STEP * self.of.prior[j]
        up, down = p.copy(), p.copy()
        up[j], down[j] = min(p[j] + h, self.of.upper[j]), max(p[j] - h, self.of.lower[j])
        difference: Array = (value(up) - value(down)) / (up[j] - down[j])
        return difference


def unit(vectors: Array) -> Array:
    """Vectors (K, 3) of length 1."""
    along: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return along


def _moved(poses: Poses, step: Array) -> Poses:
    """Poses displaced and turned by (K, 6)."""
    along = unit(poses.frame[:, :, 2] + step[:, 3:])
    return Poses(poses.position + step[:, :3], frames_along(along, poses.frame[:, :, 0]))


def _stacked(poses: Poses) -> Array:
    return np.hstack([poses.position, poses.frame[:, :, 2]])
