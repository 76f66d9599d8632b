"""The chain, from what is commanded to what is measured:

    commanded joints -> clock -> drive -> mechanics -> sensor -> measured poses

Every effect is a term of one stage, and effects of one stage act one after the other, in the order of the robot file.
Whoever asks what a robot does asks this chain: fits and diagnosis (`parametric_chain.py`), simulations along a path
(`studies/simulate.py`), and, through a robot with its effects at work in it, bounds, plans, goals and the live view.
Effects of the mechanics are in that robot's tubes, contacts and loads, those of the drive in `drive.collars`, and how
late it follows in `drive.late_s`. The tracker's own delay and effects of the sensor change what is measured, not where
the robot is: the chain has them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import or_meant
from ctrplan.base.arrays import Array, to_be_read
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import CATALOGUE, Effect, Parameter, Stage, Values
from ctrplan.effects.learned import learned as learned_table
from ctrplan.effects.learned.inputs import Situation, unit
from ctrplan.effects.learned.learned import COMMON_NOTES, FILE_NOTES, Learned, effect_of
from ctrplan.errors import FEW, InputError
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import Measurements, Poses, moved_rigidly
from ctrplan.robot.named_numbers import with_values
from ctrplan.robot.robot import Robot
from ctrplan.storage.toml_document import Document, interval_fault


@dataclass(frozen=True)
class Acting:
    """An effect at work, with the values [SI] of its parameters; those that are not named stay neutral."""

    effect: Effect
    values: Values

    def driven(self, collars: Collars, directions: Array) -> Collars:
        """Collars (K, n) where an effect of the drive puts them. Raises InputError for what is none."""
        given = Collars(to_be_read(collars.theta), to_be_read(collars.l))
        return self.effect.alike(self.effect.drive(self.values, given, to_be_read(directions)), given)

    def seen(self, poses: Poses, data: Measurements) -> Poses:
        """What an effect of the sensor makes of K poses. Raises InputError for what is none."""
        given = Poses(to_be_read(poses.position), to_be_read(poses.frame))
        return self.effect.alike(self.effect.sensor(self.values, given, data), given)


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
            collars = given.driven(collars, directions)
        return collars

    @cached_property
    def mechanics(self) -> Robot:
        """The tubes, contacts and loads with every effect of the mechanics in them; its drive is ideal."""
        robot = self.ideal
        for given in self.of_stage("mechanics"):
            named, key = given.effect.mechanics(given.values, robot), f"effects.{given.effect.name}"
            if not isinstance(named, Mapping):
                raise InputError(f"must return numbers by name, not {type(named).__name__}", key=key)
            try:
                robot = with_values(robot, named) if named else robot
            except InputError as error:
                raise InputError(f"makes another robot, of which {error}", key=key) from error
        return robot

    def sensor(self, poses: Poses, data: Measurements, first: int = 0) -> Poses:
        """What is measured of the K poses of the tip, as the sensor's effects before `first` have left them."""
        for given in self.of_stage("sensor")[first:]:
            poses = given.seen(poses, data)
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
    """Tables of [effects.*] that take the place of numbers which change to `named`, with the new values.

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


def check_effects(robot: Robot, document: Document) -> None:
    """Raises InputError for an effect that is not in the catalogue and for parameters it does not have."""
    for name, table in robot.effects.items():
        if learned_table.is_learned(name):
            for key, rule in learned_table.faults(name, table, COMMON_NOTES, robot.n):
                raise document.fault(rule, "effects", name, *([key] if key else []))
        elif name not in CATALOGUE:
            rule = f"unknown effect, known ones are {', '.join(CATALOGUE)}{or_meant(name, CATALOGUE)}"
            raise document.fault(rule, "effects", name)
        known = {parameter.name: parameter for parameter in effect_of(name, table, robot.n).parameters(robot)}
        for key, value in table.items():
            if key in (FILE_NOTES if learned_table.is_learned(name) else COMMON_NOTES):
                continue
            if key not in known:
                raise document.fault(_unknown(key, [*known]), "effects", name, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.fault("must be a number", "effects", name, key)
            low, high = known[key].lower, known[key].upper
            if not low <= value <= high:
                raise document.fault(f"must be from {low:g} to {high:g}", "effects", name, key)
        _check_intervals(name, table, known, document)


def _unknown(key: str, known: Sequence[str]) -> str:
    """The rule that a key which is no parameter breaks: of many parameters it names the likeliest, and examples."""
    if len(known) <= 2 * FEW:
        return f"unknown parameter, known ones are {', '.join(known)}{or_meant(key, known)}"
    meant = or_meant(key, known).replace(";", ",") or ","
    return f"unknown parameter{meant} {len(known)} are known: {known[0]}, {known[1]} to {known[-1]}"


def _check_intervals(name: str, table: Mapping[str, Any], known: Mapping[str, Parameter], document: Document) -> None:
    if not isinstance(intervals := table.get("ci95", {}), dict):
        raise document.fault("must be a table of intervals", "effects", name, "ci95")
    for key, ends in intervals.items():
        if key not in known:
            raise document.fault(_unknown(key, [*known]), "effects", name, "ci95", key)
        if fault := interval_fault(ends, float(table.get(key, known[key].neutral))):
            raise document.fault(fault, "effects", name, "ci95", key)
        if not (known[key].lower <= ends[0] and ends[1] <= known[key].upper):
            rule = f"must be from {known[key].lower:g} to {known[key].upper:g}"
            raise document.fault(rule, "effects", name, "ci95", key)


def range_notes(
    robot: Robot, theta_commanded: ArrayLike, l_commanded: ArrayLike, poses: Poses | None = None
) -> tuple[str, ...]:
    """One sentence for each input that leaves its range, at rotations (n,) or (K, n) [rad] and translations [m] alike.

    `poses` are the K tips, for terms of the sensor; without them nothing is said about tips.
    """
    built = [given.effect for given in Chain.of(robot).acting if isinstance(given.effect, Learned)]
    if not built:
        return ()
    theta, l = np.atleast_2d(np.asarray(theta_commanded, float)), np.atleast_2d(np.asarray(l_commanded, float))  # noqa: E741
    at = Situation(theta, l, poses=poses, tubes=robot.tubes)
    return tuple(_sentence(effect, name, worst) for effect in built for name, worst in effect.leaves(at).items())


def plan_range_notes(robot: Robot, joints: Array) -> tuple[str, ...]:
    """Where built terms leave their data, as `range_notes`, at joint values (K, m) in the order of the drive."""
    return range_notes(robot, *robot.drive.commanded(joints))


def _sentence(effect: Learned, name: str, worst: float) -> str:
    span, of = effect.ranges[name], unit(name)
    ends = f"{span.low:.4g} to {span.high:.4g} {of}".rstrip()
    where = f"{name} reaches {worst:.4g} {of}".rstrip()
    return f"{effect.name} was built from data with {name} from {ends}; here {where}, and it is held at the edge."


def installed(robot: Robot) -> Robot:
    """The robot of a file with the file's effects at work; itself if it has none."""
    return with_chain(robot, Chain.of(robot)) if robot.effects else robot


def with_chain(robot: Robot, chain: Chain) -> Robot:
    """`robot` with the mechanics and the drive of a chain."""
    built = chain.mechanics
    counted = frozenset[int]().union(*(given.effect.counts_turns_of for given in chain.of_stage("drive")))
    drive = replace(built.drive, terms=_at_rest(chain), counted=counted, play=_play(chain), late_s=_late_s(chain))
    given = replace(
        robot, tubes=built.tubes, contacts=built.contacts, loads=built.loads, drive=drive, ideal=chain.ideal
    )
    return replace(given, model_error_m=robot.model_error_m + _not_in_shapes_m(robot, chain))


def _not_in_shapes_m(robot: Robot, chain: Chain) -> float:
    """How far [m] effects may move any point of the robot that shapes do not have, wherever its file's intervals let
    its numbers be.

    A turn of the plate moves it by its length at the largest angle. That grows or shrinks with every number, so that of
    each the end is taken where it is larger, until no end makes it larger.
    """

    def reach_m(ideal: Robot, acting: Sequence[Acting]) -> float:
        built = Chain(ideal, tuple(acting)).mechanics
        of_mechanics = [given for given in acting if given.effect.stage == "mechanics"]
        turn_rad = sum(given.effect.largest_turn_rad(given.values, built) for given in of_mechanics)
        return turn_rad * max(tube.length_m for tube in built.tubes)

    ideal, acting, most_m, before_m = chain.ideal, list(chain.acting), 0.0, -np.inf
    if not any(given.effect.overrides("largest_turn_rad") for given in acting):
        return 0.0
    while most_m > before_m:
        before_m = most_m
        for name, ends in robot.intervals.ci95.items():
            tried = [ideal, *(with_values(ideal, {name: end}) for end in ends)]
            ideal = max(tried, key=lambda one: reach_m(one, acting))
        for k, given in enumerate(acting):
            ways = [acting[k], *(replace(given, values=values) for values in _at_ends(acting[k], robot))]
            acting[k] = max(ways, key=lambda one: reach_m(ideal, [*acting[:k], one, *acting[k + 1 :]]))
        most_m = reach_m(ideal, acting)
    return most_m


def _at_ends(given: Acting, robot: Robot) -> Iterator[Values]:
    """The values of an effect with one of them at an end of what the robot's file says of it."""
    name, si = given.effect.name, {parameter.name: parameter.si for parameter in given.effect.parameters(robot)}
    for key, ends in robot.effects.get(name, {}).get("ci95", {}).items():
        yield from ({**given.values, key: end * si[key]} for end in ends)
    for key, most in anywhere(robot, name).items():
        yield from ({**given.values, key: side * most} for side in (-1, 1))


def anywhere(robot: Robot, name: str) -> Mapping[str, float]:
    """What values of an effect of the robot's file that differ from pose to pose come to at most, either way [SI]."""
    table = robot.effects.get(name, {})
    effect = effect_of(name, table, robot.n)
    si = {parameter.name: parameter.si for parameter in effect.parameters(robot.ideal or robot)}
    widest = {key: float(value) for key, value in table.items() if key in si}
    widest |= {key: max([widest.get(key, 0.0), *ends], key=abs) for key, ends in table.get("ci95", {}).items()}
    return effect.anywhere({key: value * si[key] for key, value in widest.items()})


def _at_rest(chain: Chain) -> tuple[DriveAtRest, ...]:
    able = chain.on(None, {}).of_stage("drive")
    return (DriveAtRest(Chain(chain.ideal, able)),) if any(given.effect.acts_at_rest for given in able) else ()


def _play(chain: Chain) -> Array | None:
    """(G, 2 n) [rad], [m] how far effects that depend on directions move the collars, every way the same.

    Those of effects that follow one another add up; G are the places in the stage that other effects part.
    """
    n, places = chain.ideal.n, list[Array]()
    for plays, group in _grouped(chain.on(None, {}).of_stage("drive")):
        if plays:
            moved = [given.effect.play(given.values, n) for given in group]
            places.append(np.sum([np.hstack([own.theta[0], own.l[0]]) for own in moved], axis=0))
    return np.array(places) if places else None


def _grouped(acting: Sequence[Acting]) -> Iterator[tuple[bool, Iterator[Acting]]]:
    """Effects of the drive that follow one another and all have play, or all have none, and whether they have."""
    return itertools.groupby(acting, key=lambda given: not given.effect.acts_at_rest)


def _late_s(chain: Chain) -> tuple[Array, Array] | None:
    """(n,), (n,) how much later than commanded collars turn and slide; None of a drive that follows at once."""
    delays = chain.drive_delays_s(chain.ideal.n)
    return (delays[: chain.ideal.n], delays[chain.ideal.n :]) if delays.any() else None


@dataclass(frozen=True)
class DriveAtRest:
    """The drive's stage at collars (K, n), (K, n) whose last directions nobody knows.

    Play comes where it has its turn in the stage, so that what acts after it acts on the played collars.
    """

    chain: Chain

    def __call__(self, theta: Array, l: Array, off: Array | None) -> tuple[Array, Array]:  # noqa: E741 (as in the equations)
        """Where collars stand that are commanded to theta [rad], l [m], `off` (2 G n,) [rad], [m] by play.

        None: in the middle of all play. An effect between two places of play acts on what the first of them leaves: a
        collar may stand on another side in each.
        """
        *_, (_, moved) = self._passed(Collars(theta, l), off)
        return moved.theta, moved.l

    def bends(self, theta: Array, l: Array, off: Array | None) -> Iterator[tuple[Array, Array]]:  # noqa: E741
        """Inputs (K,) of effects, each at the collars that reach it, and values (B,) between which these are smooth."""
        for given, reaching in self._passed(Collars(theta, l), off):
            if given:
                yield from given.effect.bends(given.values, reaching)

    def _passed(self, moved: Collars, off: Array | None) -> Iterator[tuple[Acting | None, Collars]]:
        """Each effect with the collars that reach it; None with those that come out."""
        n, nowhere = moved.theta.shape[1], np.zeros((len(moved.theta), 2 * moved.theta.shape[1]))
        in_middle = np.zeros(2 * n)
        places = iter(() if off is None else off.reshape(-1, 2 * n))
        for plays, group in _grouped(self.chain.acting):
            if plays:
                own = next(places, in_middle)
                moved = Collars(moved.theta + own[:n], moved.l + own[n:])
                continue
            for given in group:
                yield given, moved
                moved = given.driven(moved, nowhere)
        yield None, moved
