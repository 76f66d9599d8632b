"""The friction bound over one or two axes: commanded rotations and translations, or numbers of the robot file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import (
    EXECUTOR,
    PROGRESS,
    SEARCH_TIME,
    SEED,
    Choice,
    Made,
    checked,
    in_plain_digits,
    require,
)
from ctrplan.base.arrays import Array, numbers
from ctrplan.base.long_work import StageProgress, cores, one_core
from ctrplan.base.package import shown
from ctrplan.drive.drive import UNITS, Kind
from ctrplan.errors import CtrplanError, InputError, NoAnswerError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import TASK, chunks, columns_of, join, run
from ctrplan.pipeline.chain import range_notes
from ctrplan.plans.plan import Plan
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.storage.csv_table import csv_text
from ctrplan.storage.toml_document import LARGEST_NUMBER, override_names
from ctrplan.storage.toml_faults import unit_of
from ctrplan.studies.child_process import ChildExecutor
from ctrplan.studies.study.axes import CONFIGURATION

if TYPE_CHECKING:
    from ctrplan.base.long_work import Progress
    from ctrplan.mechanics.shapes import Accuracy, Bounds
    from ctrplan.scenario.scenario import Scenario

MOST_POINTS = 1_000_000
FORM = "has the form KEY=FROM:TO:COUNT, such as theta_3=0:180:91 or contact.1.friction_coefficient=0:0.5:26"
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
    match = CONFIGURATION.fullmatch(key)
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
    if not (abs(first) <= LARGEST_NUMBER and abs(last) <= LARGEST_NUMBER):
        rule = f"FROM and TO must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}"
        raise InputError(rule, key="--sweep", value=text)
    if count < 2:
        raise InputError("COUNT must be at least 2", key="--sweep", value=text)
    if count > MOST_POINTS:
        raise InputError(f"COUNT must be at most {MOST_POINTS:,}", key="--sweep", value=text)
    values: Array = np.asarray(np.linspace(first, last, int(count)), dtype=np.float64)
    if len(np.unique(values)) < count:
        raise InputError("FROM and TO must differ, by enough for COUNT values", key="--sweep", value=text)
    return values


FEWEST_TASKS = 32  # while there are as many configurations


@shown
@dataclass(frozen=True, eq=False)
class Sweep:
    """Bounds at every combination of the axes' values, the last axis running fastest."""

    robot: Robot  # as in its file
    theta_commanded: Array  # (n,) [rad], of tubes that no axis turns
    l_commanded: Array  # (n,) [m], of tubes that no axis translates
    axes: tuple[SweepAxis, ...]
    values: Array  # (K, axes) in the axes' units
    bounds: Bounds  # of the K configurations
    warnings: tuple[str, ...]  # about the robots at the axes' values

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(K,) whether the bound holds: the solves converged and the robot does not snap."""
        converged = np.isin(self.bounds.status, (Status.CONVERGED, Status.MULTIPLE))
        return np.asarray(converged & np.isfinite(self.bounds.position_m), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class _Task:
    """Some rows of a sweep, those of one robot next to each other; picklable, for executors."""

    content: Mapping[str, Any]  # of the robot file
    file: str | None
    axes: tuple[SweepAxis, ...]
    values: Array  # (k, axes) in the axes' units
    theta_commanded: Array  # (k, n) [rad]
    l_commanded: Array  # (k, n) [m]

    def robots(self) -> Iterator[tuple[Robot, slice]]:
        """Each robot and the rows it is asked about. Raises InputError for values that no robot can have."""
        keys = tuple(axis for axis in self.axes if axis.kind is None)
        settings = self.values[:, [axis.kind is None for axis in self.axes]].tolist()
        first = 0
        for setting, rows in groupby(settings):
            end = first + sum(1 for _ in rows)
            yield _robot(self.content, self.file, keys, setting), slice(first, end)
            first = end

    def check(self) -> tuple[str, ...]:
        """Warnings about the robots. Raises InputError, which says at which values something does not nest."""
        warnings: list[str] = []
        for robot, rows in self.robots():
            theta_b, l_b = self._collars(robot, rows)
            if refused := robot.mechanics.first_refused(theta_b, l_b):
                k, rule = refused
                axes = zip(self.axes, self.values[rows][k].tolist(), strict=True)
                turned = rule.startswith("theta_b")
                where = " and ".join(axis.at(value) for axis, value in axes if turned or axis.kind != "rotation")
                raise InputError(nesting_violation(robot, theta_b[k], l_b[k]) or rule, key=where or None)
            warnings += [*robot.warnings, *range_notes(robot, self.theta_commanded[rows], self.l_commanded[rows])]
        return tuple(warnings)

    def solve(self, accuracy: Accuracy) -> Bounds:
        """Bounds of the rows, on the calling thread."""
        groups = ((robot, *self._collars(robot, rows)) for robot, rows in self.robots())
        return join([robot.bound_many(*collars, accuracy=accuracy, threads=1) for robot, *collars in groups])

    def _collars(self, robot: Robot, rows: slice) -> tuple[Array, Array]:
        return robot.collars(self.theta_commanded[rows], self.l_commanded[rows])


@checked(
    accuracy=Choice("search", "certificate", "exact"),
    progress=PROGRESS,
    executor=EXECUTOR,
)
def sweep(
    content: Mapping[str, Any],
    axes: Sequence[SweepAxis],
    theta_commanded: ArrayLike,
    l_commanded: ArrayLike,
    *,
    file: str | None = None,
    accuracy: Accuracy = "search",
    progress: StageProgress | None = None,
    executor: Executor | None = None,
) -> Sweep:
    """Bounds of the robot of a robot file's `content` at commanded rotations (n,) [rad] and translations (n,) [m].

    One or two axes replace what they name. Nothing is solved before every robot and configuration is known to be
    well-formed; raises InputError otherwise. Without an executor the tasks run on a thread per core.
    """
    check_axes(axes)
    robot = robot_from_dict(content, file=file)
    theta, l = numbers(theta_commanded, "theta_commanded"), numbers(l_commanded, "l_commanded")  # noqa: E741
    if not theta.shape == l.shape == (robot.n,):
        raise InputError(
            f"must have shape ({robot.n},), one value per tube, not {theta.shape}, {l.shape}", key="joints"
        )
    values = np.stack(np.meshgrid(*(axis.values for axis in axes), indexing="ij"), axis=-1).reshape(-1, len(axes))
    order = _robot_by_robot(axes, values)
    configurations = _configurations(axes, values, theta, l)
    size = max(1, min(TASK, len(values) // FEWEST_TASKS))
    rows = [order[chunk] for chunk in chunks(len(values), size)]
    tasks = [_Task(content, file, tuple(axes), values[k], *(table[k] for table in configurations)) for k in rows]
    report: StageProgress = progress or (lambda *_: None)
    warnings: dict[str, None] = {}
    for done, task in enumerate(tasks, start=1):
        warnings |= dict.fromkeys(task.check())
        report("check", done / len(tasks))
    bounds = _run(executor, tasks, accuracy, partial(report, "bounds"))
    return Sweep(robot, theta, l, tuple(axes), values, _reordered(bounds, np.argsort(order)), tuple(warnings))


def check_axes(axes: Sequence[SweepAxis]) -> None:
    """Raises InputError unless there are one or two different axes and not too many points."""
    if not 1 <= len(axes) <= 2:
        raise InputError("takes one axis or two", key="--sweep", value=[axis.key for axis in axes])
    if len({(axis.kind, *override_names(axis.key)) for axis in axes}) < len(axes):
        raise InputError("names the same axis twice", key="--sweep", value=axes[0].key)
    if (count := math.prod(len(axis.values) for axis in axes)) > MOST_POINTS:
        raise InputError(f"{count:,} points are more than {MOST_POINTS:,}", key="--sweep")


def sweep_csv(result: Sweep) -> str:
    """A row per configuration: the axes, bound_mm, bound_deg, stability, max_strain, status; failed solves have nan."""
    bounds = result.bounds
    results = [bounds.position_m * 1e3, np.degrees(bounds.tangent_rad), bounds.stability, bounds.max_strain]
    names = [axis.column for axis in result.axes]
    rows = zip(np.column_stack([result.values, *results]).tolist(), bounds.status.tolist(), strict=True)
    header = [*names, "bound_mm", "bound_deg", "stability", "max_strain", "status"]
    return csv_text(header, ([*numbers, Status(status).name] for numbers, status in rows))


def _robot(content: Mapping[str, Any], file: str | None, axes: Sequence[SweepAxis], setting: Sequence[float]) -> Robot:
    overrides = [f"{axis.key}={value!r}" for axis, value in zip(axes, setting, strict=True)]
    try:
        return robot_from_dict(content, file=file, overrides=overrides)
    except InputError as error:
        others = [axis.at(value) for axis, value in zip(axes, setting, strict=True) if axis.key != error.key]
        rule = f"{error.rule} (at {' and '.join(others)})" if others else error.rule
        raise InputError(rule, file=error.file, key=error.key, value=error.value, unit=error.unit) from None


def _robot_by_robot(axes: Sequence[SweepAxis], values: Array) -> NDArray[np.intp]:
    """Order of the rows in which each robot comes up once."""
    pairs = zip(axes, values.T, strict=True)
    columns = [column * np.sign(axis.values[1] - axis.values[0]) for axis, column in pairs if axis.kind is None]
    return np.lexsort(columns[::-1]) if columns else np.arange(len(values))


def _configurations(axes: Sequence[SweepAxis], values: Array, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741
    """Commanded rotations (K, n) [rad] and translations (K, n) [m] of all rows."""
    tables = {"rotation": np.tile(theta, (len(values), 1)), "translation": np.tile(l, (len(values), 1))}
    for axis, column in zip(axes, values.T, strict=True):
        if axis.kind is not None:
            tables[axis.kind][:, axis.tube] = column * UNITS[axis.kind][1]
    return tables["rotation"], tables["translation"]


def _run(
    executor: Executor | None, tasks: Sequence[_Task], accuracy: Accuracy, progress: Callable[[float], object]
) -> Bounds:
    calls = [(task, accuracy) for task in tasks]
    if executor is not None:
        return join(run(executor, _Task.solve, calls, progress))
    with ThreadPoolExecutor(cores()) as threads:
        return join(run(threads, _Task.solve, calls, progress))


def _reordered(bounds: Bounds, order: NDArray[np.intp]) -> Bounds:
    return type(bounds)(*(getattr(bounds, name)[order] for name in columns_of(bounds)))


SCENARIO = Made("Scenario")


@checked(seed=SEED, time_s=SEARCH_TIME, executor=EXECUTOR, progress=PROGRESS)
def plan_many(
    scenarios: Iterable[Scenario],
    *,
    seed: int = 0,
    time_s: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[Plan | CtrplanError]:
    """A plan for each scenario in their order, or the error that says why there is none; see `ctrplan.plan`.

    Each is done on one thread by `executor`, which has the interface of concurrent.futures, by default by as many
    processes as there are cores. `progress` is told the finished share. Raises InputError for what is no scenario.
    """
    queue = list(scenarios)
    for k, scenario in enumerate(queue):
        require(f"scenarios[{k}]", scenario, SCENARIO)
    with ExitStack() as stack:
        chosen = executor or stack.enter_context(ChildExecutor())
        futures = [_submitted(chosen, scenario, seed, time_s) for scenario in queue]
        stack.callback(lambda: [future.cancel() for future in futures])
        results = []
        for future in futures:
            results.append(_result(future))
            if progress is not None:
                progress(len(results) / len(futures))
    return results


def _submitted(executor: Executor, scenario: Scenario, seed: int, time_s: float | None) -> Any:
    try:
        return executor.submit(_plan, scenario, seed, time_s)
    except RuntimeError as error:  # of all executors of concurrent.futures
        raise InputError(f"takes no tasks ({error})", key="executor", value=executor) from error


def _result(future: Any) -> Plan | CtrplanError:
    try:
        result: Plan = future.result()
        return result
    except CtrplanError as error:
        return error
    except Exception as error:  # of the process that should have planned
        return NoAnswerError(f"no plan: {' '.join(str(error).split()) or type(error).__name__}")


def _plan(scenario: Scenario, seed: int, time_s: float | None) -> Plan:
    from ctrplan.planning.planner import plan  # which pictures of a path, who import this file, do not need

    with one_core():
        return plan(scenario, seed=seed, time_s=time_s)
