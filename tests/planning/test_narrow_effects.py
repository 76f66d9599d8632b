"""Effects of the drive that change within less than a step of the joints are followed as any other, or refused."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from ball_scenes import FRICTIONLESS, certified, joints, robot, scene
from made_up_input import FUZZ
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import STEP_M, STEP_RAD
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import BOW, JointSpace
from ctrplan.storage.toml_document import read_document

MIDDLE_MM = -61.3  # of what is narrow, in the travel of the inner tube: home is at -34
START, END = joints(0, 20, 60, -45), joints(0, 20, 60, -10)
THERE = joints(0, 20, 60, MIDDLE_MM + 34)


def turning(half_mm: float, **parts: Any) -> dict[str, Any]:
    """A term that turns the inner tube by where it is pushed to."""
    span = [MIDDLE_MM - half_mm, MIDDLE_MM + half_mm]
    return {"stage": "drive", "acts_on": "the rotation of tube 3", "range": {"l_3": span}, **parts}


def reached(of: Robot, at: Array, room_mm: float) -> tuple[list[float], float]:
    """A ball that the tip at joints (m,) would enter by `room_mm`, on the side that effects move it to."""
    plain = robot(**FRICTIONLESS)
    tips = [one.solve(*one.drive.collars(at), accuracy="certificate").tip_m for one in (plain, of)]
    away = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    centre = tips[1] + (0.5e-3 - room_mm * 1e-3 + of.tubes[2].outer_diameter_m / 2) * away
    return (1e3 * centre).tolist(), 0.5


@pytest.mark.parametrize("half_mm", [0.1, 0.01, 1e-4])
@pytest.mark.parametrize("part", ["bump_3_of_5_l_3_deg", "knot_2_of_3_l_3_deg"])
def test_a_bump_between_two_steps_of_the_joints_is_found(part: str, half_mm: float) -> None:
    """Steps of 0.5 mm passed over a bump of 0.2 mm that turns the tube by 10 deg: certified at 0.65 mm, hit by 0.3."""
    bumped = robot(**FRICTIONLESS, effects={"learned_theta_3": turning(half_mm, **{part: 10.0})})
    (problem,) = certified(scene(bumped, START, END, reached(bumped, THERE, 0.3))).problems
    assert "too close" in problem
    free = certified(scene(bumped, START, END, reached(bumped, THERE, -1.0)))
    assert free.valid
    assert 0 < free.min_clearance_m < 1.0e-3


def test_a_bump_of_what_another_effect_moves_is_found() -> None:
    """No joint is where it acts by itself: what reaches it is turned by another effect first."""
    waves = {"stage": "drive", "sin_2_theta_1_deg": 30.0, "range": {"theta_1": [-180, 180]}}
    narrow = {"stage": "drive", "bump_3_of_5_theta_2_deg": 10.0, "range": {"theta_2": [29.95, 30.05]}}
    bumped = robot(**FRICTIONLESS, effects={"learned_theta_2": waves, "learned_theta_3": narrow})
    way = np.array([joints(0, 20, 60, -30), joints(40, 20, 60, -30)])
    at = way[0] + [0.5 * np.arcsin(1 / 3), 0, 0, 0]  # 20 deg + 30 deg sin(2 theta_1)
    assert not certified(scene(bumped, *way, reached(bumped, at, 0.3))).valid
    assert certified(scene(bumped, *way, reached(bumped, at, -1.0))).valid


@pytest.mark.parametrize("mm", [0.5, 0.17])
def test_what_is_narrower_than_play_is_refused(mm: float) -> None:
    """A turn beside the bump, which play reaches at a third of its width: 1.3 mm were certified, and it was hit."""
    effects = {"backlash": {"l_3_mm": 1.0}, "learned_theta_3": turning(0.05, bump_3_of_5_l_3_deg=10.0)}
    ends = THERE - [0, 0, np.radians(1), mm * 1e-3], THERE + [0, 0, np.radians(1), -mm * 1e-3]
    far = [0.0, 0.0, -80.0], 1.0
    (problem,) = certified(scene(robot(**FRICTIONLESS, effects=effects), *ends, far)).problems
    assert "changes within less than play" in problem
    effects["learned_theta_3"] = turning(20.0, bump_3_of_5_l_3_deg=10.0)
    assert certified(scene(robot(**FRICTIONLESS, effects=effects), *ends, far)).valid


@pytest.mark.parametrize("part, off_deg", [("sin_9_theta_1_deg", 20.0), ("sin_3_theta_1_deg", 55.0)])
def test_waves_that_an_interval_passes_over_are_refused(part: str, off_deg: float) -> None:
    """Both ends and the middle of an outer tube that is straight stand where a wave is nothing: 4.1 mm were certified,
    and tube 3 turns by 10 deg in between, which takes the tip into a ball.
    """
    tubes = copy.deepcopy(dict(read_document(ROBOTS / "three_tube.toml").content))["tube"]
    tubes[0]["section"][0]["curvature_y_per_m"] = 0.0
    wave = {"stage": "drive", part: 10.0, "range": {"theta_1": [-180, 180]}}
    homed = {"homing_offset": {"theta_1_deg": 0.0, "ci95": {"theta_1_deg": [-off_deg, off_deg]}}}
    ends = joints(0, 20, 60, -30), joints(0, 20.4, 60.4, -30)
    far = [0.0, 0.0, -80.0], 1.0
    for effects, is_seen in (({**homed, "learned_theta_3": wave}, False), ({"learned_theta_3": wave, **homed}, True)):
        result = certified(scene(robot(**FRICTIONLESS, tube=tubes, effects=effects), *ends, far))
        assert ("changes within less" not in "".join(result.problems)) == is_seen


@pytest.mark.parametrize("seed", range(40) if FUZZ else [3, 4])
def test_collars_stand_on_the_chords_of_steps_whatever_the_effects(seed: int) -> None:
    """Random terms, narrow and wide, multiplied and one after the other, driven at 200,000 places."""
    rng = np.random.default_rng(seed)
    way = np.array([joints(*rng.uniform(-90, 90, 3), -60), joints(*rng.uniform(-90, 90, 3), -10)])
    effects = {f"learned_{target}": _drawn(rng, target, way) for target in ("theta_2", "l_3", "theta_3")}
    drive = robot(effects=effects).drive
    rows, place = JointSpace.of_robot(robot(effects=effects)).straight_steps(way), np.linspace(0, 1, 200_001)
    along = (rows[:, 3] - way[0, 3]) / (way[1, 3] - way[0, 3])
    stand, at_rows = (np.hstack(drive.collars(q)) for q in (way[0] + place[:, None] * (way[1] - way[0]), rows))
    chords = np.array([np.interp(place, along, column) for column in at_rows.T]).T
    size = np.repeat([2 * STEP_RAD, 2 * STEP_M], 3)
    assert (np.abs(stand - chords) / size).max() < 2 * BOW
    assert len(rows) < 2000


def _drawn(rng: np.random.Generator, target: str, way: Array) -> dict[str, Any]:
    unit, most = ("deg", 40.0) if target.startswith("theta") else ("mm", 1.0)
    begin, end = np.degrees(way[:, 0])
    width = 10 ** rng.uniform(-2, 1.5)  # of a range [deg]
    middle = rng.uniform(min(begin, end), max(begin, end))
    low_mm, wide_mm = rng.uniform(-90, -50), 10 ** rng.uniform(-2, 1.5)
    parts = [
        f"{form}_{rng.integers(1, 6)}_of_{rng.integers(5, 10)}_{name}"
        for form in ("bump", "knot")
        for name in ("theta_1", "l_3")
    ]
    parts += ["slope_theta_1", "square_l_3", f"sin_{rng.integers(1, 10)}_theta_1", "cos_2_theta_1"]
    drawn = ["_times_".join(rng.choice(parts, size=size, replace=False)) for size in (1, 2, 2)]
    return {
        "stage": "drive",
        "range": {"theta_1": [middle - width / 2, middle + width / 2], "l_3": [low_mm, low_mm + wide_mm]},
        **{f"{name}_{unit}": float(rng.uniform(-most, most)) for name in drawn},
    }
