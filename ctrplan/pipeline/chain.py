"""The chain, from what is commanded to what is measured:

    commanded joints -> clock -> drive -> mechanics -> sensor -> measured poses

Every effect is a term of one stage, and effects of one stage act one after the other, in the order of the robot file.
Whoever asks what a robot does asks this chain: fits and diagnosis (`parametric_chain.py`), simulations along a path
(`studies/simulate.py`), and, through the robot that `installed.py` makes of it, bounds, plans, goals and the live view.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import Effect, Stage, Values
from ctrplan.effects.learned.learned import FILE_NOTES, effect_of
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import Measurements, Poses, moved_rigidly
from ctrplan.robot.named_numbers import with_values
from ctrplan.robot.robot import Robot


@dataclass(frozen=True)
class Acting:
    """An effect at work, with the values [SI] of its parameters; those that are not named stay neutral."""

    effect: Effect
    values: Values


@dataclass(frozen=True, eq=False)
class Chain:
    """A robot as built, without effects, and the effects that act in its stages."""

    ideal: Robot
    acting: tuple[Acting, ...]

    @classmethod
    def of(cls, robot: Robot) -> Chain:
        """The chain of a robot with the effects of its file."""
        ideal, acting = robot.ideal or robot, acting_in_file(robot)
        for given in acting:  # what takes the place of the file's own numbers is as if it stood there
            if given.effect.sets_outright:
                ideal = with_values(ideal, given.effect.mechanics(given.values, ideal))
        return cls(ideal, tuple(given for given in acting if not given.effect.sets_outright))

    def on(self, time_s: Array | None, more: Mapping[str, Array], *, of_collars: bool = False) -> Chain:
        """This chain without effects that need a column which these data do not have.

        of_collars: joints are those of the collars, which the drive has moved already.
        """
        able = [given for given in self.acting if not given.effect.missing_columns(time_s, more)]
        return replace(
            self, acting=tuple(given for given in able if not (of_collars and given.effect.stage == "drive"))
        )

    def collars(self, data: Measurements, directions: Array) -> Collars:
        """Where the collars stand, (K, n), when the K poses are taken; `directions` (K, 2 n) of the last motions."""
        return self.drive(self.homed(self.clock(data), data), directions)

    def homed(self, commanded: Collars, data: Measurements) -> Collars:
        """What was commanded, (K, n), from the zeros that the runs of the K poses have."""
        result = (given.effect.zeros(given.values, data) for given in self.of_stage("drive"))
        off = [zeros for zeros in result if zeros is not None]
        if not off:
            return commanded
        total = np.sum(off, axis=0)
        return Collars(commanded.theta + total[:, : data.n], commanded.l + total[:, data.n :])

    def clock(self, data: Measurements) -> Collars:
        """What was commanded, (K, n), at the instants that the K poses belong to."""
        delays_s = self.delay_s + self.drive_delays_s(data.n)
        commanded = at_instants(data, np.hstack([data.theta_commanded, data.l_commanded]), delays_s)
        return Collars(commanded[:, : data.n], commanded[:, data.n :])

    def late(self, data: Measurements) -> Collars:
        """Where the drive is told to be, (K, n), at the K poses: what was commanded, as late as it follows."""
        table = np.hstack([data.theta_commanded, data.l_commanded])
        commanded = at_instants(data, table, self.drive_delays_s(data.n))
        return Collars(commanded[:, : data.n], commanded[:, data.n :])

    def drive(self, commanded: Collars, directions: Array) -> Collars:
        """Where collars (K, n) stand when the drive has gone to where they are commanded.

        directions (K, 2 n): sign of the last motion of each rotation, then of each translation; 0 where nobody knows.
        """
        collars = commanded
        for given in self.of_stage("drive"):
            collars = given.effect.drive(given.values, collars, directions)
        return collars

    @cached_property
    def mechanics(self) -> Robot:
        """The tubes, contacts and loads with every effect of the mechanics in them; its drive is ideal."""
        robot = self.ideal
        for given in self.of_stage("mechanics"):
            if named := given.effect.mechanics(given.values, robot):
                robot = with_values(robot, named)
        return robot

    def sensor(self, poses: Poses, data: Measurements) -> Poses:
        """What is measured of the K poses of the tip."""
        for given in self.of_stage("sensor"):
            poses = given.effect.sensor(given.values, poses, data)
        return poses

    def plate_turn(self, collars: Collars) -> Array | None:
        """(K, 3) [rad] by which what is in front of the plate is turned at K collars; None where nothing turns it."""
        robot = self.mechanics
        turns = [given.effect.plate_turn(given.values, robot, collars) for given in self.of_stage("mechanics")]
        results = [turn for turn in turns if turn is not None]
        return np.sum(results, axis=0) if results else None

    def seen(self, poses: Poses, collars: Collars, data: Measurements) -> Poses:
        """What is measured of the K poses of the tip: turned with the plate, then as the sensor has them."""
        return self.sensor(self.turned(poses, collars), data)

    def turned(self, poses: Poses, collars: Collars) -> Poses:
        """The K poses of the tip, turned with the plate."""
        turn = self.plate_turn(collars)
        return poses if turn is None else moved_rigidly(poses, turn, np.zeros(3))

    def changing(self, data: Measurements) -> dict[str, Array]:
        """By how much (K,) named numbers of the mechanics differ at each pose."""
        changes: dict[str, Array] = {}
        for given in self.of_stage("mechanics"):
            for name, change in given.effect.changing(given.values, self.mechanics, data).items():
                changes[name] = changes.get(name, 0.0) + change
        return changes

    def drive_delays_s(self, n: int) -> Array:
        """(2 n,) how much later [s] than commanded each rotation, then each translation, happens."""
        delays: Array = np.zeros(2 * n) + sum(g.effect.drive_delays_s(g.values, n) for g in self.of_stage("clock"))
        return delays

    @property
    def delay_s(self) -> float:
        """How much earlier [s] the joints are that a pose belongs to."""
        return float(sum(given.effect.delay_s(given.values) for given in self.of_stage("clock")))

    @property
    def release_m(self) -> float:
        """Relative translation [m] that leaves 1/e of the circumferential friction."""
        return min((given.effect.friction_release_m(given.values) for given in self.acting), default=np.inf)

    @property
    def turns_with_tip(self) -> bool:
        """Whether what is measured depends on how the innermost tube is turned about its tangent."""
        return any(given.effect.turns_with_tip for given in self.acting)

    def friction_state(self, data: Measurements) -> Array:
        """(K, n - 1) circumferential share of the Coulomb limit of each pair, of poses at rest."""
        return self.friction_share(data) * friction_state(data, self.release_m)

    def friction_share(self, data: Measurements) -> Array:
        """(K, n - 1) of the friction state that is left at each pose."""
        share = np.ones((data.count, data.n - 1))
        for given in self.of_stage("mechanics"):
            share = share * given.effect.friction_share(given.values, data)
        return share

    def of_stage(self, stage: Stage) -> tuple[Acting, ...]:
        """The effects of one stage, in the order in which they act."""
        return tuple(given for given in self.acting if given.effect.stage == stage)


def acting_in_file(robot: Robot) -> tuple[Acting, ...]:
    """The effects of a robot's file with their values in SI, in the order of the file."""
    results = []
    for name, table in robot.effects.items():
        effect = effect_of(name, table, robot.n)
        si = {parameter.name: parameter.si for parameter in effect.parameters(robot.ideal or robot)}
        values = {key: float(value) * si[key] for key, value in table.items() if key not in FILE_NOTES}
        results.append(Acting(effect, values))
    return tuple(results)


def taken_along(
    tables: Mapping[str, Mapping[str, Any]], robot: Robot, named: Mapping[str, float]
) -> dict[str, dict[str, Any]]:
    """Those of a file's [effects.*] that take the place of numbers which change to `named`, with the new values.

    Their intervals go: they were of the values before.
    """
    changed: dict[str, dict[str, Any]] = {}
    for name, table in tables.items():
        effect = effect_of(name, table, robot.n)
        for parameter in effect.parameters(robot.ideal or robot) if effect.sets_outright else ():
            number = next(iter(effect.mechanics({parameter.name: parameter.neutral * parameter.si}, robot)))
            if parameter.name in table and number in named:
                new = changed.setdefault(name, dict(table))
                new[parameter.name] = float(named[number] / parameter.si)
                if "ci95" in new:
                    new["ci95"] = {key: ends for key, ends in new["ci95"].items() if key != parameter.name}
    return changed


def at_instants(data: Measurements, table: Array, delay_s: Array | float) -> Array:
    """Rows of `table` (R, c), one for each waypoint, at the times of the K poses less `delay_s`, one or (c,).

    Linear between waypoints; before a run begins and after it ends, the robot rests.
    """
    if not np.any(delay_s) or data.time_s is None:
        return table[data.rows]
    result = np.empty((data.count, table.shape[1]))
    for run in np.unique(data.sequence[data.rows]).tolist():
        waypoints, poses = np.flatnonzero(data.sequence == run), data.sequence[data.rows] == run
        times, delays = data.time_s[data.rows[poses]], np.broadcast_to(delay_s, table.shape[1])
        columns = zip(delays, table[waypoints].T, strict=True)
        result[poses] = np.column_stack([np.interp(times - late, data.time_s[waypoints], c) for late, c in columns])
    return result
