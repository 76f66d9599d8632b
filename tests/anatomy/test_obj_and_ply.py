"""What OBJ and binary PLY files may say about one and the same cube, and how long a large one takes."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.anatomy.mesh_formats import read_obj
from ctrplan.errors import InputError

CORNERS = [[x, y, z] for x in (0, 10) for y in (0, 10) for z in (0, 10)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
MIXED = [*QUADS[1:], QUADS[0][:3], (QUADS[0][0], *QUADS[0][2:])]  # two triangles and five quads


def volume_mm3(path: Path) -> float:
    vertices, faces = load_mesh(path)
    a, b, c = (vertices[faces[:, k]] * 1e3 for k in range(3))
    return float(np.einsum("ki,ki->k", a, np.cross(b, c)).sum() / 6)


def obj(vertex: str = "v {} {} {}", corner: str = "{0}", faces: object = MIXED, end: str = "\n") -> str:
    lines = [vertex.format(*place) for place in CORNERS]
    for face in faces:  # type: ignore[attr-defined]
        lines.append("f " + " ".join(corner.format(k + 1, k - 8) for k in face))
    return end.join(lines) + end


@pytest.mark.parametrize(
    "text",
    [
        obj(),
        obj(corner="{1}"),
        obj(vertex="v\t{}\t{}\t{}").replace("f ", "f\t"),
        obj(vertex="  v {} {} {} 1.0"),
        obj(vertex="v {} {} {} 0.5 0.5 0.5"),
        obj(corner="{0}/1/1"),
        obj(corner="{0}//{0}"),
        obj(corner="{1}/"),
        obj(end="\r\n"),
        obj(end="\r"),
        "\ufeff" + obj(),
        "mtllib absent.mtl\no cube\ng a b\nusemtl x\ns off\nvn 0 0 1\nvt 0 0\n# Gefäß\n" + obj(),
        obj().replace(" 10 10 10", " 10 \\\n10 10"),
        obj().replace("v 0 0 0", "v 0 0 0 # the origin"),
        "g some\n" + obj().replace("v ", "usemtl x\nv "),
    ],
    ids=lambda text: repr(text[:20]),
)
def test_one_cube_however_it_is_written(text: str, tmp_path: Path) -> None:
    path = tmp_path / "cube.obj"
    path.write_bytes(text.encode())
    assert volume_mm3(path) == pytest.approx(1000.0)
    path.write_bytes(text.encode("latin-1", "ignore"))
    assert volume_mm3(path) == pytest.approx(1000.0)


def test_negative_indices_count_from_the_last_vertex_so_far(tmp_path: Path) -> None:
    """Faces between the vertices: the same index means another vertex each time."""
    cube = trimesh.creation.box((10, 10, 10))
    lines = []
    for face in cube.faces:
        lines += ["v {} {} {}".format(*cube.vertices[k]) for k in face] + ["f -3 -2 -1"]
    (tmp_path / "soup.obj").write_text("\n".join(lines))
    assert volume_mm3(tmp_path / "soup.obj") == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("f 5", "f 0", "line 9 is no face"),
        ("f 5", "f -9", "line 9 is no face"),
        ("f 5", "f five", "line 9 is no face of three corners and more: f five"),
        ("f 5", "f 1_0", "line 9 is no face"),
        ("f 5", "f " + "9" * 5000, "line 9 is no face"),
        ("f 5", "f 99", "a triangle refers to a vertex beyond the 8 there are"),
        ("f 5 7 8 6", "f 5 7", "line 9 is no face"),
        ("v 0 0 10", "v 0 0", "line 2 is no vertex of three coordinates: v 0 0"),
        ("v 0 0 10", "v 0 0 1_0", "line 2 is no vertex"),
        ("v 0 0 10", "v 0 0 x", "line 2 is no vertex"),
    ],
)
def test_the_line_of_a_fault_is_named(old: str, new: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "cube.obj"
    path.write_text(obj().replace(old, new, 1))
    with pytest.raises(InputError, match=words) as caught:
        load_mesh(path)
    assert len(str(caught.value)) < 400


def test_an_obj_of_many_groups_takes_time_in_proportion_to_its_lines(tmp_path: Path) -> None:
    """Twice the lines, about twice the time; 400,000 lines in seconds."""
    times = []
    for count in (50_000, 100_000):
        groups = "".join(f"g group{k}\nusemtl material{k}\nf 1 2 3\n" for k in range(count))
        (tmp_path / "groups.obj").write_text(obj() + groups)
        began = time.process_time()  # others on the machine don't count
        assert len(read_obj(tmp_path / "groups.obj")[1]) == count + 12
        times.append(time.process_time() - began)
    assert times[1] < 4 * times[0] + 0.2 and times[1] < 5


def ply(
    order: str = "<",
    count: str = "uchar",
    index: str = "int",
    faces: object = MIXED,
    extra: bool = False,
    end: str = "\n",
) -> bytes:
    codes = {"uchar": "B", "ushort": "H", "int": "i", "uint": "I", "short": "h", "uint8": "B"}
    rows = list(faces)  # type: ignore[call-overload]
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = ["ply", f"format {name} 1.0", "comment a cube", "element vertex 8"]
    header += ["property float x", "property float y", "property float z"] + ["property uchar red"] * extra
    header += [f"element face {len(rows)}"] + ["property uchar flags"] * extra
    header += [f"property list {count} {index} vertex_indices"] + ["property list uchar float texcoord"] * extra
    content = [(end.join([*header, "end_header"]) + end).encode()]
    for place in CORNERS:
        content.append(struct.pack(f"{order}3f", *place) + b"\x07" * extra)
    for k, row in enumerate(rows):
        content.append(b"\x01" * extra + struct.pack(f"{order}{codes[count]}", len(row)))
        content.append(struct.pack(f"{order}{len(row)}{codes[index]}", *row))
        if extra:
            content.append(struct.pack(f"{order}B{k % 3}f", k % 3, *[0.5] * (k % 3)))
    return b"".join(content)


TRIANGLES = [face for quad in QUADS for face in (quad[:3], (quad[0], *quad[2:]))]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("faces", [MIXED, QUADS, TRIANGLES], ids=["mixed", "quads", "triangles"])
@pytest.mark.parametrize("types", [("uchar", "int"), ("uint8", "uint"), ("int", "short"), ("ushort", "uchar")])
@pytest.mark.parametrize("extra", [False, True])
def test_one_cube_in_every_binary_ply(
    order: str, faces: object, types: tuple[str, str], extra: bool, tmp_path: Path
) -> None:
    path = tmp_path / "cube.ply"
    path.write_bytes(ply(order, *types, faces, extra))
    assert volume_mm3(path) == pytest.approx(1000.0)
    if order == "<" and not extra:
        path.write_bytes(ply(order, *types, faces, end="\r\n"))
        assert volume_mm3(path) == pytest.approx(1000.0)


@pytest.mark.parametrize("lost", [1, 5, 40, 150])
def test_a_binary_ply_cut_short_is_damaged(lost: int, tmp_path: Path) -> None:
    path = tmp_path / "cube.ply"
    path.write_bytes(ply()[:-lost])
    with pytest.raises(InputError, match="is damaged"):
        load_mesh(path)
    path.write_bytes(ply() + b"\0" * lost)
    with pytest.raises(InputError, match=f"{lost} bytes are left over"):
        load_mesh(path)


def test_a_large_mixed_ply_is_read_in_seconds(tmp_path: Path) -> None:
    path = tmp_path / "large.ply"
    path.write_bytes(ply(faces=[*MIXED, *[QUADS[0], QUADS[0][:3]] * 100_000]))
    began = time.process_time()
    assert volume_mm3(path) == pytest.approx(1000.0)  # repeated triangles are one
    assert time.process_time() - began < 5
