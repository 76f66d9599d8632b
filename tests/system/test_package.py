"""The package's own names: all there, loaded on first use, and cheap to import."""

from __future__ import annotations

import subprocess
import sys

import pytest

import ctrplan


@pytest.mark.parametrize("name", ctrplan.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(ctrplan, name) is not None
    assert name in dir(ctrplan)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'plans'"):
        _ = ctrplan.plans


def test_functions_are_not_hidden_by_the_modules_of_their_name() -> None:
    assert callable(ctrplan.plan) and callable(ctrplan.reorder)
    assert callable(ctrplan.planning.plan) and callable(ctrplan.planning.reorder)
    assert isinstance(ctrplan.planning.BoundObjective, type)


@pytest.mark.parametrize("module", ["ctrplan", "ctrplan.cli", "ctrplan.commands.program"])
def test_import_loads_nothing_heavy(module: str) -> None:
    heavy = "{'numpy', 'scipy', 'ompl', 'ruckig', 'trimesh', 'igl', 'plotly', 'matplotlib', 'tqdm', 'msgspec'}"
    code = f"import sys, {module}; print(*sorted({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == ""
