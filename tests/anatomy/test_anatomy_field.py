"""The field of an anatomy in bricks: as accurate as a grid of its own, shared by bases and robots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ctrplan.anatomy import clearance_grid as module
from ctrplan.anatomy.clearance_grid import (
    BRICK,
    Lattice,
    SignedDistanceField,
    anatomy_field,
    field_bounds,
    shared_spacing_m,
)
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array

REACH_M = 0.09


@pytest.fixture(autouse=True)
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    return tmp_path / "fields"


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[module.Index]:
    """The bricks built so far."""
    found, build = list[module.Index](), module._build

    def noted(parts: list[AnatomyPart], lattice: Lattice, index: module.Index) -> module.Grid:
        found.append(index)
        return build(parts, lattice, index)

    monkeypatch.setattr(module, "_build", noted)
    return found


def avoided() -> list[AnatomyPart]:
    box = trimesh.creation.box((0.02, 0.03, 0.01))
    mesh = Mesh(np.asarray(box.vertices) + [0.01, -0.03, 0.06], np.asarray(box.faces))
    return [AnatomyPart(mesh, "avoid", 1e-3), AnatomyPart(Sphere(np.array([0.0, 0.02, 0.05]), 0.01))]


def lumens() -> list[AnatomyPart]:
    lumen = Capsule(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.02, 0.11]), 0.015)
    return [AnatomyPart(lumen, "inside", 0.5e-3), *avoided()[1:]]


def poses(count: int) -> list[tuple[Array, Array]]:
    """Base positions (3,) [m] some millimetres, and rotations (3, 3) some degrees, apart."""
    rng = np.random.default_rng(5)
    turns = Rotation.from_rotvec(rng.normal(scale=0.2, size=(count, 3)))
    return list(zip(rng.normal(scale=4e-3, size=(count, 3)), turns.as_matrix(), strict=True))


def field(parts: list[AnatomyPart], pose: tuple[Array, Array], reach_m: float = REACH_M) -> SignedDistanceField:
    lower, upper = field_bounds(parts, reach_m, *pose)
    spacing = shared_spacing_m(parts, reach_m)
    return anatomy_field(parts, lower, upper, spacing, base_position_m=pose[0], reach_m=reach_m)


def nodes(grid: SignedDistanceField) -> Array:
    """(N, 3) [m] in the order of the values."""
    return grid.origin_m + grid.spacing_m * np.indices(grid.values_m.shape).reshape(3, -1).T


@pytest.mark.parametrize("parts", [avoided(), lumens()], ids=["avoided", "lumen"])
def test_within_reach_it_is_as_accurate_as_the_grid_of_a_part(parts: list[AnatomyPart]) -> None:
    """Exact near surfaces, by at most 2 % too large and by sqrt(3) / 2 of a coarse step too small far from them."""
    pose = poses(1)[0]
    grid, rows = field(parts, pose), slice(None, None, 53)
    points, stored = nodes(grid)[rows], grid.values_m.ravel()[rows]
    exact, within = exact_clearance(parts, points), np.linalg.norm(points - pose[0], axis=1) <= REACH_M
    points, stored, exact = points[within], stored[within], exact[within]
    near = np.abs(exact) < 9 * grid.spacing_m  # margins take up to 2 of the 11 steps that are exact
    np.testing.assert_allclose(stored[near], exact[near], atol=1e-8)
    assert (np.abs(stored - exact) <= 2 * np.sqrt(3) * grid.spacing_m + 0.02 * np.abs(exact)).all()
    between = points + np.random.default_rng(2).uniform(-1, 1, points.shape) * grid.spacing_m
    between = np.clip(between[near], grid.origin_m, grid.upper_m)
    off = np.abs(grid.sample(between) - exact_clearance(parts, between))
    inside = np.linalg.norm(between - pose[0], axis=1) < REACH_M - 2 * grid.spacing_m
    assert inside.any() and off[inside].max() <= np.sqrt(3) / 2 * grid.spacing_m


@pytest.mark.parametrize("parts", [avoided(), lumens()], ids=["avoided", "lumen"])
def test_it_holds_the_box_asked_for_and_is_not_clear_beyond_reach(parts: list[AnatomyPart]) -> None:
    for pose in poses(4):
        lower, upper = field_bounds(parts, REACH_M, *pose)
        grid = field(parts, pose)
        assert (grid.origin_m <= lower + 1e-12).all() and (grid.upper_m >= upper - 1e-12).all()
        points, values = nodes(grid), grid.values_m.ravel()
        left_out = values == np.float32(-REACH_M)
        away = np.linalg.norm(points - pose[0], axis=1)
        assert not left_out.any() or away[left_out].min() > REACH_M
        assert exact_clearance(parts, points[left_out]).size == left_out.sum()


def test_bases_share_bricks_to_the_bit(built: list[module.Index]) -> None:
    first, second = (field(avoided(), pose) for pose in poses(2))
    assert len(built) == len(set(built))
    offset = np.round((second.origin_m - first.origin_m) / first.spacing_m).astype(int)
    np.testing.assert_allclose(second.origin_m, first.origin_m + first.spacing_m * offset, atol=1e-12)
    low = np.maximum(offset, 0)
    high = np.minimum(first.values_m.shape, second.values_m.shape + offset)
    common = first.values_m[tuple(map(slice, low, high))]
    again = second.values_m[tuple(map(slice, low - offset, high - offset))]
    both = (common > -REACH_M) & (again > -REACH_M)
    assert both.mean() > 0.5
    np.testing.assert_array_equal(common[both], again[both])


def test_twenty_bases_in_a_lumen_take_the_room_of_one(disk: Path, built: list[module.Index]) -> None:
    reach_m = 0.2  # beyond the lumen, from all of them
    field(lumens(), poses(1)[0], reach_m)
    stored = sum(file.stat().st_size for file in disk.iterdir())
    count = len(built)
    for pose in poses(20):
        field(lumens(), pose, reach_m)
    assert len(built) == count and sum(file.stat().st_size for file in disk.iterdir()) == stored


def test_robots_of_much_the_same_reach_share_bricks(built: list[module.Index]) -> None:
    """Those that the longer one reaches beyond are built for it."""
    pose = poses(1)[0]
    spacings = {shared_spacing_m(avoided(), reach_m) for reach_m in np.linspace(0.085, 0.095, 9)}
    assert len(spacings) == 1
    field(avoided(), pose, 0.085)
    few = len(built)
    field(avoided(), pose, 0.095)
    assert len(set(built)) == len(built) < 2 * few


@pytest.mark.parametrize("parts", [avoided(), lumens()], ids=["avoided", "lumen"])
def test_bricks_meet_at_the_same_values(parts: list[AnatomyPart]) -> None:
    lattice = Lattice.of(parts, 0.5e-3)
    for axis in range(3):
        beside = tuple(int(axis == i) for i in range(3))
        lower, upper = (module._build(parts, lattice, index) for index in ((0, 0, 0), beside))
        np.testing.assert_allclose(lower.take(BRICK, axis), upper.take(0, axis), atol=1e-7)


def test_a_lumen_out_of_reach_leaves_nothing_clear() -> None:
    far = np.array([0.5, 0.5, 0.5]), np.eye(3)
    assert (field(lumens(), far).values_m < 0).all()


def test_another_anatomy_or_spacing_shares_nothing(built: list[module.Index]) -> None:
    pose = poses(1)[0]
    lower, upper = field_bounds(avoided(), REACH_M, *pose)
    for parts, spacing in ((avoided(), 1e-3), (avoided()[:1], 1e-3), (avoided(), 2e-3)):
        before = len(built)
        anatomy_field(parts, lower, upper, spacing, base_position_m=pose[0], reach_m=REACH_M)
        assert len(built) > before


def test_a_damaged_brick_is_built_again(disk: Path, built: list[module.Index]) -> None:
    first = field(avoided(), poses(1)[0])
    count = len(built)
    next(iter(disk.iterdir())).write_bytes(b"not an archive")
    np.testing.assert_array_equal(field(avoided(), poses(1)[0]).values_m, first.values_m)
    assert len(built) == count + 1


def test_progress_rises_to_one() -> None:
    pose, seen = poses(1)[0], list[float]()
    lower, upper = field_bounds(avoided(), REACH_M, *pose)
    anatomy_field(avoided(), lower, upper, 2e-3, base_position_m=pose[0], reach_m=REACH_M, progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1
