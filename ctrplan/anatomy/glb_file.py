"""Binary glTF files: all their meshes where their scene puts them, or those of one name."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
import trimesh

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal
from ctrplan.base.arrays import Array


def read_glb(stream: BinaryIO, group: str | None) -> tuple[Array, Indices]:
    """Vertices (V, 3) in the file's unit and triangles (F, 3). Raises MeshRefusal for a group that there is not."""
    scene = trimesh.load_scene(stream, file_type="glb", process=False, skip_materials=True)
    vertices, faces, count, names = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0, list[str]()
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        names.append(str(node))
        if group not in (None, name, node) or not hasattr(mesh, "faces"):
            continue
        vertices.append(np.asarray(mesh.vertices) @ transform[:3, :3].T + transform[:3, 3])
        faces.append(np.asarray(mesh.faces, dtype=np.int64) + count)
        count += len(mesh.vertices)
    if group is not None and not count:
        raise MeshRefusal(f"has no group {group!r}, but {', '.join(map(repr, sorted(names)[:12])) or 'none'}")
    return np.concatenate(vertices), np.concatenate(faces)
