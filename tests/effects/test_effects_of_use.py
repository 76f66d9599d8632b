"""Effects of time, speed, use and of the front plate: each by a law of its own."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_data import SIGMA_M, chain_of, measured, pair_robot, waypoints
from scipy.integrate import solve_bvp

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import CATALOGUE
from ctrplan.effects.learned.parts import LARGEST
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.shapes import largest_plate_moment, plate_moment
from ctrplan.pipeline.parametric_chain import ParametricChain

ROBOT = pair_robot(contact=[{"friction_coefficient": 0.3}])
PLAIN = pair_robot()


def log(speed: float = 1.0, rest_s: float = 0.0) -> Measurements:
    """A turn of the inner tube by 120 degrees at 10 Hz that slides besides, then a rest; poses are zero."""
    moving = np.arange(21) / 10 / speed
    time_s = np.concatenate([moving, moving[-1] + np.arange(1, 11) * rest_s / 10]) if rest_s else moving
    theta = np.interp(time_s, moving, np.linspace(0.5, 0.5 + 2.1, 21))
    slide = np.interp(time_s, moving, np.linspace(-0.02, -0.01, 21))
    nothing = np.zeros((len(time_s), 3))
    joints = np.column_stack([0 * theta, theta]), np.column_stack([0 * theta - 3e-3, slide])
    return Measurements(
        np.zeros(len(time_s), int), *joints, np.arange(len(time_s)), nothing, nothing, time_s, is_stream=True
    )


def tips(data: Measurements, effect: str | None = None, robot: object = ROBOT, **values: float) -> Array:
    """Predicted positions with an effect's values in the units of their names."""
    chain = chain_of(robot, data, {effect: list(values)} if effect else {})  # type: ignore[arg-type]
    p = chain.neutral.copy()
    for j, parameter in enumerate(chain.parameters):
        p[j] = values.get(parameter.name, parameter.neutral) * parameter.si
    return np.asarray(chain.predict(p, derivatives=False).position_m)


def test_friction_creeps_away_at_rest() -> None:
    data = log(rest_s=50.0)
    full, gone = tips(data), tips(data, "relaxation", released_share=1.0, time_s=2.0)
    free = tips(data, robot=PLAIN)
    np.testing.assert_allclose(gone[:21], full[:21], atol=1e-9)  # nothing rests yet
    left = np.linalg.norm(gone - free, axis=1)[20:] / np.linalg.norm(full - free, axis=1)[20:]
    assert np.all(np.diff(left) < 0) and left[-1] < 1e-3
    assert left[1] == pytest.approx(np.exp(-5.0 / 2.0), abs=0.02)  # friction is small: deviations follow it


def test_friction_falls_with_speed_to_its_share() -> None:
    values = {"moving_share": 0.4, "speed_deg_s": 10.0}
    fast, slow = log(speed=100.0), log(speed=1e-3)
    np.testing.assert_allclose(tips(slow, "friction_speed", **values)[1:], tips(slow)[1:], atol=1e-5)
    less = robot_from_dict({**ROBOT.content, "contact": [{"friction_coefficient": 0.4 * 0.3}]})
    free, full = tips(fast, robot=PLAIN), tips(fast)
    np.testing.assert_allclose(
        tips(fast, "friction_speed", **values)[1:],
        tips(fast, robot=less)[1:],
        atol=0.02 * np.linalg.norm(full - free, axis=1).max(),
    )


def test_equal_delays_of_the_drive_are_one_of_the_tracker() -> None:
    data = log()
    both, tracker = tips(data, "drive_lag", theta_s=0.13, l_s=0.13), tips(data, "lag", tau_s=0.13)
    np.testing.assert_allclose(both, tracker, atol=1e-12)
    assert np.abs(tips(data, "drive_lag", theta_s=0.13) - tracker).max() > 1e-4


def test_precurvature_is_lost_with_use_alone() -> None:
    data = waypoints(PLAIN, 6)
    new = tips(data, "precurvature_loss", PLAIN, loss_2_percent=2.0)
    worn = tips(data, robot=PLAIN)
    curved = chain_of(PLAIN, data, {})
    p = curved.neutral.copy()
    p[[q.name for q in curved.parameters].index("precurvature_factor_2_2")] = 1.02
    more = curved.predict(p, derivatives=False).position_m
    np.testing.assert_allclose(new[-1], worn[-1], atol=1e-9)
    assert np.linalg.norm(new[0] - worn[0]) == pytest.approx(np.linalg.norm(more[0] - worn[0]), rel=0.15)
    later = replace(data, time_s=None if data.time_s is None else 7 * data.time_s)
    np.testing.assert_allclose(tips(later, "precurvature_loss", PLAIN, loss_2_percent=2.0), new)  # no matter of time


def test_a_tube_bent_behind_the_plate_leaves_it_as_a_supported_beam_does() -> None:
    curvature, length = 2.0, 0.03

    def beam(s: Array, y: Array) -> Array:  # deflection, slope, curvature, its slope: no load between the supports
        return np.vstack([y[1], y[2], y[3], 0 * s])

    def ends(a: Array, b: Array) -> Array:  # clamped; supported, where the moment EI (y'' - curvature) vanishes
        return np.array([a[0], a[1], b[0], b[2] - curvature])

    slope = solve_bvp(beam, ends, np.linspace(0, length, 20), np.zeros((4, 20))).sol(length)[1]
    collars = Collars(np.array([[0.0, 1.0], [np.pi / 2, 1.0]]), np.array([[-length, -0.05], [-length, -0.05]]))
    turn = CATALOGUE["bent_base"].plate_turn({"curvature_x_per_m": curvature}, PLAIN, collars)
    np.testing.assert_allclose(turn, slope * np.eye(3)[:2], atol=1e-9)  # and turns with tube 1


def drawn_back(turn: float) -> Collars:
    """The curved section of the inner tube, which begins 30 mm from its base, 5 mm inside the plate."""
    return Collars(np.array([[0.2, turn]]), np.array([[0.0, -0.035]]))


def test_the_plate_yields_to_curved_sections_inside_it_alone() -> None:
    inner = PLAIN.tubes[1]
    straight = plate_moment(PLAIN.tubes[1:], np.zeros((1, 1)), np.array([[-0.02]]))
    assert not straight.any()
    moment = plate_moment(PLAIN.tubes[1:], np.array([[0.7]]), np.array([[-0.045]]))  # all of the guide is filled
    assert np.linalg.norm(moment) == pytest.approx(inner.bending_stiffness_Nm2 * 9.0)
    turns = [CATALOGUE["plate_compliance"].plate_turn({"compliance_rad_per_Nm": 0.1}, PLAIN, drawn_back(a))
             for a in (0.0, np.pi)]  # fmt: skip
    np.testing.assert_allclose(turns[0], -np.asarray(turns[1]), atol=1e-12)


def test_play_in_the_plate_tilts_by_its_room_and_no_more() -> None:
    effect, room = CATALOGUE["plate_clearance"], np.radians(1.5)
    turn = effect.plate_turn({"tilt_deg": room}, PLAIN, drawn_back(0.3))
    assert turn is not None and 0.8 * room < np.linalg.norm(turn) < room
    assert effect.largest_turn_rad({"tilt_deg": room}, PLAIN) == room
    compliance = CATALOGUE["plate_compliance"]
    assert compliance.largest_turn_rad({"compliance_rad_per_Nm": 0.1}, PLAIN) == 0.1 * largest_plate_moment(PLAIN.tubes)


@pytest.mark.parametrize("name", ["plate_clearance", "plate_compliance", "bent_base"])
def test_a_turned_plate_moves_the_tip_rigidly_and_plans_allow_for_it(name: str) -> None:
    data = waypoints(PLAIN, 4)
    values = {p.name: p.prior for p in CATALOGUE[name].parameters(PLAIN)}
    robot = robot_from_dict({**PLAIN.content, "effects": {name: values}})
    drawn = replace(data, l_commanded=data.l_commanded + [-4e-3, -0.03])
    turned, plain = tips(drawn, robot=robot), tips(drawn, robot=PLAIN)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(plain, axis=1), rtol=1e-9)
    moved = np.linalg.norm(turned - plain, axis=1).max()
    assert 1e-6 < moved < robot.model_error_m


@pytest.mark.parametrize("said", [0.1, 0.0])
@pytest.mark.parametrize("name", ["plate_clearance", "plate_compliance", "bent_base"])
def test_plans_allow_for_the_largest_turn_of_the_plate_within_what_is_stated(name: str, said: float) -> None:
    """Every number at the end of its interval where the plate turns most, also of a plate that the file's value alone
    would not let turn: the stiffness of tubes was left at its own value there.
    """

    def kept_m(values: dict[str, Any], curvature: float, **more: Any) -> float:
        content = copy.deepcopy({**PLAIN.content, "effects": {name: values}, **more})
        content["tube"][1]["section"][-1]["curvature_y_per_m"] = curvature
        return robot_from_dict(content).model_error_m

    least, most = ({p.name: scale * p.prior for p in CATALOGUE[name].parameters(PLAIN)} for scale in (said, 1.0))
    ci95 = {key: [0.0, value] for key, value in most.items()}
    curvature = PLAIN.tubes[1].sections[-1].curvature_y_per_m
    number = f"tube.2.section.{len(PLAIN.tubes[1].sections)}.curvature_y_per_m"
    stated = {"ci95": {number: [0.9 * curvature, 1.2 * curvature]}}
    found = kept_m({**least, "ci95": ci95}, curvature, uncertainty=stated)
    assert found == pytest.approx(kept_m(most, 1.2 * curvature)) and found > 2 * kept_m(least, curvature)


def test_plans_allow_for_what_a_built_property_bends_the_plate_by() -> None:
    """A tube that is curved by a tenth more somewhere bears on the plate by a tenth more."""
    content = {**PLAIN.content, "effects": {"plate_compliance": {"compliance_rad_per_Nm": 0.1}}}
    moments = [t.bending_stiffness_Nm2 * max(s.curvature_per_m for s in t.sections) for t in PLAIN.tubes]
    more = {"slope_l_2_percent": 4.0, "range": {"l_2": [-30, 0]}, "ci95": {"slope_l_2_percent": [2.0, 10.0]}}
    built = copy.deepcopy({**content, "effects": {**content["effects"], "learned_curvature_2": more}})
    bent, plain = (robot_from_dict(each).model_error_m for each in (built, content))
    assert bent / plain == pytest.approx(1 + LARGEST * 0.1 * moments[1] / sum(moments), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [("precurvature_loss", {"loss_1_percent": 4.0, "loss_2_percent": -3.0}), ("bent_base", {"curvature_x_per_m": 3.0})],
)
def test_fits_find_them(name: str, values: dict[str, float]) -> None:
    plan = waypoints(PLAIN, 12)
    plan = replace(
        plan, l_commanded=plan.l_commanded + np.where(np.arange(len(plan.sequence)) % 45 < 20, -0.01, 0)[:, None]
    )
    data = measured(PLAIN, plan, {name: values})
    found = calibrate(PLAIN, data, ["calibration", f"effects.{name}"])
    for key, true in values.items():
        low, high = found.estimates[key].ci95
        assert low - 0.3 * (high - low) < true < high + 0.3 * (high - low)
    assert found.held_out is not None and found.held_out.rms_m < 1.4 * np.sqrt(3) * SIGMA_M


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("friction_speed", {"moving_share": 0.6, "speed_deg_s": 20.0}),
        ("relaxation", {"released_share": 0.5, "time_s": 3.0}),
        ("drive_lag", {"theta_s": 0.12, "l_s": 0.05}),
        ("precurvature_loss", {"loss_1_percent": 2.0, "loss_2_percent": -3.0}),
        ("plate_clearance", {"tilt_deg": 0.7}),
        ("plate_compliance", {"compliance_rad_per_Nm": 0.2}),
        ("bent_base", {"curvature_x_per_m": 1.5, "curvature_y_per_m": -0.5}),
    ],
)
def test_derivatives_are_those_of_differences(name: str, values: dict[str, float]) -> None:
    data = log(rest_s=5.0)
    data = replace(data, l_commanded=data.l_commanded - [0.0, 0.02])
    beside = {"homing_offset": ["theta_2_deg"], "base_misalignment": ["rotation_x_deg"]}  # of other stages
    chain: ParametricChain = chain_of(ROBOT, data, {**beside, name: list(values)})
    p = chain.neutral.copy()
    p[-len(values) :] = [values[q.name] * q.si for q in chain.parameters[-len(values) :]]
    found = chain.predict(p)
    for j in range(len(p) - len(values), len(p)):
        h = 2e-3 * chain.prior[j] * np.eye(len(p))[j]
        up, down = (chain.predict(p + side * h, derivatives=False).position_m for side in (1, -1))
        by = (up - down) / (2 * h[j])
        size = np.abs(by).max()
        assert size > 0
        np.testing.assert_allclose(found.position_by[:, :, j], by, atol=0.03 * size)
