"""Base poses: spread as asked, worth the same however the base rolls, and found where the scenario's own is useless."""

from __future__ import annotations

import itertools
import json
import math
import re
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from places import ROBOTS
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.__main__ import main
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.planning import place as screening
from ctrplan.planning.base_pose import BaseFrame, BasePose, Patch, base_pose, placed
from ctrplan.planning.place import Placement, PoseScore, Screen, place

PAIR = ROBOTS / "table_5_pair.toml"
WAY = {"rotate outer": 20.0, "rotate inner": 140.0, "translate inner": 10.0}  # there and back
START = {"rotate outer": 0.0, "rotate inner": 0.0, "translate inner": -30.0}
JOINTS_GOAL = "goal={joints={" + ", ".join(f'"{name}"={value}' for name, value in START.items()) + "}}"
AWAY = 50.0  # deg by which the scenario's base looks past the target


@pytest.fixture(autouse=True)
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screening, "SAMPLES", 1500)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot that looks past what it could reach from where it stands, over a sphere that it must not touch."""
    folder = tmp_path_factory.mktemp("placing")
    robot = ctrplan.load_robot(PAIR)
    (folder / "robot.toml").write_text(tomli_w.dumps(dict(robot.content)), encoding="utf-8")
    joints = np.array([WAY[joint.name] * joint.si_per_unit for joint in robot.drive.joints])
    tip = robot.bound(*robot.collars(*robot.drive.commanded(joints))).frictionless.tip_m
    tilted = Rotation.from_euler("x", AWAY, degrees=True)
    x, y, z, w = tilted.as_quat().tolist()
    content = {
        "robot": "robot.toml",
        "base": {"position_mm": [3, 4, 5], "quaternion_wxyz": [w, x, y, z], "position_sigma_mm": 0.1},
        "start": START,
        "goal": {"tip_mm": (1e3 * tip + [3, 4, 5]).tolist(), "tolerance_mm": 1.0},
        "anatomy": [
            {"kind": "sphere", "center_mm": (1e3 * tip + [3, 4, 17]).tolist(), "radius_mm": 8},
            {
                "kind": "capsule",
                "from_mm": [3, 4, -20],
                "to_mm": (1e3 * tip + [3, 4, 5]).tolist(),
                "radius_mm": 35,
                "role": "inside",
            },
        ],
    }
    (folder / "scenario.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def scenario(folder: Path) -> ctrplan.Scenario:
    return ctrplan.load_scenario(folder / "scenario.toml")


@pytest.fixture(scope="module")
def found(scenario: ctrplan.Scenario) -> Placement:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(screening, "SAMPLES", 1500)
        return place(scenario, candidates=24, confirmed=4)


def patch(scenario: ctrplan.Scenario, **keys: Any) -> Patch:
    given: dict[str, Any] = {"along_m": None, "radius_m": 8e-3, "cone_rad": 0.5, "rolls": False, **keys}
    aim = np.asarray(scenario.goal.tip_m)
    return Patch(scenario.base_position_m, aim_m=aim, upright=scenario.base_R, **given)


def some(where: Patch, count: int = 128, seed: int = 0) -> list[BaseFrame]:
    return list(itertools.islice(where.poses(seed), count))


def test_poses_fill_the_patch_and_the_cone_evenly(scenario: ctrplan.Scenario) -> None:
    where = patch(scenario)
    poses = some(where, 256)
    away = np.array([pose.position_m - where.center_m for pose in poses])
    assert np.linalg.norm(away, axis=1).max() <= 8e-3 + 1e-8
    assert np.mean(np.linalg.norm(away, axis=1) <= 4e-3) == pytest.approx(1 / 4, abs=0.02)  # by area
    assert np.abs(away @ (where.aim_m - where.center_m)).max() < 1e-9  # across the way
    ways = np.array([where.aim_m - pose.position_m for pose in poses])
    cosine = np.einsum("ki,ki->k", ways, [pose.direction for pose in poses]) / np.linalg.norm(ways, axis=1)
    assert cosine.min() >= math.cos(0.5) - 1e-9
    assert np.mean(cosine >= (1 + math.cos(0.5)) / 2) == pytest.approx(1 / 2, abs=0.02)  # by solid angle
    for pose in poses[:50]:
        np.testing.assert_allclose(pose.R.T @ pose.R, np.eye(3), atol=1e-12)
    assert all(np.array_equal(a.R, b.R) for a, b in zip(poses[:8], some(where, 8), strict=True))
    assert not np.array_equal(poses[0].R, some(where, 1, seed=1)[0].R)


def test_poses_lie_along_an_opening(scenario: ctrplan.Scenario) -> None:
    other = scenario.base_position_m + [0.03, 0, 0]
    where = patch(scenario, along_m=other, radius_m=0.0)
    shares = np.array([(pose.position_m - where.center_m)[0] / 0.03 for pose in some(where)])
    off = [(pose.position_m - where.center_m)[1:] for pose in some(where)]
    assert np.abs(off).max() < 1e-8 and shares.min() >= 0 and shares.max() <= 1
    assert np.diff(np.sort(shares)).max() < 0.05


def test_a_patch_of_no_size_and_no_cone_is_one_pose(scenario: ctrplan.Scenario) -> None:
    where = patch(scenario, radius_m=0.0, cone_rad=0.0)
    way = (where.aim_m - where.center_m) / np.linalg.norm(where.aim_m - where.center_m)
    for pose in some(where, 5):
        np.testing.assert_allclose(pose.position_m, where.center_m, atol=1e-9)
        np.testing.assert_allclose(pose.direction, way, atol=1e-9)


def test_rolling_the_base_changes_nothing_that_the_screen_says(scenario: ctrplan.Scenario) -> None:
    """All tubes can turn together: that is why two angles are enough."""
    where = patch(scenario)
    screen = Screen(scenario, where, np.random.default_rng(0))
    poses = [pose for pose in some(where, 16) if screen.is_clear(pose)][:8]
    rolled = [BaseFrame(pose.position_m, pose.R @ Rotation.from_euler("z", 1.0).as_matrix()) for pose in poses]
    worths, others = screen.look(poses), screen.look(rolled)
    assert any(worth.likely for worth in worths) and np.ptp([worth.share for worth in worths]) > 0.1
    for worth, other in zip(worths, others, strict=True):
        assert (worth.likely, worth.possible) == (other.likely, other.possible)
        np.testing.assert_allclose([worth.share, worth.room_m], [other.share, other.room_m], rtol=1e-3, atol=1e-5)


def test_poses_are_found_where_the_own_one_reaches_nothing(scenario: ctrplan.Scenario, found: Placement) -> None:
    assert not found.own.reached and found.own.reason and found.poses[0].reached == 1
    assert [pose.rank for pose in found.poses] == sorted(pose.rank for pose in found.poses)
    assert found.drawn >= found.clear == 24 >= found.promising >= 1
    assert f"reaches 1 of 1 targets, the scenario's own {found.own.reached}" in found.sentence
    robot, goal = scenario.robot, scenario.goal
    for pose in (pose for pose in found.poses if pose.reached):
        best = pose.targets[0].best
        assert best is not None
        bound = robot.bound(*robot.drive.collars(best.joints))
        tips = np.array([shape.tip_m for shape in (bound.frictionless, *bound.corners)])
        missed = np.linalg.norm(tips @ pose.R.T + pose.position_m - goal.tip_m, axis=1)  # the worst of all, by hand
        assert missed[0] <= goal.tolerance_m and missed.max() <= pose.targets[0].worst_m + 1e-9
        assert pose.share == pytest.approx(pose.targets[0].worst_m / goal.tolerance_m)
        body = bound.frictionless.centreline_m @ pose.R.T + pose.position_m
        sphere: Any = scenario.anatomy[0].shape
        room = np.linalg.norm(body - sphere.center_m, axis=1) - bound.frictionless.radius_m - sphere.radius_m
        assert pose.clearance_m <= room[bound.frictionless.s_m >= 0].min() + 2e-4  # the grid's step


def test_what_inverse_kinematics_finds_does_not_depend_on_the_roll(found: Placement) -> None:
    best = found.poses[0]
    roll = Rotation.from_euler("z", 2.0).as_matrix()
    rolled = base_pose(placed(best.scenario, BaseFrame(best.position_m, best.R @ roll)), 0)
    assert rolled.reached == 1 and rolled.share == pytest.approx(best.share, abs=0.05)


def test_the_same_seed_finds_the_same_poses(scenario: ctrplan.Scenario) -> None:
    def numbers() -> list[Any]:
        poses = place(scenario, candidates=4, confirmed=2).poses
        return [(pose.position_m.tolist(), pose.R.tolist(), pose.rank) for pose in poses]

    assert numbers() == numbers()


def test_an_interruption_keeps_what_was_found(scenario: ctrplan.Scenario) -> None:
    stop = threading.Event()

    def press(stage: str, share: float) -> None:
        if stage == "confirming" and share > 0:
            stop.set()

    found = place(scenario, candidates=8, confirmed=5, progress=press, interrupted=stop)
    assert found.interrupted and 2 <= len(found.poses) < 5 and "before the interruption" in found.sentence


def test_ranks_put_starting_planning_and_reaching_before_accuracy(found: Placement) -> None:
    best = found.poses[0]
    lost = replace(best, targets=found.own.targets)
    blocked, unplanned = replace(best, start_reason="snaps"), replace(best, plan_reason="no path")

    def shifted(share: float) -> BasePose:
        target = best.targets[0]
        assert target.best is not None
        return replace(best, targets=(replace(target, best=replace(target.best, bound_m=share * 1e-3)),))

    order = [shifted(0.5), shifted(0.7), lost, unplanned, blocked]
    assert sorted(reversed(order), key=lambda pose: pose.rank) == order


def test_the_written_scenario_has_exactly_the_pose(folder: Path, found: Placement, tmp_path: Path) -> None:
    from ctrplan.files.file_content import names_files_outside, placed_scenario
    from ctrplan.storage.toml_document import read_document

    document = read_document(folder / "scenario.toml")
    before = ctrplan.load_scenario(folder / "scenario.toml")
    for file in (folder / "placed.toml", folder / "below.toml", tmp_path / "far.toml"):
        pose = next(pose for pose in found.poses if not pose.is_own)
        file.write_text(placed_scenario(document, pose, file), encoding="utf-8")
        outside = file.parent != folder
        assert names_files_outside(document, file) == outside
        after = ctrplan.load_scenario(file, allow_outside=outside)
        assert np.array_equal(after.base_position_m, pose.position_m) and np.array_equal(after.base_R, pose.R)
        assert after.registration == before.registration and after.robot.sha256 == before.robot.sha256
        np.testing.assert_array_equal(after.goal.tip_m, before.goal.tip_m)


def test_the_command_writes_the_pose_that_is_picked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    command = ["place", "scenario.toml", "--candidates", "8", "--confirm", "3"]
    assert main([*command, "--json", "--set", "goal.tolerance_mm=2"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["poses"][0]["reached"] == 1 and not told["own"]["reached"]
    written = ctrplan.load_scenario("scenario_placed.toml")
    assert written.goal.tolerance_m == 2e-3
    np.testing.assert_allclose(written.base_position_m * 1e3, told["poses"][0]["position_mm"], atol=1e-9)
    assert main([*command, "-o", "mine.toml", "--pick", "7"]) == 2
    out, err = capsys.readouterr()
    assert err == "ctrplan: --pick = 7: there are 3 poses.\n" and "as it is" in out and not Path("mine.toml").exists()


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (
            ["-o", "scenario.toml"],
            2,
            "--output = 'scenario.toml': would write over scenario.toml, which is read: name another place.",
        ),
        (["-o", "none/a.toml"], 2, "--output = 'none/a.toml': must be a file in a folder that exists."),
        (["--cone-deg", "91"], 2, "--cone-deg = 91.0 deg: must be a number from 0 to 90."),
        (["--set", JOINTS_GOAL], 2, "a tip is needed."),
        (
            ["--center-mm", "0", "0", "900", "--candidates", "1"],
            1,
            "scenario.toml: 40 base poses were tried, at each the start is not valid or no target is within reach.",
        ),
    ],
)
def test_bad_input_gets_one_sentence(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    code: int,
    sentence: str,
) -> None:
    monkeypatch.chdir(folder)
    assert main(["place", "scenario.toml", *options]) == code
    assert capsys.readouterr().err.endswith(f"{sentence}\n")


def test_loads_would_turn_along_with_the_base(folder: Path) -> None:
    """They are stated in the robot's frame: poses were proposed as if the world turned with the robot."""
    loaded = ctrplan.load_scenario(folder / "scenario.toml", ["robot.effects.gravity.g_x_m_s2=9.81"])
    with pytest.raises(InputError, match="has loads, which are stated in the robot's frame"):
        place(loaded)


def test_a_turned_base_turns_loads_and_says_so(folder: Path) -> None:
    """Once gravity down the anatomy pulled along the robot where [base] turned that, without a word."""
    down, turned = "robot.effects.gravity.g_z_m_s2=-9.81", "base={direction = [1, 0, 0]}"
    said = ctrplan.load_scenario(folder / "scenario.toml", [down, turned]).warnings
    assert any("effects: has loads, which are in the robot's frame: the base turns them." in note for note in said)
    for calm in ([down, "base={position_mm = [0, 0, 1]}"], [turned]):
        assert not any("loads" in note for note in ctrplan.load_scenario(folder / "scenario.toml", calm).warnings)


def test_arguments_are_checked(scenario: ctrplan.Scenario) -> None:
    for keys in ({"center_m": [0, 0]}, {"along_m": [0, 0, 1e9]}, {"radius_m": -1.0}, {"candidates": 0}):
        with pytest.raises(InputError):
            place(scenario, **keys)  # type: ignore[arg-type]
    with pytest.raises(NoAnswerError, match="base poses were tried"):
        place(scenario, center_m=[0, 0, 0.9], candidates=1)


def test_a_target_just_out_of_reach_is_not_counted_as_reached(folder: Path) -> None:
    """Those within reach come first: with a needle of few joints, poses that nearly reach crowded them out."""
    robot = ctrplan.load_robot(PAIR)
    longest = robot.bound(*robot.drive.collars(np.array([0.0, 0.0, robot.drive.upper[2]]))).frictionless
    tip, onwards = longest.tip_m, longest.tubes[-1].frames[-1, :, 2]
    for beyond_mm, reached in ((-3.0, 1), (1.5, 0)):
        place_mm = (1e3 * tip + beyond_mm * onwards).tolist()
        content = {"robot": "robot.toml", "start": START, "goal": {"tip_mm": place_mm, "tolerance_mm": 1.0}}
        (folder / "free.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
        scenario = ctrplan.load_scenario(folder / "free.toml")
        where = patch(scenario, radius_m=0.0, cone_rad=0.0)
        (worth,) = Screen(scenario, where, np.random.default_rng(0)).look([BaseFrame(np.zeros(3), np.eye(3))])
        assert (worth.likely, worth.reached, worth.possible) == (reached, reached, 1)


def test_poses_that_lack_the_least_room_are_looked_at_first() -> None:
    """In a narrow lumen no pose seems to have room for friction's error; a low bound there is no help."""
    pose = BaseFrame(np.zeros(3), np.eye(3))
    fits = PoseScore(pose, likely=1, reached=1, possible=1, share=3.0, room_m=1e-4)
    nearly = PoseScore(pose, likely=0, reached=1, possible=1, share=2.0, room_m=-1e-4)
    far_from_it = PoseScore(pose, likely=0, reached=1, possible=1, share=0.5, room_m=-2e-3)
    beside_it = PoseScore(pose, likely=0, reached=0, possible=1, share=0.1, room_m=1e-3)
    order = [fits, nearly, far_from_it, beside_it]
    assert sorted(reversed(order), key=lambda worth: worth.rank) == order


def test_a_target_that_is_walled_off_says_where_it_is_tightest(folder: Path) -> None:
    robot = ctrplan.load_robot(PAIR)
    tip = robot.bound(*robot.drive.collars(np.zeros(3))).frictionless.tip_m
    wall = {"kind": "sphere", "center_mm": [0.0, 0.0, 40.0], "radius_mm": 6.0}  # before the plate, around all tubes
    goal = {"tip_mm": (1e3 * tip).tolist(), "tolerance_mm": 1.0}
    content = {"robot": "robot.toml", "start": START, "goal": goal, "anatomy": [wall]}
    (folder / "walled.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    (target,) = base_pose(ctrplan.load_scenario(folder / "walled.toml"), 0).targets
    assert target.solutions and not target.valid
    (said,) = re.findall(r"too close to the anatomy, tightest to anatomy.1 \(sphere\) at \[(.*)\] mm", target.reason)
    place = np.array([float(x) for x in said.split(",")])
    assert np.linalg.norm(place - wall["center_mm"]) < 6.0
