"""What a built term depends on and acts on: inputs with the ranges of the data, targets by stage."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import DEGREE, MILLIMETRE, Stage
from ctrplan.measurement.approach import friction_state, time_at_rest_s, turning_speeds
from ctrplan.measurement.measurements import Measurements, Poses
from ctrplan.mechanics.tube import Tube

WHOLE_TURN_DEG = 300.0  # of a rotation, with which a periodic part has seen the whole turn
OF_TUBE = re.compile(r"(theta|turn|l|overlap|load|speed)_([1-9]\d*)")
TIP = ("x", "y", "z", "tx", "ty", "tz")
CLOCK = ("time", "rest")
UNITS = {
    "theta": "deg",
    "turn": "deg",
    "l": "mm",
    "overlap": "mm",
    "load": "",
    "speed": "deg/s",
    "time": "s",
    "rest": "s",
}
UNITS |= {"x": "mm", "y": "mm", "z": "mm", "tx": "", "ty": "", "tz": ""}


@dataclass(frozen=True, eq=False)
class Situation:
    """K poses that a term is asked about; a stage knows the joints, and of the rest what is not None."""

    theta: Array  # (K, n) rad
    l: Array  # noqa: E741 (as in the equations)  # (K, n) m
    directions: Array | None = None  # (K, 2 n) of the last motions
    poses: Poses | None = None
    data: Measurements | None = None
    tubes: Sequence[Tube] | None = None
    known: dict[str, Array | None] = field(default_factory=dict)  # inputs that were computed before
    shapes: dict[Hashable, Array] = field(default_factory=dict)  # shapes of inputs over their ranges, as well

    @property
    def count(self) -> int:
        """K."""
        return len(self.theta)


def is_rotation(name: str) -> bool:
    """Whether an input is an angle that comes round."""
    return name.startswith(("theta_", "turn_"))


def is_of_collars(name: str) -> bool:
    """Whether collars alone say an input."""
    return name.startswith(("theta_", "turn_", "l_")) and OF_TUBE.fullmatch(name) is not None


def unit(name: str) -> str:
    """The unit of an input; empty for columns of the data, whose names say it, and pure numbers."""
    return UNITS.get(name.rsplit("_", 1)[0] if OF_TUBE.fullmatch(name) else name, "")


def exists(name: str, n: int) -> bool:
    """Whether a robot of n tubes can have an input; a column of the data has any other name."""
    match = OF_TUBE.fullmatch(name)
    if not match:
        return bool(re.fullmatch(r"[A-Za-z]\w*", name))
    first = 2 if match[1] == "turn" else 1
    last = n - 1 if match[1] in ("overlap", "load", "speed") else n
    return first <= int(match[2]) <= last


def values(name: str, at: Situation) -> Array | None:
    """(K,) of an input, None where the situation does not know it."""
    if name not in at.known:
        at.known[name] = _values(name, at)
    return at.known[name]


def _values(name: str, at: Situation) -> Array | None:
    match = OF_TUBE.fullmatch(name)
    if match:
        return _OF_TUBE[match[1]](at, int(match[2]) - 1)
    if name in TIP:
        if at.poses is None:
            return None
        k = TIP.index(name)
        return at.poses.position[:, k] * 1e3 if k < 3 else at.poses.frame[:, k - 3, 2]
    if at.data is None:
        return None
    if name == "time":
        return None if at.data.time_s is None else at.data.time_s[at.data.rows]
    if name == "rest":
        return None if at.data.time_s is None else time_at_rest_s(at.data)
    if name not in at.data.more:
        return None
    column = at.data.more[name][at.data.rows]
    return np.where(np.isfinite(column), column, np.nan)


def _overlap_mm(at: Situation, i: int) -> Array | None:
    """Length over which the curved parts of a tube and of the next one lie in front of the plate and in each other."""
    if at.tubes is None:
        return None
    ends = []
    for k in (i, i + 1):
        tube = at.tubes[k]
        straight = tube.sections[0].length_m if not tube.sections[0].curvature_per_m and len(tube.sections) > 1 else 0.0
        ends.append((np.maximum(at.l[:, k] + straight, 0.0), at.l[:, k] + tube.length_m))
    both = np.minimum(ends[0][1], ends[1][1]) - np.maximum(ends[0][0], ends[1][0])
    shared: Array = np.maximum(both, 0.0) * 1e3
    return shared


_OF_TUBE: dict[str, Callable[[Situation, int], Array | None]] = {
    "theta": lambda at, i: np.degrees(at.theta[:, i]),
    "turn": lambda at, i: np.degrees(at.theta[:, i] - at.theta[:, i - 1]),
    "l": lambda at, i: at.l[:, i] * 1e3,
    "overlap": _overlap_mm,
    "load": lambda at, i: None if at.data is None else friction_state(at.data)[:, i],
    "speed": lambda at, i: None if at.data is None else np.degrees(turning_speeds(at.data)[:, i]),
}


@dataclass(frozen=True)
class InputRange:
    """The range of an input in the data, in its own unit."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """Between the ends."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> float:
        """Half the width."""
        return max((self.high - self.low) / 2, 1e-12)

    @property
    def is_whole_turn(self) -> bool:
        """Whether a rotation has seen nearly all angles."""
        return self.high - self.low >= WHOLE_TURN_DEG

    def nearest(self, angle_deg: Array) -> Array:
        """(K,) the same angles, by whole turns as near to the middle as they come."""
        near: Array = angle_deg - 360.0 * np.round((angle_deg - self.middle) / 360.0)
        return near


Ranges = Mapping[str, InputRange]


def clamped(name: str, ranges: Ranges, at: Situation, *, periodic: bool = False) -> Array:
    """(K,) values of an input inside its range; its middle where the situation does not know it."""
    span, result = ranges[name], values(name, at)
    if result is None:
        return np.full(at.count, span.middle)
    result = np.where(np.isfinite(result), result, span.middle)
    if periodic and span.is_whole_turn:
        return result
    inside: Array = np.clip(span.nearest(result) if periodic else result, span.low, span.high)
    return inside


def outside(name: str, span: InputRange, at: Situation, *, periodic: bool) -> NDArray[np.bool_]:
    """(K,) whether an input is out of its range by more than a thousandth of it; one that nobody knows is not."""
    result = values(name, at)
    if result is None or (periodic and is_rotation(name) and span.is_whole_turn):
        return np.zeros(at.count, bool)
    near = span.nearest(result) if periodic else result
    far: NDArray[np.bool_] = np.abs(near - span.middle) > span.half * 1.001 + 1e-9
    return far


PREFIX = "learned_"
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class TargetKind:
    """A kind of target: its stage, the unit of its coefficients, how large they may be, and what it is in words."""

    stage: Stage
    unit: str
    si: float
    prior: float
    words: str
    has_axes: bool = False

    @property
    def most(self) -> float:
        """The largest coefficient, either way."""
        return 12 * self.prior


KINDS = {
    "theta": TargetKind("drive", "deg", DEGREE, 5.0, "the rotation of tube {}"),
    "l": TargetKind("drive", "mm", MILLIMETRE, 2.0, "the translation of tube {}"),
    "curvature": TargetKind("mechanics", "percent", 0.01, 10.0, "the precurvature of tube {}"),
    "bend": TargetKind("mechanics", "percent", 0.01, 10.0, "the precurvature of tube {} across its plane"),
    "stiffness": TargetKind("mechanics", "percent", 0.01, 20.0, "the bending stiffness of tube {}"),
    "plate": TargetKind("mechanics", "deg", DEGREE, 2.0, "the tilt of all in front of the plate", has_axes=True),
    "sensor": TargetKind("sensor", "mm", MILLIMETRE, 3.0, "the position that is read", has_axes=True),
}
WAY = "_way"  # of a drive's term that depends on the last direction of motion
NAME = re.compile(r"learned_(theta|l|curvature|bend|stiffness|plate|sensor)(?:_([1-9]\d*))?(_way)?")


@dataclass(frozen=True)
class Target:
    """A kind and the tube that it is of, from 1; 0 of none."""

    kind_name: str
    tube: int = 0
    of_way: bool = False

    @property
    def kind(self) -> TargetKind:
        """The kind of quantity that the term adds to."""
        return KINDS[self.kind_name]

    @property
    def effect_name(self) -> str:
        """The name of the effect in a robot file."""
        return PREFIX + self.kind_name + (f"_{self.tube}" if self.tube else "") + (WAY if self.of_way else "")

    @property
    def words(self) -> str:
        """For people."""
        return self.kind.words.format(self.tube)


def target(effect_name: str, n: int) -> Target | None:
    """The target of an effect's name, for a robot of n tubes; None where the name is of none."""
    n_a_m_e = NAME.fullmatch(effect_name)
    if not n_a_m_e:
        return None
    kind, tube, way = n_a_m_e[1], int(n_a_m_e[2] or 0), bool(n_a_m_e[3])
    if KINDS[kind].has_axes != (tube == 0) or tube > n or (way and KINDS[kind].stage != "drive"):
        return None
    return Target(kind, tube, way)
