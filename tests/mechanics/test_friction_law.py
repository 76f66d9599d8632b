"""The friction law: how it loads and releases, what bounds it, and how near it comes to simulated histories."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS

import ctrplan
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.friction import FrictionLaw, largest_deviation, released_share, tip_deviations
from ctrplan.robot.friction_calibration import HISTORIES, _digest, fit, friction_law, misses, simulated_paths

LAW = FrictionLaw(loading_rad=np.array([0.3, 0.5]), release_m=np.array([0.2e-3, 0.4e-3]))
TIMES = np.linspace(0, 1, 60)[:, None]


def leg(turn: list[float], slide_mm: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Waypoints (K, 3) of a straight leg of three tubes."""
    return TIMES * turn, TIMES * np.multiply(slide_mm, 1e-3)


def test_rotation_loads_linearly_up_to_the_limit() -> None:
    phi = LAW.follow(*leg([0, 1.0, 1.0], [0, 0, 0]), np.array([0.0, 0.25]))
    np.testing.assert_allclose(phi[:, 0], np.minimum(TIMES[:, 0] / 0.3, 1), atol=1e-9)
    np.testing.assert_allclose(phi[:, 1], 0.25)  # its tubes turn together


def test_translation_releases_moving_pairs_and_never_a_locked_one() -> None:
    phi = LAW.follow(*leg([0, 0, 0], [0, 0, -2]), np.array([1.0, -1.0]))
    np.testing.assert_array_equal(phi[:, 0], 1.0)
    expected = released_share(np.array(1.0), TIMES[:, 0] * 2e-3 / 0.4e-3)
    np.testing.assert_allclose(-phi[:, 1], expected, atol=0.05)  # an implicit step of first order
    assert expected[-1] == pytest.approx(2 * np.exp(-6), rel=0.01)  # 2 exp(-x - 1) in the long run


def test_release_goes_on_where_it_stopped() -> None:
    for load in (1.0, 0.6, 0.05):
        whole = released_share(np.array(load), np.array(2.3))
        parts = released_share(released_share(np.array(load), np.array(1.1)), np.array(1.2))
        assert parts == pytest.approx(float(whole), rel=1e-3)


def test_rotation_during_translation_keeps_the_share_of_its_slip() -> None:
    radius = LAW.release_m[1] / LAW.loading_rad[1]
    phi = LAW.follow(*leg([0, 0, 6.0], [0, 0, 8]), np.array([0.0, -1.0]))[-1, 1]
    assert np.tan(np.arcsin(phi)) == pytest.approx(radius * 6.0 / 8e-3, rel=1e-6)


def test_a_step_solves_its_equation_from_no_slide_to_a_long_one() -> None:
    """One backward Euler step by `advance`, near the limit and far from it, against bisection."""
    rng, law = np.random.default_rng(5), FrictionLaw(np.ones(1), np.ones(1))
    trial = rng.choice([-1.0, 1.0], 4000) * 10 ** rng.uniform(-8, 2, 4000)
    trial[:2000] = np.sign(trial[:2000]) * (1 + rng.normal(size=2000) * 10 ** rng.uniform(-16, -1, 2000))
    slide = np.where(rng.random(4000) < 0.1, 0.0, 10 ** rng.uniform(-35, 4, 4000))
    low, high = np.full(4000, -np.pi / 2), np.full(4000, np.pi / 2)
    for _ in range(60):
        middle = (low + high) / 2
        above = np.sin(middle) + slide * np.tan(middle) > trial
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    phi = law.advance(np.zeros((4000, 1)), trial[:, None], slide[:, None])
    np.testing.assert_allclose(phi[:, 0], np.sin((low + high) / 2), atol=1e-12)


def test_every_start_stays_between_the_corners_and_below_the_load_left() -> None:
    rng = np.random.default_rng(3)
    for _ in range(6):
        turn, slide = rng.uniform(-1.5, 1.5, 3) * rng.integers(0, 2, 3), rng.uniform(-4, 4, 3) * rng.integers(0, 2)
        theta_b, l_b = leg(list(turn), list(slide))
        starts = np.array([[-1, -1], [0.3, -0.8], [1, 1]])
        low, some, high = np.moveaxis(LAW.follow(theta_b, l_b, starts), 1, 0)
        assert np.all(low <= some + 1e-9) and np.all(some <= high + 1e-9)
        left = LAW.load_left(np.array([0.3, 0.8]), theta_b[[0, -1]], l_b[[0, -1]], TIMES[:, 0])
        assert np.all(np.abs(some) <= left + 0.02)
        full = LAW.load_left(np.ones(2), theta_b[[0, -1]], l_b[[0, -1]], TIMES[:, 0])
        assert np.all(full <= 1) and np.all(left <= full + 1e-12)


def test_deviations_are_exact_at_corners_and_without_friction() -> None:
    rng = np.random.default_rng(0)
    corners, tip = rng.normal(size=(5, 4, 3)), rng.normal(size=(5, 3))
    for k, phi in enumerate(([1, 1], [1, -1], [-1, 1], [-1, -1])):
        np.testing.assert_allclose(tip_deviations(corners, tip, np.tile(phi, (5, 1))), corners[:, k] - tip, atol=1e-12)
    np.testing.assert_allclose(tip_deviations(corners, tip, np.zeros((5, 2))), 0, atol=1e-12)
    worst = np.linalg.norm(corners - tip[:, None], axis=2).max(axis=1)
    np.testing.assert_allclose(largest_deviation(corners, tip, np.ones((5, 2))), worst)


def test_calibrated_law_predicts_histories_it_has_not_seen() -> None:
    """Errors on other histories."""
    robot = ctrplan.load_robot(ROBOTS / "table_5_pair.toml")
    law = fit(robot, simulated_paths(robot, HISTORIES, np.random.default_rng(0)))
    unseen = simulated_paths(robot, 5, np.random.default_rng(9))
    errors = np.concatenate([misses(law, path) for path in unseen])
    away = np.concatenate([np.linalg.norm(path.tip_m - path.frictionless_m, axis=1) for path in unseen])
    assert np.sqrt(np.mean(errors**2)) < 0.15 * np.sqrt(np.mean(away**2))


def test_law_is_kept_on_disk_and_a_damaged_one_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("ctrplan.robot.friction_calibration.HISTORIES", 1)
    first = friction_law(ctrplan.load_robot(ROBOTS / "table_1_pair.toml"))
    (stored,) = (tmp_path / "friction_laws").glob("*.json")
    content = stored.read_text()
    assert friction_law(ctrplan.load_robot(ROBOTS / "table_1_pair.toml")).loading_rad == first.loading_rad
    stored.write_text(content[:20])
    again = friction_law(ctrplan.load_robot(ROBOTS / "table_1_pair.toml"))
    assert again.loading_rad == first.loading_rad and stored.read_text() == content


def test_single_tube_has_no_pairs_and_no_law() -> None:
    law = FrictionLaw(np.ones(0), np.ones(0))
    assert tip_deviations(np.ones((2, 1, 3)), np.ones((2, 3)), np.ones((2, 0))).shape == (2, 3)
    assert law.load_left(np.ones(0), np.zeros((2, 1)), np.zeros((2, 1)), np.ones(3)).shape == (3, 0)


def test_a_law_belongs_to_what_the_drive_makes_of_joints() -> None:
    robot = ctrplan.load_robot(ROBOTS / "table_5_pair.toml")
    offsets = [{"homing_offset": {"theta_2_deg": angle}} for angle in (3.0, 4.0)]
    moved = [robot_from_dict({**robot.content, "effects": effects}) for effects in offsets]
    assert len({_digest(r) for r in (robot, *moved)}) == 3
    assert _digest(moved[0]) == _digest(robot_from_dict(moved[0].content))
