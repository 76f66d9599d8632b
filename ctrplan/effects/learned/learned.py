"""Terms that were built from measurements, as effects: what they act on, their parts, and the ranges they hold in."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import ANYWHERE, CATALOGUE, Effect, Parameter, Values, with_column
from ctrplan.effects.learned import learned as learned_table
from ctrplan.effects.learned import parts
from ctrplan.effects.learned.inputs import (
    AXES,
    PREFIX,
    InputRange,
    Ranges,
    Situation,
    Target,
    is_of_collars,
    is_rotation,
    outside,
    target,
)
from ctrplan.effects.learned.inputs import values as input_values
from ctrplan.effects.learned.parts import Part, formula, likeness
from ctrplan.measurement.measurements import Measurements, Poses
from ctrplan.robot.named_numbers import value_of
from ctrplan.robot.robot import Robot

DIGITS = 6  # of numbers that a fit writes


class Learned(Effect):
    """A sum of few parts, each a coefficient in the unit of what the term acts on times a shape of its inputs.

    Parameters are named AXIS_PART_UNIT, `x_slope_l_3_deg`; without an axis where there is only one amount. Inputs are
    held at the edge of their ranges. Nothing is said about a cause.
    """

    equation = "amount = sum of coefficients times shapes of the inputs, each held inside its range"
    signature = "what remained beside the effects that are named"
    experiment = "measure again along its inputs, and look at the part that it acts on"

    def __init__(self, on: Target, names: Sequence[str], ranges: Ranges, n: int, largest_mm: float = 0.0) -> None:
        """names: of the parameters; n: number of tubes; largest_mm: how far it moved a tip in its data."""
        self.target, self.ranges, self.largest_mm = on, dict(ranges), largest_mm
        self.name, self.stage, self.in_words = on.effect_name, on.kind.stage, f"a built term of {on.words}"
        self.acts_at_rest = not on.of_way and on.kind.stage != "mechanics"
        self.parts: dict[str, tuple[int, Part]] = {}
        for name in names:
            result = split_name(name, on, n)
            if result is None:
                raise ValueError(name)
            self.parts[name] = result
        self._shapes = {part: k for k, part in enumerate(dict.fromkeys(part for _, part in self.parts.values()))}

    def with_largest(self, largest_mm: float, n: int) -> Learned:
        """The term with another size that it moved a tip by in its data; n: number of tubes."""
        return type(self)(self.target, list(self.parts), self.ranges, n, largest_mm)

    @property
    def inputs(self) -> dict[str, bool]:
        """Inputs of the term, and whether each counts modulo whole turns."""
        results: dict[str, bool] = {}
        for _, part in self.parts.values():
            for name, periodic in parts.inputs(part).items():
                results[name] = results.get(name, True) and periodic
        return results

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return self.parameters_of()

    def parameters_of(self) -> tuple[Parameter, ...]:
        """Parameters of the term, whatever the robot."""
        kind = self.target.kind
        return tuple(Parameter(n, kind.prior, lower=-kind.most, upper=kind.most, si=kind.si) for n in self.parts)

    def amount(self, values: Values, at: Situation) -> Array:
        """(K, 3) by axis, in the target's SI unit; the first of them where it has no axes."""
        if self not in at.shapes:
            at.shapes[self] = np.column_stack([parts.amounts(part, at, self.ranges) for part in self._shapes])
        coefficients = np.zeros((len(self._shapes), 3))
        for name, value in values.items():
            axis, part = self.parts[name]
            coefficients[self._shapes[part], axis] += value
        total: Array = at.shapes[self] @ coefficients
        return total

    def most(self, values: Values) -> float:
        """What no amount exceeds, in the target's SI unit."""
        by_axis = np.zeros(3)
        for name, value in values.items():
            by_axis[self.parts[name][0]] += abs(value) * parts.LARGEST
        return float(np.linalg.norm(by_axis))

    def leaves(self, at: Situation) -> dict[str, float]:
        """Inputs that leave their ranges, with the value that is farthest out, in the unit of the range."""
        results = {}
        for name, periodic in self.inputs.items():
            if (far := outside(name, self.ranges[name], at, periodic=periodic)).any():
                results[name] = parts.farthest(name, self.ranges[name], at, far, periodic=periodic)
        return results

    def stated(self, values: Values) -> Mapping[str, Any]:
        largest = {"largest_mm": self.largest_mm} if self.stage == "mechanics" else {}
        return {
            "stage": self.stage,
            "acts_on": self.target.words,
            "formula": formula(self.parts, self.target, self.ranges, values),
            "may_be": likeness(self.parts, self.target),
            **largest,
            "range": {
                name: [_rounded(r.low), _rounded(r.high)] for name, r in self.ranges.items() if name in self.inputs
            },
        }


class LearnedDrive(Learned):
    """A built term that acts on a collar."""

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        amount = self.amount(values, Situation(collars.theta, collars.l, directions))[:, 0]
        if self.target.kind_name == "theta":
            return Collars(with_column(collars.theta, self.target.tube, amount), collars.l)
        return Collars(collars.theta, with_column(collars.l, self.target.tube, amount))

    def bends(self, values: Values, collars: Collars) -> Iterator[tuple[Array, Array]]:
        at = Situation(collars.theta, collars.l)
        for factor in (factor for part in self._shapes for factor in part if factor.input):
            given, where = input_values(factor.input, at), parts.bends(factor, self.ranges[factor.input])
            assert given is not None  # collars alone say it
            if factor.periodic:
                turns = np.arange(np.floor(given.min() / 360) - 1, np.floor(given.max() / 360) + 1)
                where = np.add.outer(360 * turns, where % 360).ravel()
            yield given, where

    @property
    def counts_turns_of(self) -> frozenset[int]:
        counted = (name.split("_") for name, periodic in self.inputs.items() if is_rotation(name) and not periodic)
        pairs = ((int(tube), int(tube) - (kind == "turn")) for kind, tube in counted)
        return frozenset(itertools.chain.from_iterable(pairs))

    def play(self, values: Values, n: int) -> Collars:
        results = {kind: np.zeros((1, n)) for kind in ("theta", "l")}
        results[self.target.kind_name][0, self.target.tube - 1] = self.most(values)
        return Collars(results["theta"], results["l"])


class LearnedMechanics(Learned):
    """A built term of a tube's property, as small changes: of a pose they are known, elsewhere by an interval."""

    def changing(self, values: Values, robot: Robot, data: Measurements) -> Mapping[str, Array]:
        rows = data.rows
        joints = data.theta_commanded[rows], data.l_commanded[rows]
        at = Situation(*joints, data=data, tubes=robot.tubes)
        return {name: rate * self.amount(values, at)[:, 0] for name, rate in self._rates(robot).items()}

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        if ANYWHERE not in values:
            return {}
        return {name: value_of(robot, name) + rate * values[ANYWHERE] for name, rate in self._rates(robot).items()}

    def anywhere(self, values: Values) -> Mapping[str, float]:
        return {ANYWHERE: self.most(values)}

    def _rates(self, robot: Robot) -> dict[str, float]:
        """By how much numbers of the robot change for an amount of one."""
        i = self.target.tube
        if self.target.kind_name == "stiffness":
            return {f"tube.{i}.bending_stiffness_Nm2": robot.tubes[i - 1].bending_stiffness_Nm2}
        rates = {}
        for k, section in enumerate(robot.tubes[i - 1].sections, start=1):
            x, y = section.curvature_x_per_m, section.curvature_y_per_m
            across = (-y, x) if self.target.kind_name == "bend" else (x, y)
            for axis, curvature in zip("xy", across, strict=True):
                if curvature:
                    rates[f"tube.{i}.section.{k}.curvature_{axis}_per_m"] = curvature
        return rates


class LearnedPlate(Learned):
    """A built term that turns all in front of the plate."""

    def plate_turn(self, values: Values, robot: Robot, collars: Collars) -> Array | None:
        return self.amount(values, Situation(collars.theta, collars.l, tubes=robot.tubes))

    def largest_turn_rad(self, values: Values, robot: Robot) -> float:
        return self.most(values)


class LearnedSensor(Learned):
    """A built term of what the sensor reads."""

    _situation: Situation | None = None  # of the last poses: a fit asks for many values at the same ones

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        at = self._situation
        if at is None or at.poses is not poses or at.data is not data:
            joints = data.theta_commanded[data.rows], data.l_commanded[data.rows]
            at = self._situation = Situation(*joints, poses=poses, data=data)
        return Poses(poses.position + self.amount(values, at), poses.frame)

    def __getstate__(self) -> dict[str, Any]:
        """All but the last poses, which no other process asks about."""
        return {name: value for name, value in vars(self).items() if name != "_situation"}


def learned(on: Target, names: Sequence[str], ranges: Ranges, n: int, largest_mm: float = 0.0) -> Learned:
    """A term of the class that its target asks for. Raises ValueError for a name that is no parameter's."""
    classes = {"drive": LearnedDrive, "mechanics": LearnedMechanics, "sensor": LearnedSensor}
    made = LearnedPlate if on.kind_name == "plate" else classes[on.kind.stage]
    return made(on, names, ranges, n, largest_mm)


def split_name(name: str, on: Target, n: int) -> tuple[int, Part] | None:
    """Axis and part of a parameter's name; None where the target has none of that name."""
    suffix, axis = f"_{on.kind.unit}", 0
    if not name.endswith(suffix):
        return None
    text = name[: -len(suffix)]
    if on.kind.has_axes:
        if len(text) < 3 or text[0] not in AXES or text[1] != "_":
            return None
        axis, text = AXES.index(text[0]), text[2:]
    result = parts.part(text, n)
    if result is None or on.of_way != any(factor.form == "sign" for factor in result):
        return None
    return axis, result


def named(on: Target, part_name: str) -> list[str]:
    """The parameters of a part, one for each axis."""
    axes = [f"{axis}_" for axis in AXES] if on.kind.has_axes else [""]
    return [f"{axis}{part_name}_{on.kind.unit}" for axis in axes]


def ranges_of(table: Mapping[str, Any]) -> dict[str, InputRange]:
    """The ranges of a robot file's table."""
    return {name: InputRange(float(low), float(high)) for name, (low, high) in table.get("range", {}).items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


TEXTS = ("stage", "acts_on", "formula", "may_be")  # for people; nothing reads them
NOTES = (*TEXTS, "largest_mm", "range")  # keys that are no coefficients
MOST_PARTS = 48  # coefficients of one term


def is_learned(name: str) -> bool:
    """Whether an effect of that name was built."""
    return name.startswith(PREFIX)


def learned_in(name: str, table: Mapping[str, Any], notes: tuple[str, ...], n: int) -> Learned:
    """The effect of a table that `faults` finds nothing in, of a robot of n tubes; `notes` are keys of any effect."""
    on = target(name, n)
    assert on is not None
    names = [key for key in table if key not in (*notes, *NOTES)]
    return learned(on, names, ranges_of(table), n, float(table.get("largest_mm", 0.0)))


def faults(name: str, table: Mapping[str, Any], notes: tuple[str, ...], n: int) -> Iterator[tuple[str, str]]:
    """Keys, empty for the whole table, with what is wrong with each."""
    on = target(name, n)
    if on is None:
        rule = "is no term of this robot: learned_theta_I, l_I, curvature_I, bend_I, stiffness_I, plate or sensor"
        yield "", rule
        return
    needed: set[str] = set()
    coefficients = [key for key in table if key not in (*notes, *NOTES)]
    for key in coefficients:
        result = split_name(key, on, n)
        if result is None:
            axis = "AXIS_" if on.kind.has_axes else ""
            yield key, f"is no part of a built term, which are named {axis}PART_{on.kind.unit}: docs/effects.md"
        else:
            needed |= (inputs := set(parts.inputs(result[1])))
            if on.kind.stage == "drive" and (unknown := [name for name in inputs if not is_of_collars(name)]):
                yield key, f"depends on {', '.join(sorted(unknown))}, which a drive does not know"
    if len(coefficients) > MOST_PARTS:
        yield "", f"has {len(coefficients)} coefficients, more than {MOST_PARTS}"
    for key in TEXTS:
        if not isinstance(table.get(key, ""), str):
            yield key, "must be a text"
    if on.kind.stage == "mechanics" and not (
        _is_number(table.get("largest_mm", 0.0)) and table.get("largest_mm", 0) >= 0
    ):
        yield "largest_mm", "must be a number of at least 0"
    yield from _range_faults(table.get("range", {}), needed)


def _range_faults(ranges: Any, needed: set[str]) -> Iterator[tuple[str, str]]:
    if not isinstance(ranges, dict):
        yield "range", "must be a table of ranges, input = [lowest, highest]"
        return
    for name in sorted(needed):
        ends = ranges.get(name)
        if not (isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends)) and ends[0] <= ends[1]):
            yield "range", f"must have {name} = [lowest, highest], which a part depends on"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


COMMON_NOTES = ("ci95", "provenance")  # keys of any effect's table that say where its values come from
FILE_NOTES = (*COMMON_NOTES, *learned_table.NOTES)  # keys that are no parameters


def effect_of(name: str, table: Mapping[str, Any], n: int) -> Effect:
    """The effect of a table that was checked, in the file of a robot with n tubes."""
    return learned_table.learned_in(name, table, COMMON_NOTES, n) if learned_table.is_learned(name) else CATALOGUE[name]
