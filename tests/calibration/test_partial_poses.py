"""Poses of which not everything was measured: positions alone, and tangents seen along an axis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import SIGMA_M, chain_of, measured, pair_robot, waypoints, write_csv
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.calibration.least_squares import fit
from ctrplan.calibration.residuals import Noise, residuals
from ctrplan.diagnosis import CATALOGUE, diagnose
from ctrplan.diagnosis.adequacy import adequacy
from ctrplan.diagnosis.workbench import linear
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
TRUE = {"calibration": {"precurvature_factor_1_1": 1.06, "stiffness_factor_2": 1.15}}
NOISE = Noise(1e-3, 0.05)  # large, so that no pose is an outlier and none shares the errors of the solver


@pytest.fixture(scope="module")
def data() -> Measurements:
    return measured(ROBOT, waypoints(ROBOT, 14), TRUE)


def seen(data: Measurements, axes: list[int]) -> Measurements:
    """The tangents with some components only."""
    tangent = np.full_like(data.tangent, np.nan)
    tangent[:, axes] = data.tangent[:, axes] / np.linalg.norm(data.tangent[:, axes], axis=1, keepdims=True)
    return replace(data, tangent=tangent)


def without_tangents(data: Measurements) -> Measurements:
    return replace(data, tangent=np.full_like(data.tangent, np.nan))


def test_a_position_alone_counts_as_three_numbers_and_says_what_it_said(data: Measurements) -> None:
    chain, alone = chain_of(ROBOT, data, {}), without_tangents(data)
    prediction, group = chain.predict(chain.neutral), np.arange(data.count)
    whole, part = (residuals(d, prediction, NOISE, group) for d in (data, alone))
    np.testing.assert_allclose(part.r[:, :3], whole.r[:, :3], atol=1e-9)
    np.testing.assert_allclose(part.J[:, :3], whole.J[:, :3], rtol=1e-9)
    assert not part.r[:, 3:].any() and not part.J[:, 3:].any()
    found = fit(chain_of(ROBOT, alone, {}), Noise(SIGMA_M, 0.05), alone.configuration)
    left = adequacy(linear(found), alone.configuration, np.zeros(alone.count, bool))
    assert left.total.p > 1e-3 and left.tangent.dof == 0 and left.total.dof == left.position.dof < 3 * alone.count


def turned(tangent: Array, axis: Array, angle: float) -> Array:
    return np.asarray(Rotation.from_rotvec(angle * axis).apply(tangent))


def test_a_tangent_seen_along_an_axis_tells_turns_about_it_alone(data: Measurements) -> None:
    chain, sight = chain_of(ROBOT, data, {}), np.array([0.0, 1.0, 0.0])
    prediction = chain.predict(chain.neutral)
    flat, group, angle = seen(replace(data, tangent=prediction.tangent), [0, 2]), np.arange(data.count), 0.02
    about = residuals(flat, replace(prediction, tangent=turned(prediction.tangent, sight, angle)), NOISE, group)
    inside = np.hypot(*prediction.tangent[:, [0, 2]].T)
    shrink = about.r[:, 3] / (angle * inside / NOISE.tangent_rad)
    assert np.abs(shrink) == pytest.approx(1.0, rel=0.01)
    tilt = np.cross(sight, prediction.tangent)
    tilt /= np.linalg.norm(tilt, axis=1, keepdims=True)
    towards = np.array([turned(t, a, angle) for t, a in zip(prediction.tangent, tilt, strict=True)])
    assert np.abs(residuals(flat, replace(prediction, tangent=towards), NOISE, group).r[:, 3:]).max() < 1e-6
    assert not about.r[:, 4].any() and not about.J[:, 4].any()


def test_derivatives_of_what_is_seen_are_those_of_differences(data: Measurements) -> None:
    flat, group, h = seen(data, [0, 1]), np.arange(data.count), 1e-4
    chain = chain_of(ROBOT, flat, {})
    here = residuals(flat, chain.predict(chain.neutral), NOISE, group)
    up, down = (
        residuals(flat, chain.predict(chain.neutral + side * h * np.eye(len(chain.neutral))[0]), NOISE, group)
        for side in (1, -1)
    )
    np.testing.assert_allclose(here.J[:, 3, 0], (down.r - up.r)[:, 3] / (2 * h), atol=0.01)


@pytest.mark.parametrize("change", [without_tangents, lambda data: seen(data, [0, 2])])
def test_parameters_come_back_from_partial_poses(change: object, data: Measurements) -> None:
    found = calibrate(ROBOT, change(data))  # type: ignore[operator]
    for name, true in TRUE["calibration"].items():
        low, high = found.estimates[name].ci95
        assert low - 0.3 * (high - low) < true < high + 0.3 * (high - low)
    assert found.held_out is not None and found.held_out.rms_m < 1.3 * np.sqrt(3) * SIGMA_M


def test_an_effect_is_named_from_positions_alone() -> None:
    plan = waypoints(ROBOT, 18)
    data = without_tangents(measured(ROBOT, plan, TRUE | {"backlash": {"theta_2_deg": 8.0}}))
    robot = robot_from_dict(
        {k: v for k, v in ROBOT.content.items() if k != "measurement"}
        | {"measurement": {"position_sigma_mm": SIGMA_M * 1e3}}
    )
    few = {name: CATALOGUE[name] for name in ("backlash", "homing_offset", "sensor_offset")}
    found = diagnose(robot, data, catalogue=few)
    assert found.verdict == "named" and [f.term.name for f in found.judgement.findings] == ["backlash"]
    assert found.gap.after.rms_m < 1.5 * found.gap.floor_m


def test_files_may_lack_tangents_wholly_by_row_or_in_one_component(tmp_path: Path, data: Measurements) -> None:
    write_csv(tmp_path / "whole.csv", data)
    lines = [line.split(",") for line in (tmp_path / "whole.csv").read_text().splitlines()]
    header = lines[0]

    def written(name: str, columns: list[str], blank: int | None = None) -> Measurements:
        kept = [header.index(column) for column in header if column not in columns]
        rows = [[line[k] for k in kept] for line in lines]
        if blank is not None:
            rows[blank + 1][-3:] = [""] * 3
        (tmp_path / name).write_text("\n".join(",".join(row) for row in rows))
        return load_measurements(tmp_path / name, ROBOT)

    bare = written("bare.csv", ["tx", "ty", "tz"])
    assert not bare.has_tangents and bare.count == data.count
    np.testing.assert_array_equal(bare.position_m, data.position_m)
    flat = written("flat.csv", ["ty"])
    np.testing.assert_array_equal(flat.given[:, 3:], [[True, False]] * data.count)
    assert any("no ty" in warning and "seen along y" in warning for warning in flat.warnings)
    partly = written("partly.csv", [], blank=int(data.rows[0]))
    assert not partly.given[0, 3:].any() and partly.given[1:].all()
