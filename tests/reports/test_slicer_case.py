"""A plan as a folder for 3D Slicer: nodes find their files, the frames agree, the robot is within its envelope."""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from written_plan_files import write_small_plan

from ctrplan.__main__ import main
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_scene import WrittenMotion, written_motion
from ctrplan.reports.slicer_case import case_files

STEPS = 4


@pytest.fixture(scope="module")
def motion(plan: Plan) -> WrittenMotion:
    return written_motion(WrittenPlan.of(plan), STEPS)


@pytest.fixture(scope="module")
def files(motion: WrittenMotion) -> dict[str, str | bytes]:
    return case_files(motion, "LPS")


def references(node: ET.Element) -> list[tuple[str, str]]:
    entries = [entry.split(":") for entry in node.get("references", "").split(";") if entry]
    return [(role, one) for role, ids in entries for one in ids.split()]


def test_the_scene_loads_every_file_and_every_reference_leads_somewhere(files: dict[str, str | bytes]) -> None:
    root = ET.fromstring(files["scene.mrml"])
    ids = [node.get("id") for node in root]
    assert len(set(ids)) == len(ids)
    for node in root:
        assert {to for _, to in references(node)} <= set(ids)
    named = {node.get("fileName") for node in root if node.get("fileName")}
    assert named == set(files) - {"scene.mrml"}
    assert all(node.get("coordinateSystem") == "LPS" for node in root if node.get("fileName"))
    used = [to for node in root for _, to in references(node)]
    assert {node.get("id") for node in root if node.get("fileName")} <= set(used)


def test_centrelines_are_those_of_the_tenths_that_their_names_say(files: dict[str, str | bytes]) -> None:
    """Only those tenths of four poses have a file that a pose is near to, each another one."""
    names = sorted(name for name in files if name.startswith("centreline_"))
    assert names == [f"centreline_{percent:03}.mrk.json" for percent in (0, 30, 70, 100)]
    assert len({files[name] for name in names}) == len(names)


def test_the_player_moves_each_tube_and_the_envelope(files: dict[str, str | bytes], motion: WrittenMotion) -> None:
    root = ET.fromstring(files["scene.mrml"])
    (browser,) = root.findall("SequenceBrowser")
    pairs = dict(references(browser))
    numbers = (browser.get("virtualNodePostfixes") or "").split()
    assert len(numbers) == motion.scenario.robot.n + 1
    for number in numbers:
        assert pairs[f"sequenceNodeRef{number}"].startswith("vtkMRMLSequenceNode")
        assert pairs[f"dataNodeRef{number}"].startswith("vtkMRMLModelNode")
    fps = float(browser.get("playbackRateFps") or 0)
    assert fps == pytest.approx((STEPS - 1) / motion.times_s[-1], rel=1e-2)


def test_a_frame_turns_all_of_the_case_about_the_axis_to_the_head(
    files: dict[str, str | bytes], motion: WrittenMotion
) -> None:
    turned = case_files(motion, "RAS")
    for name in ("tip_path.mrk.json", "targets.mrk.json", "closest.mrk.json", "centreline_100.mrk.json"):
        here, there = (points(content[name]) for content in (files, turned))
        np.testing.assert_allclose(there, here * [-1, -1, 1], atol=1e-9)
    for name in ("tube_1.ply", "swept_envelope.ply", "anatomy_1.ply"):
        here, there = (vertices(content[name])[0] for content in (files, turned))
        np.testing.assert_allclose(there, here * [-1, -1, 1], atol=1e-4)


def test_the_tip_goes_from_the_first_pose_to_the_last_and_the_closest_place_is_as_far_as_it_says(
    files: dict[str, str | bytes], motion: WrittenMotion
) -> None:
    goal = points(files["targets.mrk.json"])[-1]
    np.testing.assert_allclose(goal, motion.scenario.goal.tip_m * 1e3, atol=1e-6)
    path = points(files["tip_path.mrk.json"])
    for row, pose in ((0, motion.path[0]), (-1, motion.path[-1])):
        np.testing.assert_allclose(path[row], pose.tip_m * 1e3, atol=2e-3)
    ends = points(files["closest.mrk.json"])
    assert np.linalg.norm(np.diff(ends, axis=0)) == pytest.approx(motion.plan.closest.distance_m * 1e3, abs=1e-5)


def test_the_robot_is_within_the_space_that_its_envelope_sweeps(
    files: dict[str, str | bytes], motion: WrittenMotion
) -> None:
    shell = vertices(files["swept_envelope.ply"])
    for pose in motion.path:
        for rod in pose.tubes:
            inside = igl.winding_number(*shell, rod.centreline_m * 1e3)
            assert np.all(inside > 0.5)


def test_the_command_writes_the_folder_and_asks_for_the_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_small_plan(tmp_path)
    command = ["export", str(tmp_path / "plan.json"), "--allow-outside", "--to", "slicer", "-o", str(tmp_path / "case")]
    assert main(command) == 2 and "--frame: must be RAS or LPS" in capsys.readouterr().err
    assert not (tmp_path / "case").exists()
    assert main([*command, "--frame", "RAS", "--steps", "2"]) == 0
    assert "2 poses" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "case").iterdir()}
    assert {"scene.mrml", "tip_path.mrk.json", "tube_3.seq.mrb", "base.tfm", "SHA256SUMS"} <= names


def points(content: str | bytes) -> np.ndarray:
    (markup,) = json.loads(content)["markups"]
    return np.array([point["position"] for point in markup["controlPoints"]])


def vertices(content: str | bytes) -> tuple[np.ndarray, np.ndarray]:
    assert isinstance(content, bytes)
    mesh = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    return np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
