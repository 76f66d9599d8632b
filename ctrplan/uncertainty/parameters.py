"""The uncertain parameters of a robot: what its file gives a 95 % interval for.

Each is normal around its value, with the stated interval as its 95 % one, and truncated where physics or the effect
ends it: no friction below zero, no Poisson's ratio above 0.5. Where an interval is not symmetric because it ends there,
the other side says how wide the normal is. Errors are independent unless the file states a correlation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import CI95, Array
from ctrplan.effects.learned.learned import effect_of, is_learned
from ctrplan.mechanics.tube import SOFTEST_NM2
from ctrplan.pipeline.chain import Acting, Chain, anywhere, with_chain
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import KEYS, Robot, file_key

SMALLEST_M = 1e-6  # of a clearance or length that is drawn
PHYSICAL = {  # what a number of the file can be, SI
    "bending_stiffness_Nm2": (SOFTEST_NM2, np.inf),
    "poisson_ratio": (-0.95, 0.5),
    "curvature_per_m": (0.0, np.inf),
    "length_m": (SMALLEST_M, np.inf),
    "clearance_m": (SMALLEST_M, np.inf),
    "friction_coefficient": (0.0, 2.0),
}
TITLES = {
    "bending_stiffness_Nm2": "stiffness",
    "poisson_ratio": "Poisson's ratio",
    "curvature_per_m": "precurvature",
    "curvature_x_per_m": "precurvature",
    "curvature_y_per_m": "precurvature",
    "length_m": "length",
    "clearance_m": "clearance",
    "friction_coefficient": "friction",
}
UNITS = {"mm": "mm", "deg": "deg", "Nm2": "N m^2", "m": "1/m", "N": "N", "s2": "m/s^2", "percent": "%"}


@dataclass(frozen=True, eq=False)
class UncertainParameters:
    """P numbers of a robot with 95 % intervals; arrays (P,) are SI. Those of no width are left out."""

    robot: Robot
    names: tuple[str, ...]  # as tube.2.poisson_ratio or effects.friction.mu_1
    value: Array
    low: Array  # of the 95 % interval
    high: Array
    least: Array  # that physics or the effect allows
    most: Array
    correlation: Array  # (P, P)
    si: Array  # SI value of the unit that files and screens use

    @property
    def count(self) -> int:
        """P."""
        return len(self.names)

    @property
    def half_width(self) -> Array:
        """(P,) half the widths of the 95 % intervals."""
        return (self.high - self.low) / 2

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations of the normals, before they are truncated."""
        sigma: Array = np.maximum(self.high - self.value, self.value - self.low) / CI95
        return sigma

    @cached_property
    def is_correlated(self) -> NDArray[np.bool_]:
        """(P,) whether errors go with those of others."""
        beside: NDArray[np.bool_] = np.any(np.abs(self.correlation - np.eye(self.count)) > 1e-9, axis=1)
        return beside

    @property
    def unit(self) -> tuple[str, ...]:
        """The unit of a parameter in files and on screens; empty for pure numbers."""
        return tuple(UNITS.get(self._file_name(name).rsplit("_", 1)[-1], "") for name in self.names)

    @property
    def title(self) -> tuple[str, ...]:
        """What people call each: "precurvature of tube 3"; several may have the same one."""
        return tuple(_title(name, self.robot) for name in self.names)

    def robot_at(self, offset: Array) -> Robot:
        """The robot with its parameters `offset` (P,) away from their values, kept within what physics allows."""
        if not self.count:
            return self.robot
        values = np.clip(self.value + offset, self.least, self.most).tolist()
        return _changed(self.robot, dict(zip(self.names, values, strict=True)))

    def widened(self, factor: Array | float) -> UncertainParameters:
        """The parameters with intervals `factor` times as wide."""
        low, high = (self.value + factor * (end - self.value) for end in (self.low, self.high))
        return replace(self, low=low, high=high)

    def measured(self, known: NDArray[np.bool_]) -> UncertainParameters:
        """What is left to know once those of a mask (P,) are measured: errors that go with theirs shrink."""
        rest, C = ~known, self.correlation
        shared = C[np.ix_(rest, known)] @ np.linalg.pinv(C[np.ix_(known, known)])
        left = C[np.ix_(rest, rest)] - shared @ C[np.ix_(known, rest)]
        scale = np.sqrt(np.maximum(np.diag(left), 0.0))
        safe = np.where(scale > 0, scale, 1.0)
        correlation = left / np.outer(safe, safe)
        np.fill_diagonal(correlation, 1.0)
        kept = np.flatnonzero(rest).tolist()
        columns = {name: getattr(self, name)[rest] for name in ("value", "low", "high", "least", "most", "si")}
        result = replace(self, names=tuple(self.names[k] for k in kept), correlation=correlation, **columns)
        return result.widened(scale)

    def drawn(self, rng: np.random.Generator, count: int) -> Array:
        """(count, P) offsets from the values; draws that physics does not allow are drawn anew."""
        if not self.count:
            return np.zeros((count, 0))
        values, vectors = np.linalg.eigh(self.correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        result = np.empty((0, self.count))
        while len(result) < count:
            offset = rng.standard_normal((count, self.count)) @ root.T * self.sigma
            moved = self.value + offset
            result = np.concatenate([result, offset[np.all((moved >= self.least) & (moved <= self.most), axis=1)]])
        return result[:count]

    def _file_name(self, name: str) -> str:
        return name if name.startswith("effects.") else file_key(name, 0.0)[0]


def uncertain_parameters(robot: Robot) -> UncertainParameters:
    """What the robot's file gives 95 % intervals for and its body depends on.

    Effects of clock and sensor change what is measured, not where the robot is. A contact whose friction is an interval
    is not among them: bounds and certificates take its upper end already.
    """
    results = {**_of_file(robot), **_of_effects(robot)}
    moving = {name: row for name, row in results.items() if row[2] > row[1]}
    rows = np.array(list(moving.values())).reshape(-1, 6)
    names = tuple(moving)
    value, low, high, least, most, si = rows.T
    return UncertainParameters(robot, names, value, low, high, least, most, _correlation(robot, names), si)


Row = tuple[float, float, float, float, float, float]  # value, low, high, least, most, si


def _of_file(robot: Robot) -> dict[str, Row]:
    ideal, result = Chain.of(robot).ideal, dict[str, Row]()
    for name, (low, high) in robot.intervals.ci95.items():
        key = name.rsplit(".", 1)[-1]
        least, most = PHYSICAL.get(key, (-np.inf, np.inf))
        value = value_of(ideal, name)
        si = next(si for known, si in KEYS.values() if known == key)
        result[name] = value, min(low, value), max(high, value), min(least, value), max(most, value), si
    return result


def _of_effects(robot: Robot) -> dict[str, Row]:
    results = dict[str, Row]()
    for name, table in robot.effects.items():
        effect = effect_of(name, table, robot.n)
        known = {parameter.name: parameter for parameter in effect.parameters(robot.ideal or robot)}
        for key, (low, high) in table.get("ci95", {}).items() if effect.stage in ("drive", "mechanics") else ():
            parameter = known[key]
            value = float(table.get(key, parameter.neutral))
            ends = min(low, value), max(high, value), parameter.lower, parameter.upper
            si = parameter.si
            results[f"effects.{name}.{key}"] = (value * si, *(end * si for end in ends), si)  # type: ignore[assignment]
        for key, most in anywhere(robot, name).items():
            results[f"effects.{name}.{key}"] = 0.0, -most, most, -most, most, 1.0
    return results


def _correlation(robot: Robot, names: tuple[str, ...]) -> Array:
    stated, result = robot.intervals, np.eye(len(names))
    if stated.correlation is None:
        return result
    place = {name: k for k, name in enumerate(stated.correlated)}
    known = [k for k, name in enumerate(names) if name in place]
    rows = [place[names[k]] for k in known]
    result[np.ix_(known, known)] = stated.correlation[np.ix_(rows, rows)]
    return result


def _changed(robot: Robot, values: Mapping[str, float]) -> Robot:
    """The robot with parameters at `values` [SI], as if its file said so."""
    chain = Chain.of(robot)
    ideal, effects = chain.ideal, {given.effect.name: given for given in chain.acting}
    for name, value in values.items():
        kind, *rest = name.split(".")
        if kind != "effects":
            ideal = with_values(ideal, {name: value})
            continue
        effect = effect_of(rest[0], robot.effects[rest[0]], robot.n)
        if effect.sets_outright:
            ideal = with_values(ideal, effect.mechanics({rest[1]: value}, ideal))
        else:
            present = effects[rest[0]].values if rest[0] in effects else {}
            effects[rest[0]] = Acting(effect, {**present, rest[1]: value})
    return with_chain(robot, Chain(ideal, tuple(effects.values())))


def _title(name: str, robot: Robot) -> str:
    kind, *rest = name.split(".")
    if kind == "effects":
        number = next((part for part in rest[1].split("_") if part.isdecimal()), "")
        title = effect_of(rest[0], robot.effects[rest[0]], robot.n).title
        if is_learned(rest[0]):
            return title
        return "friction" if rest[0] == "friction" else f"{title}, number {number}" if number else title
    what = TITLES[name.rsplit(".", 1)[-1]]
    if what == "friction":
        return what
    return f"{what} of {'tube' if kind == 'tube' else 'pair'} {rest[0]}"
