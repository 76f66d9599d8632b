"""The judge's distances agree with formulas and with a mesh's every triangle; moving everything changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.audit.body import RawAnatomy, winding_number
from ctrplan.base.arrays import Array

BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
SHELL = trimesh.util.concatenate([BALL, trimesh.creation.icosphere(subdivisions=2, radius=0.01)])
SHELL.faces[len(BALL.faces) :] = SHELL.faces[len(BALL.faces) :, ::-1]  # a cavity


def line(count: int = 400) -> Array:
    """Points along a curve that crosses the ball, its cavity, and the ball again."""
    t = np.linspace(-1, 1, count)
    return np.stack([0.03 * t, 0.002 * np.sin(9 * t), 0.001 * t], axis=1)


def test_shapes_with_formulas() -> None:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (300, 3))
    a, b = np.array([0.01, 0, 0]), np.array([-0.02, 0.03, 0.01])
    parts = [
        AnatomyPart(Sphere(a, 0.004), margin_m=1e-3),
        AnatomyPart(Capsule(a, b, 0.003)),
        AnatomyPart(Capsule(b, b, 0.002)),
    ]
    for part in parts:
        np.testing.assert_allclose(RawAnatomy.of([part]).room(points), exact_clearance([part], points), atol=1e-12)


@pytest.mark.parametrize("role", ["avoid", "inside"])
def test_meshes_with_every_triangle(role: str) -> None:
    """trimesh's nearest points on triangles, and the radii that say inside and outside of a thick shell."""
    part = AnatomyPart(Mesh(SHELL.vertices, SHELL.faces), role)  # type: ignore[arg-type]
    points = line(60)
    triangles = SHELL.triangles
    nearest = [
        np.linalg.norm(trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1))) - p, axis=1).min()
        for p in points
    ]
    radius = np.linalg.norm(points, axis=1)
    within = (radius < 0.0198) & (radius > 0.01)
    sure = (radius < 0.0095) | within | (radius > 0.0201)
    expected = np.where(within, -1, 1) * np.array(nearest) * (1 if role == "avoid" else -1)
    np.testing.assert_allclose(RawAnatomy.of([part]).room(points)[sure], expected[sure], atol=1e-9)


def test_agrees_with_the_distance_that_certificates_use() -> None:
    lumen = AnatomyPart(Mesh(BALL.vertices, BALL.faces), "inside", 1e-3)
    other = AnatomyPart(Mesh(BALL.vertices + [0.02, 0, 0], BALL.faces), "inside")
    parts = [lumen, other, AnatomyPart(Sphere(np.zeros(3), 0.003))]
    np.testing.assert_allclose(RawAnatomy.of(parts).room(line()), exact_clearance(parts, line()), atol=1e-9)


def test_winding_numbers_count_layers() -> None:
    twice = np.concatenate([BALL.triangles, BALL.triangles])
    assert winding_number(twice, np.zeros(3)) == pytest.approx(2)
    assert winding_number(SHELL.triangles, np.zeros(3)) == pytest.approx(0, abs=1e-9)
    assert winding_number(BALL.triangles, np.array([0.0, 0.0, 0.05])) == pytest.approx(0, abs=1e-9)


def test_a_rigid_displacement_changes_no_distance() -> None:
    R, shift = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.array([0.1, -0.2, 0.05])
    moved = AnatomyPart(Mesh(SHELL.vertices @ R.T + shift, SHELL.faces))
    here = RawAnatomy.of([AnatomyPart(Mesh(SHELL.vertices, SHELL.faces))]).room(line())
    np.testing.assert_allclose(RawAnatomy.of([moved]).room(line() @ R.T + shift), here, atol=1e-9)


def test_the_least_of_a_body_is_that_of_all_its_points() -> None:
    """Points that are left out can't be nearer."""
    rng = np.random.default_rng(5)
    sphere = AnatomyPart(Sphere(np.array([0.02, 0.01, 0.06]), 0.01))
    block = trimesh.creation.box(bounds=[[-0.02, -0.02, 0.03], [-0.005, 0.02, 0.05]])
    box = AnatomyPart(Mesh(np.array(block.vertices), np.array(block.faces)))
    for _ in range(50):
        turns = np.cumsum(0.06 * rng.standard_normal((6, 60, 3)), axis=1) + [0.0, 0.0, 1.0]
        bodies = 2e-3 * np.cumsum(turns / np.linalg.norm(turns, axis=2, keepdims=True), axis=1)
        radius = np.where(np.arange(60) < 30, 1.3e-3, 0.9e-3)
        for parts in ((sphere,), (box,), (sphere, box)):
            anatomy = RawAnatomy.of(parts)
            least, looked = anatomy.least(bodies, radius)
            every = np.array([(anatomy.room(body) - radius).min() for body in bodies])
            np.testing.assert_allclose(least, every, atol=1e-12)
            assert looked <= bodies.shape[0] * bodies.shape[1]
