"""What a built term may depend on: joints, tips, time, columns of the data, in the units that ranges are stated in."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.experiment.friction_states import friction_state
from ctrplan.experiment.measurements import Measurements
from ctrplan.experiment.motion import time_at_rest_s, turning_speeds
from ctrplan.mechanics.tube import Tube
from ctrplan.sensor.poses import Poses

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
    known: dict[str, Array | None] = field(default_factory=dict)  # inputs that were asked for before

    @property
    def count(self) -> int:
        """K."""
        return len(self.theta)


def is_rotation(name: str) -> bool:
    """Whether an input is an angle that comes round."""
    return name.startswith(("theta_", "turn_"))


def unit(name: str) -> str:
    """Of an input; empty for columns of the data, whose names say it, and pure numbers."""
    return UNITS.get(name.rsplit("_", 1)[0] if OF_TUBE.fullmatch(name) else name, "")


def exists(name: str, n: int) -> bool:
    """Whether a robot of n tubes can have an input; a column of the data has any other name."""
    found = OF_TUBE.fullmatch(name)
    if not found:
        return bool(re.fullmatch(r"[A-Za-z]\w*", name))
    first = 2 if found[1] == "turn" else 1
    last = n - 1 if found[1] in ("overlap", "load", "speed") else n
    return first <= int(found[2]) <= last


def values(name: str, at: Situation) -> Array | None:
    """(K,) of an input, None where the situation does not know it."""
    if name not in at.known:
        at.known[name] = _values(name, at)
    return at.known[name]


def _values(name: str, at: Situation) -> Array | None:
    found = OF_TUBE.fullmatch(name)
    if found:
        return _OF_TUBE[found[1]](at, int(found[2]) - 1)
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
