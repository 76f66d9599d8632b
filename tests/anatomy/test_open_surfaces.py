"""Meshes with openings, sheets, groups, frames: what is closed says where, what can't be told is refused."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from phantoms import distance_mm, part_of

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.errors import InputError

Faces = NDArray[np.int64]


def ball(subdivisions: int = 4, radius: float = 20.0) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def without(mesh: trimesh.Trimesh, gone: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[~np.asarray(gone)], process=False)


def pierced() -> trimesh.Trimesh:
    mesh = ball()
    return without(mesh, (mesh.faces == 7).any(axis=1) | (np.arange(len(mesh.faces)) == 300))


def cut(bumpy: float = 0.0) -> trimesh.Trimesh:
    """A tube along z, open at both ends, one of them bent by that much."""
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(0, 30, 25), indexing="ij")
    radius = 5 + 0.8 * np.cos(3 * angle)  # an end that is not convex
    height = z + bumpy * np.cos(2 * angle) * (z > 29)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(40), np.arange(24), indexing="ij")
    a, b = i * 25 + j, (i + 1) % 40 * 25 + j
    faces = np.concatenate([np.stack([a, b, b + 1], -1).reshape(-1, 3), np.stack([a, b + 1, a + 1], -1).reshape(-1, 3)])
    return trimesh.Trimesh(vertices, faces, process=False)


def entry(folder: Path, mesh: trimesh.Trimesh, suffix: str = ".ply", **keys: Any) -> Any:
    mesh.export(folder / f"a{suffix}")
    return part_of(folder, None, **{"kind": "mesh", "file": f"a{suffix}", "unit": "mm"} | keys)


def test_small_holes_are_closed_and_said_where(tmp_path: Path) -> None:
    part = entry(tmp_path, pierced())
    (note,) = part.shape.notes
    assert note.startswith("2 openings were closed, the widest at (") and "mm from any vertex" in note
    middle = np.array([float(x) for x in note.split("(")[1].split(")")[0].split(",")])
    assert np.linalg.norm(middle - ball().vertices[7]) < 1
    points = np.random.default_rng(0).uniform(-25, 25, (500, 3))
    whole = entry(tmp_path, ball())
    assert not whole.shape.notes
    np.testing.assert_allclose(distance_mm(part, points), distance_mm(whole, points), atol=0.2)


def test_repair_off_and_holes_that_are_too_large_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"file = 'a.ply': is not closed: has 8 open edges"):
        entry(tmp_path, pierced(), repair="off")
    mesh = ball()
    with pytest.raises(
        InputError, match=r"is open at \(.*\) mm, [23]\d.* mm across: a patch would lie .* must lie within 2 mm"
    ):
        entry(tmp_path, without(mesh, np.abs(mesh.triangles_center - (0, 0, 20)).max(axis=1) < 10))
    with pytest.raises(InputError, match="it is flat, repair = 'caps' closes it"):
        entry(tmp_path, cut())
    with pytest.raises(InputError, match="close it where the mesh was made, or say kind = 'surface'"):
        entry(tmp_path, cut(2.0), repair="caps")


def test_flat_cuts_are_capped_when_asked(tmp_path: Path) -> None:
    part = entry(tmp_path, cut(), repair="caps")
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    flat = np.stack([np.cos(angle), np.sin(angle)]) * (5 + 0.8 * np.cos(3 * angle))
    area = np.sum(flat[0] * np.roll(flat[1], -1) - flat[1] * np.roll(flat[0], -1)) / 2
    surface = part.shape.surface()
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces] * 1e3, 1, 0)
    assert np.einsum("ki,ki->", a, np.cross(b, c)) / 6 == pytest.approx(30 * area, rel=1e-6)
    caps = np.abs(np.cross(b - a, c - a)[:, 2])
    assert caps.sum() / 2 == pytest.approx(2 * area, rel=1e-6)  # none of their triangles is outside, or twice there
    assert (distance_mm(part, [[0, 0, 1], [0, 0, 29]]) == pytest.approx(-1)) and distance_mm(part, [[0, 0, -3]]) == 3


def test_what_cant_be_told_apart_is_refused_with_the_place(tmp_path: Path) -> None:
    mesh = ball()
    fin = np.array([[*mesh.faces[5][:2], len(mesh.vertices)]])
    branched = trimesh.Trimesh(
        [*mesh.vertices, mesh.vertices[mesh.faces[5][0]] * 1.2], [*mesh.faces, *fin], process=False
    )
    with pytest.raises(InputError, match=r"is not closed at \(.*\) mm, where 3 triangles meet at an edge: inside and"):
        entry(tmp_path, branched)


def test_a_sheet_has_a_distance_without_a_sign(tmp_path: Path) -> None:
    wall = trimesh.Trimesh([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    part = entry(tmp_path, wall, kind="surface")
    np.testing.assert_allclose(distance_mm(part, [[5, 5, 3], [5, 5, -3], [5, -4, 3]]), [3, 3, 5], atol=1e-6)
    with pytest.raises(InputError, match="role = 'inside': must be 'avoid': a sheet has no inside"):
        entry(tmp_path, wall, kind="surface", role="inside")


def two_boxes() -> list[trimesh.Trimesh]:
    return [trimesh.creation.box((10, 10, 10)), trimesh.creation.box((4, 6, 8)).apply_translation((20, 0, 0))]


def test_groups_of_an_obj_and_nodes_of_a_glb_by_name(tmp_path: Path) -> None:
    lines, count = [], 1
    for name, mesh in zip(("wall", "nodule left"), two_boxes(), strict=True):
        lines += [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"g {name}"]
        lines += ["f " + " ".join(str(k + count) for k in face) for face in mesh.faces]
        count += len(mesh.vertices)
    (tmp_path / "a.obj").write_text("\n".join(lines))
    scene = trimesh.Scene()
    scene.add_geometry(two_boxes()[0], node_name="wall", geom_name="wall")
    away = trimesh.transformations.translation_matrix((20, 0, 0))
    scene.add_geometry(trimesh.creation.box((4, 6, 8)), node_name="nodule left", geom_name="n", transform=away)
    scene.export(tmp_path / "a.glb")
    for file in ("a.obj", "a.glb"):
        said = {"unit": "mm", "up": "z"}
        part = part_of(tmp_path, None, kind="mesh", file=file, **said, group="nodule left")
        np.testing.assert_allclose(np.array(part.box) * 1e3, [[18, -3, -4], [22, 3, 4]], atol=1e-5)
        whole = part_of(tmp_path, None, kind="mesh", file=file, **said)
        np.testing.assert_allclose(np.array(whole.box) * 1e3, [[-5, -5, -5], [22, 5, 5]], atol=1e-5)
        with pytest.raises(InputError, match="has no group 'lung', but .*'wall'"):
            part_of(tmp_path, None, kind="mesh", file=file, **said, group="lung")


def vtk_files(folder: Path, mesh: trimesh.Trimesh) -> list[str]:
    """The mesh in each form that VTK writes: text, binary, cells of version 5, XML of three encodings."""
    v, f = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    counted = np.column_stack([np.full(len(f), 3), f])
    ends = 3 * np.arange(1, len(f) + 1)
    begin = "# vtk DataFile Version {}\n3D Slicer output. SPACE=LPS\n{}\nDATASET POLYDATA\nPOINTS {} double\n"
    text = begin.format("3.0", "ASCII", len(v)) + "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in v.tolist())
    text += f"\nPOLYGONS {len(f)} {counted.size}\n" + "\n".join(" ".join(map(str, row)) for row in counted)
    (folder / "text.vtk").write_text(text + f"\nPOINT_DATA {len(v)}\nSCALARS a double\nLOOKUP_TABLE default\n0 1 2\n")
    old = begin.format("4.2", "BINARY", len(v)).encode() + v.astype(">f8").tobytes()
    old += f"\nMETADATA\nINFORMATION 0\n\nPOLYGONS {len(f)} {counted.size}\n".encode() + counted.astype(">i4").tobytes()
    (folder / "old.vtk").write_bytes(old + b"\n")
    new = begin.format("5.1", "BINARY", len(v)).encode() + v.astype(">f8").tobytes()
    new += (
        f"\nPOLYGONS {len(f) + 1} {f.size}\nOFFSETS vtktypeint64\n".encode()
        + np.append(0, ends).astype(">i8").tobytes()
    )
    (folder / "new.vtk").write_bytes(new + b"\nCONNECTIVITY vtktypeint64\n" + f.astype(">i8").tobytes() + b"\n")
    arrays = {"Points": v, "connectivity": f, "offsets": ends}
    for name, packed, form in (("inline", False, "binary"), ("packed", True, "binary"), ("raw", True, "appended")):
        (folder / f"{name}.vtp").write_bytes(vtp(arrays, len(v), len(f), packed, form))
        (folder / f"{name}.vtu").write_bytes(vtu(arrays, len(v), len(f), packed, form))
    vtk = ["text.vtk", "old.vtk", "new.vtk"]
    return [*vtk, *(f"{name}.{kind}" for name in ("inline", "packed", "raw") for kind in ("vtp", "vtu"))]


def vtu(arrays: dict[str, Any], points: int, faces: int, packed: bool, form: str) -> bytes:
    """An unstructured grid of the surface's cells, with a line and a tetrahedron among them that are no surface."""
    corners = np.concatenate([arrays["connectivity"].reshape(-1), [0, 1], [0, 1, 2, 3]])
    ends = np.concatenate([arrays["offsets"], arrays["offsets"][-1] + np.array([2, 6])])
    kinds = np.array([5] * faces + [3, 10])
    content = vtp(
        {"Points": arrays["Points"], "connectivity": corners, "offsets": ends}, points, faces + 2, packed, form
    )
    text = content.replace(b"PolyData", b"UnstructuredGrid").replace(b"NumberOfPolys", b"NumberOfCells")
    coded = " ".join(map(str, kinds)).encode()
    types = b'<DataArray type="UInt8" Name="types" format="ascii">' + coded + b"</DataArray>"
    return text.replace(b"<Polys>", b"<Cells>").replace(b"</Polys>", types + b"</Cells>")


def vtp(arrays: dict[str, Any], points: int, faces: int, packed: bool, form: str) -> bytes:
    texts, appended = {}, b""
    for name, array in arrays.items():
        data = array.astype("<f8" if name == "Points" else "<i8").tobytes()
        block = zlib.compress(data)
        head = struct.pack("<4I", 1, len(data), 0, len(block)) if packed else struct.pack("<I", len(data))
        if form == "appended":
            texts[name] = f'offset="{len(appended)}"/>'
            appended += head + block
            continue
        coded = base64.b64encode(head) + base64.b64encode(block) if packed else base64.b64encode(head + data)
        texts[name] = ">\n" + coded.decode() + "\n</DataArray>"
    array = '<DataArray type="{}" Name="{}" format="' + form + '" NumberOfComponents="3" {}'
    p, c, o = (array.format("Float64" if n == "Points" else "Int64", n, t.lstrip()) for n, t in texts.items())
    p, c, o = (x.replace('" >', '">') for x in (p, c, o))
    packer = ' compressor="vtkZLibDataCompressor"' if packed else ""
    text = f"""<?xml version="1.0"?><VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"{packer}><PolyData>
<Piece NumberOfPoints="{points}" NumberOfPolys="{faces}"><Points>{p}</Points><Polys>{c}{o}</Polys></Piece></PolyData>"""
    end = b'<AppendedData encoding="raw">_' + appended + b"</AppendedData>" if appended else b""
    return text.encode() + end + b"</VTKFile>"


def test_each_file_of_vtk_holds_the_same_surface(tmp_path: Path) -> None:
    mesh = ball(2)
    for name in vtk_files(tmp_path, mesh):
        vertices, faces = load_mesh(tmp_path / name)
        assert len(faces) == len(mesh.faces), name
        np.testing.assert_allclose(np.sort(vertices, axis=0), np.sort(mesh.vertices * 1e-3, axis=0), atol=1e-12)
        content = (tmp_path / name).read_bytes()
        for cut_at in (30, len(content) // 3, len(content) * 2 // 3):
            (tmp_path / name).write_bytes(content[:cut_at])
            with pytest.raises(InputError):
                load_mesh(tmp_path / name)


@pytest.mark.parametrize("suffix", [".vtk", ".obj", ".ply", ".stl"])
def test_the_frame_that_3d_slicer_writes_into_a_mesh_counts(suffix: str, tmp_path: Path) -> None:
    mesh = two_boxes()[1]
    if suffix == ".vtk":
        vtk_files(tmp_path, mesh)
        (tmp_path / "text.vtk").rename(tmp_path / "a.vtk")
    else:
        mesh.export(tmp_path / f"a{suffix}", **({"encoding": "ascii"} if suffix == ".ply" else {}))
        content = (tmp_path / f"a{suffix}").read_bytes()
        said = {".obj": b"# SPACE=LPS\n" + content, ".stl": b"SPACE=LPS".ljust(80) + content[80:]}
        said[".ply"] = content.replace(b"format ascii 1.0\n", b"format ascii 1.0\ncomment SPACE=LPS\n")
        (tmp_path / f"a{suffix}").write_bytes(said[suffix])
    made = {"kind": "mesh", "file": f"a{suffix}", "unit": "mm"}
    np.testing.assert_allclose(np.array(part_of(tmp_path, "LPS", **made).box)[:, 0] * 1e3, [18, 22], atol=1e-5)
    turned = part_of(tmp_path, "RAS", **made)
    np.testing.assert_allclose(np.array(turned.box)[:, 0] * 1e3, [-22, -18], atol=1e-5)
    assert (distance_mm(turned, [[-20, 0, 0]]) < 0).all()
    with pytest.raises(InputError, match="frame = 'RAS': contradicts the file, which says LPS"):
        part_of(tmp_path, "RAS", **made, frame="RAS")
    with pytest.raises(InputError, match="frame: is missing: anatomy.1 is in LPS"):
        part_of(tmp_path, None, **made)


def test_a_mesh_that_says_no_frame_is_asked_for_it_in_a_scenario_that_has_one(tmp_path: Path) -> None:
    two_boxes()[1].export(tmp_path / "a.stl")
    made = {"kind": "mesh", "file": "a.stl", "unit": "mm"}
    with pytest.raises(InputError, match="anatomy.1.frame: is missing: the file does not say"):
        part_of(tmp_path, "RAS", **made)
    box = np.array(part_of(tmp_path, "RAS", **made, frame="LPS").box) * 1e3
    np.testing.assert_allclose(box, [[-22, -3, -4], [-18, 3, 4]], atol=1e-5)
