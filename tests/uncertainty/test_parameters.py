"""Intervals of robot files: read, refused in one sentence, written by calibrations and read again."""

from __future__ import annotations

import numpy as np
import pytest
from measured_data import chain_of, measured, pair_robot, waypoints
from places import SCENARIOS

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.uncertainty.parameters import CI95, UncertainParameters, uncertain_parameters

PAIR = pair_robot()
ROBOT = SCENARIOS / "robots" / "three_tube.toml"


def stated(ci95: dict[str, list[float]], **more: object) -> UncertainParameters:
    return uncertain_parameters(robot_from_dict({**PAIR.content, "uncertainty": {"ci95": ci95, **more}}))


def test_intervals_are_read_in_si_and_in_the_units_of_the_file() -> None:
    effects = {
        "friction": {"mu_1": 0.2, "ci95": {"mu_1": [0.1, 0.3]}},
        "homing_offset": {"theta_2_deg": 1.0, "ci95": {"theta_2_deg": [0.0, 2.0]}},
        "base_misalignment": {"shift_x_mm": 1.0, "ci95": {"shift_x_mm": [0.0, 2.0]}},  # moves no robot
    }
    content = {**PAIR.content, "effects": effects, "uncertainty": {"ci95": {"tube.2.section.1.length_mm": [29, 31]}}}
    found = uncertain_parameters(robot_from_dict(content))
    assert found.names == (
        "tube.2.section.1.length_m", "effects.friction.mu_1", "effects.homing_offset.theta_2_deg",
    )  # fmt: skip
    np.testing.assert_allclose(found.value, [0.03, 0.2, np.radians(1)])
    np.testing.assert_allclose(found.half_width, [1e-3, 0.1, np.radians(1)])
    assert found.unit == ("mm", "", "deg")
    assert found.title[:2] == ("length of tube 2", "friction")


def test_an_interval_of_friction_of_a_contact_is_left_to_the_bound() -> None:
    content = {**PAIR.content, "contact": [{"friction_coefficient": [0.1, 0.3]}]}
    assert uncertain_parameters(robot_from_dict(content)).count == 0


def test_a_magnitude_keeps_its_direction() -> None:
    parameters = stated({"tube.2.section.2.curvature_per_m": [8, 10]})
    section = parameters.robot_at(np.array([1.0])).tubes[1].sections[1]
    assert (section.curvature_x_per_m, section.curvature_y_per_m) == pytest.approx((0.0, 10.0))


@pytest.mark.parametrize(
    ("override", "rule"),
    [
        ("uncertainty.ci95.tube.2.poisson_ratio=[0.4, 0.5]", "must contain its value"),
        ("uncertainty.ci95.tube.2.poisson_ratio=[0.4, 0.2]", "low <= high"),
        ("uncertainty.ci95.tube.2.poisson_ratio=[nan, 0.4]", "finite"),
        ("uncertainty.ci95.tube.2.poisson_ratio=0.3", "must be an interval"),
        ("uncertainty.ci95.tube.2.colour=[0, 1]", "is no number of this file"),
        ("uncertainty.ci95.tube.9.poisson_ratio=[0.2, 0.4]", "is no number of this file"),
        ("uncertainty.ci95.tube.2.section.1.curvature_per_m=[0, 1]", "no direction"),
        ("effects.friction.ci95.mu_1=[0.3, 0.4]", "must contain its value"),
        ("effects.friction.ci95.mu_9=[0.1, 0.4]", "unknown parameter"),
        ("effects.friction.ci95.mu_1=[-0.1, 0.4]", "must be from 0 to 1"),
        ("effects.friction.ci95=3", "must be a table of intervals"),
        ('uncertainty.correlated=["tube.1.poisson_ratio"]', "has no 95 % interval"),
        ("uncertainty.correlation=[[1.0]]", "must be 0 rows"),
    ],
)
def test_what_is_no_interval_is_refused_in_one_sentence(override: str, rule: str) -> None:
    with pytest.raises(InputError) as refusal:
        load_robot(ROBOT, [override])
    assert rule in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize("correlation", ["[[1, 2], [2, 1]]", "[[1, 0.5], [0.1, 1]]", "[[2, 0], [0, 1]]", "[[1, 0]]"])
def test_what_is_no_correlation_is_refused(correlation: str) -> None:
    names = ["tube.1.poisson_ratio", "tube.2.poisson_ratio"]
    given = [f"uncertainty.ci95.{name}=[0.2, 0.4]" for name in names]
    with pytest.raises(InputError, match="correlation"):
        load_robot(ROBOT, [*given, f"uncertainty.correlated={names}", f"uncertainty.correlation={correlation}"])


@pytest.mark.parametrize("override", ["base.position_sigma_mm=-1", "base.rotation_sigma_deg=nan"])
def test_a_registration_that_can_not_be_is_refused(override: str) -> None:
    with pytest.raises(InputError, match="base."):
        load_scenario(SCENARIOS / "ribs.toml", [override])


def test_draws_have_the_stated_spread_and_correlation_and_stay_physical() -> None:
    names = ["tube.1.poisson_ratio", "tube.2.poisson_ratio"]
    ci95 = {names[0]: [0.2, 0.4], names[1]: [0.25, 0.35], "contact.1.friction_coefficient": [0.0, 0.2]}
    parameters = stated(ci95, correlated=names, correlation=[[1, -0.8], [-0.8, 1]])
    drawn = parameters.drawn(np.random.default_rng(1), 20_000)
    np.testing.assert_allclose(drawn[:, :2].std(axis=0), [0.1 / CI95, 0.05 / CI95], rtol=0.03)
    assert np.corrcoef(drawn[:, :2].T)[0, 1] == pytest.approx(-0.8, abs=0.03)
    assert drawn[:, 2].min() >= 0.0  # friction 0 is the file's: one half of the normal remains
    assert np.quantile(drawn[:, 2], 0.95) == pytest.approx(0.2, rel=0.05)


def test_measuring_one_of_two_errors_that_go_together_narrows_the_other() -> None:
    names = ["tube.1.poisson_ratio", "tube.2.poisson_ratio"]
    parameters = stated({name: [0.2, 0.4] for name in names}, correlated=names, correlation=[[1, 0.6], [0.6, 1]])
    left = parameters.measured(np.array([True, False]))
    assert left.names == (names[1],)
    assert left.half_width[0] == pytest.approx(0.1 * 0.8)


@pytest.fixture(scope="module")
def calibrated() -> tuple[UncertainParameters, Array]:
    """Parameters read again from the file of a calibration, and the covariance of its fit."""
    truth = {"calibration": {"precurvature_factor_1_1": 1.05, "poisson_ratio_2": 0.35}, "friction": {"mu_1": 0.2}}
    data = measured(PAIR, waypoints(PAIR, 12), truth)
    names = [
        *(p.name for p in chain_of(PAIR, data, {}).parameters if p.name[-8:] != "factor_1"),
        "effects.friction.mu_1",
    ]
    found = calibrate(PAIR, data, names, held_out=0.0)
    return uncertain_parameters(robot_from_dict(found.robot_content())), found.fit.covariance


def test_intervals_of_a_calibration_come_back_from_its_file(calibrated: tuple[UncertainParameters, Array]) -> None:
    """Intervals were once written nowhere, and that of friction was dropped when the file was read."""
    parameters, covariance = calibrated
    assert "tube.1.section.1.curvature_per_m" in parameters.names and "effects.friction.mu_1" in parameters.names
    assert parameters.count == len(covariance)
    spread = np.sqrt(np.diag(covariance))
    friction = parameters.names.index("effects.friction.mu_1")
    assert parameters.half_width[friction] == pytest.approx(CI95 * spread[-1], rel=1e-3)
    curvature = parameters.names.index("tube.1.section.1.curvature_per_m")
    assert parameters.half_width[curvature] == pytest.approx(5.0 * CI95 * spread[0], rel=1e-3)
    shared = covariance[0, -1] / spread[0] / spread[-1]
    assert parameters.correlation[curvature, friction] == pytest.approx(shared, abs=1e-3)


def test_a_second_pass_keeps_the_intervals_of_the_first() -> None:
    data = measured(PAIR, waypoints(PAIR, 10), {"friction": {"mu_1": 0.2}})
    both = calibrate(PAIR, data, ["poisson_ratio_1"], second_pass=["effects.friction.mu_1"])
    one = calibrate(PAIR, data, ["poisson_ratio_1"])
    name = "tube.1.poisson_ratio"
    twice, once = (robot_from_dict(found.robot_content()).intervals.ci95 for found in (both, one))
    np.testing.assert_allclose(twice[name], once[name], rtol=1e-6)
