"""The judge of plans for public patients (tests/oracles/patient_clearance.py) measures as formulas and libigl do."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import igl
import numpy as np
import patient_clearance
import pytest
import SimpleITK
import trimesh
from scipy.spatial.transform import Rotation

SPACING = np.array([0.7, 0.9, 1.6])


@pytest.fixture
def judge() -> ModuleType:
    return patient_clearance


def test_bases_turn_as_the_files_say(judge: ModuleType) -> None:
    turned = Rotation.random(random_state=1)
    x, y, z, w = turned.as_quat()
    _, R = judge._base({"position_mm": [1, 2, 3], "quaternion_wxyz": [w, x, y, z]})
    np.testing.assert_allclose(R, turned.as_matrix(), atol=1e-14)
    _, R = judge._base({"position_mm": [1, 2, 3], "direction": [1.0, -2.0, 0.5]})
    np.testing.assert_allclose(R @ [0, 0, np.sqrt(5.25)], [1.0, -2.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


def test_distances_to_triangles_are_those_of_libigl(judge: ModuleType) -> None:
    body = trimesh.creation.icosphere(2, radius=10)
    vertices, faces = body.vertices * [1, 1.3, 0.7] + [5, 6, 7], np.asarray(body.faces, np.int64)
    points = np.random.default_rng(0).normal(size=(200, 3)) * 9 + [5, 6, 7]
    apart = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
    within = np.abs(igl.winding_number(vertices, faces, points)) > 0.5
    for inside in (True, False):
        found = judge._triangle_room(vertices[faces], inside, points)
        np.testing.assert_allclose(found, np.where(within == inside, apart, -apart), atol=1e-12)


def test_distances_to_voxels_are_those_to_every_box(judge: ModuleType, tmp_path: Path) -> None:
    voxels = np.zeros((20, 24, 28), np.uint8)
    voxels[5:12, 6:15, 8:20] = voxels[12:16, 10:12, 12:14] = 1
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing(SPACING)
    image.SetOrigin((3, -4, 5))
    image.SetDirection(Rotation.random(random_state=2).as_matrix().ravel())
    SimpleITK.WriteImage(image, str(tmp_path / "a.nrrd"))
    index = np.random.default_rng(0).uniform(2, 18, (200, 3))
    points = np.array([image.TransformContinuousIndexToPhysicalPoint(place) for place in index.tolist()])
    for inside in (True, False):
        boxes = np.argwhere((voxels == 1) != inside)[:, ::-1]
        gaps = np.maximum(np.abs(index[:, None] - boxes) - 0.5, 0) * SPACING
        apart = np.linalg.norm(gaps, axis=2).min(axis=1)
        found = judge._voxel_room(tmp_path / "a.nrrd", 1, inside, points)
        np.testing.assert_allclose(np.maximum(found, 0), apart, atol=1e-9)
        assert np.all(found[apart == 0] <= 0)
