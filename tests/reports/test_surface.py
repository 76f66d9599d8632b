"""Surfaces are closed, have the radius they should, and are thinned without being moved."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.surface import Rod, Surface, capsule
from ctrplan.reports.robot_surface import anatomy_surface, thinned


def helix(stations: int = 60) -> Rod:
    t = np.linspace(0, 4, stations)
    line = np.stack([np.cos(t), np.sin(t), 0.5 * t], axis=1) * 0.05
    tangent = np.stack([-np.sin(t), np.cos(t), np.full_like(t, 0.5)], axis=1)
    return Rod(line, tangent / np.linalg.norm(tangent, axis=1, keepdims=True), np.linspace(0.002, 0.001, stations))


def mesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices_m, surface.faces, process=False)


@given(sides=st.integers(3, 24), stations=st.integers(2, 50))
@settings(max_examples=30, deadline=None)
def test_swept_rod_is_watertight(sides: int, stations: int) -> None:
    surface = helix(stations).surface(sides)
    assert surface.vertices_m.shape == (stations * sides + 2, 3)
    assert mesh(surface).is_watertight and mesh(surface).is_winding_consistent


def test_swept_rod_has_its_radius_and_faces_outward() -> None:
    rod, sides = helix(), 16
    rings = rod.surface(sides).vertices_m[:-2].reshape(len(rod.radius_m), sides, 3)
    spokes = rings - rod.centreline_m[:, None]
    np.testing.assert_allclose(np.linalg.norm(spokes, axis=2), np.tile(rod.radius_m[:, None], sides), rtol=1e-12)
    np.testing.assert_allclose(np.einsum("nki,ni->nk", spokes, rod.tangent), 0, atol=1e-15)
    polygon = sides / 2 * np.sin(2 * np.pi / sides)
    length = np.linalg.norm(np.diff(rod.centreline_m, axis=0), axis=1)
    middle = np.square(rod.radius_m[1:]) + rod.radius_m[1:] * rod.radius_m[:-1] + np.square(rod.radius_m[:-1])
    assert mesh(rod.surface(sides)).volume == pytest.approx(polygon * float(length @ middle) / 3, rel=1e-3)


def test_frames_do_not_jump_when_the_rod_moves_a_little() -> None:
    rod = helix()
    tilted = Rod(rod.centreline_m, rod.tangent @ np.array([[1, 0, 1e-4], [0, 1, 0], [-1e-4, 0, 1]]), rod.radius_m)
    shift = np.abs(rod.surface(8).vertices_m - tilted.surface(8).vertices_m).max()
    assert shift < 2e-3 * rod.radius_m.max()


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.05)])
def test_capsule_keeps_its_distance(end: tuple[float, float, float]) -> None:
    start, radius = np.array([0.01, 0.02, 0.03]), 0.012
    surface = capsule(start, start + end, radius, 64)
    axis = np.array(end)
    along = np.clip((surface.vertices_m - start) @ axis / max(axis @ axis, 1e-30), 0, 1)
    distance = np.linalg.norm(surface.vertices_m - start - along[:, None] * axis, axis=1)
    on_axis = 2  # the poles' middles
    np.testing.assert_allclose(distance[:-on_axis], radius, rtol=1e-9)
    exact = np.pi * radius**2 * np.linalg.norm(axis) + 4 / 3 * np.pi * radius**3
    assert mesh(surface).volume == pytest.approx(exact, rel=0.01)


def test_thinning_keeps_the_surface_where_it_was() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.03)
    part = AnatomyPart(Mesh(sphere.vertices, sphere.faces))
    few = anatomy_surface(part, triangles=5000)
    assert len(sphere.faces) > 80_000 and 500 < len(few.faces) <= 5000
    np.testing.assert_allclose(np.linalg.norm(few.vertices_m, axis=1), 0.03, rtol=0.01)
    assert mesh(few).volume == pytest.approx(sphere.volume, rel=0.02)


def test_coarse_meshes_stay_as_they_are() -> None:
    box = trimesh.creation.box()
    surface = Surface(np.array(box.vertices), np.array(box.faces))
    assert thinned(surface, 12) is surface


def test_thin_vessels_stay_whole_when_they_are_thinned() -> None:
    """Merged in cells of a grid, those that are thinner than a cell fell to flakes."""
    t = np.linspace(0, 40, 3000)
    line = np.stack([np.cos(t), np.sin(t), 0.05 * t], axis=1) * 0.05
    tangent = np.gradient(line, t, axis=0)
    rod = Rod(line, tangent / np.linalg.norm(tangent, axis=1, keepdims=True), np.full(len(t), 4e-4))
    whole = rod.surface(8)
    few = thinned(whole, 4000)
    assert len(few.faces) <= 4000 < len(whole.faces) / 10
    assert mesh(few).is_watertight
    assert mesh(few).volume == pytest.approx(mesh(whole).volume, rel=0.1)
