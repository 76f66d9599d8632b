"""Tubes that end inside others: the robot's tip is where the foremost of them ends."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import SIGMA_M, measured, pair_robot, waypoints, write_csv

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import nests, reach_inequalities
from ctrplan.robot.robot import Robot

TUBES = (  # outer and inner diameter, stiffness, sections: length [mm], curvature [1/m]
    (2.6, 2.3, 0.05, [(20.0, 0.0), (70.0, 4.0)]),
    (2.2, 1.9, 0.03, [(40.0, 0.0), (80.0, 7.0)]),
    (1.8, 1.5, 0.01, [(60.0, 0.0), (90.0, 14.0)]),
)


def robot_of(count: int, *, retractable: bool = True, friction: float = 0.0, clearance_mm: float = 0.05) -> Robot:
    tubes = [
        {
            "outer_diameter_mm": outer,
            "inner_diameter_mm": inner,
            "bending_stiffness_Nm2": stiffness,
            "poisson_ratio": 0.3,
            "retractable": retractable and i > 0,
            "section": [
                {"length_mm": mm, "curvature_x_per_m": 0, "curvature_y_per_m": curvature} for mm, curvature in sections
            ],
        }
        for i, (outer, inner, stiffness, sections) in enumerate(TUBES[:count])
    ]
    contact = {"friction_coefficient": friction, "clearance_mm": clearance_mm}
    return robot_from_dict({"tube": tubes, "contact": [contact] * (count - 1)})


def planar_tip(robot: Robot, l_b: Array) -> Array:
    """Tip of tubes bent in one plane that do not twist: arcs of the mean curvature of the tubes that are there."""
    stations = {0.0}
    for tube, begin in zip(robot.tubes, l_b, strict=True):
        stations |= {begin + x for x in np.cumsum([0.0, *(section.length_m for section in tube.sections)]).tolist()}
    places = sorted(s for s in stations if s >= 0)
    x = z = angle = 0.0
    for a, b in zip(places, places[1:], strict=False):
        middle, moment, stiffness = (a + b) / 2, 0.0, 0.0
        for tube, begin in zip(robot.tubes, l_b, strict=True):
            ends = begin + np.cumsum([section.length_m for section in tube.sections])
            if begin < middle < ends[-1]:
                section = tube.sections[int(np.searchsorted(ends, middle))]
                moment += tube.bending_stiffness_Nm2 * section.curvature_y_per_m
                stiffness += tube.bending_stiffness_Nm2
        curvature, h = moment / stiffness, b - a
        half = np.sinc(curvature * h / 2 / np.pi) * h
        x, z = x + half * np.sin(angle + curvature * h / 2), z + half * np.cos(angle + curvature * h / 2)
        angle += curvature * h
    return np.array([x, 0.0, z])


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_tubes_in_one_plane_bend_as_those_that_are_there(count: int, seed: int) -> None:
    robot, rng = robot_of(count), np.random.default_rng(seed)
    lengths = np.array([tube.length_m for tube in robot.tubes])
    l_b = -np.sort(rng.uniform(0, 1, count)) * (lengths - 5e-3)  # tips in any order, in front of the plate
    l_b[-1] = -lengths[-1] + 0.02 if seed % 2 else l_b[-1]  # or the innermost one drawn back for sure
    l_b = np.minimum.accumulate(l_b)
    expected = planar_tip(robot, l_b)
    np.testing.assert_allclose(robot.zero_clearance(np.zeros(count), l_b).tip_m, expected, atol=2e-6)
    shapes = [robot_of(count, clearance_mm=c).solve(np.zeros(count), l_b) for c in (0.08, 0.005)]
    off = [np.linalg.norm(shape.tip_m - expected) for shape in shapes]
    assert all(shape.status <= Status.MULTIPLE for shape in shapes)
    assert off[0] < 1e-3 and off[1] < 0.25e-3  # clearance lets tubes tilt, in order or not
    np.testing.assert_allclose(shapes[0].centreline_m[-1], shapes[0].tip_m, atol=1e-9)


def test_a_robot_whose_tips_are_in_order_is_the_same() -> None:
    theta, l_b = np.array([0.3, -0.8, 2.0]), np.array([-5e-3, -0.02, -0.03])
    shapes = [robot_of(3, retractable=keyed, friction=0.2).solve(theta, l_b, 0.7) for keyed in (True, False)]
    np.testing.assert_array_equal(shapes[0].tip_m, shapes[1].tip_m)


def test_a_tube_drawn_back_to_the_plate_leaves_the_others_alone() -> None:
    pair, outer = robot_of(2), robot_of(1)
    length = pair.tubes[1].length_m
    gone = pair.solve([0.4, 2.0], [-1e-3, -length + 1e-4])
    alone = outer.solve([0.4], [-1e-3])
    assert np.linalg.norm(gone.tip_m - alone.tip_m) < 3 * pair.clearance_m[0]
    assert gone.max_strain > alone.max_strain  # of the part behind the plate, which is held straight


@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_the_tip_is_continuous_where_one_tube_passes_another(phi: float) -> None:
    robot = robot_of(3, friction=0.2)
    flush = robot.tubes[1].length_m - robot.tubes[0].length_m
    joints = [[-5e-3, -5e-3 - flush + h, -0.125] for h in (-2e-5, -2e-6, 2e-6, 2e-5)]
    tips = [robot.solve([0.2, 1.1, 2.4], l_b, phi).tip_m for l_b in joints]
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 4e-5


def test_derivatives_of_retracted_robots_are_those_of_differences() -> None:
    robot = robot_of(3, friction=0.2)
    theta, l_b, phi = np.array([[0.1, 1.2, 2.0]]), np.array([[-4e-3, -0.05, -0.09]]), np.array([[0.5, -0.7]])
    names = [
        "theta_b.3",
        "l_b.1",
        "l_b.2",
        "l_b.3",
        "tube.2.bending_stiffness_Nm2",
        "tube.2.section.2.curvature_y_per_m",
    ]
    found = robot.mechanics.tips_with_friction(theta, l_b, phi, parameters=tuple(names))
    for j, name in enumerate(names[:4]):
        kind, i = name.split(".")
        h = np.zeros((1, 3))
        h[0, int(i) - 1] = 1e-5 if kind == "l_b" else 1e-4
        ends = [
            robot.mechanics.tips_with_friction(
                theta + (side * h if kind == "theta_b" else 0), l_b + (side * h if kind == "l_b" else 0), phi
            ).position_m[0]
            for side in (1, -1)
        ]
        by = (ends[0] - ends[1]) / (2 * h.max())
        np.testing.assert_allclose(found.position_by[0, :, j], by, atol=2e-2 * np.linalg.norm(by) + 5e-3)
    assert np.isfinite(found.position_by).all()


def test_a_history_goes_through() -> None:
    robot = robot_of(2, friction=0.2)
    slide = np.linspace(-0.02, -0.09, 15)
    theta = np.column_stack([np.zeros(15), np.full(15, 1.0)])
    path = robot.history().follow(theta, np.column_stack([np.full(15, -2e-3), slide]))
    assert np.all(path.status <= Status.MULTIPLE)
    free = robot_of(2).history().follow(theta, np.column_stack([np.full(15, -2e-3), slide]))
    solved = np.array([robot_of(2).solve(t, [-2e-3, at]).tip_m for t, at in zip(theta, slide, strict=True)])
    assert np.linalg.norm(free.position_m - solved, axis=1).max() < 0.1e-3


def test_measurements_of_a_retracting_robot_are_read_and_calibrated(tmp_path: Path) -> None:
    content = copy.deepcopy(dict(pair_robot().content))
    plain = robot_from_dict(content)
    content["tube"][1]["retractable"] = True
    robot, plan = robot_from_dict(content), waypoints(plain, 14)
    back = np.where(np.arange(len(plan.sequence)) % 30 < 15, -0.045, 0.0)
    back = np.column_stack([0 * back, back])
    plan = replace(plan, l_commanded=plan.l_commanded + back)
    assert not nests(plain.tubes, plan.l_commanded).all() and nests(robot.tubes, plan.l_commanded).all()
    true = {"precurvature_factor_2_2": 1.07, "stiffness_factor_2": 0.9}
    write_csv(tmp_path / "a.csv", measured(robot, plan, {"calibration": true}))
    found = calibrate(robot, load_measurements(tmp_path / "a.csv", robot))
    for name, value in true.items():
        low, high = found.estimates[name].ci95
        assert low - 0.3 * (high - low) < value < high + 0.3 * (high - low)
    assert found.held_out is not None and found.held_out.rms_m < 1.3 * np.sqrt(3) * SIGMA_M
    with pytest.raises(InputError, match="must keep the tips in order.*retractable = true"):
        load_measurements(tmp_path / "a.csv", plain)


def test_plans_keep_tips_in_order_and_loads_need_it() -> None:
    robot = robot_of(2)
    G, h = reach_inequalities(robot.tubes)
    drawn = np.array([-1e-3, -0.08])
    assert nests(robot.tubes, drawn[None]).all() and not np.all(G @ drawn <= h)
    loaded = robot_from_dict({**robot.content, "effects": {"tip_load": {"force_x_N": 0.1}}})
    with pytest.raises(InputError, match="carries loads"):
        loaded.solve([0.0, 1.0], drawn)
