"""Effects change the measured poses in the way that they state; folders are in the format of measured data."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hidden_effects import drive, effects, sensor
from hidden_effects.bank import cases, make
from hidden_effects.case import Case, true_names
from hidden_effects.chain import Poses, poses
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.effects import Draw
from hidden_effects.experiment import Experiment, approaches, continuous_motion
from hidden_effects.friction import remaining
from hidden_effects.leftover import leftover_over_noise
from hidden_effects.mesh import Fineness
from hidden_effects.noise import NOISE, add_noise
from hidden_effects.world import ROBOTS, Motion, Ordinary, World, believed
from made_up_input import FUZZ

import ctrplan
from ctrplan.diagnosis import CATALOGUE
from ctrplan.drive.legs import Collars

COARSE = Fineness(2e-3, 8e-3, 1.4, 2)
DURATION_S = 100.0


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return approaches(believed(), 2, np.random.default_rng(5))


@pytest.fixture(scope="module")
def plain(experiment: Experiment) -> Poses:
    return poses(believed(), experiment, COARSE)


def draw(size: float = 1.0, seed: int = 0) -> Draw:
    return Draw(size, np.random.default_rng(seed), DURATION_S)


def with_effect(name: str, size: float = 1.0, world: World | None = None) -> World:
    return effects.apply(name, world or believed(), draw(size))[0]


def test_the_catalogue_has_the_nineteen_effects() -> None:
    assert {part for name in effects.CATALOGUE for part in effects.truth_name(name).split("|")} == {
        "friction", "clearance", "translation_release", "nonlinear_elasticity", "off_plane_precurvature",
        "varying_precurvature", "ovality", "tip_load", "gravity", "shaft_torsion", "backlash", "homing_offset",
        "joint_scale", "eccentricity", "base_misalignment", "sensor_offset", "sensor_distortion", "lag", "drift",
    }  # fmt: skip
    named = {name: effects.truth_name(name) for name in effects.UNKNOWN}
    assert all(named.pop(name) == since for name, since in effects.NAMED_SINCE.items())
    assert set(named.values()) == {"unknown"}


EVERY = sorted({*effects.CATALOGUE, *effects.UNKNOWN} - {"lag", "translation_release"})


@pytest.mark.parametrize("name", EVERY if FUZZ else EVERY[::3])
def test_every_effect_changes_poses_and_the_more_the_larger(name: str, experiment: Experiment, plain: Poses) -> None:
    kept = np.tile([True, False, False, False, True], 2)  # approaches of the two configurations
    rows = np.flatnonzero(experiment.measured)[kept]
    some = replace(experiment, measured=np.isin(np.arange(len(experiment.measured)), rows))
    moved = [np.abs(poses(with_effect(name, size), some, COARSE).p - plain.p[kept]).max() for size in (0.5, 2.0)]
    assert 1e-6 < moved[0] < moved[1] < 30e-3


@pytest.mark.parametrize("name", ["eccentricity", "joint_scale", "homing_rotation", "homing_translation", "backlash"])
@pytest.mark.parametrize("seed", range(3 if FUZZ else 1))
def test_true_parameters_of_the_drive_mean_what_a_diagnosis_means_by_them(name: str, seed: int, tmp_path: Path) -> None:
    """An eccentricity's sin and cos were told the wrong way round, and no interval contained them."""
    changed, true = effects.apply(name, believed(), draw(2.0, seed))
    rng, n = np.random.default_rng(seed), believed().n
    turns = rng.uniform(-3.0, 3.0, (12, n))
    motion = Motion(turns, rng.uniform(-0.05, 0.0, (12, n)), np.arange(12.0), np.zeros(12, int))
    moved = changed.drive[-1](motion)
    (tmp_path / "robot.toml").write_text(robot_toml(believed(), "three tubes"))
    found = CATALOGUE[effects.truth_name(name).split("|")[-1]]
    si = {q.name: q.si for q in found.parameters(ctrplan.load_robot(tmp_path / "robot.toml"))}
    values = {key: value * si[key] for key, value in true.items()}
    directions = np.hstack([drive.last_direction(motion), np.zeros((12, n))])
    collars = found.drive(values, Collars(motion.theta, motion.l), directions)
    np.testing.assert_allclose(collars.theta, moved.theta, atol=1e-12)
    np.testing.assert_allclose(collars.l, moved.l, atol=1e-15)


def test_off_plane_precurvature_is_a_homing_offset(experiment: Experiment, plain: Poses) -> None:
    """A tube with one curved section has an exact look-alike, up to the change of the curvature's size."""
    tilted = with_effect("off_plane_precurvature")
    u = np.array(tilted.tubes[-1].sections[-1].curvature_per_m)
    tube = -1 if u[0] else 1
    section = tilted.tubes[tube].sections[-1]
    angle = np.arctan2(-section.curvature_per_m[0], section.curvature_per_m[1])
    turned = replace(section, curvature_per_m=(0.0, float(np.hypot(*section.curvature_per_m))))
    tubes = list(believed().tubes)
    tubes[tube] = replace(tubes[tube], sections=(*tubes[tube].sections[:-1], turned))
    offset = np.zeros(3)
    offset[tube] = angle
    homed = replace(believed(), tubes=tuple(tubes), drive=(drive.Offset(offset, np.zeros(3)),))
    same = poses(homed, experiment, COARSE)
    assert np.abs(poses(tilted, experiment, COARSE).p - plain.p).max() > 0.3e-3
    np.testing.assert_allclose(same.p, poses(tilted, experiment, COARSE).p, atol=1e-6)


def test_friction_depends_on_the_approach_alone(experiment: Experiment, plain: Poses) -> None:
    found = poses(with_effect("friction", 3.0), experiment, COARSE).p.reshape(2, 5, 3)
    released = plain.p.reshape(2, 5, 3)
    np.testing.assert_allclose(found[:, 4], released[:, 4], atol=1e-6)  # after the oscillation
    assert np.linalg.norm(found[:, 0] - found[:, 3], axis=1).min() > 0.2e-3
    np.testing.assert_allclose(released[:, 0], released[:, 4], atol=1e-6)


def test_translation_releases_friction() -> None:
    np.testing.assert_allclose(remaining(np.array([1.0, -1.0]), np.array([0.0, 2e-3]), 2e-3), [1.0, -np.exp(-1)])
    plan = approaches(believed(), 2, np.random.default_rng(6), translate_last=True)
    slid = plan.translated_m[plan.measured]
    assert np.all(slid[:5] == 0) and np.all(slid[5:9, 1] >= 1e-3) and np.all(slid[5:9, 0] == 0)


def motion_of(theta: np.ndarray, sequence: np.ndarray) -> Motion:
    return Motion(theta, 0 * theta, np.arange(len(theta)) * 1.0, sequence)


def test_backlash_is_half_of_it_against_the_last_direction() -> None:
    theta = np.array([[0, 0], [1, 0], [0.5, 0.2], [0.5, 0.2], [0, 0], [-1, 0]])
    motion = motion_of(theta, np.array([0, 0, 0, 0, 1, 1]))
    moved = drive.Backlash(np.array([0.2, 0.4]))(motion).theta - theta
    np.testing.assert_allclose(moved, [[0, 0], [-0.1, 0], [0.1, -0.2], [0.1, -0.2], [0, 0], [0.1, 0]])


def test_decreasing_oscillation_leaves_no_backlash(experiment: Experiment) -> None:
    moved = drive.Backlash(np.array([0, 0.2, 0.2]))(experiment.motion).theta - experiment.motion.theta
    at_poses = moved[experiment.measured].reshape(2, 5, 3)
    np.testing.assert_allclose(at_poses[:, 4], 0, atol=1e-12)
    np.testing.assert_allclose(at_poses[:, 0, 1:], -0.1)
    np.testing.assert_allclose(at_poses[:, 3, 1:], 0.1)


def test_sensor_terms() -> None:
    rng = np.random.default_rng(0)
    p, time_s = rng.normal(0, 0.05, (7, 3)), np.arange(7.0)
    F = np.linalg.qr(rng.standard_normal((7, 3, 3)))[0]
    offset = np.array([1e-3, -2e-3, 0.5e-3])
    np.testing.assert_allclose(
        np.linalg.norm(sensor.TipOffset(offset)(p, F, time_s)[0] - p, axis=1), np.linalg.norm(offset)
    )
    drifted = sensor.Drift(offset)(p, F, time_s)[0] - p
    np.testing.assert_allclose(drifted, time_s[:, None] * offset)
    moved, turned = sensor.Misalignment(np.array([0, 0, np.pi / 2]), offset)(p, F, time_s)
    np.testing.assert_allclose(moved - offset, p @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-12)
    np.testing.assert_allclose(np.swapaxes(turned, 1, 2) @ turned, np.swapaxes(F, 1, 2) @ F, atol=1e-12)
    field = sensor.Distortion(1e-3 * np.eye(3)[:2], 20 * np.eye(3)[:2], np.zeros(2))
    step = 1e-6 * F[:, :, 2]
    along = (field(p + step, F, time_s)[0] - field(p - step, F, time_s)[0]) / 2e-6
    np.testing.assert_allclose(
        field(p, F, time_s)[1][:, :, 2], along / np.linalg.norm(along, axis=1)[:, None], atol=1e-8
    )


@pytest.mark.parametrize("name", ["two tubes", "four tubes"])
def test_robots_of_two_and_four_tubes_are_what_the_model_says(name: str, tmp_path: Path) -> None:
    world = ROBOTS[name]()
    (tmp_path / "robot.toml").write_text(robot_toml(world, name))
    robot = ctrplan.load_robot(tmp_path / "robot.toml")
    plan = approaches(world, 1, np.random.default_rng(1))
    k = np.flatnonzero(plan.measured)
    assert len(k) == 2 ** (world.n - 1) + 1 and np.all(np.abs(plan.motion.l - world.middle_m) <= world.half_m + 1e-12)
    one = replace(plan, measured=np.arange(len(plan.measured)) == k[-1])
    shape = robot.solve(plan.motion.theta[k[-1]], plan.motion.l[k[-1]])
    tip = poses(world, one)
    np.testing.assert_allclose(tip.p[0], shape.tip_m, atol=0.1e-3)
    (tmp_path / "measurements.csv").write_text(measurements_csv(one, tip.p, tip.tangent))
    read = ctrplan.load_measurements(tmp_path / "measurements.csv", robot)
    np.testing.assert_allclose(read.theta_commanded, plan.motion.theta, atol=1e-6)  # nothing is taken for wrapped


def test_lag_reports_where_the_tip_was() -> None:
    plan = continuous_motion(believed(), 17, np.random.default_rng(2))
    plain, late = believed(), replace(believed(), lag_s=0.2)
    now, before = poses(plain, plan, COARSE), poses(late, plan, COARSE)
    np.testing.assert_allclose(before.p[2:], now.p[:-2], atol=1e-9)
    assert np.linalg.norm(before.p - now.p, axis=1).max() > 0.5e-3


def test_recalibration_takes_up_ordinary_parameters_but_not_effects() -> None:
    plan = approaches(believed(), 3, np.random.default_rng(8))
    ordinary = Ordinary((1.01, 0.99, 1.005), (1.0, 1.01, 0.985), (0.31, 0.29, 0.305))
    assert leftover_over_noise(believed(), plan, poses(ordinary.of(believed()), plan, COARSE), COARSE) < 0.02
    lost = leftover_over_noise(believed(), plan, poses(with_effect("base_misalignment", 2.0), plan, COARSE), COARSE)
    assert 0.2 < lost < 10


def test_noise_has_the_stated_size_or_says_by_how_much_it_is_off() -> None:
    rng = np.random.default_rng(0)
    spread = {name: float(np.std(sample(rng, 200_000))) for name, sample in NOISE.items()}
    assert spread["gaussian"] == pytest.approx(1, abs=0.01)
    assert spread["understated"] == pytest.approx(1.5, abs=0.01)
    assert spread["overstated"] == pytest.approx(1 / 1.5, abs=0.01)
    tails = {name: float(np.mean(np.abs(NOISE[name](rng, 100_000)) > 4)) for name in ("gaussian", "heavy")}
    assert tails["heavy"] > 20 * tails["gaussian"] and tails["heavy"] > 1e-3
    p, t = add_noise(np.zeros((20_000, 3)), np.tile([0.0, 0.0, 1.0], (20_000, 1)), "gaussian", rng)
    np.testing.assert_allclose(np.std(p, axis=0), 0.4e-3, rtol=0.03)
    np.testing.assert_allclose(np.linalg.norm(t, axis=1), 1)
    np.testing.assert_allclose(np.rad2deg(np.std(t[:, :2], axis=0)), 0.5, rtol=0.03)


def test_bank_of_folders_is_drawn_from_its_seed_and_resumes(tmp_path: Path) -> None:
    todo = cases(3)
    assert len(todo) >= 200 and len({case.name for case in todo}) == len(todo) and todo == cases(3) != cases(4)
    correlated = [case for case in todo if case.row == "null, correlated"]
    assert len({(case.left, case.continuous) for case in correlated}) == len(correlated) > 10
    assert all(true_names(case) == ["unknown"] for case in correlated)
    case = Case("tiny", "pair", 4, (("tip_load", 1.0), ("backlash", 1.0)), count=2)
    make(tmp_path, [case], jobs=2)
    written = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "tiny").iterdir()}
    assert set(written) == {"robot.toml", "measurements.csv", "truth.json"}
    make(tmp_path, [case])
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "tiny").iterdir()} == written
    truth = json.loads((tmp_path / "tiny" / "truth.json").read_text())
    assert truth["effects"] == ["backlash", "tip_load"] and truth["leftover_over_noise"] > 0
    check_format(tmp_path / "tiny", truth)


def test_positions_alone_are_read_with_their_noise_alone(tmp_path: Path, experiment: Experiment, plain: Poses) -> None:
    (tmp_path / "robot.toml").write_text(robot_toml(believed(), "positions", tangents=False))
    (tmp_path / "measurements.csv").write_text(measurements_csv(experiment, plain.p, None))
    robot = ctrplan.load_robot(tmp_path / "robot.toml")
    data = ctrplan.load_measurements(tmp_path / "measurements.csv", robot)
    assert robot.measurement is not None and robot.measurement.tangent_sigma_rad is None and not data.has_tangents
    np.testing.assert_allclose(data.position_m, plain.p, atol=1e-7)


def check_format(folder: Path, truth: dict[str, Any]) -> None:
    """Checks a folder against the description of measured data."""
    with (folder / "measurements.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    joints = [f"theta_{i}_rad" for i in (1, 2, 3)] + [f"l_{i}_m" for i in (1, 2, 3)]
    pose = ["x_m", "y_m", "z_m", "tx", "ty", "tz"]
    assert list(rows[0]) == ["sequence", "time_s", *joints, *pose]
    measured = [row for row in rows if row["x_m"]]
    assert len(measured) == 10 and all(row[key] == "" for row in rows if row not in measured for key in pose)
    assert np.all(np.diff([float(row["time_s"]) for row in rows]) > 0)
    tips = np.array([[float(row[key]) for key in pose[:3]] for row in measured])
    tangents = np.array([[float(row[key]) for key in pose[3:]] for row in measured])
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1, atol=2e-6)
    spread = np.linalg.norm(tips - np.repeat(tips[::5], 5, axis=0), axis=1)  # backlash and noise
    assert 0.1e-3 < spread.max() < 20e-3 and np.all(np.ptp(tips.reshape(2, 5, 3), axis=1) > 0)
    assert set(truth["ordinary"]) == {"curvature", "stiffness", "poisson_ratio"}
    robot = ctrplan.load_robot(folder / "robot.toml")
    assert robot.measurement is not None and robot.measurement.position_sigma_m == pytest.approx(0.4e-3)
    for tube, true in zip(robot.tubes, believed().tubes, strict=True):
        assert tube.outer_diameter_m == pytest.approx(2 * true.outer_radius_m)
        assert [s.length_m for s in tube.sections] == pytest.approx([s.length_m for s in true.sections])
