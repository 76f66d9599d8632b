"""The module for 3D Slicer, as far as it can be looked at without one: what it makes of a folder."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from ctrplan.files.plan_file import WrittenPlan
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_scene import written_motion
from ctrplan.reports.slicer_case import case_files
from ctrplan.storage.output_folder import write_results

FILE = Path(__file__).parents[2] / "extras" / "slicer" / "CtrplanCase.py"


@pytest.fixture(scope="module")
def module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("CtrplanCase", FILE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_is_short_and_says_what_was_not_tested() -> None:
    text = FILE.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 200 and "Not tested inside 3D Slicer" in text


def test_it_finds_what_a_case_holds_and_what_is_missing(module: ModuleType, plan: Plan, tmp_path: Path) -> None:
    assert "holds no scene.mrml" in module.faults(tmp_path)[0]
    write_results(tmp_path, case_files(written_motion(WrittenPlan.of(plan), 2), "LPS"))
    assert module.faults(tmp_path) == []
    assert module.title(tmp_path) == "From entry to goal."
    (tmp_path / "CT.nii.gz").touch()
    assert [path.name for path in module.volumes(tmp_path)] == ["CT.nii.gz"]
    (tmp_path / "plate.ply").unlink()
    assert module.faults(tmp_path) == [f"{tmp_path / 'plate.ply'} is missing."]
