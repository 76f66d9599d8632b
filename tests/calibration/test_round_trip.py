"""What a fit writes is what it found: calibrate, write, read and predict give the fit's own prediction.

For every effect that the robot file may have already, alone and beside others, and for the file's own numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from effect_values import OF_CONTINUOUS_MOTIONS, continuous_motion, effects, one_of_each_stage
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration.calibrate import calibrate
from ctrplan.calibration.least_squares import Fit, fit_at
from ctrplan.calibration.parameters import BaseParameters, NamedParameters
from ctrplan.calibration.residuals import Noise
from ctrplan.calibration.robot_content import calibrated_content
from ctrplan.effects.effect import CATALOGUE
from ctrplan.files.robot_file import load_robot, robot_from_dict, write_robot
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

PLAIN = pair_robot(contact=[{"friction_coefficient": 0.1, "clearance_mm": 0.05}])
SAME_M = 2e-7  # numbers in files have six or seven digits
NOISE = Noise(1e-4, 1e-3)
BESIDE = ("homing_offset", "off_plane_precurvature", "clearance", "base_misalignment", "friction")


def data_for(names: Sequence[str]) -> Measurements:
    return continuous_motion() if set(names) & set(OF_CONTINUOUS_MOTIONS) else waypoints(PLAIN, 3)


def fitted(robot: Robot, data: Measurements, terms: Sequence[Term]) -> Fit:
    """A fit that has ended somewhere: wherever that is, it has to be what is written."""
    chain = ParametricChain(robot, data, terms)
    p = chain.neutral + 0.1 * chain.prior * np.resize([1.0, -0.7, 0.4], len(chain.prior))
    return fit_at(chain, NOISE, np.arange(data.count), np.clip(p, chain.lower, chain.upper))


def agrees(found: Fit) -> Robot:
    """The robot that is read again, after checking that it predicts what the fit predicts."""
    chain = found.chain
    of_effects = [t for t in chain.terms if not t.effect.of_the_file]
    again = robot_from_dict(calibrated_content(found, of_effects, chain.data, 0.0))
    here = chain.predict(found.p, derivatives=False)
    for robot in (again, chain.installed_at(found.p)):
        there = ParametricChain(robot, chain.data, []).predict(np.zeros(0), derivatives=False)
        np.testing.assert_allclose(there.position_m, here.position_m, atol=SAME_M)
        np.testing.assert_allclose(there.tangent, here.tangent, atol=1e-5)
    return again


@pytest.mark.parametrize("name", CATALOGUE)
def test_one_parameter_of_an_effect_of_the_file_is_fitted_and_the_others_stay(name: str) -> None:
    given = effects([name], PLAIN)
    robot = robot_from_dict({**PLAIN.content, "effects": given})
    chosen = [p.name for p in CATALOGUE[name].parameters(PLAIN)][-1:]
    again = agrees(fitted(robot, data_for([name]), [term(CATALOGUE[name], chosen, robot)]))
    kept = {key: value for key, value in given[name].items() if key not in chosen}
    assert kept.items() <= again.effects[name].items()
    assert again.effects[name][chosen[0]] != given[name][chosen[0]]


@pytest.mark.parametrize("name", one_of_each_stage())
def test_ordinary_parameters_are_fitted_beside_effects_of_the_file(name: str) -> None:
    names = list(dict.fromkeys([name, *BESIDE]))
    robot = robot_from_dict({**PLAIN.content, "effects": effects(names, PLAIN)})
    base = BaseParameters()
    agrees(fitted(robot, data_for(names), [term(base, [p.name for p in base.parameters(robot)], robot)]))


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_is_added_beside_effects_of_the_file(name: str) -> None:
    beside = [other for other in BESIDE if other != name]
    robot = robot_from_dict({**PLAIN.content, "effects": effects(beside, PLAIN)})
    chosen = [p.name for p in CATALOGUE[name].parameters(PLAIN)]
    again = agrees(fitted(robot, data_for([name]), [term(CATALOGUE[name], chosen, robot)]))
    assert set(again.effects) == {name, *beside}


@pytest.mark.parametrize(
    "number",
    [
        "contact.1.friction_coefficient",
        "contact.1.clearance_m",
        "tube.2.section.2.curvature_y_per_m",
        "tube.2.section.1.length_m",
        "tube.1.bending_stiffness_Nm2",
        "tube.2.poisson_ratio",
    ],
)
@pytest.mark.parametrize("beside", [(), BESIDE])
def test_numbers_of_the_file_are_fitted_beside_effects(number: str, beside: tuple[str, ...]) -> None:
    robot = robot_from_dict({**PLAIN.content, "effects": effects(beside, PLAIN)})
    named = NamedParameters([number], {}, {})
    agrees(fitted(robot, data_for(beside), [term(named, [number], robot)]))


def test_one_offset_of_homing_is_calibrated_and_the_other_stays() -> None:
    """Once only the change of one offset was written, and the other was gone."""
    true = {"theta_1_deg": 5.0, "theta_2_deg": 3.5}
    data = measured(PLAIN, waypoints(PLAIN, 12), {"homing_offset": true}, noise=0.0)
    robot = robot_from_dict({**PLAIN.content, "effects": {"homing_offset": {"theta_1_deg": 5.0, "theta_2_deg": 3.0}}})
    found = calibrate(robot, data, ["effects.homing_offset.theta_2_deg"])
    written = found.robot_content()["effects"]["homing_offset"]
    assert written["theta_1_deg"] == 5.0
    assert written["theta_2_deg"] == pytest.approx(3.5, abs=0.02)


def test_friction_of_the_file_and_of_its_effect_are_one_number() -> None:
    """Once 0.3 was fitted and 0.2 read again."""
    robot = robot_from_dict({**PLAIN.content, "effects": {"friction": {"mu_1": 0.2, "ci95": {"mu_1": [0.1, 0.3]}}}})
    data = measured(PLAIN, waypoints(PLAIN, 12), {"friction": {"mu_1": 0.3}}, noise=0.0)
    found = calibrate(robot, data, ["contact.1.friction_coefficient"])
    again = robot_from_dict(found.robot_content())
    assert again.friction[0, 1] == pytest.approx(0.3, abs=0.01)
    assert again.friction[0, 1] == pytest.approx(found.estimates["contact.1.friction_coefficient"].value, rel=1e-5)
    assert again.effects["friction"]["ci95"] == {}


def test_clearance_of_the_file_is_what_its_effect_is_added_to() -> None:
    """Once 0.07 mm was fitted and 0.09 mm read again."""
    robot = robot_from_dict({**PLAIN.content, "effects": {"clearance": {"delta_1_mm": 0.02}}})
    data = measured(PLAIN, waypoints(PLAIN, 12), {"clearance": {"delta_1_mm": 0.04}}, noise=0.0)
    found = calibrate(robot, data, ["contact.1.clearance_m"])
    again = robot_from_dict(found.robot_content())
    assert again.clearance_m[0] * 1e3 == pytest.approx(0.09, abs=2e-3)
    assert found.robot.clearance_m[0] == pytest.approx(again.clearance_m[0], rel=1e-5)


def test_the_robot_in_python_is_that_of_the_file(tmp_path: Path) -> None:
    """Once it lacked the error that is left and the intervals, and a plan for it could not be opened again."""
    data = measured(
        PLAIN, waypoints(PLAIN, 12), {"homing_offset": {"theta_2_deg": 5.0}, "tip_load": {"force_x_N": 0.1}}
    )
    found = calibrate(PLAIN, data, ["calibration", "effects.homing_offset"])
    write_robot(tmp_path / "robot.toml", found.robot_content())
    read = load_robot(tmp_path / "robot.toml")
    assert found.robot.sha256 == read.sha256 and found.robot.model_error_m == pytest.approx(
        found.model_error_m, rel=1e-6
    )
    assert found.robot.intervals.ci95 == read.intervals.ci95 and "tube.2.poisson_ratio" in read.intervals.ci95
    (tmp_path / "made.toml").write_text(found.robot.to_toml())
    assert load_robot(tmp_path / "made.toml").sha256 == read.sha256
