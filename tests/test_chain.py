"""The chain from commanded joints to measured poses: derivatives, effects that vanish, effects of robot files."""

from __future__ import annotations

import numpy as np
import pytest
from measured_data import chain_of, pair_robot, waypoints

from ctrplan.chain import Chain
from ctrplan.diagnosis.effect import CATALOGUE
from ctrplan.drive import Array
from ctrplan.measurements import Measurements
from ctrplan.robot import robot_from_dict

ROBOT = pair_robot(contact=[{"friction_coefficient": 0.1}])
DATA = waypoints(ROBOT, 3)


def streamed() -> Measurements:
    """A continuous motion with every waypoint measured."""
    time = np.arange(12) * 0.1
    theta = np.column_stack([0 * time, 0.3 + 1.1 * time + 0.4 * np.sin(4 * time)])
    nothing = np.zeros((12, 3))
    l = np.column_stack([0 * time, -0.02 + 0.004 * time])  # noqa: E741
    return Measurements(np.zeros(12, int), theta, l, np.arange(12), nothing, nothing, time, True)


def data_for(name: str) -> Measurements:
    return streamed() if name in ("lag", "translation_release") else DATA


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_neutral_effect_changes_nothing(name: str) -> None:
    data = data_for(name)
    plain, chain = chain_of(ROBOT, data, {}), chain_of(ROBOT, data, {name: None})
    without, with_it = (c.predict(c.neutral, derivatives=False) for c in (plain, chain))
    np.testing.assert_allclose(with_it.position_m, without.position_m, atol=5e-6)
    np.testing.assert_allclose(with_it.tangent, without.tangent, atol=1e-4)


@pytest.mark.parametrize("name", CATALOGUE)
def test_derivatives_are_those_of_the_prediction(name: str) -> None:
    chain = chain_of(ROBOT, data_for(name), {name: None})
    p = inside(chain)
    found = chain.predict(p)
    for j in range(chain.slices()[1].start, len(p)):
        step = np.zeros_like(p)
        step[j] = 2e-4 * chain.prior[j]
        up, down = (chain.predict(p + s, derivatives=False).position_m for s in (step, -step))
        by = (up - down) / (2 * step[j])
        scale = np.abs(by).max() + 1e-6 / chain.prior[j]
        np.testing.assert_allclose(found.position_by[:, :, j], by, atol=0.03 * scale)


def inside(chain: Chain) -> Array:
    """Values away from neutral and from bounds, where everything is smooth."""
    rng = np.random.default_rng(4)
    p = chain.neutral + 0.2 * chain.prior * rng.uniform(0.5, 1.0, len(chain.prior))
    for j, parameter in enumerate(chain.parameters):
        if parameter.name in ("stiffness_fraction", "strain_percent"):
            p[j] = 0.6 * parameter.si
        if parameter.name == "l_1_mm":  # the base of tube 1 can't be in front of the plate
            p[j] = -1.0 * parameter.si
    return np.clip(p, chain.lower + 0.01 * chain.prior, chain.upper - 0.01 * chain.prior)


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_in_the_robot_file_is_the_effect_of_the_chain(name: str) -> None:
    data = data_for(name)
    fitted = chain_of(ROBOT, data, {name: None})
    p = inside(fitted)
    base = fitted.slices()[0]
    p[base] = fitted.neutral[base]
    values = {q.name: float(v / q.si) for q, v in zip(fitted.parameters, p, strict=True)}
    table = {q.name: values[q.name] for q in CATALOGUE[name].parameters(ROBOT)}
    given = chain_of(robot_from_dict({**ROBOT.content, "effects": {name: table}}), data, {})
    there, here = given.predict(given.neutral, derivatives=False), fitted.predict(p, derivatives=False)
    np.testing.assert_allclose(there.position_m, here.position_m, atol=1e-8)
    np.testing.assert_allclose(there.tangent, here.tangent, atol=1e-6)


def test_a_homing_offset_moves_what_the_drive_reaches() -> None:
    robot = robot_from_dict({**ROBOT.content, "effects": {"homing_offset": {"theta_2_deg": 5.0, "l_2_mm": -1.0}}})
    plain, moved = ROBOT.drive.collars(np.zeros(4)), robot.drive.collars(np.zeros(4))
    np.testing.assert_allclose(np.degrees(moved[0] - plain[0]), [0, 5])
    np.testing.assert_allclose((moved[1] - plain[1]) * 1e3, [0, -1])
    many = robot.drive.collars(np.zeros((3, 4)))
    assert many[0].shape == many[1].shape == (3, 2)
    np.testing.assert_allclose(many[0][1], moved[0])


def test_off_plane_precurvature_is_an_angle_offset_of_a_tube_that_is_curved_all_along() -> None:
    off, homing = (
        chain_of(ROBOT, DATA, {"off_plane_precurvature": None}),
        chain_of(ROBOT, DATA, {"homing_offset": None}),
    )
    p, q = off.neutral.copy(), homing.neutral.copy()
    names = [parameter.name for parameter in off.parameters]
    angle, u = np.radians(8.0), 9.0
    p[names.index("delta_2_2_per_m")] = -u * np.tan(angle)
    p[names.index("precurvature_factor_2_2")] = 1.0
    q[[parameter.name for parameter in homing.parameters].index("theta_2_deg")] = angle
    q[[parameter.name for parameter in homing.parameters].index("precurvature_factor_2_2")] = 1 / np.cos(angle)
    a, b = off.predict(p, derivatives=False), homing.predict(q, derivatives=False)
    np.testing.assert_allclose(a.position_m, b.position_m, atol=1e-6)
