"""The package's own names: all there, loaded on first use, and cheap to import."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import ctrplan
from ctrplan.commands.program import COMMANDS


@pytest.mark.parametrize("name", ctrplan.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(ctrplan, name) is not None
    assert name in dir(ctrplan)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'figures'"):
        _ = ctrplan.figures


def test_functions_are_not_hidden_by_the_modules_of_their_name() -> None:
    assert callable(ctrplan.plan) and callable(ctrplan.reorder)
    assert callable(ctrplan.planning.plan) and callable(ctrplan.planning.reorder)
    assert isinstance(ctrplan.planning.BoundObjective, type)


HEAVY = {"numpy", "scipy", "ompl", "ruckig", "trimesh", "igl", "plotly", "matplotlib", "tqdm", "msgspec"}


def imported(code: str) -> set[str]:
    """Modules that are imported when the code has run."""
    shown = f"import sys\n{code}\nprint(*sys.modules, file=sys.stderr)"
    return set(subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True).stderr.split())


@pytest.mark.parametrize("module", ["ctrplan", "ctrplan.__main__", "ctrplan.commands.program"])
def test_import_loads_nothing_heavy(module: str) -> None:
    modules = imported(f"import {module}")
    assert module in modules and not HEAVY & modules


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_imports_the_command_alone(command: str | None) -> None:
    arguments = [command, "--help"] if command else ["--help"]
    modules = imported(f"from ctrplan.__main__ import main\ntry:\n    main({arguments})\nexcept SystemExit:\n    pass")
    own = {f"ctrplan.commands.{name}" for name in COMMANDS} & modules
    assert own == ({f"ctrplan.commands.{command}"} if command else set()) and not HEAVY & modules


MULTIPLIED = """
import contextlib
from pathlib import Path
from ctrplan.__main__ import main
with contextlib.suppress(SystemExit):
    main(["--version"])
import numpy
numpy.ones((500, 500)) @ numpy.ones((500, 500))
print(len(list(Path("/proc/self/task").iterdir())))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists() or os.cpu_count() == 1, reason="counts threads as Linux does")
@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_linear_algebra_of_commands_has_one_thread_unless_the_environment_says_otherwise(
    given: dict[str, str], threads: str
) -> None:
    plain = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", MULTIPLIED], env=plain | given, capture_output=True, text=True)
    assert done.stdout.split()[-1] == threads
