"""The shipped anatomy meshes are what their script makes."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh
from places import SCENARIOS

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.mesh import Mesh


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_meshes", SCENARIOS / "make_meshes.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


make_meshes = script()
swept, implicit = (importlib.import_module(f"anatomies.{name}") for name in ("swept", "implicit"))
HOLES = {"sphenoid_wall": 1}


def test_regenerating_gives_the_shipped_files(tmp_path: Path) -> None:
    made = make_meshes.make_meshes(tmp_path)
    assert {p.name for p in made} == {p.name for p in tmp_path.iterdir()}
    for path in made:
        assert path.read_bytes() == (SCENARIOS / "meshes" / path.name).read_bytes(), path.name
        assert path.stat().st_size < 400_000


@pytest.mark.parametrize(
    ("name", "bodies"),
    [
        ("vessel", 1),
        ("ribs", 4),
        ("heart_chamber", 1),
        ("airway", 1),
        ("ventricle", 1),
        ("sphenoid_wall", 1),
        ("conchae", 2),
    ],
)
def test_meshes_are_closed_and_outward(name: str, bodies: int) -> None:
    path = SCENARIOS / "meshes" / f"{name}.stl"
    mesh = trimesh.load_mesh(path)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert mesh.euler_number == 2 * bodies - 2 * HOLES.get(name, 0)
    vertices, faces = load_mesh(path, "mm")
    assert len(faces) == len(mesh.faces)
    np.testing.assert_allclose(mesh.bounds * 1e-3, [vertices.min(axis=0), vertices.max(axis=0)], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "room_mm"), [("vessel", 11.9), ("heart_chamber", 10.0), ("airway", 8.5), ("ventricle", 5.5)]
)
def test_lumens_have_room_at_the_front_plate(name: str, room_mm: float) -> None:
    vertices, faces = load_mesh(SCENARIOS / "meshes" / f"{name}.stl")
    clearance = exact_clearance([AnatomyPart(Mesh(vertices, faces), "inside")], np.zeros((1, 3)))
    assert clearance[0] > room_mm * 1e-3


def test_tube_keeps_its_radius_around_the_centreline() -> None:
    def bend(s: np.ndarray) -> np.ndarray:
        return np.full_like(s, 1 / 200)

    curve = swept.space_curve(150.0, 61, bend, lambda s: np.zeros_like(s), (0, 0, 0))
    arc = np.linspace(0, 150.0, 61) / 200
    expected = 200 * np.stack([1 - np.cos(arc), np.zeros(61), np.sin(arc)], axis=1)
    np.testing.assert_allclose(curve, expected, atol=1e-3)
    vertices, faces = swept.sweep_tube(curve, np.full(61, 6.0), 48)
    part = AnatomyPart(Mesh(vertices * 1e-3, faces), "inside")
    clearance = exact_clearance([part], curve[5:-5] * 1e-3)
    np.testing.assert_allclose(clearance, 6e-3, atol=3e-5)


def test_implicit_surfaces_lie_where_their_distance_is_zero() -> None:
    """The finer, the nearer (first order: nodes are kept off the surface); a hole shows in the topology."""
    body = implicit.united(
        [implicit.round_cone((0, 0, 0), (0, 0, 20), 5.0), implicit.round_cone((0, 0, 6), (9, 0, 9), 3.0)], 3.0
    )
    off = []
    for cell in (1.2, 0.6):
        vertices, faces = implicit.surface(body, (-8, -8, -8), (15, 8, 28), cell)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight and mesh.euler_number == 2 and mesh.area_faces.min() > 0
        off.append(np.sqrt(np.mean(body(vertices) ** 2)))
    assert off[1] < 0.75 * off[0] and off[1] < 0.02
    pierced = implicit.without(body, implicit.round_cone((0, -20, 14), (0, 20, 14), 1.5))
    vertices, faces = implicit.surface(pierced, (-8, -8, -8), (15, 8, 28), 0.9)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0 and mesh.euler_number == 0


def test_frames_do_not_twist() -> None:
    s = np.linspace(0, 40, 200)
    helix = np.stack([20 * np.cos(s / 10), 20 * np.sin(s / 10), 3 * s], axis=1)
    vertices, _ = swept.sweep_tube(helix, np.full(200, 2.0), 12)
    spoke = (vertices[: 200 * 12].reshape(200, 12, 3)[:, 0] - helix) / 2
    tangent = np.gradient(helix, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    turn = np.einsum("ki,ki->k", np.cross(spoke[:-1], spoke[1:]), tangent[:-1])
    assert np.abs(turn).max() < 1e-4
