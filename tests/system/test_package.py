"""The package's own names: all there, loaded on first use, and cheap to import."""

from __future__ import annotations

import subprocess
import sys

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
