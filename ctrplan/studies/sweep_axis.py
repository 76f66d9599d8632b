"""One axis of a sweep: which quantity, from where to where, in the units people write."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arguments import in_plain_digits
from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Kind
from ctrplan.errors import InputError
from ctrplan.storage.toml_faults import unit_of

MOST_POINTS = 1_000_000
FURTHEST = 1e12  # of any unit; keys of the robot file have ranges of their own
FORM = "has the form KEY=FROM:TO:COUNT, such as theta_3=0:180:91 or contact.1.friction_coefficient=0:0.5:26"
_COLLAR = re.compile(r"(theta|l)_([0-9]+)")
_KINDS: dict[str, Kind] = {"theta": "rotation", "l": "translation"}


@dataclass(frozen=True, eq=False)
class SweepAxis:
    """Evenly spaced values of a collar's rotation or translation, or of a key of the robot file."""

    key: str  # theta_I or l_I, I the tube counted from 1, or as in --set
    values: Array  # (N,) in `unit`
    kind: Kind | None = None  # of a collar's motion; None for a key of the robot file
    tube: int = 0  # counted from 0, of a collar's motion

    @property
    def unit(self) -> str:
        """deg, mm, 1/m, ...; empty for a number without one."""
        if self.kind is not None:
            return "deg" if self.kind == "rotation" else "mm"
        return unit_of(self.key.rpartition(".")[2]) or ""

    @property
    def column(self) -> str:
        """Header in a table; keys of the robot file name their unit already."""
        return f"{self.key}_{self.unit}" if self.kind else self.key

    @property
    def label(self) -> str:
        """Text beside an axis of a picture."""
        return f"{self.key} ({self.unit})" if self.unit else self.key

    def at(self, value: float) -> str:
        """What stands in sentences: theta_3 = 90 deg."""
        return f"{self.key} = {value:.6g} {self.unit}".rstrip()


def parse_axis(text: str, n: int) -> SweepAxis:
    """The axis of KEY=FROM:TO:COUNT for a robot of n tubes. Raises InputError; a robot file's key is not looked up."""
    key, equals, limits = (part.strip() for part in text.partition("="))
    parts = limits.split(":")
    if not equals or not key or len(parts) != 3:
        raise InputError(FORM, key="--sweep", value=text)
    values = _values(parts, text)
    match = _COLLAR.fullmatch(key)
    if not match:
        return SweepAxis(key, values)
    tube = int(match[2])
    if not 1 <= tube <= n:
        raise InputError(f"no such tube, they are counted from 1 (outermost) to {n}", key="--sweep", value=key)
    return SweepAxis(f"{match[1]}_{tube}", values, _KINDS[match[1]], tube - 1)


def _values(parts: list[str], text: str) -> Array:
    first, last, count = in_plain_digits(parts[0]), in_plain_digits(parts[1]), in_plain_digits(parts[2], whole=True)
    if first is None or last is None or count is None:
        raise InputError(f"{FORM}: two numbers and a whole one", key="--sweep", value=text)
    if not (abs(first) <= FURTHEST and abs(last) <= FURTHEST):
        raise InputError(f"FROM and TO must be from {-FURTHEST:g} to {FURTHEST:g}", key="--sweep", value=text)
    if count < 2:
        raise InputError("COUNT must be at least 2", key="--sweep", value=text)
    if count > MOST_POINTS:
        raise InputError(f"COUNT must be at most {MOST_POINTS:,}", key="--sweep", value=text)
    values: Array = np.asarray(np.linspace(first, last, int(count)), dtype=np.float64)
    if len(np.unique(values)) < count:
        raise InputError("FROM and TO must differ, by enough for COUNT values", key="--sweep", value=text)
    return values
