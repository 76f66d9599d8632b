"""Surfaces of structures in medical images: how near they are to what was scanned, closed, and whole where thin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from phantoms import AXES, CENTRE, OBLIQUE, capsule, distance_mm, image, near_points, part_of, torus, written
from scipy.spatial.transform import Rotation

from ctrplan.anatomy import structure
from ctrplan.anatomy.structure import ImageStructure


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.7, 0.7, 1.4)])
def test_the_surface_lies_between_the_voxels_without_stairs(spacing: Any, tmp_path: Path) -> None:
    """Root mean square below 0.15 voxel, no systematic shift, and nowhere off by more than the margin is widened by."""
    wide = max(spacing)
    centre, axis = np.array([3.1, -2.3, 8.7]), OBLIQUE[0]
    bodies = [
        capsule(centre - 8 * wide * axis, centre + 8 * wide * axis, 5 * wide),
        torus(centre, Rotation.from_euler("xy", [50, 20], degrees=True).as_matrix(), 9 * wide, 4 * wide),
    ]
    for body in bodies:
        written(image(body, centre, 16 * wide, spacing), tmp_path / "a.nrrd")
        part = part_of(tmp_path, kind="volume", file="a.nrrd", label=3, margin_mm=0.5)
        off = body(part.shape.surface().vertices_m * 1e3) / wide
        assert np.sqrt(np.mean(off**2)) <= 0.15 and abs(np.mean(off)) <= 0.03
        assert np.abs(off).max() <= structure.LABEL_ERROR
        assert part.margin_m == pytest.approx(0.5e-3 + structure.LABEL_ERROR * wide * 1e-3)


def test_labels_leave_a_wall_along_the_voxels_open_by_nearly_one(tmp_path: Path) -> None:
    """Two boxes have the same labels: what is said of one surface can't be nearer to both than half their distance."""
    voxel, sizes = 1.0, (6.05, 6.95)

    def box(half: float) -> Any:
        return lambda points: np.abs(points).max(axis=1) - half

    made = [image(box(half), np.zeros(3), 12.0 - voxel / 2, voxel, np.eye(3)) for half in sizes]
    assert np.array_equal(*map(SimpleITK.GetArrayFromImage, made))
    assert np.any(np.isclose(np.mod(made[0].GetOrigin(), voxel), 0))  # voxels at whole mm: 6 is within both, 7 is not
    written(made[0], tmp_path / "a.nrrd")
    part = part_of(tmp_path, kind="volume", file="a.nrrd", label=3)
    places = part.shape.surface().vertices_m * 1e3
    wall = places[(np.sort(np.abs(places), axis=1)[:, 1] < 3.0)]  # of flat sides, away from edges
    off = [np.abs(box(half)(wall)).max() for half in sizes]
    least = (sizes[1] - sizes[0]) / 2
    assert max(off) >= least > 0.15 * voxel
    assert max(off) <= part.shape.surface_error_m * 1e3  # which the margin includes


def test_grey_values_cross_a_threshold_between_voxels(tmp_path: Path) -> None:
    body = capsule(CENTRE - 9 * OBLIQUE[1], CENTRE + 9 * OBLIQUE[1], 6)
    written(image(body, CENTRE, 24, 1.0, grey=True), tmp_path / "a.nrrd")
    inside = part_of(tmp_path, kind="volume", file="a.nrrd", above=-500)
    assert np.abs(body(inside.shape.surface().vertices_m * 1e3)).max() <= structure.GREY_ERROR
    outside = part_of(tmp_path, kind="volume", file="a.nrrd", below=-500, role="inside")
    points = CENTRE + (near_points() - CENTRE) / 2  # nearer to the body than to the image's edges
    np.testing.assert_allclose(distance_mm(outside, points), -distance_mm(inside, points), atol=0.05)


def test_the_surface_is_closed_and_every_voxel_on_its_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Voxels are drawn at random: whatever the slabs, every edge has two triangles and every voxel stays in or out."""
    import igl

    inside = np.pad(np.random.default_rng(3).random((13, 12, 11)) < 0.4, 2)
    chosen = ImageStructure(inside, None, np.zeros(3, np.int64), False)
    surfaces = []
    for slab in (5, 100):
        monkeypatch.setattr(structure, "SLAB", slab)
        vertices, faces = structure.level_surface(chosen)
        sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        assert (np.unique(sides, axis=0, return_counts=True)[1] % 2 == 0).all()
        centres = np.argwhere(np.ones(inside.shape, bool))[:, ::-1].astype(float)
        winding = igl.winding_number(vertices, faces, centres)
        np.testing.assert_array_equal(winding > 0.5, inside.ravel())
        surfaces.append(np.sort(np.round(vertices, 9).view([("", float)] * 3), axis=0))
    np.testing.assert_array_equal(*surfaces)


def test_a_tube_of_one_voxel_stays_whole(tmp_path: Path) -> None:
    inside = np.zeros((40, 9, 9), bool)
    inside[3:37, 4, 4] = True
    vertices, _ = structure.level_surface(ImageStructure(inside, None, np.zeros(3, np.int64), False))
    assert vertices[:, 2].min() < 3 and vertices[:, 2].max() > 36


def test_thin_tubes_are_known_to_be_less_certain(tmp_path: Path) -> None:
    for radius, bound in ((0.9, structure.THIN_ERROR), (2.5, structure.LABEL_ERROR)):
        body = capsule(CENTRE - 12 * OBLIQUE[1], CENTRE + 12 * OBLIQUE[1], radius)
        written(image(body, CENTRE, 18, 1.0, AXES["swapped"]), tmp_path / "a.nrrd")
        part = part_of(tmp_path, kind="volume", file="a.nrrd", label=3)
        assert part.shape.surface_error_m == pytest.approx(bound * 1e-3)
        assert np.abs(body(part.shape.surface().vertices_m * 1e3)).max() <= bound
