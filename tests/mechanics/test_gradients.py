"""Gradients are limits of differences, and know what no motion of the whole changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from made_up_input import FUZZ
from places import SCENARIOS
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.shapes import BoundGradient
from ctrplan.mechanics.tube import Loads
from ctrplan.motion.checker import MotionChecker
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot

LIMIT = 1e-5  # of the size of a derivative
QUANTITIES = ("position_m", "tangent_rad", "stability", "tip_m")
ROWS = 8
STEPS = {"theta_b": 2e-5, "l_b": 1e-6}  # rad, m: small against bends and elements
PARAMETERS = {  # and steps as shares of their values
    "tube.1.bending_stiffness_Nm2": 1e-5,
    "tube.2.poisson_ratio": 1e-4,
    "tube.2.section.2.curvature_y_per_m": 1e-5,
    "tube.1.section.2.length_m": 1e-5,
    "contact.1.friction_coefficient": 1e-5,
    "contact.1.clearance_m": 3e-6,
}


@cache
def nested_robot(n: int) -> Robot:
    """n tubes, each stiffer than the one within, whose tips stand apart."""
    tubes: list[dict[str, Any]] = [
        {
            "outer_diameter_mm": 1.0 + 0.5 * (n - 1 - i),
            "inner_diameter_mm": 0.7 + 0.5 * (n - 1 - i),
            "bending_stiffness_Nm2": 0.01 * 1.6 ** (n - 1 - i),
            "poisson_ratio": 0.3,
            "collar_length_mm": 5.0,
            "section": [
                {"length_mm": 30 + 15 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 0},
                {"length_mm": 40, "curvature_x_per_m": 0, "curvature_y_per_m": 5 + 1.5 * i},
            ],
        }
        for i in range(n)
    ]
    contacts = [{"friction_coefficient": 0.2, "clearance_mm": 0.1}] * (n - 1)
    return robot_from_dict({"tube": tubes, "contact": contacts})


def configurations(n: int) -> tuple[Array, Array]:
    random = np.random.default_rng(n)
    apart = np.hstack([random.uniform(4e-3, 6e-3, (ROWS, 1)), random.uniform(5.5e-3, 1e-2, (ROWS, n - 1))])
    return random.uniform(-np.pi, np.pi, (ROWS, n)), -np.cumsum(apart, axis=1)


def gradient(robot: Robot, theta_b: Array, l_b: Array, parameters: tuple[str, ...] = ()) -> BoundGradient:
    result = robot.bounds(theta_b, l_b, gradient=True, parameters=parameters).gradient
    assert result is not None
    return result


def assert_limit(values: Callable[[float], Array], by: Array, step: float, scale: Array) -> None:
    """`by` (K, ...) is the slope of `values` at 0, wherever differences across two steps agree with each other.

    They do not where the mesh or the active branch changes between them.
    """
    wide, narrow = ((values(h) - values(-h)) / (2 * h) for h in (step, step / 2))
    axes = tuple(range(1, by.ndim))
    apart, off = (np.abs(part).max(axis=axes, initial=0.0) for part in (wide - narrow, narrow - by))
    smooth = apart <= LIMIT * scale
    assert smooth.mean() >= 0.75, apart / scale
    assert np.all(off[smooth] <= LIMIT * scale[smooth]), off / scale


@pytest.mark.parametrize("n", [1, 2, 3, 4] if FUZZ else [1, 3])
@pytest.mark.parametrize("kind", ["theta_b", "l_b"])
def test_bound_stability_and_tip_by_collars(n: int, kind: str) -> None:
    robot, rows = nested_robot(n), configurations(n)
    here = gradient(robot, *rows)
    for j in range(n):
        beside: dict[float, BoundGradient] = {}

        def at(h: float, j: int = j, beside: dict[float, BoundGradient] = beside) -> BoundGradient:
            if h not in beside:
                moved = [part.copy() for part in rows]
                moved[kind == "l_b"][:, j] += h
                beside[h] = gradient(robot, *moved)
            return beside[h]

        for name in QUANTITIES:
            by = getattr(getattr(here, name), kind)
            size = np.abs(by).max(axis=tuple(range(1, by.ndim)))
            floor = 1e-3 * np.median(np.abs(getattr(here, name).value)) / (1.0 if kind == "theta_b" else 1e-2)
            assert_limit(
                lambda h, name=name: getattr(at(h), name).value, by[..., j], STEPS[kind], np.maximum(size, floor)
            )


@pytest.mark.parametrize("name", PARAMETERS)
def test_bound_stability_and_tip_by_parameters(name: str) -> None:
    robot, rows = nested_robot(3), configurations(3)
    here = gradient(robot, *rows, (name,))
    key, si = (name.removesuffix("_m") + "_mm", 1e-3) if name.endswith(("length_m", "clearance_m")) else (name, 1.0)
    place = key.split(".")
    content: Any = robot.content
    for part in place[:-1]:
        content = content[int(part) - 1] if part.isdecimal() else content[part]
    value = content[place[-1]] * si
    beside: dict[float, BoundGradient] = {}

    def at(h: float) -> BoundGradient:
        if h not in beside:
            beside[h] = gradient(robot.with_(f"{key}={(value + h) / si!r}"), *rows)
        return beside[h]

    for quantity in QUANTITIES:
        by = getattr(here, quantity).parameters[..., 0]
        size = np.abs(by).reshape(ROWS, -1).max(axis=1)
        floor = 1e-3 * np.median(np.abs(getattr(here, quantity).value)) / value
        assert_limit(
            lambda h, quantity=quantity: getattr(at(h), quantity).value,
            by,
            PARAMETERS[name] * value,
            np.maximum(size, floor),
        )


@pytest.mark.parametrize("n", [2, 3])
def test_turning_the_whole_robot_changes_no_bound_and_turns_the_tip(n: int) -> None:
    here = gradient(nested_robot(n), *configurations(n))
    for name in ("position_m", "tangent_rad", "stability"):
        by = getattr(here, name).theta_b
        assert np.all(np.abs(by.sum(axis=1)) <= 1e-5 * np.abs(by).max(axis=1)), name
    turned = np.cross([0.0, 0.0, 1.0], here.tip_m.value)
    np.testing.assert_allclose(here.tip_m.theta_b.sum(axis=2), turned, atol=1e-8)


def test_a_batch_says_what_each_row_says_and_nothing_of_refused_ones() -> None:
    robot, (theta_b, l_b) = nested_robot(3), configurations(3)
    l_b[2, 0] = 0.01
    many = robot.bounds(theta_b, l_b, gradient=True, parameters=["tube.1.poisson_ratio"])
    assert many.gradient is not None
    for k in (0, 5):
        single = robot.bound(theta_b[k], l_b[k], gradient=True, parameters=["tube.1.poisson_ratio"])
        assert single.gradient is not None and robot.bound(theta_b[k], l_b[k]).gradient is None
        assert abs(single.gradient.position_m.value - single.position_m) < 1e-8
        for name in QUANTITIES:
            for part in ("value", "theta_b", "l_b", "parameters"):
                row = getattr(getattr(many.gradient, name), part)[k]
                np.testing.assert_allclose(getattr(getattr(single.gradient, name), part), row, rtol=1e-9, atol=1e-12)
    assert np.isnan(many.gradient.position_m.theta_b[2]).all() and np.isnan(many.gradient.tip_m.value[2]).all()


def test_the_bound_of_one_tube_is_zero_and_stays_so() -> None:
    here = gradient(nested_robot(1), *configurations(1))
    assert not here.position_m.value.any() and not here.position_m.theta_b.any() and not here.tangent_rad.l_b.any()


def test_what_has_no_gradient_is_refused() -> None:
    robot, (theta_b, l_b) = nested_robot(2), configurations(2)
    with pytest.raises(InputError, match=r"^accuracy = 'exact': has no gradient"):
        robot.bound(theta_b[0], l_b[0], accuracy="exact", gradient=True)
    with pytest.raises(InputError, match="parameters = .*: need gradient=True"):
        robot.bound(theta_b[0], l_b[0], parameters=["tube.1.poisson_ratio"])
    with pytest.raises(InputError, match="no such parameter of the robot"):
        robot.bounds(theta_b, l_b, gradient=True, parameters=["tube.7.poisson_ratio"])
    with pytest.raises(InputError, match="no such parameter of the robot"):
        checker("vessel").clearance(checker("vessel").scenario.start, gradient=True, parameters=["tube.1.colour"])


@cache
def checker(name: str) -> MotionChecker:
    return MotionChecker(load_scenario(SCENARIOS / f"{name}.toml"))


def states(name: str) -> Array:
    return checker(name).space.sample(np.random.default_rng(4), ROWS)


@pytest.mark.parametrize("name", ["vessel", "sinus"] if FUZZ else ["vessel"])  # sinus by its base, below
def test_clearance_by_joints(name: str) -> None:
    own, q = checker(name), states(name)
    here = own.clearance(q, gradient=True)
    assert here.by_joints is not None
    for j, rotates in enumerate(own.space.drive.is_rotation.tolist()):

        def values(h: float, j: int = j) -> Array:
            return own.clearance(q + h * np.eye(q.shape[1])[j], gradient=True).clearance_m

        size = np.abs(here.by_joints[:, own.space.drive.is_rotation == rotates]).max(axis=1)
        assert_limit(
            values, here.by_joints[:, j], 2e-5 if rotates else 1e-6, np.maximum(size, 1e-4 if rotates else 1e-1)
        )


def placed(own: MotionChecker, turn: Array, shift: Array) -> MotionChecker:
    """The checker, whose base is turned by a rotation vector and displaced; with the same memory of states."""
    moved, scenario = object.__new__(MotionChecker), own.scenario
    R = Rotation.from_rotvec(turn).as_matrix() @ scenario.base_R
    base = replace(scenario, base_R=R, base_position_m=scenario.base_position_m + shift)
    vars(moved).update(vars(own) | {"scenario": base})
    return moved


def test_clearance_by_the_base_pose() -> None:
    own, q = checker("sinus"), states("sinus")
    here = own.clearance(q, gradient=True)
    assert here.by_base_position is not None and here.by_base_rotation is not None
    for j, unit in enumerate(np.eye(3)):
        assert_limit(
            lambda h, unit=unit: placed(own, 0 * unit, h * unit).clearance(q, gradient=True).clearance_m,
            here.by_base_position[:, j],
            1e-6,
            np.ones(ROWS),
        )
        assert_limit(
            lambda h, unit=unit: placed(own, h * unit, 0 * unit).clearance(q, gradient=True).clearance_m,
            here.by_base_rotation[:, j],
            1e-5,
            np.linalg.norm(here.by_base_rotation, axis=1),
        )


def test_clearance_grows_as_fast_as_the_nearest_point_moves_away() -> None:
    """A clearance is a distance; and turning the base about the robot's axis is turning all tubes."""
    own, q = checker("sinus"), states("sinus")
    here, n = own.clearance(q, gradient=True), own.mechanics.n
    assert here.by_base_position is not None and here.by_base_rotation is not None and here.by_joints is not None
    np.testing.assert_allclose(np.linalg.norm(here.by_base_position, axis=1), 1.0, atol=1e-6)
    turned = here.by_base_rotation @ own.scenario.base_R[:, 2]
    whole = np.linalg.lstsq(own.space.drive.matrix_theta, np.ones(n))[0]
    np.testing.assert_allclose(own.space.drive.matrix_theta @ whole, 1.0)
    np.testing.assert_allclose(here.by_joints @ whole, turned, atol=1e-8)


def test_clearance_with_and_without_gradient_and_of_one_state() -> None:
    own, q = checker("vessel"), states("vessel")
    plain, here = own.clearance(q), own.clearance(q, gradient=True, parameters=["contact.1.friction_coefficient"])
    assert plain.by_joints is None and here.by_parameters is not None and here.by_parameters.shape == (ROWS, 1)
    np.testing.assert_allclose(plain.clearance_m, here.clearance_m, atol=1e-8)
    np.testing.assert_array_equal(own.clearance(q[3]).clearance_m, plain.clearance_m[3:4])
    outside = q.copy()
    outside[1] = 10.0
    assert np.flatnonzero(np.isnan(own.clearance(outside, gradient=True).clearance_m)).tolist() == [1]
    free = MotionChecker(replace(own.scenario, anatomy=())).clearance(q, gradient=True)
    assert free.by_joints is not None
    assert np.isposinf(free.clearance_m).all() and not free.by_joints.any()


@pytest.mark.parametrize("n", [2, 3])
def test_the_end_of_a_motion_on_which_all_pairs_slip(n: int) -> None:
    """There arrival does not depend on the way; by translations a history's own mesh remains, which moves along."""
    robot, l_b = nested_robot(n), np.array([-2e-3, -9e-3, -16e-3])[:n]
    begin, end = np.arange(n) * 2.0, np.arange(n) * 2.5

    def arrived(theta: Array, l: Array) -> Any:  # noqa: E741
        history = robot.history()
        for waypoint in (np.zeros(n), begin):
            history.advance(waypoint, l_b)
        history.advance(theta, l)
        return history

    history = arrived(end, l_b)
    here = history.gradient(["contact.1.friction_coefficient"])
    np.testing.assert_allclose(here.value, history.shape().tip_m, atol=1e-9)
    size = np.linalg.norm(here.theta_b, axis=0).max()
    for j, unit in enumerate(np.eye(n)):
        tips = [arrived(end + h * unit, l_b).shape().tip_m for h in (5e-4, -5e-4)]
        assert np.linalg.norm((tips[0] - tips[1]) / 1e-3 - here.theta_b[:, j]) <= LIMIT * size
        tips = [arrived(end, l_b + h * unit).shape().tip_m for h in (1e-5, -1e-5)]
        assert np.linalg.norm((tips[0] - tips[1]) / 2e-5 - here.l_b[:, j]) <= 1e-4
    target = here.value + np.array([3e-3, 0.0, 4e-3])
    error = here.distance_from(target)
    assert error.value == pytest.approx(5e-3)
    np.testing.assert_allclose(error.theta_b, -(0.6 * here.theta_b[0] + 0.8 * here.theta_b[2]))
    history.advance(end - 0.05 * np.arange(n), l_b)  # pairs turn round, and stick
    assert np.isnan(history.gradient().theta_b).all()
    with pytest.raises(InputError, match="has no state before its first advance"):
        robot.history().gradient()


SOFT = {"softening_strain": 0.004, "softening_fraction": 0.6}
TIP_STEPS = {  # in SI units
    **{"theta_b.2": 2e-5, "l_b.3": 1e-6, "tube.1.bending_stiffness_Nm2": 2e-5, "tube.2.poisson_ratio": 3e-4},
    **{"tube.3.section.2.curvature_y_per_m": 8e-3, "tube.2.softening_strain": 4e-6, "tube.3.softening_fraction": 6e-4},
    **{"tube.2.ovality": 1e-4, "tube.2.ovality_axis_rad": 7e-4, "contact.1.friction_coefficient": 2e-4},
    **{"loads.tip_force_N.2": 1e-4, "loads.tip_moment_Nm.3": 1e-4, "loads.gravity_m_s2.1": 3e-3},
}
DIGITS = 1e-6  # of a derivative, that differences across small steps agree with it


@pytest.mark.parametrize("changes", [{}, SOFT, {"ovality": 0.1, "ovality_axis_rad": 0.7}, {**SOFT, "ovality": -0.1}])
@pytest.mark.parametrize("force_N", [0.0, 0.05])
def test_tips_of_softened_oval_and_loaded_tubes(changes: dict[str, float], force_N: float) -> None:
    """By every kind of number: what differences of tips say, extrapolated from two steps, to six digits."""
    robot, (theta_b, l_b) = nested_robot(3), configurations(3)
    tubes = [replace(tube, **changes, density_kg_m3=6450.0) for tube in robot.tubes]
    robot = replace(robot, tubes=tuple(tubes), loads=Loads(tip_force_N=(force_N, 0.5 * force_N, 0.0)))
    phi = np.random.default_rng(3).uniform(-0.9, 0.9, (ROWS, 2))
    names = [name for name in TIP_STEPS if changes.get("softening_strain") or "softening" not in name]
    by = robot.mechanics.tips_with_friction(theta_b, l_b, phi, parameters=names).position_by

    def tip(name: str, h: float) -> Array:
        joints, moved = {"theta_b": theta_b.copy(), "l_b": l_b.copy()}, robot
        if (kind := name[:-2]) in joints:
            joints[kind][:, int(name[-1]) - 1] += h
        else:
            moved = with_values(robot, {name: value_of(robot, name) + h})
        return moved.mechanics.tips_with_friction(*joints.values(), phi).position_m

    for k, name in enumerate(names):
        step = TIP_STEPS[name]
        wide, narrow = ((tip(name, h) - tip(name, -h)) / (2 * h) for h in (step, step / 2))
        apart, off = (np.abs(part).max(axis=1) for part in (wide - narrow, (4 * narrow - wide) / 3 - by[:, :, k]))
        size = max(np.abs(by[:, :, k]).max(), 1e-6)  # m: a round tube has no oval axis
        smooth = apart <= LIMIT * size  # not where an element is added or a point begins to soften between the steps
        assert smooth.mean() >= 0.75, name
        assert np.all(off[smooth] <= DIGITS * size), name
