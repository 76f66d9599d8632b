"""NaN, infinite, denormal and huge numbers at the public functions, and values at, on and just beyond their limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.anatomy.clearance_grid import field_bounds
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario, scenario_from_dict
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits
from ctrplan.storage.toml_document import read_document

FILE = SCENARIOS / "robots" / "table_1_pair.toml"
ROBOT, MODEL = load_robot(FILE), load_robot(FILE).mechanics
THETA, L = [0.1, 1.0], [0.0, -0.017]
NOT_FINITE = [math.nan, math.inf, -math.inf]
HUGE = [1e16, -1e16, 1e154, 1e300, -1.7e308]
DENORMAL = [5e-324, -5e-324, 1e-310]

# Every function of joint values: configuration (n,), (n,) -> numbers.
FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "zero_clearance": lambda t, at: ROBOT.zero_clearance(t, at).tip_m,
    "solve": lambda t, at: ROBOT.solve(t, at, 1.0).tip_m,
    "bound": lambda t, at: ROBOT.bound(t, at).position_m,
    "bound, exact": lambda t, at: ROBOT.bound(t, at, accuracy="exact").position_m,
    "bound_many": lambda t, at: ROBOT.bound_many([THETA, t], [L, at]).position_m,
    "tips": lambda t, at: MODEL.tips([t], [at])[0],
    "tips_with_friction": lambda t, at: MODEL.tips_with_friction([t], [at], [[1.0]]).position_m,
    "body": lambda t, at: MODEL.body(t, at)[0],
    "check_path": lambda t, at: MODEL.check_path([THETA, t], [L, at]).tip_m,
    "advance": lambda t, at: ROBOT.history().advance(t, at).shape.tip_m,
    "follow": lambda t, at: ROBOT.history().follow([THETA, t], [L, at]).position_m,
}


def with_number(value: float, place: int) -> tuple[list[float], list[float]]:
    theta, l = list(THETA), list(L)  # noqa: E741
    (theta if place < 2 else l)[place % 2] = value
    return theta, l


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_no_joint_value_is_refused_by_every_function(name: str) -> None:
    for value in [*NOT_FINITE, *HUGE]:
        for place in range(4):
            with pytest.raises(InputError):
                FUNCTIONS[name](*with_number(value, place))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_denormal_joint_value_is_zero(name: str) -> None:
    for place in range(3):  # the fourth, the inner base, can't be at zero because of its collar
        at_zero = FUNCTIONS[name](*with_number(0.0, place))
        assert np.all(np.isfinite(at_zero))
        for value in DENORMAL if place < 2 else [-5e-324, 5e-324]:
            np.testing.assert_allclose(FUNCTIONS[name](*with_number(value, place)), at_zero, atol=1e-9)


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e-20, 1e-13, 1e-11])
def test_a_leg_of_the_size_of_rounding_is_walked(size: float) -> None:
    """Such legs come out of anybody's arithmetic; they end where they began."""
    theta = [[0.0, 1.0], [0.0, 1.0 + size], [size, 1.0]]
    found = MODEL.check_path(theta, [L] * 3)
    assert found.status.tolist() == [Status.CONVERGED] * 3 and found.fraction.tolist() == [0, 1, 1]
    np.testing.assert_allclose(found.tip_m, np.repeat(found.tip_m[:1], 3, axis=0), atol=1e-8)


@pytest.mark.parametrize("key", ["rotation_rad", "translation_m", "motion_m", "near_m", "point_spacing_m"])
def test_a_walk_that_would_not_end_is_refused(key: str) -> None:
    for value in (math.nan, 0.0, -1.0, 5e-324, -math.inf):
        with pytest.raises(InputError, match=f"{key} = .*must be a number from 1e-06 to 100"):
            PathDensity(**{key: value})


@pytest.mark.parametrize("key", ["stability", "max_strain", "clearance_m"])
def test_a_limit_that_nothing_could_break_is_refused(key: str) -> None:
    with pytest.raises(InputError, match="must be a number"):
        PathLimits(**{key: math.nan})


@pytest.mark.parametrize("threads", [-1, 1025, 10**12])
def test_threads_are_counted(threads: int) -> None:
    with pytest.raises(InputError, match="threads = "):
        ROBOT.bound_many([THETA], [L], threads=threads)


@pytest.mark.parametrize("value", [*NOT_FINITE, 0.0, -1.0, 3601.0])
def test_a_search_has_a_time(value: float) -> None:
    with pytest.raises(InputError, match="time_s = .*above 0 and at most 3600"):
        ctrplan.plan(load_scenario(SCENARIOS / "pair_free.toml"), time_s=value)


@pytest.mark.parametrize("seed", [-1, 2**31, 2**70, 1.5])
def test_a_search_has_a_seed(seed: Any, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="seed = "):
        ctrplan.plan(load_scenario(SCENARIOS / "pair_free.toml"), seed=seed)
    if seed == -1:
        assert main(["ik", str(FILE), "--tip-mm", "20", "0", "100", "--seed", "-1"]) == 2
        assert "--seed = -1: must be a whole number from 0 to" in capsys.readouterr().err


@pytest.mark.parametrize("value", [*NOT_FINITE, 0.0, -1.0])
def test_sizes_of_the_anatomy_are_positive(value: float) -> None:
    part = AnatomyPart(Sphere(np.zeros(3), 0.01))
    with pytest.raises(InputError):
        Sphere(np.zeros(3), value)
    with pytest.raises(InputError):
        field_bounds([part], value)
    with pytest.raises(InputError):
        time_parameterise(
            [[0.0] * 3, [0.1, 0, 0]], load_scenario(SCENARIOS / "pair_free.toml").robot.drive, period_s=value
        )


def changed(**keys: Any) -> Any:
    """The pair after overrides; points in keys are written as two underscores."""
    overrides = [f"{key.replace('__', '.')}={value}" for key, value in keys.items()]
    return robot_from_dict(read_document(FILE, overrides).content)


@pytest.mark.parametrize("above", [0.0, 1e-12, 1e-6])
def test_two_tubes_of_equal_radius_are_refused(above: float) -> None:
    inner_mm = ROBOT.tubes[0].inner_diameter_m * 1e3
    with pytest.raises(InputError, match="must be smaller than"):
        changed(tube__2__outer_diameter_mm=inner_mm + above)


def test_clearance_may_be_as_small_as_one_likes_but_not_zero() -> None:
    """Friction at the limit of no clearance is that of the smallest clearance: the bound settles."""
    with pytest.raises(InputError, match=r"clearance_mm = 0 mm: must be above 0 and at most 1000"):
        changed(contact__1__clearance_mm=0)
    bounds = [changed(contact__1__clearance_mm=c).bound([0, 2.0], L).position_m for c in (1e-3, 1e-4, 1e-5)]
    assert np.all(np.isfinite(bounds)) and abs(bounds[2] - bounds[1]) < 0.2 * abs(bounds[1] - bounds[0]) + 1e-6


@pytest.mark.parametrize("theta", [0.3, 1.5, 3.0])
def test_without_friction_there_is_nothing_to_bound(theta: float) -> None:
    assert changed(contact__1__friction_coefficient=0).bound([0, theta], L).position_m < 1e-9


def test_straight_tubes_stay_straight() -> None:
    keys = {
        f"tube__{i}__section__{k + 1}__curvature_y_per_m": 0
        for i in (1, 2)
        for k in range(len(ROBOT.tubes[i - 1].sections))
    }
    bound = changed(**keys).bound([0, 2.0], L)
    np.testing.assert_allclose(bound.frictionless.tip_m[:2], 0, atol=1e-9)
    assert bound.position_m < 1e-9


@pytest.mark.parametrize("ratio", [-0.9989, -0.5, 0.0, 0.5])
def test_poissons_ratio_at_its_bounds_has_a_bound_that_is_finite(ratio: float) -> None:
    """The torsional stiffness is 1000 times the bending stiffness at the lower end."""
    bound = changed(tube__1__poisson_ratio=ratio, tube__2__poisson_ratio=ratio).bound([0, 1.0], L)
    assert bound.frictionless.status <= Status.MULTIPLE and 0 <= bound.position_m < 0.1


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_joint_values_at_on_and_beyond_every_limit(side: str) -> None:
    content = read_document(SCENARIOS / "pair_free.toml").content
    file = str(SCENARIOS / "pair_free.toml")
    scenario = scenario_from_dict(content, file=file)
    inward = 1 if side == "lower" else -1
    for joint in scenario.robot.drive.joints:
        limit = getattr(joint, side) / joint.si_per_unit
        if not math.isfinite(limit):
            continue

        def start(value: float, name: str = joint.name) -> Any:
            return scenario_from_dict({**content, "start": {**content["start"], name: value}}, file=file).start

        for value in (limit, math.nextafter(limit, inward * math.inf), limit + inward * 1e-9):
            try:
                assert np.all(np.isfinite(start(value)))
            except InputError as error:  # the limit itself may not nest with the other joints' start
                assert "must be within the joint's limits" not in str(error)
        with pytest.raises(InputError, match="must be within the joint's limits"):
            start(limit - inward * 1e-4)


@pytest.mark.parametrize("tube", [0, 1])
def test_nesting_holds_at_the_limit_and_not_beyond(tube: int) -> None:
    limit = [0.0, -ROBOT.tubes[1].collar_length_m]
    assert np.isfinite(ROBOT.bound(THETA, limit).position_m)
    limit[tube] += 1e-6
    with pytest.raises(InputError):
        ROBOT.bound(THETA, limit)


def test_a_path_beyond_the_limits_names_row_and_joint() -> None:
    scenario = load_scenario(SCENARIOS / "pair_free.toml")
    joints = scenario.robot.drive.joints
    j = next(k for k, joint in enumerate(joints) if math.isfinite(joint.upper))
    path = np.array([scenario.start, scenario.start])
    path[1, j] = joints[j].upper + 1e-3
    with pytest.raises(NoAnswerError, match=f"row 1: {joints[j].name}"):
        ctrplan.reorder(path, scenario)


@pytest.mark.parametrize("value", ["1e200", "1e300", "1001"])
def test_diameters_beyond_a_metre_are_millimetres_gone_wrong(value: str) -> None:
    with pytest.raises(InputError, match=r"tube\.1\.outer_diameter_mm = .* mm: must be above 0 and at most 1000\."):
        changed(tube__1__outer_diameter_mm=value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("values_m", np.zeros((2, 2))),
        ("values_m", "walls"),
        ("origin_m", np.zeros(2)),
        ("origin_m", [0.0, math.nan, 0.0]),
        ("spacing_m", 0.0),
        ("spacing_m", -1e-3),
        ("spacing_m", math.nan),
        ("R_AB", np.eye(2)),
        ("p_AB", [0.0]),
    ],
)
def test_grids_of_other_shapes_are_refused(key: str, value: Any) -> None:
    whole = {
        "values_m": np.zeros((2, 2, 2)),
        "origin_m": [0, 0, 0],
        "spacing_m": 0.1,
        "R_AB": np.eye(3),
        "p_AB": [0, 0, 0],
    }
    assert Field(**whole).values_m.dtype == np.float32  # type: ignore[arg-type]
    with pytest.raises(InputError, match=key):
        Field(**whole | {key: value})  # type: ignore[arg-type]
