"""The drive is affine in its joints, keeps its limits in SI units, and nesting is what the inequalities say."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Drive, Joint, Kind
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.mechanics.tube import nesting_inequalities
from ctrplan.robot.robot import Robot, nesting_violation

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@pytest.fixture
def robot() -> Robot:
    return load_robot(ROBOTS / "three_tube.toml")


def with_default_drive(*overrides: str) -> Robot:
    content = tomllib.loads((ROBOTS / "three_tube.toml").read_text())
    del content["home"], content["joint"]
    return robot_from_dict(content, overrides=overrides)


def random_drive(rng: np.random.Generator) -> Drive:
    n, m = rng.integers(1, 6, 2)
    kinds: list[Kind] = ["rotation", "translation"]
    joints = tuple(
        Joint(f"{j}", kinds[rng.integers(2)], rng.normal(size=n), -1.0, 1.0, 1.0, 1.0, 1.0) for j in range(m)
    )
    return Drive(joints, rng.normal(size=n), rng.normal(size=n))


def stacked(collars: tuple[Array, Array]) -> Array:
    return np.stack(collars)


@pytest.mark.parametrize("seed", range(50))
def test_collars_are_affine_and_a_batch_is_its_rows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drive = random_drive(rng)
    a, b, t = rng.normal(size=len(drive.joints)), rng.normal(size=len(drive.joints)), rng.normal()
    between = (1 - t) * stacked(drive.collars(a)) + t * stacked(drive.collars(b))
    np.testing.assert_allclose(stacked(drive.collars((1 - t) * a + t * b)), between, rtol=0, atol=1e-13)
    batch = stacked(drive.collars(np.stack([a, b])))
    for row, q in enumerate((a, b)):
        np.testing.assert_allclose(batch[:, row], stacked(drive.collars(q)), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(drive.collars(0 * a), (drive.home_theta_rad, drive.home_l_m))


@pytest.mark.parametrize("seed", range(20))
def test_the_matrices_are_the_slopes_and_a_joint_moves_its_own_kind(seed: int) -> None:
    drive = random_drive(np.random.default_rng(seed))
    for j, joint in enumerate(drive.joints):
        unit = np.eye(len(drive.joints))[j]
        theta, l_b = stacked(drive.collars(unit)) - stacked(drive.collars(0 * unit))
        np.testing.assert_allclose(theta, drive.matrix_theta[:, j], rtol=0, atol=1e-14)
        np.testing.assert_allclose(l_b, drive.matrix_l[:, j], rtol=0, atol=1e-14)
        moved, still = (theta, l_b) if joint.kind == "rotation" else (l_b, theta)
        np.testing.assert_allclose(moved, joint.moves, rtol=0, atol=1e-14)
        assert not still.any()


@pytest.mark.parametrize("q", [[0.0], [[0.0] * 3], np.zeros((2, 2, 4)), 0.0])
def test_joint_values_of_another_shape_are_refused(robot: Robot, q: Any) -> None:
    with pytest.raises(InputError, match=r"^joint values: must have shape \(m,\) or \(K, m\), m = 4 joints, not "):
        robot.drive.collars(q)


def test_limits_and_rates_come_back_in_the_units_of_the_file(robot: Robot) -> None:
    drive, scale = robot.drive, np.array([joint.si_per_unit for joint in robot.drive.joints])
    assert [joint.unit for joint in drive.joints] == ["deg", "deg", "deg", "mm"]
    assert drive.names == ("rotate outer", "rotate middle", "rotate inner", "translate inner")
    assert drive.is_rotation.tolist() == [True, True, True, False]
    assert drive.wraps.tolist() == [False, True, True, False]
    assert drive.lower / scale == pytest.approx([-180, -math.inf, -math.inf, -86.4], rel=1e-15)
    assert drive.upper / scale == pytest.approx([180, math.inf, math.inf, 0], rel=1e-15)
    assert drive.max_velocity / scale == pytest.approx([60, 60, 60, 10], rel=1e-15)
    assert drive.max_acceleration / scale == pytest.approx([240, 240, 240, 50], rel=1e-15)
    assert drive.max_jerk / scale == pytest.approx([2400, 2400, 2400, 500], rel=1e-15)


def test_rates_that_a_joint_omits_have_the_documented_defaults(robot: Robot) -> None:
    content = tomllib.loads((ROBOTS / "three_tube.toml").read_text())
    for joint in content["joint"]:
        for key in [key for key in joint if key.startswith("max_") and "_s" in key]:
            del joint[key]
    drive = robot_from_dict(content).drive  # the shipped robots spell the defaults out
    for name in ("max_velocity", "max_acceleration", "max_jerk"):
        np.testing.assert_array_equal(getattr(drive, name), getattr(robot.drive, name))


def test_nobody_can_change_a_shared_drive(robot: Robot) -> None:
    for array in (robot.drive.lower, robot.drive.matrix_l, robot.drive.home_l_m, robot.clearance_m, robot.friction):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_without_joints_every_tube_rotates_and_reaches_from_plate_to_collar() -> None:
    robot = with_default_drive()
    drive, n = robot.drive, robot.n
    assert drive.names == tuple(f"{move} {i}" for move in ("rotate", "translate") for i in (1, 2, 3))
    assert drive.wraps.tolist() == [True] * n + [False] * n
    np.testing.assert_allclose(drive.home_l_m, [0, -0.017, -0.034], atol=1e-15)
    np.testing.assert_array_equal(drive.matrix_theta, np.eye(n, 2 * n))
    np.testing.assert_array_equal(drive.matrix_l, np.eye(n, 2 * n, n))
    lengths = np.array([tube.length_m for tube in robot.tubes])
    retracted, extended = (drive.collars(np.where(drive.is_rotation, 0, q))[1] for q in (drive.lower, drive.upper))
    np.testing.assert_allclose(retracted + lengths, 0, atol=1e-15)  # all tips at the plate
    np.testing.assert_allclose(extended, drive.home_l_m, atol=1e-15)  # collars touch
    assert nesting_violation(robot, np.zeros(n), extended) is None


def test_one_tube_has_a_default_drive() -> None:
    content = tomllib.loads((ROBOTS / "three_tube.toml").read_text())
    robot = robot_from_dict({"tube": content["tube"][:1]})
    assert robot.drive.names == ("rotate 1", "translate 1")
    assert nesting_violation(robot, [0.0], [-0.01]) is None


def nests(robot: Robot, l_b: Array) -> bool:
    """The rules as the design writes them."""
    lengths = [tube.length_m for tube in robot.tubes]
    pairs = range(robot.n - 1)
    bases = all(l_b[i] - l_b[i + 1] >= robot.tubes[i + 1].collar_length_m for i in pairs)
    tips = all(l_b[i] + lengths[i] <= l_b[i + 1] + lengths[i + 1] for i in pairs)
    return bool(l_b[0] <= 0 and bases and tips)


def test_nesting_is_its_inequalities_and_its_rules() -> None:
    robot = with_default_drive("tube.2.collar_length_mm=5")  # 17 mm would lock tubes 1 and 2 together
    rng = np.random.default_rng(0)
    G, h = nesting_inequalities(robot.tubes)
    outcomes = set()
    for _ in range(2000):
        l_b = robot.drive.home_l_m + rng.uniform(-0.1, 0.02) + rng.uniform(-0.06, 0.01, robot.n)
        expected = nests(robot, l_b)
        outcomes.add(expected)
        assert bool((G @ l_b <= h).all()) == expected == (nesting_violation(robot, np.zeros(robot.n), l_b) is None)
    assert outcomes == {True, False}


def test_nesting_allows_touching_collars_and_flush_tips_and_no_nan(robot: Robot) -> None:
    for q_mm in (0.0, -86.4):
        assert nesting_violation(robot, *robot.drive.collars([0, 0, 0, q_mm * 1e-3])) is None
    assert nesting_violation(robot, np.zeros(3), [0, -0.017, np.nan]) is not None


@pytest.mark.parametrize(
    ("l_mm", "sentence"),
    [
        ([1, -17, -34], "the base of tube 1 at l_1b = 1 mm must be at or behind the plate, l_1b <= 0"),
        (
            [0, -10, -34],
            "the base of tube 2 at l_2b = -10 mm and the base of tube 1 at l_1b = 0 mm "
            "must be at least 17 mm apart, the collar of tube 2",
        ),
        (
            [0, -17, -121],
            "the base of tube 3 (moved by translate inner) at l_3b = -121 mm and the base of tube 2 at l_2b = -17 mm "
            "must keep the tips in order, but tube 3 ends at 149.4 mm and tube 2 at 150 mm",
        ),
    ],
)
def test_a_violation_names_tubes_joints_and_values(robot: Robot, l_mm: list[float], sentence: str) -> None:
    assert nesting_violation(robot, np.zeros(3), np.array(l_mm) * 1e-3) == sentence


@pytest.mark.parametrize(("theta_b", "l_b", "key"), [([0, 0], [0, 0, 0], "theta_b"), ([0, 0, 0], [[0, 0, 0]], "l_b")])
def test_collars_of_another_number_of_tubes_are_refused(robot: Robot, theta_b: Any, l_b: Any, key: str) -> None:
    with pytest.raises(InputError, match=rf"^{key}: must have one value per tube, shape \(3,\), not "):
        nesting_violation(robot, theta_b, l_b)


def test_a_scaled_rotation_counts_its_turns() -> None:
    """q and q + 360 deg were once taken for one place where joint_scale moves the collar by 3 % of a turn."""
    content = load_robot(ROBOTS / "three_tube.toml").content
    plain, scaled, bent = (
        robot_from_dict({**content, "effects": effects}, file=str(ROBOTS / "made_up.toml")).drive
        for effects in ({}, {"joint_scale": {"theta_3": 0.03}}, {"eccentricity": {"sin_3_deg": 5.0}})
    )
    assert plain.wraps.tolist() == plain.is_unlimited.tolist() == bent.wraps.tolist()
    assert scaled.is_unlimited.tolist() == plain.is_unlimited.tolist()
    assert scaled.wraps.tolist() == (plain.wraps & (plain.matrix_theta[2] == 0)).tolist()
    assert 0 < scaled.wraps.sum() < plain.wraps.sum()
