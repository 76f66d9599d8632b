"""What real scans of public patients needed: entries that lie a little too near a wall, and lumens cut open."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import case_phantom as phantom
import numpy as np
import phantoms
import pytest
import trimesh

import ctrplan
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.patients.case import case
from ctrplan.patients.work import SCENARIO
from ctrplan.scenario.scenario import Scenario

TARGET = phantom.ENTRY + phantoms.OBLIQUE @ (20.0, -30.0, 120.0)


def scenario_of(output: Path, *inputs: Path, **keys: Any) -> Scenario:
    case(output, inputs, **({"robot": phantom.ROBOT, "frame": "LPS", "until": "scenario"} | keys))
    return ctrplan.load_scenario(output / SCENARIO, allow_outside=True)


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("patient") / "lps.nrrd"
    phantoms.written(phantom.labels(), path)
    return path


def test_an_entry_may_lack_room_that_is_within_its_radius(image: Path, tmp_path: Path) -> None:
    beside = phantom.ENTRY + (phantom.LUMEN_MM - 4) * phantoms.OBLIQUE[:, 0]  # the voxels are 5 mm wide
    keys: dict[str, Any] = {"lumens": ["1"], "avoids": ["2"], "targets": [TARGET], "entries": [beside]}
    scenario = scenario_of(tmp_path / "near", image, radius_mm=8.0, **keys)
    assert exact_clearance(scenario.anatomy, scenario.base_position_m[None])[0] < 0
    with pytest.raises(InputError, match="nearest place with room"):
        scenario_of(tmp_path / "far", image, radius_mm=0.5, **keys)


def test_nothing_reached_says_what_was_tried(image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not only why the entry's own pose fails, which may be one of many reasons."""
    own = SimpleNamespace(reached=0, reason="the nearest tip is 16.8 mm away")
    tried = "256 poses tried: 200 have a valid start, 2 seem to reach one; none reaches a target: too close."
    nothing = SimpleNamespace(poses=(own,), drawn=256, sentence=tried)
    monkeypatch.setattr("ctrplan.patients.steps.place", lambda *_, **__: nothing)
    keys: dict[str, Any] = {"lumens": ["1"], "avoids": ["2"], "targets": [TARGET], "entries": [phantom.ENTRY]}
    with pytest.raises(NoAnswerError, match=r"nothing is reached from the entry .* 256 poses tried: .*: too close\. A"):
        scenario_of(tmp_path / "case", image, until="bases", **keys)


def test_a_lumen_cut_open_is_capped_where_that_is_asked_for(tmp_path: Path) -> None:
    tube = trimesh.creation.cylinder(radius=20, segment=[phantom.ENTRY - 10 * phantom.WAY, phantom.FAR])
    flat = np.abs(tube.face_normals @ phantom.WAY) > 0.9
    trimesh.Trimesh(tube.vertices, tube.faces[~flat]).export(tmp_path / "tube.stl")
    keys: dict[str, Any] = {"lumens": ["tube"], "file_frame": "LPS", "targets": [phantom.ENTRY + 100 * phantom.WAY]}
    keys["entries"] = [phantom.ENTRY]
    with pytest.raises(InputError, match="caps"):
        scenario_of(tmp_path / "open", tmp_path / "tube.stl", **keys)
    scenario = scenario_of(tmp_path / "capped", tmp_path / "tube.stl", repair="caps", **keys)
    ends = (phantom.ENTRY - 11 * phantom.WAY, phantom.ENTRY - 9 * phantom.WAY)
    outside, inside = exact_clearance(scenario.anatomy, np.array(ends) * 1e-3)
    assert outside < 0 < inside < 1e-3
