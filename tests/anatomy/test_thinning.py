"""A thinned surface is closed, has few triangles, and is nowhere farther from the surface than is said."""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from phantoms import distance_mm, part_of

from ctrplan.anatomy import surface_file
from ctrplan.anatomy.surface_file import thinned


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface_file, "HUGE", 15_000)
    monkeypatch.setattr(surface_file, "ENOUGH", 4_000)


def lump() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=8)
    unit = mesh.vertices / 8
    wave = 1 + 0.1 * np.sin(4 * unit[:, 0]) * np.cos(3 * unit[:, 1]) + 0.05 * np.sin(6 * unit[:, 2])
    return trimesh.Trimesh(mesh.vertices * wave[:, None], mesh.faces, process=False)


def test_what_it_is_off_by_bounds_distances(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lump().export(tmp_path / "a.stl")
    part = part_of(tmp_path, None, kind="mesh", file="a.stl", unit="mm", margin_mm=1)
    (note,) = part.shape.notes
    error_mm = part.shape.surface_error_m * 1e3
    assert 0 < error_mm <= 0.05 and part.margin_m == pytest.approx(1e-3 + part.shape.surface_error_m)
    assert f"off by {error_mm:.2g} mm at most" in note and 3_000 < len(part.shape.surface().faces) <= 8_000
    monkeypatch.setattr(surface_file, "HUGE", 10**9)
    whole = part_of(tmp_path, None, kind="mesh", file="a.stl", unit="mm")
    points = np.random.default_rng(0).uniform(-11, 11, (4000, 3))
    assert np.abs(distance_mm(part, points) - distance_mm(whole, points)).max() <= error_mm


def test_the_bound_holds_for_all_points_of_the_surface() -> None:
    """Between a coarse ball and a fine one lies the sagitta, which no vertex shows."""
    fine, coarse = trimesh.creation.icosphere(4, radius=0.001), trimesh.creation.icosphere(3, radius=0.001)
    vertices, faces = np.asarray(fine.vertices), np.asarray(fine.faces, dtype=np.int64)
    thin, triangles = np.asarray(coarse.vertices), np.asarray(coarse.faces, dtype=np.int64)
    bound = surface_file._error_m(vertices, faces, thin, triangles)
    shares = np.random.default_rng(0).dirichlet((1, 1, 1), (len(faces), 20))
    points = np.einsum("fsk,fkx->fsx", shares, vertices[faces]).reshape(-1, 3)
    away = np.sqrt(igl.point_mesh_squared_distance(points, thin, triangles)[0].max())
    assert away <= bound <= 3 * away


def test_what_cant_be_thinned_by_as_little_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = lump()
    vertices, faces = np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.faces, dtype=np.int64)
    monkeypatch.setattr(surface_file, "MOST_ERROR_M", 1e-9)
    kept, same, error = thinned(vertices, faces)
    assert kept is vertices and same is faces and error == 0
    monkeypatch.setattr(surface_file, "_simplify", lambda: None)
    assert thinned(vertices, faces)[1] is faces
