"""Distances to triangles by the core's tree, against libigl's and every triangle tried by itself; samples of grids."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from ctrplan.anatomy.clearance_grid import SignedDistanceField
from ctrplan.anatomy.parts import TriangleTree
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.arrays import Array

STEPS = 40  # along the sides of triangles that are tried point by point


def soup(rng: np.random.Generator, faces: int) -> tuple[Array, Array]:
    """Triangles of all sizes, some of them needles, edges or points."""
    vertices = rng.normal(size=(3 * faces, 3)) * 10 ** rng.uniform(-3, 0, size=(3 * faces, 1))
    index = np.arange(3 * faces).reshape(-1, 3)
    index[::7, 2] = index[::7, 1]  # an edge
    index[::11] = index[::11, :1]  # a point
    return vertices, index


def of_every_triangle(points: Array, vertices: Array, faces: Array) -> Array:
    """By a fine grid of points on every triangle, from above."""
    u, v = np.meshgrid(*[np.linspace(0, 1, STEPS + 1)] * 2)
    inside = u + v <= 1 + 1e-12
    weights = np.column_stack([1 - u[inside] - v[inside], u[inside], v[inside]])
    on = np.einsum("wk,fkx->fwx", weights, vertices[faces]).reshape(-1, 3)
    return np.array([np.sqrt(((on - p) ** 2).sum(axis=1).min()) for p in points])


@pytest.mark.parametrize("faces", [1, 2, 3, 8, 9, 40, 1000])
def test_distances_are_those_of_another_library(faces: int) -> None:
    rng = np.random.default_rng(faces)
    vertices, index = soup(rng, faces)
    points = rng.normal(size=(500, 3)) * 10 ** rng.uniform(-3, 1, size=(500, 1))
    tree = igl.AABB()
    tree.init(vertices, index)
    expected = np.sqrt(np.asarray(tree.squared_distance(vertices, index, points)[0]))
    assert TriangleTree(vertices, index).distance(points) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_no_point_of_a_triangle_is_nearer() -> None:
    rng = np.random.default_rng(0)
    vertices, index = soup(rng, 12)
    points = rng.normal(size=(60, 3))
    found, above = TriangleTree(vertices, index).distance(points), of_every_triangle(points, vertices, index)
    sides = np.linalg.norm(vertices[index] - vertices[np.roll(index, 1, axis=1)], axis=2)
    assert np.all(found <= above + 1e-12) and np.all(found >= above - sides.max() / STEPS)


def test_the_order_of_points_and_triangles_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    vertices, index = soup(rng, 300)
    points = rng.normal(size=(400, 3))
    found = TriangleTree(vertices, index).distance(points)
    shuffled, other = rng.permutation(400), TriangleTree(vertices, rng.permutation(index))
    assert np.array_equal(other.distance(points[shuffled]), found[shuffled])
    assert TriangleTree(vertices, index).distance(points[:0]).shape == (0,)


def test_what_is_no_surface_is_refused() -> None:
    vertices = np.eye(3)
    with pytest.raises(ValueError, match="needs triangles"):
        TriangleTree(vertices, np.zeros((0, 3), dtype=np.int64))
    for index in (3, -1):
        with pytest.raises(ValueError, match="not there"):
            TriangleTree(vertices, np.array([[0, 1, index]]))


def test_the_sign_of_a_run_of_points_is_that_of_each() -> None:
    """Points come in all orders, near two spheres that overlap and one inside out of reach of the next point."""
    vertices, faces = sphere()
    mesh = Mesh(np.concatenate([vertices, vertices + [0.8, 0, 0]]), np.concatenate([faces, faces + len(vertices)]))
    rng = np.random.default_rng(2)
    line = np.linspace([-2, 0.1, 0.2], [3, -0.2, 0.1], 300)
    for points in (line, line[::-1], rng.permutation(line), rng.uniform(-2, 3, size=(2000, 3))):
        alone = np.concatenate([mesh.distance(p[None]) for p in points])
        assert np.array_equal(mesh.distance(points), alone)


def test_points_on_both_sides_of_a_wall_have_signs_of_their_own() -> None:
    """The points are as far from the wall as they can be with the wall in between."""
    rng, vertices = np.random.default_rng(4), np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    sides = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2]]
    mesh = Mesh(vertices, np.array([*sides, [2, 4, 6], [1, 3, 5], [3, 7, 5]])[:, ::-1])
    for away in 10.0 ** rng.uniform(-6, -1, size=200):
        points = np.array([[0.4, 0.4, -away], [0.4, 0.4, away], [0.4, 0.4, -away], [0.4, 0.4, away]])
        assert np.sign(mesh.distance(points)) == pytest.approx([1, -1, 1, -1])


def sphere() -> tuple[Array, Array]:
    """An octahedron, halved three times, on the unit sphere and turned outward."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(3):
        vertices, faces = igl.upsample(vertices, faces)[:2]
    return vertices / np.linalg.norm(vertices, axis=1)[:, None], np.asarray(faces, dtype=np.int64)


def test_samples_of_a_grid_are_trilinear_and_lipschitz_outside() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(4, 3, 5)).astype(np.float32)
    field = SignedDistanceField(np.array([1.0, -2.0, 0.5]), 0.25, values)
    unit = rng.uniform(-0.5, 1.5, size=(500, 3))
    places = unit * (np.array(values.shape) - 1)
    inside = np.clip(places, 0, np.array(values.shape) - 1)
    low = np.minimum(inside.astype(int), np.array(values.shape) - 2)
    share, expected = inside - low, np.zeros(500)
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner), share, 1 - share), axis=1)
        expected += weight * values[tuple((low + corner).T)]
    expected -= 0.25 * np.linalg.norm(places - inside, axis=1)
    assert field.sample(field.origin_m + 0.25 * places) == pytest.approx(expected, abs=1e-6)
