"""What a scenario allows besides friction: play of the drive, parameters within their intervals, drives that follow
late, and a base that stands elsewhere.

All but the base are a box of axes from -1 to 1, with the robot of the file in its middle. Correlated parameters are
moved along the principal axes of their errors. The base's shift and turn lie in balls that hold 95 % of them; which
shift and turn bring a body nearest is computed for each body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrplan.audit.body import RawAnatomy
from ctrplan.base.arrays import CHI95, Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.learned.learned import effect_of
from ctrplan.errors import CtrplanError
from ctrplan.mechanics.tube import moved_to_nest
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot
from ctrplan.scenario.scenario import Registration
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters

MOST_ROBOTS = 400  # that are kept, of a few kB each
PROBED = 6  # points of a body for which the base is moved against them, and places where the drive is asked
EVEN = 1e-9  # by which correlations and sides of intervals count as nothing


@dataclass(frozen=True)
class BaseMove:
    """Where the base stands instead, anatomy's frame: turned about its origin, then shifted."""

    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def of(self, points_m: Array, base_m: Array) -> Array:
        """Points (K, 3) of the anatomy's frame, moved."""
        angle = float(np.linalg.norm(self.turn_rad))
        lever = points_m - base_m
        if angle:
            axis = np.array(self.turn_rad) / angle
            along = np.outer(lever @ axis, axis)
            lever = along + np.cos(angle) * (lever - along) + np.sin(angle) * np.cross(axis, lever)
        return np.asarray(base_m + lever + self.shift_m)


STANDING = BaseMove()


@dataclass(frozen=True, eq=False)
class AllowedRobots:
    """The robots of a file: A axes of their box, the robot at a place of it, and how late its drive follows."""

    robot: Robot
    parameters: UncertainParameters
    played: NDArray[np.intp]  # (B,) actuators whose last direction matters, of the 2 n: rotations, then translations
    sides: Array  # (A', 2, Q) offsets of Q parameters at either end of their axes
    clock: tuple[tuple[str, str, float, float, float], ...]  # effect, parameter, value, low and high [s]
    known: dict[bytes, Robot | None] = field(default_factory=dict)
    chains: dict[bytes, Chain] = field(default_factory=dict)

    @classmethod
    def of(cls, robot: Robot) -> AllowedRobots:
        """What the file of a robot says."""
        parameters = _with_contacts(uncertain_parameters(robot))
        none, sides, clock = np.empty(0, dtype=np.intp), _sides(parameters), tuple(_clock(robot))
        still = cls(robot, parameters, none, sides, clock)
        ends = [np.zeros(still.count), *(side * np.eye(still.count)[axis] for axis, side in still.ends)]
        played = np.flatnonzero(np.any([still._feels_direction(axes) for axes in ends], axis=0))
        return cls(robot, parameters, played, sides, clock, still.known, still.chains)

    @property
    def count(self) -> int:
        """Number of axes: play, parameters, delays."""
        return len(self.played) + len(self.sides) + len(self.clock)

    @cached_property
    def ends(self) -> tuple[tuple[int, float], ...]:
        """Axes and the ends of them, -1 or 1, that differ from the file's robot."""
        play = [(k, side) for k in range(len(self.played)) for side in (-1.0, 1.0)]
        of_parameters = [(len(play) // 2 + k, k) for k in range(len(self.sides))]
        wide = [(a, s) for a, k in of_parameters for j, s in enumerate((-1.0, 1.0)) if np.any(self.sides[k, j])]
        begin = len(self.played) + len(self.sides)
        late = [
            (begin + k, s)
            for k, (_, _, value, low, high) in enumerate(self.clock)
            for s, end in ((-1.0, low), (1.0, high))
            if abs(end - value) > EVEN
        ]
        return (*play, *wide, *late)

    def play(self, axes: Array) -> Array:
        """(2 n,) shares of the play, -1 to 1."""
        shares = np.zeros(2 * self.robot.n)
        shares[self.played] = axes[: len(self.played)]
        return shares

    def offset(self, axes: Array) -> Array:
        """(Q,) by which parameters differ from the file's."""
        of_parameters = axes[len(self.played) : len(self.played) + len(self.sides)]
        below, above = np.minimum(of_parameters, 0.0), np.maximum(of_parameters, 0.0)
        total: Array = above @ self.sides[:, 1] - below @ self.sides[:, 0]
        return total

    def at(self, axes: Array) -> Robot | None:
        """The robot with its parameters at axes (A,); None where there is no such robot."""
        offset = self.offset(axes)
        if not np.any(offset):
            return self.robot
        key = offset.tobytes()
        if key not in self.known:
            while len(self.known) >= MOST_ROBOTS:
                del self.known[next(iter(self.known))]
            try:
                self.known[key] = self.parameters.robot_at(offset)
            except CtrplanError:
                self.known[key] = None
        return self.known[key]

    def chain(self, axes: Array) -> Chain:
        """The effects on axes (A,), those of the file's values among them."""
        key = self.offset(axes).tobytes()
        if key not in self.chains:
            while len(self.chains) >= MOST_ROBOTS:
                del self.chains[next(iter(self.chains))]
            chain = Chain.of(self.robot).on(None, {})
            changed: dict[str, dict[str, float]] = {}
            for name, value in self.values(axes).items():
                kind, effect, *of_effect = name.split(".")
                if kind == "effects":
                    changed.setdefault(effect, {})[of_effect[0]] = value
            acting = (replace(g, values={**g.values, **changed.get(g.effect.name, {})}) for g in chain.acting)
            self.chains[key] = replace(chain, acting=tuple(acting))
        return self.chains[key]

    def driven(self, axes: Array, commanded: Collars) -> Collars:
        """Where the drive on axes (A,) goes that is commanded to collars (K, n): effect after effect, the last motion
        of each actuator against the side of the play that it is on. Tubes that would not nest stop one another.
        """
        robot, went = self.at(axes) or self.robot, np.tile(-self.play(axes), (len(commanded.l), 1))
        stands = self.chain(axes).drive(commanded, went)
        return Collars(stands.theta, moved_to_nest(robot.tubes, stands.l))

    def turned(self, axes: Array, collars: Collars, points_m: Array) -> Array:
        """Points (..., 3) of the robot's frame, turned with the front plate at one row of collars."""
        robot, acting = self.at(axes) or self.robot, self.chain(axes).of_stage("mechanics")
        turns = [given.effect.plate_turn(given.values, robot, collars) for given in acting]
        turn = np.sum([rows[0] for rows in turns if rows is not None], axis=0)
        if not np.any(turn):
            return points_m
        return BaseMove(tuple(turn.tolist())).of(points_m.reshape(-1, 3), np.zeros(3)).reshape(points_m.shape)

    def _feels_direction(self, axes: Array) -> Array:
        """(2 n,) whether what the drive does anywhere depends on the last direction of each actuator."""
        n, drive, rng = self.robot.n, self.robot.drive, np.random.default_rng(0)
        low, high = drive.travel_m
        at = Collars(rng.uniform(-np.pi, np.pi, (PROBED, n)), rng.uniform(low, high, (PROBED, n)))
        stands = [self.chain(axes).drive(at, np.tile(went, (PROBED, 1))) for went in (np.zeros(2 * n), *np.eye(2 * n))]
        return np.array([np.any(s.theta != stands[0].theta) or np.any(s.l != stands[0].l) for s in stands[1:]])

    def delays_s(self, axes: Array) -> Array:
        """(2 n,) how late collars follow, rotations, then translations."""
        delays: Array = (
            Chain.of(self.robot).drive_delays_s(self.robot.n) if self.is_late else np.zeros(2 * self.robot.n)
        )
        begin = len(self.played) + len(self.sides)
        for (name, key, value, low, high), share in zip(self.clock, axes[begin:], strict=True):
            more = share * (high - value if share > 0 else value - low)
            effect = effect_of(name, self.robot.effects[name], self.robot.n)
            delays = delays + effect.drive_delays_s({key: more}, self.robot.n)
        return delays

    @cached_property
    def has_plate(self) -> bool:
        """Whether an effect turns all that is in front of the plate."""
        return any(given.effect.overrides("plate_turn") for given in Chain.of(self.robot).acting)

    @property
    def plate_margin_m(self) -> float:
        """How much claims allow for effects that shapes do not have: what the robot has of it beyond its file's own."""
        return max(0.0, self.robot.model_error_m - (self.robot.ideal or self.robot).model_error_m)

    @cached_property
    def is_late(self) -> bool:
        """Whether the drive of the file follows late."""
        return bool(np.any(Chain.of(self.robot).drive_delays_s(self.robot.n)))

    @cached_property
    def latest_s(self) -> float:
        """How late any collar may be."""
        ends = [self.delays_s(np.zeros(self.count))]
        for axis, side in self.ends:
            ends.append(self.delays_s(side * np.eye(self.count)[axis]))
        return float(np.max(ends, initial=0.0))

    def in_words(self, axes: Array) -> str:
        """Parameters that differ from the file's, with their values in the file's units; empty where none does."""
        offset = self.offset(axes)
        values = np.clip(self.parameters.value + offset, self.parameters.least, self.parameters.most)
        words = [
            f"{name} = {value / si:.5g} {unit}".rstrip()
            for name, value, si, unit, moved in zip(
                self.parameters.names, values, self.parameters.si, self.parameters.unit, offset, strict=True
            )
            if moved
        ]
        begin = len(self.played) + len(self.sides)
        for (name, key, value, low, high), share in zip(self.clock, axes[begin:], strict=True):
            if share:
                words.append(
                    f"effects.{name}.{key} = {value + share * (high - value if share > 0 else value - low):.4g} s"
                )
        return ", ".join(words)

    def values(self, axes: Array) -> dict[str, float]:
        """Values [SI] of the parameters that differ from the file's, by their names."""
        offset = self.offset(axes)
        moved = np.clip(self.parameters.value + offset, self.parameters.least, self.parameters.most)
        return {n: float(v) for n, v, o in zip(self.parameters.names, moved, offset, strict=True) if o}


def _with_contacts(parameters: UncertainParameters) -> UncertainParameters:
    """Besides, the friction of contacts that is given as an interval; its value is the upper end."""
    rows = [(k, low, high) for k, (low, high) in enumerate(parameters.robot.friction.tolist(), start=1) if low < high]
    known = [
        name for name in parameters.names if "friction_coefficient" in name or name.startswith("effects.friction.")
    ]
    if not rows or known:
        return parameters
    low, high = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
    count, more = parameters.count, len(rows)
    correlation = np.eye(count + more)
    correlation[:count, :count] = parameters.correlation
    columns = {"value": high, "low": low, "high": high, "least": low, "most": high, "si": np.ones(more)}
    joined = {name: np.concatenate([getattr(parameters, name), column]) for name, column in columns.items()}
    names = (*parameters.names, *(f"contact.{k}.friction_coefficient" for k, _, _ in rows))
    return replace(parameters, names=names, correlation=correlation, **joined)  # type: ignore[arg-type]


def _sides(parameters: UncertainParameters) -> Array:
    """(A, 2, Q) offsets at the lower and the upper end of each axis."""
    below, above = parameters.low - parameters.value, parameters.high - parameters.value
    alone = ~parameters.is_correlated
    axes = [np.stack([below, above]) * row for row in np.eye(parameters.count)[alone]]
    rows = np.flatnonzero(~alone)
    if len(rows):
        values, vectors = np.linalg.eigh(parameters.correlation[np.ix_(rows, rows)])
        for value, vector in zip(values, vectors.T, strict=True):
            offset = np.zeros(parameters.count)
            offset[rows] = np.sqrt(max(value, 0.0)) * vector * np.minimum(above, -below)[rows]  # never beyond an end
            axes.append(np.stack([-offset, offset]))
    return np.array(axes).reshape(len(axes), 2, parameters.count)


def _clock(robot: Robot) -> Iterator[tuple[str, str, float, float, float]]:
    for name, table in robot.effects.items():
        if effect_of(name, table, robot.n).overrides("drive_delays_s"):
            for key, (low, high) in table.get("ci95", {}).items():
                value = float(table.get(key, 0.0))
                yield name, key, value, min(low, value), max(high, value)


STEP_M = 1e-5  # of differences of a distance


def nearest_base(
    registration: Registration, anatomy: RawAnatomy, points_m: Array, rooms_m: Array, base_m: Array
) -> BaseMove:
    """The move within the balls that brings a body nearest: points (K, 3) with rooms (K,) where the base stands.

    For some of the points that the base can bring nearest, the shift against their distance and the turn about the
    axis across their lever and it.
    """
    shift, turn = CHI95 * registration.position_sigma_m, CHI95 * registration.rotation_sigma_rad
    reach = shift + turn * np.linalg.norm(points_m - base_m, axis=1)
    order = np.argsort(rooms_m - reach)
    best, least = STANDING, np.inf
    for k in order[:: max(1, min(len(order), 4 * PROBED) // PROBED)][:PROBED].tolist():
        probes = points_m[k] + STEP_M * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
        ends = anatomy.room(probes)
        slope = ends[0::2] - ends[1::2]
        if not np.all(np.isfinite(slope)) or not np.linalg.norm(slope):
            continue
        nearer = -slope / np.linalg.norm(slope)
        about = np.cross(points_m[k] - base_m, nearer)
        size = float(np.linalg.norm(about))
        axis = about / size if size > 0 else np.zeros(3)
        move = BaseMove(tuple((turn * axis).tolist()), tuple((shift * nearer).tolist()))
        room = float(anatomy.room(move.of(points_m, base_m)).min())
        if room < least:
            best, least = move, room
    return best
