"""What a study varies: axes of choices made from its file, of which every combination is a task."""

from __future__ import annotations

import json
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.study_file import GOAL_KEYS, DrawsEntry, StudyEntry, VaryEntry
from ctrplan.storage.toml_document import Document, read_document, toml_value
from ctrplan.studies.study.points import base_poses, target_points
from ctrplan.studies.study.sources import Sources, matching_files

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

TASK_PREFIX = "task."
CONFIGURATION = re.compile(r"(theta|l)_([0-9]+)")  # commanded joints of one tube: theta_2 in deg, l_2 in mm
OF_TASK = ("seed",)  # keys that are neither the robot's nor the scenario's


@dataclass(frozen=True)
class AxisChoice:
    """What one choice says."""

    inputs: Mapping[str, Any]  # columns of the table, numbers and texts
    overrides: tuple[str, ...] = ()  # as --set takes them
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the task: target_mm, seed, file, ...
    digest: str = ""  # of the content of files that it names


@dataclass(frozen=True, eq=False)
class Axis(ABC):
    """Choices that exclude each other, one for each of `values`."""

    values: Sequence[Any] | Array

    def __len__(self) -> int:
        """Number of choices."""
        return len(self.values)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of robot or scenario that every choice sets."""
        return ()

    @abstractmethod
    def at(self, k: int) -> AxisChoice:
        """Choice k."""


@dataclass(frozen=True)
class AxisRange(Sequence[float]):
    """Evenly spaced numbers, both ends included; one alone is `low`."""

    low: float
    high: float
    size: int

    def __len__(self) -> int:
        """Number of values."""
        return self.size

    def __getitem__(self, k: int) -> float:  # type: ignore[override]  # one at a time
        """Value k."""
        share = k / (self.size - 1) if self.size > 1 else 0.0
        return self.low * (1 - share) + self.high * share


@dataclass(frozen=True, eq=False)
class KeyAxis(Axis):
    """The values that a key takes."""

    key: str  # as in --set, or one of the task's

    @property
    def keys(self) -> tuple[str, ...]:
        """None where it is one of the task's."""
        return () if is_of_task(self.key) else (self.key,)

    def at(self, k: int) -> AxisChoice:
        """Value k."""
        return keyed({self.key: self.values[k]})


@dataclass(frozen=True, eq=False)
class DrawAxis(Axis):
    """Numbers drawn for several keys together, (K, keys)."""

    values: Array
    names: tuple[str, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Those that are not of the task."""
        return tuple(key for key in self.names if not is_of_task(key))

    def at(self, k: int) -> AxisChoice:
        """Row k."""
        return keyed(dict(zip(self.names, self.values[k].tolist(), strict=True)))


@dataclass(frozen=True, eq=False)
class FileAxis(KeyAxis):
    """The files that a key names, one after the other: shown name, value of the key, digest."""

    is_main: bool  # the key is the robot or scenario itself

    @property
    def keys(self) -> tuple[str, ...]:
        """None where it is the file that all is about."""
        return () if self.is_main else super().keys

    def at(self, k: int) -> AxisChoice:
        """File k."""
        shown, value, digest = self.values[k]
        if self.is_main:
            return AxisChoice({self.key: shown}, (), {"file": value}, digest)
        chosen = keyed({self.key: value})
        return AxisChoice({self.key: shown}, chosen.overrides, chosen.settings, digest)


@dataclass(frozen=True, eq=False)
class TargetAxis(Axis):
    """Points for the tip, (K, 3) [mm] in the anatomy's frame, and what holds for all of them."""

    common: Mapping[str, Any]  # tolerance_mm, direction, direction_tolerance_deg, where they are given
    of_scenario: bool

    @property
    def keys(self) -> tuple[str, ...]:
        """What a scenario's goal is said by."""
        return ("goal", "target") if self.of_scenario else ()

    def at(self, k: int) -> AxisChoice:
        """Point k."""
        point = self.values[k].tolist()
        inputs = {f"target_{axis}_mm": value for axis, value in zip("xyz", point, strict=True)}
        goal = {"tip_mm": point, **self.common}
        return AxisChoice(inputs, goal_overrides(goal) if self.of_scenario else (), {"target": goal})


@dataclass(frozen=True, eq=False)
class BaseAxis(Axis):
    """Poses of the plate, (K, 7): position [mm] and quaternion of norm 1, w first."""

    beside: Mapping[str, Any] | None  # what else [base] says, where all of it has to be said again

    @property
    def keys(self) -> tuple[str, ...]:
        """The whole table, or the pose alone."""
        return ("base.position_mm", "base.quaternion_wxyz") if self.beside is None else ("base",)

    def at(self, k: int) -> AxisChoice:
        """Pose k."""
        position, quaternion = np.split(self.values[k], [3])
        position, quaternion = position.tolist(), quaternion.tolist()
        inputs = {f"base_{axis}_mm": value for axis, value in zip("xyz", position, strict=True)}
        inputs |= {f"base_q{axis}": value for axis, value in zip("wxyz", quaternion, strict=True)}
        pose = {"position_mm": position, "quaternion_wxyz": quaternion}
        if self.beside is not None:
            return AxisChoice(inputs, (f"base={toml_value({**pose, **self.beside})}",))
        return AxisChoice(inputs, tuple(f"base.{key}={toml_value(value)}" for key, value in pose.items()))


def is_of_task(key: str) -> bool:
    """Whether a key says how the task is done rather than with which robot or scenario."""
    return key in OF_TASK or key.startswith(TASK_PREFIX) or CONFIGURATION.fullmatch(key) is not None


def keyed(values: Mapping[str, Any]) -> AxisChoice:
    """The choice of values for keys."""
    of_files = tuple(f"{key}={toml_value(value)}" for key, value in values.items() if not is_of_task(key))
    of_task = {key.removeprefix(TASK_PREFIX): value for key, value in values.items() if is_of_task(key)}
    inputs = {key: json.dumps(value) if isinstance(value, list) else value for key, value in values.items()}
    return AxisChoice(inputs, of_files, of_task)


def goal_overrides(goal: Mapping[str, Any]) -> tuple[str, ...]:
    """What --set is told for a scenario to have this [goal] alone."""
    return f"goal={toml_value(goal)}", "target=[]"


EXTRA = "pip install 'ctrplan[study]'"
LEVELS = 4  # of Morris' grid


def drawn(varied: Sequence[VaryEntry], draws: DrawsEntry) -> Array:
    """(K, keys) in the units of the keys. Raises InputError without SALib for the two plans."""
    if draws.method == "random":
        share = np.random.default_rng(draws.seed).random((draws.count, len(varied)))
        return np.column_stack([_quantile(vary, share[:, k]) for k, vary in enumerate(varied)])
    check_salib(draws.method)
    for vary in varied:
        if draws.method == "morris" and vary.distribution in ("normal", "lognormal"):
            rule = f"{vary.distribution} has no ends, which the levels of morris need: uniform or triangular"
            raise InputError(rule, key=vary.key)
    rows: Array
    if draws.method == "sobol":
        from SALib.sample import sobol

        rows = sobol.sample(problem(varied), draws.count, calc_second_order=False, seed=draws.seed)
    else:
        from SALib.sample import morris

        rows = morris.sample(problem(varied), draws.count, num_levels=LEVELS, seed=draws.seed)
    return rows


def problem(varied: Sequence[VaryEntry]) -> dict[str, Any]:
    """What SALib calls the problem."""
    kinds = {"uniform": "unif", "normal": "norm", "lognormal": "lognorm", "triangular": "triang"}
    return {
        "num_vars": len(varied),
        "names": [vary.key for vary in varied],
        "bounds": [_bounds(vary) for vary in varied],
        "dists": [kinds[vary.distribution or ""] for vary in varied],
    }


def check_salib(method: str) -> None:
    """Raises InputError without SALib."""
    if find_spec("SALib") is None:
        raise InputError(f"needs SALib: {EXTRA}", key="draws.method", value=method)


def _bounds(vary: VaryEntry) -> list[float]:
    """Parameters of a distribution as SALib takes them; a lognormal's mean and sigma are of the logarithm."""
    if vary.distribution in ("normal", "lognormal"):
        return [vary.mean or 0.0, vary.sigma or 1.0]
    low, high = vary.low or 0.0, vary.high or 0.0
    if vary.distribution == "uniform":
        return [low, high]
    return [low, high, ((vary.mode or 0.0) - low) / (high - low)]


def _quantile(vary: VaryEntry, share: Array) -> Array:
    """Values below which shares (K,) of a distribution lie."""
    from scipy import stats

    low, high = vary.low or 0.0, vary.high or 0.0
    if vary.distribution == "uniform":
        return np.asarray(low + (high - low) * share)
    if vary.distribution == "triangular":
        return np.asarray(stats.triang.ppf(share, ((vary.mode or 0.0) - low) / (high - low), low, high - low))
    normal = np.asarray(stats.norm.ppf(share, vary.mean or 0.0, vary.sigma or 1.0))
    return np.exp(normal) if vary.distribution == "lognormal" else normal


ROBOT, SCENARIO = "robot", "scenario"
POSE, OTHER_WAYS = ("position_mm", "quaternion_wxyz"), ("direction", "look_at", "roll_deg")  # of [base]


def files_varied(entry: StudyEntry, document: Document) -> dict[str, list[Path]]:
    """The files that each key with `files` goes through. Raises InputError."""
    folder = os.path.dirname(document.file or "") or "."
    return {
        vary.key: matching_files(vary.files, folder, f"vary.{k + 1}.files", document.file)
        for k, vary in enumerate(entry.vary)
        if vary.files is not None
    }


def axes_of(
    entry: StudyEntry,
    document: Document,
    sources: Sources,
    files: dict[str, list[Path]],
    scenario: Scenario | None,
) -> list[Axis]:
    """Files first, then bases and keys in the order of the file, draws, and targets, which run fastest.

    scenario: for points of its anatomy. Raises InputError.
    """
    folder = Path(document.file or ".").parent
    results: list[Axis] = [_files(vary, entry, sources, files[vary.key], folder) for vary in entry.vary if vary.files]
    if entry.bases is not None:
        results.append(BaseAxis(np.hstack(base_poses(entry.bases, document)), _beside_pose(entry, document, files)))
    results += [KeyAxis(_values(vary), vary.key) for vary in entry.vary if vary.values or vary.count]
    if random := distributed(entry):
        results.append(DrawAxis(drawn(random, entry.draws), tuple(vary.key for vary in random)))
    if entry.targets is not None:
        points = target_points(entry.targets, scenario, document, folder)
        results.append(TargetAxis(points, _goal(entry), entry.scenario is not None))
    return results


def _beside_pose(
    entry: StudyEntry, document: Document, files: Mapping[str, Sequence[Path]]
) -> Mapping[str, Any] | None:
    """What [base] of the scenario says besides a pose, if a quaternion does not go with the rest; else None."""
    folder = Path(document.file or ".").parent
    bases = [read_document(file).content.get("base") for file in files.get(SCENARIO, [folder / (entry.scenario or "")])]
    tables = [base for base in bases if isinstance(base, dict)]
    if not any(key in table for table in tables for key in OTHER_WAYS):
        return None
    beside = [{key: value for key, value in table.items() if key not in (*POSE, *OTHER_WAYS)} for table in tables]
    if len(tables) < len(bases) or any(other != beside[0] for other in beside):
        raise document.fault("needs scenarios whose [base] say the same but for the pose", "bases")
    return beside[0]


def distributed(entry: StudyEntry) -> list[VaryEntry]:
    """The keys that have a distribution."""
    return [vary for vary in entry.vary if vary.distribution is not None]


def _values(vary: VaryEntry) -> Sequence[Any]:
    if vary.values is not None:
        return vary.values
    return AxisRange(vary.low or 0.0, vary.high or 0.0, vary.count or 1)


def _files(vary: VaryEntry, entry: StudyEntry, sources: Sources, files: list[Path], folder: Path) -> FileAxis:
    """The axis of a key whose value is a file: the start itself, a file of the task, or one that the start names."""
    is_main = vary.key == (SCENARIO if entry.scenario is not None else ROBOT)
    if is_main:
        named = [sources.name(file) for file in files]
    elif vary.key.startswith(TASK_PREFIX):
        named = [os.path.relpath(file, folder) for file in files]
    else:
        if entry.scenario is None:
            raise InputError("a robot's file names no other files", key="vary", value=vary.key)
        named = [os.path.relpath(file, (folder / entry.scenario).parent) for file in files]
    others = [other.key for other in entry.vary if other.files is None]
    inner = [key.removeprefix("robot.") for key in others] if vary.key == ROBOT and not is_main else others
    of_file = [key for key in inner if not is_of_task(key)]
    digests = [sources.digest(sources.name(file), of_file) for file in files]
    shown = _distinct_names(files)
    return FileAxis(list(zip(shown, named, digests, strict=True)), vary.key, is_main)


def _distinct_names(files: Sequence[Path]) -> list[str]:
    """File names, with as much of their folders as tells them apart."""
    for parts in range(1, max(len(file.parts) for file in files) + 1):
        names = ["/".join(file.parts[-parts:]) for file in files]
        if len(set(names)) == len(names):
            return names
    return [str(file) for file in files]


def _goal(entry: StudyEntry) -> dict[str, Any]:
    targets = entry.targets
    given = {key: getattr(targets, key) for key in GOAL_KEYS}
    goal = {
        key: list(value) if isinstance(value, tuple) else value for key, value in given.items() if value is not None
    }
    if "direction" in goal:
        goal.setdefault("direction_tolerance_deg", 5.0)
    return goal
