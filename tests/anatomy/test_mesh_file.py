"""Meshes are read alike from every format, repaired where the meaning is plain, else refused in one sentence."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from phantoms import part_of

from ctrplan.anatomy import mesh_file as mesh_input
from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.errors import InputError

Array = NDArray[np.float64]


def box(center_mm: Any = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box((10, 10, 10))
    mesh.apply_translation(center_mm)
    return mesh


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    faces = np.concatenate([m.faces + k for m, k in zip(meshes, offsets[:-1], strict=True)])
    return trimesh.Trimesh(np.concatenate([m.vertices for m in meshes]), faces, process=False)


def ball(radius_mm: float = 20.0, center_mm: Any = (0.0, 0.0, 0.0), inward: bool = False) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    mesh.apply_translation(center_mm)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1] if inward else mesh.faces, process=False)


def written(directory: Path, mesh: trimesh.Trimesh, suffix: str = ".stl") -> Path:
    path = directory / f"mesh{suffix}"
    mesh.export(path)
    return path


def clearance_mm(path: Path, points_mm: Any) -> Array:
    vertices, faces = load_mesh(path, "mm")
    return exact_clearance([AnatomyPart(Mesh(vertices, faces))], np.array(points_mm) * 1e-3) * 1e3


def volume_mm3(path: Path, unit: str = "mm") -> float:
    vertices, faces = load_mesh(path, unit)
    a, b, c = (vertices[faces[:, k]] * 1e3 for k in range(3))
    return float(np.einsum("ki,ki->k", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".STL"])
def test_formats_agree(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"mesh{suffix}"
    ball().export(path, file_type=suffix[1:].lower())
    vertices, faces = load_mesh(path)
    assert (len(vertices), len(faces)) == (642, 1280)
    assert vertices.dtype == np.float64 and faces.dtype == np.int64
    assert vertices.flags.c_contiguous and faces.flags.c_contiguous
    assert volume_mm3(path) == pytest.approx(ball().volume, rel=1e-5)


def test_text_stl_quads_and_unused_vertices(tmp_path: Path) -> None:
    path = tmp_path / "mesh.stl"
    ball().export(path, file_type="stl_ascii")
    assert volume_mm3(path) == pytest.approx(ball().volume, rel=1e-5)
    path = tmp_path / "mesh.obj"
    corners = np.array([[x, y, z] for x in (0, 10) for y in (0, 10) for z in (0, 10)])
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in [*corners, (np.nan, 0, 0)]] + ["mtllib absent.mtl", "usemtl absent"]
    path.write_text("\n".join(lines + ["f " + " ".join(map(str, q)) for q in quads]))
    vertices, faces = load_mesh(path)
    assert (len(vertices), len(faces)) == (8, 12)
    assert volume_mm3(path) == pytest.approx(1000.0)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("cm", 10.0), ("in", 25.4), ("m", 1000.0)])
def test_units_scale(unit: str, factor: float, tmp_path: Path) -> None:
    path = written(tmp_path, ball(0.4))
    assert volume_mm3(path, unit) == pytest.approx(ball(0.4).volume * factor**3, rel=1e-5)


@pytest.mark.parametrize("share", [0.1, 0.4, 1.0])
def test_winding_is_repaired(share: float, tmp_path: Path) -> None:
    mesh = ball()
    flipped = np.random.default_rng(0).random(len(mesh.faces)) < share
    faces = np.where(flipped[:, None], mesh.faces[:, ::-1], mesh.faces)
    path = written(tmp_path, trimesh.Trimesh(mesh.vertices, faces, process=False))
    assert volume_mm3(path) == pytest.approx(mesh.volume, rel=1e-5)


def test_each_body_is_turned_outward(tmp_path: Path) -> None:
    bodies = [ball(), ball(10.0, (50.0, 0.0, 0.0), inward=True), ball(5.0, (0.0, 60.0, 0.0))]
    path = written(tmp_path, together(*bodies))
    assert (clearance_mm(path, [[0, 0, 0], [50, 0, 0], [0, 60, 0]]) < 0).all()
    assert (clearance_mm(path, [[30, 0, 0], [0, 40, 0]]) > 0).all()


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("cavity", [False, True])
def test_a_cavity_stays_one_and_a_nested_solid_stays_solid(inverted: bool, cavity: bool, tmp_path: Path) -> None:
    bodies = [ball(20.0, inward=inverted), ball(10.0, inward=inverted != cavity)]
    path = written(tmp_path, together(*bodies))
    inner, wall, outside = clearance_mm(path, [[2, 0, 0], [15, 0, 0], [25, 0, 0]])
    assert wall < 0 < outside
    assert (inner > 0) == cavity


def test_cracks_below_a_micrometre_are_welded(tmp_path: Path) -> None:
    soup = ball().triangles
    jitter = np.random.default_rng(0).uniform(-2e-4, 2e-4, soup.shape)
    mesh = trimesh.Trimesh((soup + jitter).reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3), process=False)
    path = written(tmp_path, mesh, ".ply")
    vertices, _ = load_mesh(path)
    assert len(vertices) == 642
    assert volume_mm3(path) == pytest.approx(ball().volume, rel=1e-4)


def test_repeated_and_collapsed_triangles_are_dropped(tmp_path: Path) -> None:
    mesh = ball()
    faces = np.concatenate([mesh.faces, np.roll(mesh.faces[:5], 1, axis=1), [[0, 0, 1], [2, 2, 2]]])
    path = written(tmp_path, trimesh.Trimesh(mesh.vertices, faces, process=False), ".obj")
    assert len(load_mesh(path)[1]) == len(mesh.faces)


def test_bodies_that_touch_along_an_edge_are_fine(tmp_path: Path) -> None:
    touching = box((10.0, 10.0, 0.0))
    assert volume_mm3(written(tmp_path, together(box(), touching))) == pytest.approx(2000.0)
    inverted = trimesh.Trimesh(touching.vertices, touching.faces[:, ::-1], process=False)
    assert volume_mm3(written(tmp_path, together(box(), inverted))) == pytest.approx(2000.0)


def chambers(inverted: bool = False) -> tuple[trimesh.Trimesh, list[NDArray[np.bool_]]]:
    """Two boxes with a face in common, triangulated differently, and the sides of either that end at it."""
    first, second = box(), box()
    second.apply_scale((0.5, 1, 1))
    second.apply_translation((7.5, 0, 0))
    if (second.volume < 0) != inverted:
        second = trimesh.Trimesh(second.vertices, second.faces[:, ::-1], process=False)
    mesh = together(first, second)
    wall = (np.abs(mesh.triangles[:, :, 0] - 5) < 1e-9).all(axis=1)
    number = np.arange(len(wall))
    return mesh, [~wall & (number < 12), ~wall & (number >= 12)]


def test_bodies_that_touch_along_a_face_are_fine_as_they_are_wound(tmp_path: Path) -> None:
    assert volume_mm3(written(tmp_path, chambers()[0])) == pytest.approx(1500.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("turned", [(0,), (1,), (0, 1), ()])
def test_bodies_that_share_a_wall_are_not_taken_for_solid_inside_out(
    turned: tuple[int, ...], seed: int, tmp_path: Path
) -> None:
    """Each side of four is wound alike; which solids are meant can't be told without knowing the others."""
    mesh, sides = chambers(inverted=not turned)
    inward = np.any([sides[k] for k in turned], axis=0) if turned else np.zeros(len(mesh.faces), bool)
    faces = np.where(inward[:, None], mesh.faces[:, ::-1], mesh.faces)
    order = np.random.default_rng(seed).permutation(len(faces))
    path = written(tmp_path, trimesh.Trimesh(mesh.vertices, faces[order], process=False), ".ply")
    try:
        assert volume_mm3(path) == pytest.approx(1500.0)
    except InputError as error:
        assert "can't be turned outward" in str(error)


def open_ball() -> trimesh.Trimesh:
    mesh = ball()
    hole = (mesh.faces != 7).all(axis=1)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[hole], process=False)


def klein_bottle() -> trimesh.Trimesh:
    n = 24
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    a, b = 2 * np.pi * u / n, 2 * np.pi * (v + 0.5) / n
    r = 20 + 8 * (np.cos(a / 2) * np.sin(b) - np.sin(a / 2) * np.sin(2 * b))
    z = 8 * (np.sin(a / 2) * np.sin(b) + np.cos(a / 2) * np.sin(2 * b))
    vertices = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)

    def index(i: Any, j: Any) -> Any:
        return (i % n) * n + np.where(i >= n, -j - 1, j) % n

    p, q, s, t = index(u, v), index(u + 1, v), index(u + 1, v + 1), index(u, v + 1)
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((p, q, s), (p, s, t))])
    return trimesh.Trimesh(vertices, faces, process=False)


def flat() -> trimesh.Trimesh:
    return trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [2, 1, 0]], process=False)


def test_a_wall_shared_by_two_chambers_is_refused(tmp_path: Path) -> None:
    mesh = together(box(), box((10.0, 0.0, 0.0)))
    wall = (np.abs(mesh.triangles[:, :, 0] - 5) < 1e-9).all(axis=1)
    keep = ~wall | (np.arange(len(wall)) < 12)  # two chambers with a single wall between them
    path = written(tmp_path, trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False))
    with pytest.raises(InputError, match="4 open edges"):
        load_mesh(path)


def nan_ball() -> trimesh.Trimesh:
    mesh = ball()
    vertices = np.array(mesh.vertices)
    vertices[7, 1] = np.nan
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
@pytest.mark.parametrize(
    ("make", "unit", "phrase"),
    [
        (open_ball, "mm", "is not closed: has 5 open edges, one at ("),
        (nan_ball, "mm", "NaN"),
        (klein_bottle, "mm", "can't be turned outward"),
        (flat, "mm", "encloses no volume"),
        (ball, "m", "is 40 m across when read in 'm': must be at most 2 m (millimetres or centimetres?)"),
        (lambda: ball(1050.0), "mm", "is 2.1 m across when read in 'mm': must be at most 2 m (converted twice?)"),
        (lambda: ball(0.02), "mm", "is 0.04 mm across when read in 'mm': must be at least 0.1 mm (metres?)"),
        (ball, "furlong", "unit 'furlong': must be one of mm, cm, m, in"),
    ],
)
def test_mistakes_are_refused_in_one_sentence(make: Any, unit: str, phrase: str, suffix: str, tmp_path: Path) -> None:
    path = written(tmp_path, make(), suffix)
    with pytest.raises(InputError) as caught:
        load_mesh(path, unit)
    message = str(caught.value)
    assert phrase in message and message.startswith(f"{path}: ") and message.endswith(".") and "\n" not in message
    with pytest.raises(InputError) as caught:
        load_mesh(path, unit, file="s.toml", key="anatomy.3.file")
    message = str(caught.value)
    assert phrase in message and message.startswith("s.toml: anatomy.3.file = '")
    assert caught.value.exit_code == 2


def test_the_place_of_a_hole_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, open_ball())
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    place = np.array([float(x) for x in str(caught.value).split("(")[1].split(")")[0].split(",")])
    assert np.linalg.norm(place - ball().vertices[7]) < 4.0


@pytest.mark.parametrize(
    ("name", "content", "phrase"),
    [
        ("empty.stl", b"", "is empty"),
        ("latin.stl", "solid Gefäß\n".encode("latin-1"), "UTF-8"),
        ("short.stl", b"abc", "no triangles"),
        ("empty.ply", b"", "is empty"),
        ("empty.obj", b"", "is empty"),
        ("none.obj", b"# nothing\n", "no triangles"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("solid.stl", b"solid a\nendsolid a\n", "no triangles"),
        ("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
        ("mesh.step", b"ISO-10303-21;", "must end in .stl, .ply, .obj"),
        (
            "points.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\n"
            b"property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
            "no triangles",
        ),
    ],
)
def test_unreadable_files_are_refused(name: str, content: bytes, phrase: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    assert phrase in str(caught.value), str(caught.value)


@pytest.mark.parametrize("rest", [b"", b"made by a scanner", b"\0" * 50])
@pytest.mark.parametrize("name", [b"solid of a scanner", b"plain", b"solid\0"])
def test_a_binary_stl_is_one_whatever_it_calls_itself(name: bytes, rest: bytes, tmp_path: Path) -> None:
    data = box().export(file_type="stl")
    (tmp_path / "a.stl").write_bytes(name.ljust(80, b" ") + data[80:] + rest)
    assert volume_mm3(tmp_path / "a.stl") == pytest.approx(1000.0)


def test_a_second_solid_behind_a_binary_one_is_not_passed_over(tmp_path: Path) -> None:
    data = box().export(file_type="stl")
    (tmp_path / "a.stl").write_bytes(data + data)
    with pytest.raises(InputError, match="its header promises 12 triangles"):
        load_mesh(tmp_path / "a.stl")


def test_text_stl_of_other_habits(tmp_path: Path) -> None:
    """A byte-order mark is read; decimal commas are named."""
    text = box().export(file_type="stl_ascii")
    (tmp_path / "a.stl").write_text("\ufeff" + text, encoding="utf-8")
    assert volume_mm3(tmp_path / "a.stl") == pytest.approx(1000.0)
    (tmp_path / "b.stl").write_text(text.replace(".", ","))
    with pytest.raises(InputError, match="decimal commas"):
        load_mesh(tmp_path / "b.stl")


def test_a_text_stl_with_a_broken_normal_brings_no_traceback(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """trimesh logs one; normals are not used, so that the surface is read nevertheless."""
    text = box().export(file_type="stl_ascii").replace("facet normal ", "facet normal x", 1)
    (tmp_path / "a.stl").write_text(text)
    assert volume_mm3(tmp_path / "a.stl") == pytest.approx(1000.0)
    assert not caplog.records


def test_missing_truncated_and_huge_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_mesh(tmp_path / "absent.stl")
    with pytest.raises(InputError, match="null"):
        load_mesh("a\0b.stl")
    (tmp_path / "directory.stl").mkdir()
    with pytest.raises(InputError, match="is not a file"):
        load_mesh(tmp_path / "directory.stl")
    path = written(tmp_path, ball())
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(InputError, match="promises 1280 triangles, its size is that of 1220"):
        load_mesh(path)
    monkeypatch.setattr(mesh_input, "MAX_BYTES", 1000)
    with pytest.raises(InputError, match="MB large"):
        load_mesh(path)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_damaged_files_never_raise_anything_else(suffix: str, tmp_path: Path) -> None:
    content = written(tmp_path, box(), suffix).read_bytes()
    path = tmp_path / f"damaged{suffix}"

    @settings(max_examples=150, deadline=None)
    @given(st.integers(0, len(content) - 1), st.binary(max_size=8), st.integers(0, 20))
    def check(at: int, inserted: bytes, dropped: int) -> None:
        path.write_bytes(content[:at] + inserted + content[at + dropped :])
        try:
            vertices, faces = load_mesh(path)
        except InputError:
            return
        assert np.isfinite(vertices).all() and faces.max() < len(vertices)

    check()


def test_a_packed_mesh_is_named_so(tmp_path: Path) -> None:
    path = written(tmp_path, ball())
    path.write_bytes(gzip.compress(path.read_bytes()))
    with pytest.raises(InputError, match="is packed by gzip: unpack it first"):
        load_mesh(path)


def test_other_files_are_turned_where_it_is_said_and_need_a_unit(tmp_path: Path) -> None:
    path = written(tmp_path, trimesh.creation.box((10, 30, 20)).apply_translation((0, 15, 0)), ".obj")
    turned = part_of(tmp_path, None, kind="mesh", file=path.name, unit="mm", up="y")
    np.testing.assert_allclose(np.array(turned.box) * 1e3, [[-5, -10, 0], [5, 10, 30]], atol=1e-6)
    with pytest.raises(InputError, match="anatomy.1.unit: is missing: the file does not say whether"):
        part_of(tmp_path, None, kind="mesh", file=path.name)
    with pytest.raises(InputError, match="anatomy.1.up = 'x': must be one of y, z"):
        part_of(tmp_path, None, kind="mesh", file=path.name, unit="mm", up="x")
