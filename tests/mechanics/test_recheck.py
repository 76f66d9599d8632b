"""A shape checks itself: its balance evaluated anew by the core, from the angles and forces that it shows."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Accuracy, Shape
from ctrplan.mechanics.tube import Loads

ROBOT = load_robot(ROBOTS / "three_tube.toml")
THETA, L = np.array([0.3, 1.6, 2.9]), np.array([0.0, -0.017, -0.07])
RESIDUAL = 1e-8  # what the solver promises
CARRYING = Loads(tip_force_N=(0.05, -0.02, 0.0), gravity_m_s2=(0.0, -9.81, 0.0))


def with_angles(shape: Shape, tube: int, change: Array | float) -> Shape:
    tubes = list(shape.tubes)
    tubes[tube] = replace(tubes[tube], theta_rad=tubes[tube].theta_rad + change)
    return replace(shape, tubes=tuple(tubes))


def agrees(shape: Shape) -> bool:
    return shape.residual <= RESIDUAL and shape.recheck() <= 2 * RESIDUAL


@pytest.mark.parametrize("accuracy", ["search", "certificate", "exact"])
def test_every_shape_of_a_bound_is_in_balance(accuracy: Accuracy) -> None:
    bound = ROBOT.bound(THETA, L, accuracy=accuracy)
    assert len(bound.corners) == 4
    assert all(agrees(shape) for shape in (bound.frictionless, *bound.corners))


@pytest.mark.parametrize("changes", [{}, {"ovality": 0.2}, {"softening_strain": 0.004, "softening_fraction": 0.5}])
@pytest.mark.parametrize("loads", [None, CARRYING])
def test_shapes_of_loaded_softening_and_single_tubes_are(changes: dict[str, float], loads: Loads | None) -> None:
    tubes = [replace(tube, **changes) for tube in ROBOT.tubes]
    assert agrees(Mechanics(tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], loads).solve(THETA, L, [0.4, -1.0]))
    assert agrees(Mechanics(tubes[:1], [], [], loads).solve(THETA[:1], L[:1]))


def test_those_of_the_standard_model_and_along_a_history_are() -> None:
    assert agrees(ROBOT.zero_clearance(THETA, L))
    history = ROBOT.history([1, -1])
    for k in range(4):
        assert agrees(history.advance(THETA + [0, 0.2 * k, -0.3 * k], L - [0, 0, 1e-3 * k]).shape)


def test_the_balance_is_that_of_the_angles_shown() -> None:
    """A station turned by dtheta between two at rest takes a torque of GJ dtheta (1/h + 1/h') to hold, and bending."""
    shape, tube = ROBOT.solve(THETA, L, 1.0), ROBOT.tubes[2]
    assert with_angles(shape, 2, 0.0).recheck() == shape.recheck()
    station = len(shape.s_m) // 2
    h = np.diff(shape.s_m)[station - 1 : station + 1]
    change = np.zeros(len(shape.s_m))
    change[station] = 1e-6
    GJ = tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio)
    scale = max(
        t.bending_stiffness_Nm2 * np.hypot(s.curvature_x_per_m, s.curvature_y_per_m)
        for t in ROBOT.tubes
        for s in t.sections
    )
    expected = GJ * change[station] * np.sum(1 / h) / scale
    assert with_angles(shape, 2, change).recheck() == pytest.approx(expected, rel=0.05)


def test_forces_that_do_not_hold_the_tubes_are_noticed() -> None:
    shape = ROBOT.solve(THETA, L)
    for share in (0.0, 0.99, 1.01, 2.0):
        forces = tuple(share * force for force in shape.contact_force_N)
        assert replace(shape, contact_force_N=forces).recheck() > 1e3 * RESIDUAL


def test_what_does_not_fit_or_was_not_kept_is_refused() -> None:
    shape = ROBOT.solve(THETA, L)
    with pytest.raises(InputError, match="do not fit the mesh"):
        replace(shape, tubes=shape.tubes[:2]).recheck()
    with pytest.raises(InputError, match="do not fit the mesh"):
        replace(shape, contact_force_N=tuple(force[:-1] for force in shape.contact_force_N)).recheck()
    copied = copy.deepcopy(shape)  # as pickling does
    np.testing.assert_array_equal(copied.tip_m, shape.tip_m)
    with pytest.raises(InputError, match="keeps no solution"):
        copied.recheck()


@pytest.mark.parametrize("loads", [None, CARRYING])
@pytest.mark.parametrize("accuracy", ["search", "certificate", "exact"])
def test_what_is_made_when_it_is_looked_at_is_what_the_tip_is_the_end_of(
    accuracy: Accuracy, loads: Loads | None
) -> None:
    """The tip is known before the shape is; both are of one solution, and pickling keeps all of it."""
    if accuracy == "exact" and loads:
        return
    robot = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1], loads)
    bound, single = robot.bound(THETA, L, accuracy=accuracy), robot.solve(THETA, L, accuracy=accuracy)
    stiff = robot.zero_clearance(THETA, L)  # under loads its tubes are made as it is solved
    for shape in (bound.frictionless, *bound.corners, single, stiff):
        tip, tangent = shape.tip_m, shape.tip_tangent
        assert "tubes" not in vars(shape) or (loads and shape is stiff)
        copied = copy.deepcopy(shape)
        np.testing.assert_array_equal(tip, shape.centreline_m[-1])
        np.testing.assert_array_equal(tangent, shape.tubes[-1].frames[-1, :, 2])
        np.testing.assert_array_equal(copied.centreline_m, shape.centreline_m)
        assert shape.max_strain == max(tube.strain.max() for tube in shape.tubes) == copied.max_strain
    np.testing.assert_allclose(bound.frictionless.centreline_m, single.centreline_m, rtol=0, atol=1e-12)
