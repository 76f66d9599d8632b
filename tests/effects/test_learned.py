"""Built terms as effects of a robot file: held at the edge of their ranges, allowed for in margins, read strictly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_data import pair_robot, waypoints

from ctrplan.drive.legs import Collars
from ctrplan.effects.learned.inputs import InputRange, Situation, Target
from ctrplan.effects.learned.learned import LearnedSensor, effect_of, learned, named
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Poses
from ctrplan.pipeline.chain import range_notes
from ctrplan.robot.robot import Robot
from ctrplan.uncertainty.parameters import uncertain_parameters

RIPPLE = {"sin_3_theta_2_deg": 4.0, "range": {"theta_2": [-180.0, 180.0]}}
GUIDE = {"slope_l_2_deg": 6.0, "square_l_2_deg": -2.0, "range": {"l_2": [-30.0, -10.0]}}


def with_terms(**tables: dict[str, Any]) -> Robot:
    return pair_robot(effects={f"learned_{name}": table for name, table in tables.items()})


def turned_deg(robot: Robot, theta_2_deg: float, l_2_mm: float) -> float:
    """By how much tube 2 is turned further than commanded."""
    theta_b, _ = robot.collars([0.0, np.radians(theta_2_deg)], [0.0, l_2_mm * 1e-3])
    return float(np.degrees(theta_b[1])) - theta_2_deg


def test_a_coefficient_is_the_amount_and_a_wave_has_its_period() -> None:
    robot = with_terms(theta_2=RIPPLE)
    assert turned_deg(robot, 30.0, -20.0) == pytest.approx(4.0)
    for angle in (7.0, 133.0, -95.0):
        assert turned_deg(robot, angle, -20.0) == pytest.approx(turned_deg(robot, angle + 120.0, -20.0))


def test_terms_are_held_at_the_edge_of_their_range() -> None:
    robot = with_terms(theta_2=GUIDE)
    assert turned_deg(robot, 0.0, -10.0) == pytest.approx(6.0 - 2.0) == turned_deg(robot, 0.0, -4.0)
    assert turned_deg(robot, 0.0, -30.0) == pytest.approx(-6.0 - 2.0) == turned_deg(robot, 0.0, -33.0)
    assert turned_deg(robot, 0.0, -20.0) == pytest.approx(0.0)
    # a wave that has seen a quarter of a turn is held there too, whole turns apart or not
    part = with_terms(theta_2={"sin_1_theta_2_deg": 4.0, "range": {"theta_2": [0.0, 60.0]}})
    assert turned_deg(part, 100.0, -20.0) == pytest.approx(turned_deg(part, 60.0, -20.0))
    assert turned_deg(part, 30.0 - 360.0, -20.0) == pytest.approx(turned_deg(part, 30.0, -20.0))


def test_leaving_a_range_is_said_in_one_sentence_and_only_then() -> None:
    robot = with_terms(theta_2=GUIDE)
    assert range_notes(robot, [0.0, 1.0], [0.0, -0.02]) == ()
    (note,) = range_notes(robot, [[0.0, 1.0]] * 2, [[0.0, -0.02], [0.0, -0.004]])
    assert note.startswith("learned_theta_2 was built from data with l_2 from -30 to -10 mm; here l_2 reaches -4 mm")
    assert range_notes(with_terms(theta_2=RIPPLE), [0.0, 9.0], [0.0, -0.004]) == ()
    assert range_notes(pair_robot(), [0.0, 1.0], [0.0, -0.004]) == ()


def test_splines_are_one_at_their_knots_and_reproduce_lines() -> None:
    span, at = {"l_2": InputRange(-30.0, -10.0)}, np.linspace(-0.03, -0.01, 31)
    joints = Situation(np.zeros((31, 2)), np.column_stack([0 * at, at]))
    on, names = Target("theta", 2), [f"knot_{k}_of_4_l_2_deg" for k in (1, 2, 3, 4)]
    spline, line = learned(on, names, span, 2), learned(on, ["slope_l_2_deg"], span, 2)
    values = dict(zip(names, np.linspace(-1.0, 1.0, 4), strict=True))
    np.testing.assert_allclose(spline.amount(values, joints), line.amount({"slope_l_2_deg": 1.0}, joints), atol=1e-12)
    for k, name in enumerate(names):
        assert spline.amount({name: 1.0}, joints)[10 * k, 0] == pytest.approx(1.0)


def test_margins_allow_for_what_shapes_do_not_have() -> None:
    plain, plan = pair_robot(), waypoints(pair_robot(), 6)
    tilt = {"x_slope_l_2_deg": 1.0, "y_sin_1_theta_2_deg": -2.0, "range": {"l_2": [-30, 0], "theta_2": [-180, 180]}}
    robot = with_terms(plate=tilt)
    effect = effect_of("learned_plate", tilt, 2)
    values = {"x_slope_l_2_deg": np.radians(1.0), "y_sin_1_theta_2_deg": np.radians(-2.0)}
    turn = effect.plate_turn(values, plain, Collars(plan.theta_commanded, plan.l_commanded))
    assert turn is not None
    largest = effect.largest_turn_rad(values, plain)
    assert np.linalg.norm(turn, axis=1).max() <= largest < 2 * np.linalg.norm(turn, axis=1).max()
    reach = max(tube.length_m for tube in plain.tubes)
    assert robot.model_error_m == pytest.approx(largest * reach)


@pytest.mark.parametrize(("ends", "percent"), [([2.0, 6.0], 6.0), ([-9.0, 3.5], 9.0), ([1.0, 3.0], 3.0)])
def test_a_built_property_is_anything_up_to_its_most_at_any_pose(ends: list[float], percent: float) -> None:
    """Margins were what it moved tips by in its data, whatever the pose; now it is an interval, as wide as its own."""
    table = {"slope_l_2_percent": 3.0, "range": {"l_2": [-30, 0]}, "largest_mm": 0.7}
    robot = with_terms(curvature_2={**table, "ci95": {"slope_l_2_percent": ends}})
    given, most = uncertain_parameters(robot), percent / 100
    k = given.names.index("effects.learned_curvature_2.anywhere")
    assert robot.model_error_m == 0 and given.value[k] == 0
    assert -given.low[k] == given.high[k] >= most == pytest.approx(given.high[k], rel=0.3)
    for share in (given.low[k], given.high[k]):
        changed = given.robot_at(share * np.eye(given.count)[k])
        for section, own in zip(changed.tubes[1].sections, robot.tubes[1].sections, strict=True):
            assert section.curvature_per_m == pytest.approx(own.curvature_per_m * (1 + share))


@pytest.mark.parametrize(
    ("table", "counting"),
    [
        (RIPPLE, []),
        ({"knot_4_of_5_theta_2_deg": 12.0, "range": {"theta_2": [-180, 180]}}, [2]),  # nothing at 0 and at a turn
        ({"slope_theta_2_times_slope_l_2_deg": 12.0, "range": {"theta_2": [-180, 180], "l_2": [-5, 5]}}, [2]),
        ({"knot_4_of_5_turn_2_deg": 12.0, "range": {"turn_2": [-180, 180]}}, [1, 2]),
    ],
)
def test_a_whole_turn_is_another_place_where_a_term_is_other_there(table: dict[str, Any], counting: list[int]) -> None:
    """Rotations that count turns are those of tubes on whose angle the term depends, whatever it is at zero."""
    robot = with_terms(theta_2=table)
    once, again = (turned_deg(robot, 90.0 + turn, -21.0) for turn in (0.0, 360.0))
    assert (abs(once - again) > 0.1) == bool(counting)
    assert robot.drive.wraps.tolist() == [tube not in counting for tube in (1, 2)] + [False, False]


def test_play_covers_a_term_that_depends_on_the_way() -> None:
    table = {"sign_theta_2_deg": 2.0, "slope_l_2_times_sign_theta_2_deg": 3.0, "range": {"l_2": [-30, 0]}}
    robot, effect = with_terms(theta_2_way=table), effect_of("learned_theta_2_way", table, 2)
    assert robot.drive.play is not None and not robot.drive.terms
    values = {name: np.radians(value) for name, value in table.items() if isinstance(value, float)}
    rng = np.random.default_rng(3)
    nowhere = Collars(np.zeros((50, 2)), rng.uniform(-0.04, 0.01, (50, 2)))
    moved = effect.drive(values, nowhere, rng.choice([-1.0, 1.0], (50, 4)))
    assert np.abs(moved.theta[:, 1]).max() <= robot.drive.play[0][1]
    assert not effect.drive(values, nowhere, np.zeros((50, 4))).theta.any()


def test_a_sensor_reads_further_by_the_term_and_as_before_where_nobody_knows_its_input() -> None:
    on = Target("sensor")
    effect = learned(on, named(on, "slope_temperature_C"), {"temperature_C": InputRange(18.0, 24.0)}, 2)
    assert isinstance(effect, LearnedSensor) and not effect.missing_columns(None, {})
    data = waypoints(pair_robot(), 2)
    poses = Poses(np.zeros((data.count, 3)), np.tile(np.eye(3), (data.count, 1, 1)))
    values = {"x_slope_temperature_C_mm": 2e-3}
    np.testing.assert_allclose(effect.sensor(values, poses, data).position, 0.0)


def test_half_waves_over_the_time_are_nothing_where_nobody_knows_it() -> None:
    on, span = Target("sensor"), {"time": InputRange(0.0, 90.0)}
    effect = learned(on, named(on, "cos_2_over_time"), span, 2)
    assert isinstance(effect, LearnedSensor)
    data = waypoints(pair_robot(), 2)
    poses = Poses(np.zeros((data.count, 3)), np.tile(np.eye(3), (data.count, 1, 1)))
    timed = replace(data, time_s=np.linspace(-10.0, 100.0, len(data.sequence)))
    values = {"x_cos_2_over_time_mm": 2e-3}
    along = np.clip(timed.time_s[data.rows], 0.0, 90.0) / 90.0
    np.testing.assert_allclose(effect.sensor(values, poses, timed).position[:, 0], 2e-3 * np.cos(2 * np.pi * along))
    np.testing.assert_allclose(effect.sensor(values, poses, replace(data, time_s=None)).position, 0.0)


@pytest.mark.parametrize(
    ("name", "table", "said"),
    [
        ("theta_2", {**RIPPLE, "sin_3_theta_9_deg": 1.0}, r"sin_3_theta_9_deg = 1.0 deg: is no part of a built term"),
        ("theta_2", {**RIPPLE, "sin_3_theta_2_mm": 1.0}, "is no part of a built term"),
        ("theta_2", {"slope_load_1_deg": 1.0, "range": {"load_1": [-1, 1]}}, "load_1, which a drive does not know"),
        ("theta_2", {"slope_l_2_deg": 1.0}, r"must have l_2 = \[lowest, highest\]"),
        ("theta_2", {"slope_l_2_deg": 1.0, "range": {"l_2": [3.0, -3.0]}}, "must have l_2"),
        ("theta_2", {**RIPPLE, "sign_theta_2_deg": 1.0}, "is no part of a built term"),
        ("theta_2", {**RIPPLE, "formula": 3}, "must be a text"),
        ("theta_2", {**RIPPLE, "sin_3_theta_2_deg": 1e6}, "must be from -60 to 60"),
        ("theta_7", RIPPLE, "is no term of this robot"),
        ("love", RIPPLE, "is no term of this robot"),
        ("plate", {"slope_l_2_deg": 1.0, "range": {"l_2": [-3.0, 3.0]}}, "AXIS_PART_deg"),
    ],
)
def test_tables_are_read_strictly(name: str, table: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        with_terms(**{name: table})
