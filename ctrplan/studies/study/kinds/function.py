"""A function of the user's."""

from __future__ import annotations

import importlib
import importlib.util
import math
import numbers
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.errors import InputError, UserFunctionError, of_the_user
from ctrplan.studies.study.table import FIRST, LAST, TIMING
from ctrplan.studies.study.task import Loaded, TaskKind, register

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.study.task import Task

NAMED = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
UNKNOWN_S = 1.0  # how long somebody else's function takes


@register("function")
class FunctionTask(TaskKind, frozen=True, kw_only=True):
    """kind = "function": module:function(scenario, inputs, seed) returns a number, or a mapping of names to such.

    scenario: with everything that the task changes, of a robot alone in free space. The module is a file beside the
    study, which travels with the tasks, or one that is installed where the workers are.
    """

    function: str
    options: dict[str, Any] = {}  # further keyword arguments

    def expected_s(self, robot: Robot, scenario: Scenario | None) -> float:
        return UNKNOWN_S

    def files(self) -> Sequence[str]:
        if not NAMED.fullmatch(self.function):
            raise InputError("must be module:function", key="task.function", value=self.function)
        return (f"{self.function.partition(':')[0].replace('.', '/')}.py",)

    def numbers(self, task: Task, loaded: Loaded) -> Mapping[str, Any]:
        function = self._imported(loaded)
        with of_the_user(self.function):
            result = function(loaded.scenario, dict(task.inputs), task.settings["seed"], **self.options)
        return _checked(result, self.function, task.inputs)

    def _imported(self, loaded: Loaded) -> Callable[..., Any]:
        module, _, name = self.function.partition(":")
        beside = loaded.job.sources.here / loaded.job.study_folder / self.files()[0]
        try:
            with of_the_user(f"{module}: can't be imported"):
                result = _module(beside) if beside.is_file() else importlib.import_module(module)
        except UserFunctionError as failure:
            error = failure.__cause__
            if not isinstance(error, ModuleNotFoundError):
                raise
            if error.name != module.partition(".")[0]:
                raise UserFunctionError(f"{module}: needs the module {error.name}, which is not installed.") from error
            where = f"neither {self.files()[0]} beside the study nor installed where the task is done"
            raise UserFunctionError(f"{module}: is {where}.") from error
        function = getattr(result, name, None)
        if not callable(function):
            raise InputError(f"is no function of the module {module}", key="task.function", value=self.function)
        return function  # type: ignore[no-any-return]


@lru_cache(maxsize=8)
def _module(file: Path) -> Any:
    """The module in a file, under a name of its own: another study's may be called the same."""
    spec = importlib.util.spec_from_file_location(f"{file.parent.name.strip('.')}_{file.stem}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _checked(result: Any, name: str, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
    """What a function returned, as columns. Raises InputError for what no table could hold."""
    columns = result if isinstance(result, Mapping) else {"value": result}
    results = {}
    for key, value in columns.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if key in (*FIRST, *LAST, *TIMING):
            raise InputError(f"must return numbers by other names than {key!r}, which every study has", key=name)
        if not isinstance(key, str) or not key or not (isinstance(plain, (str, numbers.Real)) or plain is None):
            kind = type(value).__name__
            raise InputError(f"must return numbers or texts by name, not {kind} as {key!r}", key=name)
        if key in inputs:
            raise InputError(f"must return numbers by other names than {key!r}, which the study varies", key=name)
        results[key] = _writable(plain, f"{name}, {key!r}")
    return results


def _writable(value: Any, name: str) -> Any:
    """A number or text as any table can hold it. Raises InputError for half a character."""
    if isinstance(value, str):
        if not value.isascii() and value.encode(errors="replace").decode() != value:
            raise InputError("must be text that can be written", key=name, value=ascii(value))
        return value
    if value is None or isinstance(value, (bool, float)) or (isinstance(value, int) and abs(value) < 2**63):
        return value
    try:
        return float(value)  # of fractions, and of whole numbers beyond the columns of tables
    except OverflowError:
        return math.inf if value > 0 else -math.inf
