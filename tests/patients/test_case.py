"""`ctrplan case`: a patient's files to a certified plan; edits of its files count, a kill leaves none half written."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import case_phantom as phantom
import numpy as np
import phantoms
import pytest
import tomli_w

import ctrplan
from ctrplan.anatomy import clearance_grid
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.patients.case import Case, case
from ctrplan.patients.work import BASES, PLACED, SCENARIO, read_bases
from ctrplan.planning import place as screening
from ctrplan.reports import plan_page, plan_picture
from ctrplan.storage.toml_document import read_document

TARGET = phantom.ENTRY + phantoms.OBLIQUE @ (33.4, -25.7, 166.3)  # near where the robot begins
POINTS = {"target": TARGET, "entry": phantom.ENTRY}
FEW: dict[str, Any] = {"candidates": 4, "radius_mm": 2.0, "cone_deg": 5.0, "tolerance_mm": 3.0, "time_s": 0.3}


@pytest.fixture(autouse=True, scope="module")
def coarse() -> Any:
    """What is wide needs neither many samples of the robot nor a fine grid; pages have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(screening, "SAMPLES", 1500)
        patch.setattr(clearance_grid, "MAX_DEFAULT_NODES", 5e4)
        for module, page in ((plan_picture, "write_plan_png"), (plan_page, "write_plan_report")):
            patch.setattr(module, page, lambda path, _: path.write_text("a page"))
        yield


@pytest.fixture(scope="module")
def patient(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels in RAS, points in LPS."""
    folder = tmp_path_factory.mktemp("patient")
    phantoms.written(phantom.labels(), folder / "labels.nii.gz")
    phantom.write_markups(folder / "target.mrk.json", "LPS", {"t": TARGET})
    phantom.write_markups(folder / "entry.mrk.json", "LPS", {"1": phantom.ENTRY, "2": phantom.FAR}, "Line")
    return folder


@pytest.fixture(scope="module")
def planned(patient: Path, tmp_path_factory: pytest.TempPathFactory) -> Case:
    output = tmp_path_factory.mktemp("case") / "new"
    return case(output, [patient], lumens=["1"], avoids=["2"], robot=phantom.ROBOT, **FEW)


@pytest.fixture
def folder(planned: Case, tmp_path: Path) -> Path:
    """A copy of the case, beside the patient of the first."""
    copy = planned.folder.parent / tmp_path.name
    shutil.copytree(planned.folder, copy)
    return copy


def test_a_phantom_is_planned_and_written_whole(planned: Case) -> None:
    assert planned.plan is not None and planned.plan.certificate.valid
    written = ctrplan.load_plan(planned.folder / "plan" / "plan.json", planned.folder / PLACED, allow_outside=True)
    alone = ctrplan.load_plan(planned.folder / "plan")  # of what is packed with it, the base where it was placed
    np.testing.assert_allclose(alone.scenario.base_position_m, written.scenario.base_position_m)
    np.testing.assert_allclose(alone.scenario.base_R, written.scenario.base_R)
    place_m = written.scenario.goal.tip_m
    assert place_m is not None
    lps = np.multiply(place_m * 1e3, (-1, -1, 1))  # a case is in RAS where no number was said
    assert written.scenario.frame == "RAS"
    np.testing.assert_allclose(lps, TARGET, atol=1e-5)
    np.testing.assert_allclose(planned.plan.certificate.goal_bound_m, written.certificate["goal_bound_m"])
    slicer = json.loads((planned.folder / "slicer" / "targets.mrk.json").read_text())["markups"][0]
    assert slicer["coordinateSystem"] == "LPS"
    np.testing.assert_allclose(slicer["controlPoints"][-1]["position"], TARGET, atol=1e-4)
    assert {"report.html", "plan.png", "trajectory.csv"} <= {path.name for path in (planned.folder / "plan").iterdir()}


def test_a_rerun_keeps_all_and_an_edited_step_is_used(
    planned: Case, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ctrplan.patients.steps.place", lambda *_, **__: pytest.fail("it placed again"))
    monkeypatch.setattr("ctrplan.patients.steps.plan", lambda *_, **__: pytest.fail("it planned again"))
    assert not any(step.is_made for step in case(folder).steps)
    header, *rows = (folder / BASES).read_text().splitlines()
    assert len(rows) > 1
    (folder / BASES).write_text("\n".join([header, *rows[::-1]]) + "\n")
    found = {step.name: step for step in case(folder, until="placed").steps}
    assert [found[name].is_made for name in ("scenario", "bases", "placed")] == [False, False, True]
    assert "edited" in found["bases"].sentence
    own = ctrplan.load_scenario(folder / PLACED, allow_outside=True)
    pose = read_bases(planned.folder / BASES)[-1]
    np.testing.assert_allclose(own.base_position_m, pose.position_m, atol=1e-12)
    np.testing.assert_allclose(own.base_R, pose.R, atol=1e-12)


def test_an_edit_that_would_be_lost_is_refused_until_its_step_is_asked_for(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / BASES).write_text((folder / BASES).read_text().replace("the entry itself", "mine"))
    text = (folder / SCENARIO).read_text()
    (folder / SCENARIO).write_text(text.replace("tolerance_mm = 3", "tolerance_mm = 2"))
    with pytest.raises(InputError, match=r"bases\.csv: was edited, .* --from bases makes it anew"):
        case(folder)
    (folder / BASES).unlink()
    asked: list[float] = []

    def place(scenario: Any, **_: Any) -> Any:
        asked.append(scenario.goal.tolerance_m)
        raise NoAnswerError("none")

    monkeypatch.setattr("ctrplan.patients.steps.place", place)
    with pytest.raises(NoAnswerError, match=r"nothing is reached from the entry \[-31, 17, 57\] mm"):
        case(folder)
    assert asked == [0.002] and not (folder / BASES).exists()
    with pytest.raises(InputError, match=r"scenario\.toml: was edited"):
        case(folder, tolerance_mm=1.0)


def test_an_edited_base_is_planned_from(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = read_document(folder / PLACED).content
    content["base"]["position_mm"][0] += 0.5
    (folder / PLACED).write_text(tomli_w.dumps(content))
    asked: list[float] = []

    def plan(scenario: Any, **_: Any) -> Any:
        asked.append(1e3 * scenario.base_position_m[0])
        raise NoAnswerError("none")

    monkeypatch.setattr("ctrplan.patients.steps.plan", plan)
    with pytest.raises(NoAnswerError):
        case(folder)
    assert asked == [pytest.approx(content["base"]["position_mm"][0])]  # and from no other row
    assert (folder / "plan" / "plan.json").exists()


def test_where_a_base_has_no_plan_the_next_rows_are_tried(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def plan(scenario: Any, **_: Any) -> Any:
        asked.append(scenario.base_position_m)
        assert ctrplan.load_scenario(scenario.path, allow_outside=True).sha256 == scenario.sha256
        raise NoAnswerError("none")

    monkeypatch.setattr("ctrplan.patients.steps.plan", plan)
    with pytest.raises(NoAnswerError):
        case(folder, from_step="placed", bases=2)
    np.testing.assert_allclose(asked, [row.position_m for row in read_bases(folder / BASES)[:2]], atol=1e-12)


def test_the_row_that_a_plan_was_found_from_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def plan(scenario: Any, **_: Any) -> Any:
        asked.append(scenario)
        if len(asked) == 1:
            raise NoAnswerError("none")
        return None

    monkeypatch.setattr("ctrplan.patients.steps.plan", plan)
    monkeypatch.setattr("ctrplan.patients.steps._sentence", lambda made: "certified")
    monkeypatch.setattr(plan_page, "save_plan", lambda made, folder: None)
    case(folder, from_step="placed", until="plan", bases=2)
    record = json.loads((folder / "case.json").read_text())
    assert record["steps"]["plan"]["sentence"] == "from row 2 of bases.csv: certified"


KILLED = """
import os, signal, sys
from ctrplan.patients.case import case
from ctrplan.storage import output_folder
replace, done = os.replace, 0

def until(last):
    def replaced(*paths):
        global done
        done += 1
        replace(*paths) if done < last else os.kill(os.getpid(), signal.SIGKILL)
    return replaced

for last, folder in enumerate(sys.argv[1:], start=1):
    if not (child := os.fork()):
        output_folder.os.replace = until(last)
        case(folder, from_step="placed")
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
"""


def test_a_killed_run_leaves_no_half_written_file(planned: Case, tmp_path: Path) -> None:
    """Killed when a step is begun, when its file is written, and when it is noted that it is."""
    folders = [planned.folder.parent / f"{tmp_path.name}_{k}" for k in range(3)]
    for folder in folders:
        shutil.copytree(planned.folder, folder)
    subprocess.run([sys.executable, "-c", KILLED, *map(str, folders)], check=True)
    names = (SCENARIO, BASES, PLACED, "plan/plan.json")
    for k, folder in enumerate(folders):
        for name in names:
            assert (folder / name).read_bytes() == (planned.folder / name).read_bytes()
        made = {step.name: step.is_made for step in case(folder, until="plan").steps}
        assert made == {"scenario": False, "bases": False, "placed": k > 0, "plan": False}  # begun: done anew
        assert not [path for path in folder.iterdir() if path.name.endswith(".tmp")]
