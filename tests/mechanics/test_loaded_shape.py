"""The zero-clearance model with loads, weight, ovality, softening: one tube as `solve` has it, pairs as its limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics import loaded_shape
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import Loads, Tube, TubeSection

ROBOT = load_robot(ROBOTS / "three_tube.toml")
THETA, L = np.array([0.4, -0.9, 2.1]), np.array([0.0, -0.017, -0.06])
LOADS = Loads(tip_force_N=(0.3, -0.2, 0.1), tip_moment_Nm=(2e-3, 1e-3, 1e-3), gravity_m_s2=(3.0, 0.0, -9.0))
SOFT = {"softening_strain": 3e-4, "softening_fraction": 0.5}
TERMS: list[dict[str, Any]] = [{}, {"ovality": 0.3, "ovality_axis_rad": 0.5}, SOFT, {"ovality": 0.2, **SOFT}]


def tube(outer: float, inner: float, EI: float, lengths: tuple[float, ...], curvature: float) -> Tube:
    sections = [TubeSection(length, 0.0, 0.0) for length in lengths[:-1]]
    return Tube(outer, inner, EI, 0.3, (*sections, TubeSection(lengths[-1], curvature, 0.0)), density_kg_m3=6450.0)


# Three tubes of a public testbed, whose tips another program found by shooting to a residual of 1e-12.
TESTBED = (
    tube(2.35e-3, 2.06e-3, 0.0355595000669473, (0.149, 0.05), 7.0),
    tube(1.8e-3, 1.62e-3, 0.010278271574358048, (0.2805, 0.05), 5.0),
    tube(1.524e-3, 1.3e-3, 0.007226597628651146, (0.413, 0.05), 10.0),
)


@pytest.mark.parametrize(
    ("force", "tip_mm"),
    [((0.0, 0.0, 0.0), (0.0, -33.5823, 155.4559)), ((0.2, -0.1, 0.3), (6.6583, -33.4677, 155.4222))],
)
def test_tips_of_a_testbed_by_an_independent_shooting(force: Any, tip_mm: Any) -> None:
    model = Mechanics(TESTBED, [0.13e-3, 0.048e-3], [0.1, 0.1], Loads(tip_force_N=force))
    shape = model.zero_clearance(np.zeros(3), [-0.1, -0.2, -0.3])
    assert shape.status == Status.CONVERGED
    np.testing.assert_allclose(shape.tip_m * 1e3, tip_mm, atol=6e-5)
    tips = model.tips(np.zeros((2, 3)), [[-0.1, -0.2, -0.3]] * 2)
    np.testing.assert_allclose(tips[0] * 1e3, [tip_mm] * 2, atol=6e-5)


@pytest.mark.parametrize("terms", TERMS)
def test_one_tube_is_bent_as_by_solve(terms: dict[str, Any]) -> None:
    wire = replace(tube(1e-3, 0.0, 2e-3, (0.03, 0.12), 6.0), **terms)
    model = Mechanics([wire], [], [], LOADS)
    ours, core = (
        model.zero_clearance([0.7], [-0.02]),
        model.solve([0.7], [-0.02], accuracy="certificate", refinement=16),
    )
    assert ours.status == core.status == Status.CONVERGED
    np.testing.assert_allclose(ours.tip_m, core.tip_m, atol=3e-7)
    np.testing.assert_allclose(ours.tip_tangent, core.tip_tangent, atol=5e-6)
    assert ours.max_strain == pytest.approx(core.max_strain, rel=1e-3)
    assert np.linalg.norm(ours.tip_m - model.zero_clearance([0.7], [-0.02], loads=False).tip_m) > 1e-3


@pytest.mark.parametrize("terms", TERMS[:2])
def test_small_clearances_tend_to_it(terms: dict[str, Any]) -> None:
    tubes = tuple(replace(each, density_kg_m3=6450.0, **terms) for each in ROBOT.tubes)
    limit = Mechanics(tubes, [1e-5] * 2, [0.0] * 2, LOADS).zero_clearance(THETA, L)
    apart = [
        np.linalg.norm(Mechanics(tubes, [gap] * 2, [0.0] * 2, LOADS).solve(THETA, L).tip_m - limit.tip_m)
        for gap in (2e-5, 2e-6, 2e-7)
    ]
    assert apart[0] < 3e-3 and apart[1] < apart[0] / 2 and apart[2] < apart[1] / 2  # as the root of the clearance


def test_without_terms_it_is_the_compiled_model() -> None:
    robot = loaded_shape.LoadedRobot(ROBOT.tubes, Loads())
    bare = ROBOT.zero_clearance(THETA, L)
    ours = robot.shape(THETA, L, bare)
    np.testing.assert_allclose(ours.tip_m, bare.tip_m, atol=1e-8)
    for one, other in zip(ours.tubes, bare.tubes, strict=True):
        at = np.clip(one.s_m, other.s_m[0], other.s_m[-1])
        for name in ("theta_rad", "centreline_m"):
            given = getattr(other, name).reshape(len(other.s_m), -1)
            expected = np.column_stack([np.interp(at, other.s_m, column) for column in given.T])
            np.testing.assert_allclose(getattr(one, name).reshape(expected.shape), expected, atol=2e-4)
    assert ours.max_strain == pytest.approx(bare.max_strain, rel=1e-3)


def test_halving_the_step_moves_no_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], LOADS)
    coarse = model.tips(THETA[None], L[None])[0]
    monkeypatch.setattr(loaded_shape, "STEP_M", loaded_shape.STEP_M / 2)
    np.testing.assert_allclose(model.tips(THETA[None], L[None])[0], coarse, rtol=0, atol=2e-8)


def test_shapes_and_tips_turn_with_the_robot() -> None:
    model = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], LOADS)
    c, s = math.cos(0.8), math.sin(0.8)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = Loads(*(tuple(turn @ getattr(LOADS, name)) for name in Loads.__dataclass_fields__))
    other = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], turned)
    shape, tips = model.zero_clearance(THETA, L), model.tips(THETA[None], L[None])
    np.testing.assert_allclose(other.zero_clearance(THETA + 0.8, L).tip_m, turn @ shape.tip_m, atol=1e-8)
    np.testing.assert_allclose(tips[0][0], shape.tip_m, rtol=0, atol=2e-8)
    np.testing.assert_allclose(tips[1][0], shape.tip_tangent, atol=1e-6)


def test_a_load_beyond_all_equilibria_in_reach_fails() -> None:
    model = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], Loads(tip_force_N=(0.0, 0.0, -1e5)))
    assert model.zero_clearance(THETA, L).status == Status.FAILED
    assert model.tips(THETA[None], L[None])[2][0] == Status.FAILED
