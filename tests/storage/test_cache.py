"""A cached distance field is the built one, or is built again."""

import hashlib
import logging
import os
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from whole_grid import whole_grid

from ctrplan.anatomy import shapes
from ctrplan.anatomy.clearance_grid import SignedDistanceField
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shape import Role
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.storage import cache as field_cache


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fields"


def built(radius_m: float = 0.02, spacing_m: float = 2e-3) -> SignedDistanceField:
    return whole_grid([AnatomyPart(Sphere(np.zeros(3), radius_m))], [-0.03] * 3, [0.03] * 3, spacing_m)


def forbid_building(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "ctrplan.anatomy.clearance_grid.grid_distance", lambda *_: pytest.fail("built although it was cached")
    )


def test_hit_is_identical_to_a_rebuild(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = built()
    (stored,) = cache.iterdir()
    assert stored.suffix == ".grid"
    forbid_building(monkeypatch)
    again = built()
    np.testing.assert_array_equal(first.values_m, again.values_m)
    np.testing.assert_array_equal(first.origin_m, again.origin_m)
    assert first.spacing_m == again.spacing_m and again.parts


def test_everything_that_determines_the_values_is_in_the_key(cache: Path) -> None:
    built()
    built(radius_m=np.nextafter(0.02, 1))
    built(spacing_m=3e-3)
    parts = [AnatomyPart(Sphere(np.zeros(3), 0.02), role, 1e-3) for role in get_args(Role)]
    for part in parts:
        whole_grid([part], [-0.03] * 3, [0.03] * 3, 2e-3)
    whole_grid(parts, [-0.03] * 3, [0.03] * 3, 2e-3)
    whole_grid(parts, [-0.031] * 3, [0.029] * 3, 2e-3)
    assert len(list(cache.iterdir())) == 7


def test_where_a_mesh_came_from_makes_no_difference(cache: Path) -> None:
    corners, faces = np.vstack([np.zeros(3), 0.01 * np.eye(3)]), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    for file in (None, "here.stl", "elsewhere.stl"):
        whole_grid([AnatomyPart(Mesh(corners, faces, file))], [-0.03] * 3, [0.03] * 3, 8e-3)
    assert len(list(cache.iterdir())) == 1


def test_a_kind_whose_file_changes_is_computed_again(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who writes a kind corrects its distances now and then; the old ones must not come back."""
    built()
    edited = tmp_path / "sphere.py"
    edited.write_text(Path(shapes.sphere.__file__).read_text() + "# corrected")
    monkeypatch.setattr(shapes.sphere, "__file__", str(edited))
    built()
    assert len(list(cache.iterdir())) == 2


def test_no_flipped_bit_goes_unnoticed(cache: Path) -> None:
    first = built(spacing_m=8e-3)
    (stored,) = cache.iterdir()
    content = stored.read_bytes()
    for at in np.random.default_rng(0).permutation(len(content))[:300]:
        damaged = bytearray(content)
        damaged[at] ^= 1 << (at % 8)
        stored.write_bytes(damaged)
        np.testing.assert_array_equal(built(spacing_m=8e-3).values_m, first.values_m)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "text", "other", "longer"])
def test_damaged_file_is_rebuilt_with_a_note(damage: str, cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    first = built()
    (stored,) = cache.iterdir()
    content = bytearray(stored.read_bytes())
    if damage == "truncated":
        content = content[: len(content) // 2]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    elif damage == "text":
        content = bytearray(b"not an archive")
    stored.write_bytes(content)
    if damage == "other":  # well formed, but of another field
        other = (first.values_m + 1).tobytes()
        stored.write_bytes(hashlib.sha256(b"another key" + other).digest() + other)
    if damage == "longer":
        stored.write_bytes(content + b"more")
    with caplog.at_level(logging.WARNING):
        again = built()
    np.testing.assert_array_equal(first.values_m, again.values_m)
    assert "damaged and will be rebuilt" in caplog.text
    caplog.clear()
    built()
    assert not caplog.records


def test_unwritable_cache_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("a file where a directory should be")
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(blocked))
    built()


def test_directory_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CTRPLAN_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert field_cache.cache_directory() == tmp_path / "ctrplan"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the XDG specification: to be ignored
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert field_cache.cache_directory() == tmp_path / "home" / ".cache" / "ctrplan"


def test_least_recently_used_fields_go_first(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built(0.010)
    (oldest,) = cache.iterdir()
    size = oldest.stat().st_size
    monkeypatch.setattr(field_cache, "MAX_TOTAL_BYTES", int(2.5 * size))
    built(0.011)
    (other,) = set(cache.iterdir()) - {oldest}
    os.utime(oldest, (1, 1))
    os.utime(other, (2, 2))
    built(0.010)  # a hit makes it recent
    built(0.012)
    assert oldest.exists() and not other.exists() and len(list(cache.iterdir())) == 2


def test_what_a_killed_process_left_is_cleared_away(cache: Path) -> None:
    cache.mkdir(parents=True)
    left = cache / f".ctrplan-{'0' * 16}.tmp"
    left.write_bytes(b"half a grid")
    built()
    assert [path.suffix for path in cache.iterdir()] == [".grid"]
