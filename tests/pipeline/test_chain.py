"""The chain from commanded joints to measured poses: derivatives, effects that vanish, effects of robot files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import chain_of, pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import CATALOGUE
from ctrplan.errors import InputError, SolverError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements, Poses, frames_along
from ctrplan.mechanics.history import History
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import nesting_violation

ROBOT = pair_robot(contact=[{"friction_coefficient": 0.1}])
DATA = waypoints(ROBOT, 3)


def streamed() -> Measurements:
    """A continuous motion with every waypoint measured."""
    time = np.arange(12) * 0.1
    theta = np.column_stack([0 * time, 0.3 + 1.1 * time + 0.4 * np.sin(4 * time)])
    nothing = np.zeros((12, 3))
    l = np.column_stack([0 * time, -0.02 + 0.004 * time])  # noqa: E741
    return Measurements(np.zeros(12, int), theta, l, np.arange(12), nothing, nothing, time, True)


# Translations move the mesh along, and its elements are cut anew; a release is differentiated with its friction kept.
NOT_EXACT = {"l_1_mm": 5e-3, "l_2_mm": 1e-3, "l_2": 1e-3, "release_per_mm": 0.03}


def data_for(name: str) -> Measurements:
    return streamed() if name in ("lag", "translation_release") else DATA


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_neutral_effect_changes_nothing(name: str) -> None:
    data = data_for(name)
    plain, chain = chain_of(ROBOT, data, {}), chain_of(ROBOT, data, {name: None})
    without, with_it = (c.predict(c.neutral, derivatives=False) for c in (plain, chain))
    by_m, by_rad = (10e-6, 5e-4) if name == "kink" else (5e-6, 1e-4)  # its cells cut the mesh, which errs by 0.3 mm
    np.testing.assert_allclose(with_it.position_m, without.position_m, atol=by_m)
    np.testing.assert_allclose(with_it.tangent, without.tangent, atol=by_rad)


@pytest.mark.parametrize("name", CATALOGUE)
def test_derivatives_are_those_of_the_prediction(name: str) -> None:
    agrees(chain_of(ROBOT, data_for(name), {name: None}))


@pytest.mark.parametrize("name", ["tip_load", "homing_offset"])
def test_derivatives_go_through_a_sensor_of_the_robot_file(name: str) -> None:
    turned = robot_from_dict({**ROBOT.content, "effects": {"base_misalignment": {"rotation_z_deg": 90.0}}})
    agrees(chain_of(turned, DATA, {name: None}))


@pytest.mark.parametrize("name", [name for name, effect in CATALOGUE.items() if effect.overrides("sensor_by")])
def test_columns_that_a_sensor_knows_are_differences_of_what_it_makes(name: str) -> None:
    effect, rng = CATALOGUE[name], np.random.default_rng(2)
    tangent = rng.standard_normal((DATA.count, 3)) * 0.2 + [0.0, 0.0, 1.0]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    poses = Poses(rng.uniform(-0.1, 0.1, (DATA.count, 3)), frames_along(tangent, np.eye(3)[:1]))
    values = {q.name: q.si * (q.neutral + q.prior * rng.uniform(-1, 1)) for q in effect.parameters(ROBOT)}
    by = effect.sensor_by(values, poses)
    assert by.keys() == values.keys()
    for q in effect.parameters(ROBOT):
        step = 1e-4 * q.prior * q.si
        up, down = (effect.sensor({**values, q.name: values[q.name] + s}, poses, DATA) for s in (step, -step))
        seen = np.hstack([up.position - down.position, (up.frame - down.frame)[:, :, 2]]) / (2 * step)
        np.testing.assert_allclose(by[q.name], seen, rtol=1e-6, atol=1e-7)


def agrees(chain: ParametricChain) -> None:
    p = inside(chain)
    found = chain.predict(p)
    for j in range(chain.slices()[1].start, len(p)):
        step = np.zeros_like(p)
        step[j] = 2e-4 * chain.prior[j]
        up, down = (chain.predict(p + s, derivatives=False).position_m for s in (step, -step))
        by = (up - down) / (2 * step[j])
        scale = np.abs(by).max() + 1e-6 / chain.prior[j]
        within = NOT_EXACT.get(chain.parameters[j].name, 1e-4)
        np.testing.assert_allclose(found.position_by[:, :, j], by, atol=within * scale)


def inside(chain: ParametricChain) -> Array:
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


def close_collars() -> Measurements:
    """A continuous motion that ends with the bases 0.1 mm apart."""
    data = streamed()
    data.l_commanded[:, 1] = np.linspace(-0.01, -0.1e-3, len(data.l_commanded))
    return data


def test_a_stream_is_followed_where_a_fit_pushes_collars_together() -> None:
    chain = chain_of(ROBOT, close_collars(), {"homing_offset": ["l_2_mm"], "sensor_offset": None})
    p = chain.neutral.copy()
    p[chain.slices()[1]] = 0.2e-3
    assert chain.collars(p).l[-1, 1] > 0
    assert np.isfinite(chain.predict(p).position_m).all()
    correction = friction_correction(chain, p)
    assert correction is not None and correction.phi is not None
    assert np.abs(correction.phi - chain.friction_state(p)).max() > 0.01


@pytest.mark.parametrize("tau_s", [-0.25, 0.25])
def test_the_robot_rests_before_a_run_begins_and_after_it_ends(tau_s: float) -> None:
    data = streamed()
    chain = chain_of(ROBOT, data, {"lag": None})
    p = chain.neutral.copy()
    p[-1] = tau_s
    commanded = chain.at(p).clock(data)
    at = np.clip(data.time_s[data.rows] - tau_s, data.time_s[0], data.time_s[-1])
    for found, given in ((commanded.theta, data.theta_commanded), (commanded.l, data.l_commanded)):
        for column, values in zip(found.T, given.T, strict=True):
            np.testing.assert_allclose(column, np.interp(at, data.time_s, values), atol=1e-12)


def test_a_stream_without_a_start_is_not_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    def follow(*_: object) -> None:
        raise SolverError("no equilibrium was found at the start of the history")

    chain = chain_of(ROBOT, streamed(), {})
    monkeypatch.setattr(History, "follow", follow)
    correction = friction_correction(chain, chain.neutral)
    assert correction is not None and not np.any(correction.shift_m) and not np.any(correction.turn)
    np.testing.assert_array_equal(correction.phi, chain.friction_state(chain.neutral))


def test_compliant_shafts_find_room_where_bases_touch() -> None:
    data = waypoints(ROBOT, 2)
    data.l_commanded[:] = 0.0
    chain = chain_of(ROBOT, data, {"shaft_torsion": None})
    found, plain = (c.predict(c.start, derivatives=False) for c in (chain, chain_of(ROBOT, data, {})))
    assert found.sound.all()
    np.testing.assert_allclose(found.position_m, plain.position_m, atol=5e-5)
    compliant = chain.robot_at(chain.start)
    violation = nesting_violation(compliant, [0.0, 0.0], [0.0, 0.0])
    assert violation is not None and "room for the compliant shaft of tube 1" in violation
    for plate in (0.0, -0.013, -0.051):  # whatever is rounded
        there = nested(compliant, np.full((1, 2), plate))[0]
        assert nesting_violation(compliant, [0.0, 0.0], there) is None
        assert compliant.zero_clearance([0.0, 1.0], there).status == 0


def test_shafts_are_not_testable_between_tubes_of_one_length() -> None:
    content = dict(ROBOT.content)
    inner = {**content["tube"][1], "section": content["tube"][0]["section"]}
    robot = robot_from_dict({**content, "tube": [content["tube"][0], inner]})
    assert "equally long" in CATALOGUE["shaft_torsion"].untestable(robot, DATA)
    assert not CATALOGUE["shaft_torsion"].untestable(ROBOT, DATA)


def test_an_effect_whose_column_is_missing_does_not_act() -> None:
    timeless = replace(DATA, time_s=None)
    late = robot_from_dict({**ROBOT.content, "effects": {"lag": {"tau_s": 0.1}}})
    found, plain = (chain_of(r, timeless, {}) for r in (late, ROBOT))
    tips, expected = (c.predict(c.neutral, derivatives=False).position_m for c in (found, plain))
    np.testing.assert_array_equal(tips, expected)
    with pytest.raises(InputError, match="effects.lag: needs a column time_s"):
        chain_of(ROBOT, timeless, {"lag": None})
