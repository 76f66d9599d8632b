"""What a mesh's file states of itself is compared with what is read, and what is no mesh is called what it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from phantoms import part_of

from ctrplan.anatomy.mesh_file import load_mesh, stated_unit
from ctrplan.errors import InputError

BOX = trimesh.creation.box((20, 30, 40)).apply_translation((5.5, 0.25, 100.5))
CORNERS_MM = np.array(BOX.bounds)


def stl(scale: float = 1.0) -> str:
    return str(BOX.copy().apply_scale(scale).export(file_type="stl_ascii"))


def binary_stl(header: bytes, scale: float) -> bytes:
    return header.ljust(80, b" ") + bytes(BOX.copy().apply_scale(scale).export(file_type="stl"))[80:]


def ply(remark: str = "", scale: float = 1.0) -> str:
    text = BOX.copy().apply_scale(scale).export(file_type="ply", encoding="ascii")
    return (text.decode() if isinstance(text, bytes) else text).replace("end_header", f"{remark}end_header", 1)


def obj(remark: str = "", scale: float = 1.0) -> str:
    points = "".join("v {:.6f} {:.6f} {:.6f}\n".format(*x) for x in np.array(BOX.vertices) * scale)
    return remark + points + "".join("f {} {} {}\n".format(*(row + 1)) for row in np.array(BOX.faces))


def vtk(title: str = "surface", scale: float = 1.0) -> str:
    points = "".join("{:.6f} {:.6f} {:.6f}\n".format(*x) for x in np.array(BOX.vertices) * scale)
    faces = "".join("3 {} {} {}\n".format(*row) for row in np.array(BOX.faces))
    return (
        f"# vtk DataFile Version 4.2\n{title}\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n{points}POLYGONS 12 48\n{faces}"
    )


def vtp(points: int = 8, faces: int = 12) -> str:
    def array(name: str, values: object, kind: str = "Int32", more: str = "") -> str:
        text = " ".join(map(str, np.ravel(np.asarray(values))))
        return f'<DataArray type="{kind}" Name="{name}" format="ascii"{more}>{text}</DataArray>'

    three = ' NumberOfComponents="3"'
    inside = f"<Points>{array('p', BOX.vertices, 'Float64', three)}</Points>"
    inside += f"<Polys>{array('connectivity', BOX.faces)}{array('offsets', 3 * np.arange(1, 13))}</Polys>"
    piece = f'<Piece NumberOfPoints="{points}" NumberOfPolys="{faces}">{inside}</Piece>'
    return f'<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>{piece}</PolyData></VTKFile>'


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


STATED: dict[str, tuple[str, Callable[[float], str | bytes], str]] = {
    "OBJ in metres": ("a.obj", lambda s: obj("# File units = meters\n", s), "m"),
    "OBJ in inches": ("a.obj", lambda s: obj("# made by a modeller\n# Units: inches\n", s), "in"),
    "OBJ in centimetres": ("a.obj", lambda s: obj("# coordinates in centimetres\n", s), "cm"),
    "PLY in metres": ("a.ply", lambda s: ply("comment unit m\n", s), "m"),
    "PLY in inches": ("a.ply", lambda s: ply("obj_info units are inch\n", s), "in"),
    "binary STL in centimetres": ("a.stl", lambda s: binary_stl(b"STLB ATF UNITS=cm", s), "cm"),
    "VTK in metres": ("a.vtk", lambda s: vtk("surface, unit: meter", s), "m"),
}
PER_MM = {"m": 1e-3, "cm": 0.1, "in": 1 / 25.4}


@pytest.mark.parametrize("name", STATED)
def test_a_unit_that_a_file_states_is_its_unit_unless_the_scenario_says_another(name: str, tmp_path: Path) -> None:
    file, make, unit = STATED[name]
    path = written(tmp_path / file, make(PER_MM[unit]))
    assert stated_unit(path) == unit
    vertices, _ = load_mesh(path)
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], CORNERS_MM * 1e-3, atol=1e-6)
    part = part_of(tmp_path, None, kind="mesh", file=file)
    assert any(f"says that its unit is {unit}, which is taken" in note for note in part.shape.notes)
    said = part_of(tmp_path, None, kind="mesh", file=file, unit=unit)
    assert not any("its unit" in note for note in said.shape.notes)


def test_a_unit_against_the_one_that_the_file_states_is_said(tmp_path: Path) -> None:
    written(tmp_path / "a.obj", obj("# units: inches\n"))
    part = part_of(tmp_path, None, kind="mesh", file="a.obj", unit="mm")
    np.testing.assert_allclose(part.box, CORNERS_MM * 1e-3, atol=1e-6)
    assert any("says that its unit is in, is read in mm" in note for note in part.shape.notes)


def test_what_is_no_remark_states_no_unit(tmp_path: Path) -> None:
    for text in (obj(), obj("# 3 units in stock\n"), obj("g unit_m\n"), obj("# made in May\n")):
        assert stated_unit(written(tmp_path / "a.obj", text)) is None
    assert stated_unit(tmp_path / "none.stl") is None


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("cr.stl", stl().replace("\n", "\r")),
        ("crlf.ply", ply().replace("\n", "\r\n")),
        ("bom.vtk", "\ufeff" + vtk()),
        ("plain.vtp", vtp()),
    ],
)
def test_line_ends_and_marks_of_editors_change_nothing(file: str, content: str, tmp_path: Path) -> None:
    vertices, faces = load_mesh(written(tmp_path / file, content), "mm")
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], CORNERS_MM * 1e-3, atol=1e-6)
    assert len(faces) == 12


REFUSED: dict[str, tuple[str, str | bytes, str]] = {
    "more points stated": ("a.vtp", vtp(points=9), "it says NumberOfPoints = 9, and has 8"),
    "fewer faces stated": ("a.vtp", vtp(faces=10), "it says NumberOfPolys = 10, and has 12"),
    "fewer rows stated": ("a.ply", ply().replace("face 12", "face 10"), "its header promises 18 rows, it has 20"),
    "more rows stated": ("a.ply", ply().replace("face 12", "face 14"), "its header promises 22 rows, it has 20"),
    "cut within a triangle": ("a.stl", stl()[: len(stl()) // 2], "is damaged or cut short: of . triangles . end"),
    "decimal commas in OBJ": ("a.obj", obj().replace(".", ","), "as OBJ: its numbers have decimal commas, must have"),
    "decimal commas in PLY": ("a.ply", ply().replace(".25", ",25").replace(".5", ",5"), "have decimal commas"),
    "decimal commas in VTK": ("a.vtk", vtk().replace(".", ","), "as VTK: its numbers have decimal commas"),
    "an OBJ called STL": ("a.stl", obj(), "is OBJ by its first bytes: its name must end in .obj"),
    "a PLY called STL": ("a.stl", ply(), "is PLY by its first bytes: its name must end in .ply"),
    "an STL called OBJ": ("a.obj", stl(), "is STL by its first bytes: its name must end in .stl"),
    "a VTK called PLY": ("a.ply", vtk(), "is VTK by its first bytes: its name must end in .vtk or .vtp or .vtu"),
    "a grid": ("a.vtk", vtk().replace("POLYDATA", "STRUCTURED_POINTS"), "it holds STRUCTURED_POINTS, no surface"),
    **{
        f"{what} called {suffix}": (f"a.{suffix}", content, phrase)
        for suffix in ("stl", "ply", "obj", "vtk", "vtp", "glb")
        for what, content, phrase in (
            ("nothing", b"", ": is empty"),
            ("a web page", b"<html><p>404", "is a web page"),
            ("a pointer", b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of Git LFS"),
            ("UTF-16", obj().encode("utf-16"), "but UTF-16: save it as UTF-8"),
        )
    },
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_in_the_way_is_one_sentence(name: str, tmp_path: Path) -> None:
    file, content, phrase = REFUSED[name]
    with pytest.raises(InputError, match=phrase) as caught:
        load_mesh(written(tmp_path / file, content), "mm")
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(tmp_path / file))
