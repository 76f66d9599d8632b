"""Binary glTF: units and axes of its specification, nodes that place its meshes, and what is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from phantoms import part_of

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.errors import InputError


def test_gltf_is_in_metres_with_y_up_by_its_specification_and_may_be_said_otherwise(tmp_path: Path) -> None:
    mesh: trimesh.Trimesh = trimesh.creation.box((0.01, 0.03, 0.02)).apply_translation((0.005, 0.015, -0.01))
    path = tmp_path / "mesh.glb"
    mesh.export(path)
    upright = [[0, 0, 0], [0.01, 0.02, 0.03]]
    vertices, _ = load_mesh(path)
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], upright, atol=1e-8)
    as_stored, _ = load_mesh(path, up="z")
    np.testing.assert_allclose(as_stored.min(axis=0), [0, 0, -0.02], atol=1e-8)
    part = part_of(tmp_path, None, kind="mesh", file=path.name)
    np.testing.assert_allclose(part.box, upright, atol=1e-8)
    note = "is glTF, by its specification in metres and with y up, and was turned so that z is up (key up)"
    assert note in part.shape.notes
    assert part_of(tmp_path, None, kind="mesh", file=path.name, unit="m", up="y").shape.notes == ()
    assert part_of(tmp_path, None, kind="surface", file=path.name).shape.notes == (note,)
    said = part_of(tmp_path, None, kind="mesh", file=path.name, unit="cm", up="z")
    np.testing.assert_allclose(np.ptp(said.box, axis=0), [1e-4, 3e-4, 2e-4], atol=1e-8)


def glb(path: Path, change: Any) -> Path:
    """A box whose JSON was changed."""
    data = trimesh.Scene(trimesh.creation.box((10, 10, 10))).export(file_type="glb")
    size = int.from_bytes(data[12:16], "little")
    content = json.loads(data[20 : 20 + size])
    change(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    path.write_bytes(
        data[:8]
        + (20 + len(text) + len(rest)).to_bytes(4, "little")
        + len(text).to_bytes(4, "little")
        + b"JSON"
        + text
        + rest
    )
    return path


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "needs glTF's extension KHR_draco_mesh_compression"),
        ({"extensionsRequired": ["KHR_mesh_quantization"]}, "needs glTF's extension KHR_mesh_quantization"),
        ({"buffers": [{"uri": "a.bin", "byteLength": 4}]}, "has its vertices in another file"),
    ],
)
def test_what_gltf_needs_and_the_reader_passes_over_is_refused(change: Any, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=phrase):
        load_mesh(glb(tmp_path / "a.glb", lambda content: content.update(change)), "mm")
    path = glb(tmp_path / "b.glb", lambda content: content.update(extensionsRequired=["KHR_materials_unlit"]))
    assert len(load_mesh(path, "mm")[1]) == 12


IDENTITY = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]  # of a node: sixteen numbers, column by column


def first_node(content: Any, **keys: Any) -> None:
    content["nodes"][0].update(keys)


def positions(content: Any) -> Any:
    return next(one for one in content["accessors"] if one["type"] == "VEC3")


def other_scene(content: Any) -> None:
    """A second scene, which is the one to be shown, with the box elsewhere."""
    content["nodes"].append({"mesh": 0, "name": "away", "translation": [100, 0, 0]})
    content["scenes"].append({"nodes": [len(content["nodes"]) - 1]})
    content["scene"] = 1


@pytest.mark.parametrize(
    ("change", "low", "high"),
    [
        (lambda c: first_node(c, scale=[2, 3, 4]), [-10, -15, -20], [10, 15, 20]),
        (lambda c: first_node(c, translation=[10, 20, 30]), [5, 15, 25], [15, 25, 35]),
        (lambda c: first_node(c, rotation=[0, 0, 0.5**0.5, 0.5**0.5], scale=[1, 2, 3]), [-10, -5, -15], [10, 5, 15]),
        (lambda c: first_node(c, matrix=[*IDENTITY[:12], 5, 6, 7, 1]), [0, 1, 2], [10, 11, 12]),
        (lambda c: first_node(c, scale=[-1, 1, 1]), [-5, -5, -5], [5, 5, 5]),
        (lambda c: c["nodes"].append({"mesh": 0, "translation": [100, 0, 0]}), [-5, -5, -5], [5, 5, 5]),
        (other_scene, [95, -5, -5], [105, 5, 5]),
    ],
)
def test_gltf_stands_where_the_nodes_of_its_scene_put_it(change: Any, low: Any, high: Any, tmp_path: Path) -> None:
    vertices, faces = load_mesh(glb(tmp_path / "a.glb", change), "mm", up="z")
    np.testing.assert_allclose([vertices.min(axis=0) * 1e3, vertices.max(axis=0) * 1e3], [low, high], atol=1e-4)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0  # outward, mirrored or not


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (lambda c: positions(c).update(sparse={"count": 1}), "has sparse accessors of glTF"),
        (
            lambda c: first_node(c, matrix=IDENTITY, scale=[1, 1, 1]),
            "places a node of glTF twice, by matrix and by scale",
        ),
        (lambda c: first_node(c, skin=0), r"has a skin of glTF, whose joints move its vertices: export it without"),
        (lambda c: c["meshes"][0].update(weights=[1.0]), "has morph targets of glTF that are at work"),
        (lambda c: first_node(c, weights=[0.5]), "has morph targets of glTF that are at work"),
        (lambda c: first_node(c, extensions={"EXT_mesh_gpu_instancing": {}}), "uses glTF's EXT_mesh_gpu_instancing"),
        (lambda c: c["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}}), "EXT_meshopt_compression"),
        (lambda c: positions(c).pop("bufferView"), "has vertices of glTF without numbers .*compressed"),
        (
            lambda c: positions(c).update(min=[0, 0, 0]),
            "from -5, -5, -5 to 5, 5, 5, but glTF's min states 0, 0, 0",
        ),
        (lambda c: positions(c).update(normalized=True), "has vertices of glTF that are no plain floats"),
        (lambda c: positions(c).update(componentType=5122), "has vertices of glTF that are no plain floats"),
    ],
)
def test_what_would_move_vertices_of_gltf_is_refused(change: Any, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=phrase):
        load_mesh(glb(tmp_path / "a.glb", change), "mm")


def test_gltf_of_version_1_and_other_files_of_that_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"glTF\x01\0\0\0" + bytes(40))
    with pytest.raises(InputError, match="is no binary glTF of version 2"):
        load_mesh(tmp_path / "a.glb")
