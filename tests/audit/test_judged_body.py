"""Body points of the judge: on circles where the shape is one, and where the core says that the body is."""

from __future__ import annotations

import numpy as np
from places import SCENARIOS

from ctrplan.audit.body import SPACING_M, body_of
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.files.robot_file import load_robot

ROBOT = load_robot(SCENARIOS / "robots" / "three_tube.toml")
COLLARS = ROBOT.drive.collars(np.array([0.3, 1.2, -2.0, -0.03]))


def test_points_lie_where_the_core_says_that_the_body_is() -> None:
    """The judged points are compared with the core's outermost centreline of one solution, 0.05 mm apart."""
    shape = ROBOT.solve(*COLLARS, [0.5, -0.5], accuracy="certificate")
    phi = np.array([[0.5, -0.5]])
    core = ROBOT.mechanics.friction_bodies(*COLLARS, phi, spacing_m=0.05e-3, accuracy="certificate")
    body = body_of(ROBOT, shape)
    assert (
        distance_from_polyline(body.point_m, core.point_m[0]).max() < 10e-6
    )  # the core goes straight between stations
    np.testing.assert_allclose(body.point_m[-1], shape.tip_m, atol=1e-12)
    assert np.linalg.norm(body.point_m[0]) < 0.2e-3  # tube 1 comes out of the plate within its clearance


def test_points_are_dense_and_have_the_radius_of_the_tube_outside() -> None:
    body = body_of(ROBOT, ROBOT.solve(*COLLARS, 0.0))
    steps = np.linalg.norm(np.diff(body.point_m, axis=0), axis=1)
    assert steps[np.diff(body.tube) == 0].max() <= SPACING_M * 1.001
    assert list(np.unique(body.tube)) == [1, 3] or list(np.unique(body.tube)) == [1, 2, 3]
    radii = np.array([tube.outer_diameter_m / 2 for tube in ROBOT.tubes])
    np.testing.assert_array_equal(body.radius_m, radii[body.tube - 1])


def test_points_around_one_lie_on_the_body_and_include_it() -> None:
    body = body_of(ROBOT, ROBOT.solve(*COLLARS, 0.0))
    for index in (0, 100, len(body.tube) - 1):
        near = body.around(index)
        assert np.linalg.norm(near.point_m - body.point_m[index], axis=1).min() < 1e-12
        assert np.linalg.norm(near.point_m - body.point_m[index], axis=1).max() < 1.1 * SPACING_M
