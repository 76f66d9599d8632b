"""What a study varies: axes of choices, of which every combination is a task. Long axes are never written out."""

from __future__ import annotations

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array

TASK_PREFIX = "task."
CONFIGURATION = re.compile(r"(theta|l)_([0-9]+)")  # commanded joints of one tube: theta_2 in deg, l_2 in mm
OF_TASK = ("seed",)  # keys that are neither the robot's nor the scenario's


@dataclass(frozen=True)
class Choice:
    """What one choice says."""

    inputs: Mapping[str, Any]  # columns of the table, numbers and texts
    overrides: tuple[str, ...] = ()  # as --set takes them
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the task: target_mm, seed, file, ...
    digest: str = ""  # of the content of files that it names


class Axis(ABC):
    """Choices that exclude each other."""

    keys: tuple[str, ...] = ()  # of robot or scenario that every choice sets

    @abstractmethod
    def __len__(self) -> int:
        """Number of choices."""

    @abstractmethod
    def at(self, k: int) -> Choice:
        """Choice k."""


class Range(Sequence[float]):
    """Evenly spaced numbers, both ends included."""

    def __init__(self, low: float, high: float, count: int) -> None:
        """count: at least 1, which is `low` alone."""
        self.low, self.high, self.size = low, high, count

    def __len__(self) -> int:
        """Number of values."""
        return self.size

    def __getitem__(self, k: int) -> float:  # type: ignore[override]  # one at a time
        """Value k."""
        share = k / (self.size - 1) if self.size > 1 else 0.0
        return self.low * (1 - share) + self.high * share


class KeyAxis(Axis):
    """A key and the values that it takes."""

    def __init__(self, key: str, values: Sequence[Any]) -> None:
        """key: as in --set, or one of the task's."""
        self.key, self.values = key, values
        self.keys = () if is_of_task(key) else (key,)

    def __len__(self) -> int:
        """Number of values."""
        return len(self.values)

    def at(self, k: int) -> Choice:
        """Value k."""
        return keyed({self.key: self.values[k]})


class DrawAxis(Axis):
    """Rows of numbers drawn for several keys together."""

    def __init__(self, keys: Sequence[str], rows: Array) -> None:
        """rows: (K, keys)."""
        self.names, self.rows = tuple(keys), rows
        self.keys = tuple(key for key in keys if not is_of_task(key))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def at(self, k: int) -> Choice:
        """Row k."""
        return keyed(dict(zip(self.names, self.rows[k].tolist(), strict=True)))


class FileAxis(Axis):
    """A key and the files that it names, one after the other."""

    def __init__(self, key: str, files: Sequence[tuple[str, str, str]], *, is_main: bool) -> None:
        """files: shown name, value of the key, digest. is_main: the key is the robot or scenario itself."""
        self.key, self.files, self.is_main = key, files, is_main
        self.keys = () if is_main or is_of_task(key) else (key,)

    def __len__(self) -> int:
        """Number of files."""
        return len(self.files)

    def at(self, k: int) -> Choice:
        """File k."""
        shown, value, digest = self.files[k]
        if self.is_main:
            return Choice({self.key: shown}, (), {"file": value}, digest)
        chosen = keyed({self.key: value})
        return Choice({self.key: shown}, chosen.overrides, chosen.settings, digest)


class TargetAxis(Axis):
    """Points for the tip, (K, 3) [mm] in the anatomy's frame, and what holds for all of them."""

    def __init__(self, points_mm: Array, common: Mapping[str, Any], *, of_scenario: bool) -> None:
        """common: tolerance_mm, direction, direction_tolerance_deg, where they are given."""
        self.points_mm, self.common, self.of_scenario = points_mm, common, of_scenario
        self.keys = ("goal", "target") if of_scenario else ()

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points_mm)

    def at(self, k: int) -> Choice:
        """Point k."""
        point = self.points_mm[k].tolist()
        inputs = {f"target_{axis}_mm": value for axis, value in zip("xyz", point, strict=True)}
        goal = {"tip_mm": point, **self.common}
        return Choice(inputs, goal_overrides(goal) if self.of_scenario else (), {"target": goal})


class BaseAxis(Axis):
    """Poses of the plate: positions (K, 3) [mm] and quaternions (K, 4), w first."""

    def __init__(self, position_mm: Array, quaternion: Array, beside: Mapping[str, Any] | None = None) -> None:
        """quaternion: of norm 1. beside: what else [base] says, where all of it has to be said again."""
        self.position_mm, self.quaternion, self.beside = position_mm, quaternion, beside
        self.keys = ("base.position_mm", "base.quaternion_wxyz") if beside is None else ("base",)

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.position_mm)

    def at(self, k: int) -> Choice:
        """Pose k."""
        position, quaternion = self.position_mm[k].tolist(), self.quaternion[k].tolist()
        inputs = {f"base_{axis}_mm": value for axis, value in zip("xyz", position, strict=True)}
        inputs |= {f"base_q{axis}": value for axis, value in zip("wxyz", quaternion, strict=True)}
        pose = {"position_mm": position, "quaternion_wxyz": quaternion}
        if self.beside is not None:
            return Choice(inputs, (f"base={_inline({**pose, **self.beside})}",))
        return Choice(inputs, tuple(f"base.{key}={json.dumps(value)}" for key, value in pose.items()))


def is_of_task(key: str) -> bool:
    """Whether a key says how the task is done rather than with which robot or scenario."""
    return key in OF_TASK or key.startswith(TASK_PREFIX) or CONFIGURATION.fullmatch(key) is not None


def keyed(values: Mapping[str, Any]) -> Choice:
    """The choice of values for keys."""
    of_files = tuple(f"{key}={_toml(value)}" for key, value in values.items() if not is_of_task(key))
    of_task = {key.removeprefix(TASK_PREFIX): value for key, value in values.items() if is_of_task(key)}
    inputs = {key: json.dumps(value) if isinstance(value, list) else value for key, value in values.items()}
    return Choice(inputs, of_files, of_task)


def goal_overrides(goal: Mapping[str, Any]) -> tuple[str, ...]:
    """What --set is told for a scenario to have this [goal] alone."""
    return f"goal={_inline(goal)}", "target=[]"


def _toml(value: Any) -> str:
    """A number, text, truth value, list or table of them as TOML spells it, which is as JSON does but for tables."""
    if isinstance(value, Mapping):
        return _inline({json.dumps(key): inner for key, inner in value.items()})
    return json.dumps(value.item() if isinstance(value, np.generic) else value)


def _inline(table: Mapping[str, Any]) -> str:
    """An inline table."""
    return "{" + ", ".join(f"{key} = {_toml(value)}" for key, value in table.items()) + "}"
