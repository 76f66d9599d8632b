"""Damaged meshes of every format: read and closed, or refused in one sentence; never a hang, never all the memory."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from made_up_input import NUMBERS, assert_names_the_fault, cases

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.errors import InputError

FORMATS = ("stl", "stl_ascii", "ply", "ply_ascii", "obj")


def written(format_: str) -> tuple[str, bytes]:
    """Suffix and content of a good mesh."""
    mesh = trimesh.creation.box((10, 20, 30))
    suffix, _, text = format_.partition("_")
    if format_ == "ply_ascii":
        content = mesh.export(file_type="ply", encoding="ascii")
    else:
        content = mesh.export(file_type="stl_ascii" if text else suffix)
    return f".{suffix}", content.encode() if isinstance(content, str) else content


def check_reading(path: Path) -> None:
    try:
        vertices, faces = load_mesh(path, file="scenario.toml", key="anatomy.1.file")
    except InputError as error:
        assert_names_the_fault(error, "scenario.toml")
        assert error.value == str(path)
        return
    assert np.isfinite(vertices).all() and faces.min() >= 0 and faces.max() < len(vertices)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0)  # closed


@pytest.mark.parametrize("format_", FORMATS)
def test_bytes_lost_and_put_into_a_mesh(format_: str, tmp_path: Path) -> None:
    suffix, content = written(format_)
    path = tmp_path / f"mesh{suffix}"

    @cases(60)
    @given(st.integers(0, len(content) - 1), st.binary(max_size=8), st.integers(0, 60))
    def check(at: int, new: bytes, lost: int) -> None:
        path.write_bytes(content[:at] + new + content[at + lost :])
        check_reading(path)

    check()


@pytest.mark.parametrize("format_", ["stl_ascii", "ply_ascii", "obj", "ply"])
def test_words_of_a_mesh_replaced(format_: str, tmp_path: Path) -> None:
    """Counts in headers, indices and coordinates become numbers that nobody counts to."""
    suffix, content = written(format_)
    head, mark, body = content.partition(b"end_header\n") if format_ == "ply" else (content, b"", b"")
    words = head.split(b" ")
    path = tmp_path / f"mesh{suffix}"

    @cases(60)
    @given(st.integers(0, len(words) - 1), NUMBERS | st.text(st.characters(codec="utf-8"), max_size=4))
    def check(at: int, new: str) -> None:
        changed = [*words[:at], new.encode(), *words[at + 1 :]]
        path.write_bytes(b" ".join(changed) + mark + body)
        check_reading(path)

    check()


def test_coordinates_of_a_binary_mesh_replaced(tmp_path: Path) -> None:
    _, content = written("stl")
    path = tmp_path / "mesh.stl"

    @cases(60)
    @given(st.integers(0, 11), st.integers(0, 11), st.floats(width=32))
    def check(triangle: int, number: int, value: float) -> None:
        place = 84 + 50 * triangle + 4 * number
        path.write_bytes(content[:place] + struct.pack("<f", value) + content[place + 4 :])
        check_reading(path)

    check()


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_a_mesh_of_a_gigabyte_is_refused_by_its_size_unread(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"large{suffix}"
    with path.open("wb") as stream:
        stream.truncate(10**9)  # takes no room on the disk
    with pytest.raises(InputError, match="is 1000 MB large: must be at most 500 MB") as caught:
        load_mesh(path, file="scenario.toml", key="anatomy.1.file")
    assert_names_the_fault(caught.value, "scenario.toml")


@pytest.mark.parametrize("count", [10**6, 10**9, 10**15, 2**63, 10**30])
@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("element", ["vertex", "face"])
def test_a_header_that_promises_more_than_the_file_holds(
    count: int, encoding: str, element: str, tmp_path: Path
) -> None:
    counts = {"vertex": 3, "face": 1, element: count}
    path = tmp_path / "mesh.ply"
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex {counts['vertex']}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {counts['face']}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_text(header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(InputError) as caught:
        load_mesh(path, file="scenario.toml", key="anatomy.1.file")
    assert_names_the_fault(caught.value, "scenario.toml")
