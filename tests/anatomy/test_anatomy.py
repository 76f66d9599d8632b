"""Laws of the clearance that anatomy leaves to a point, exact and on a grid."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from whole_grid import whole_grid

from ctrplan.anatomy.clearance_grid import SignedDistanceField, default_spacing_m, field_bounds
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shape import PartShape
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.errors import CtrplanError, InputError

Array = NDArray[np.float64]
RADIUS_M = 0.03
ORIGIN, BALL = np.zeros(3), Sphere(np.zeros(3), 0.01)
ICOSPHERE = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path / "cache"))


def mesh_part(mesh: trimesh.Trimesh, shift: Any = (0.0, 0.0, 0.0), **options: Any) -> AnatomyPart:
    return AnatomyPart(Mesh(np.asarray(mesh.vertices) + shift, np.asarray(mesh.faces)), **options)


def sphere(center: Any = (0.0, 0.0, 0.0), radius: float = RADIUS_M, **options: Any) -> AnatomyPart:
    return AnatomyPart(Sphere(np.array(center), radius), **options)


def capsule(start: Any, end: Any, radius: float, **options: Any) -> AnatomyPart:
    return AnatomyPart(Capsule(np.array(start), np.array(end), radius), **options)


def mixture() -> list[AnatomyPart]:
    """Two overlapping lumens with structures in them, one mesh of each role."""
    return [
        mesh_part(ICOSPHERE, role="inside", margin_m=0.001),
        capsule((0.0, 0.0, 0.0), (0.0, 0.02, 0.06), 0.012, role="inside"),
        mesh_part(trimesh.creation.box((0.01, 0.006, 0.02)), (0.01, 0.0, 0.0), margin_m=0.002),
        sphere((-0.01, -0.01, 0.0), 0.004, margin_m=0.001),
    ]


def random_points(count: int, seed: int = 0, half_m: float = 0.06) -> Array:
    return np.random.default_rng(seed).uniform(-half_m, half_m, (count, 3))


def built(parts: list[AnatomyPart], half_m: float, spacing_m: float) -> SignedDistanceField:
    return whole_grid(parts, [-half_m] * 3, [half_m] * 3, spacing_m)


def test_clearance_is_1_lipschitz() -> None:
    a = random_points(20_000)
    b = a + np.random.default_rng(1).normal(0, 1, a.shape) * 10 ** np.random.default_rng(2).uniform(-6, -2, (len(a), 1))
    change = np.abs(exact_clearance(mixture(), a) - exact_clearance(mixture(), b))
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-9).all()


def test_faceted_sphere_lies_within_the_analytic_one_by_its_sagitta() -> None:
    points = random_points(5000)
    corners = ICOSPHERE.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = np.einsum("ki,ki->k", corners[:, 0], normals) / np.linalg.norm(normals, axis=1)
    sagitta = RADIUS_M - heights.min()
    excess = exact_clearance([mesh_part(ICOSPHERE)], points) - exact_clearance([sphere()], points)
    assert excess.min() > -1e-9
    assert excess.max() <= sagitta + 1e-9
    assert sagitta < 1e-4


@pytest.mark.parametrize(
    "make",
    [
        lambda **o: sphere((0.01, 0.0, 0.0), **o),
        lambda **o: capsule((0.0, 0.0, -0.03), (0.01, 0.0, 0.03), 0.01, **o),
        lambda **o: capsule((0.0, 0.0, 0.01), (0.0, 0.0, 0.01), 0.01, **o),
        lambda **o: mesh_part(ICOSPHERE, **o),
    ],
)
def test_roles_mirror_each_other_and_margins_are_subtracted(make: Any) -> None:
    points = random_points(2000)
    outside = exact_clearance([make(role="avoid")], points)
    assert (outside > 0).any() and (outside < 0).any()
    np.testing.assert_array_equal(exact_clearance([make(role="inside")], points), -outside)
    np.testing.assert_allclose(exact_clearance([make(margin_m=0.002)], points), outside - 0.002, atol=1e-15)
    np.testing.assert_allclose(exact_clearance([make(role="inside", margin_m=0.002)], points), -outside - 0.002)


@pytest.mark.parametrize("seed", range(5))
def test_clearance_is_equivariant(seed: int) -> None:
    R = Rotation.random(random_state=seed).as_matrix()
    shift = np.random.default_rng(seed).normal(0, 0.1, 3)
    points = random_points(2000, seed)

    def moved(p: Array) -> Array:
        return p @ R.T + shift

    def with_moved(shape: PartShape) -> PartShape:
        names = {"center_m", "from_m", "to_m", "vertices_m"} & {field.name for field in fields(shape)}
        return replace(shape, **{name: moved(getattr(shape, name)) for name in names})

    parts = [replace(part, shape=with_moved(part.shape)) for part in mixture()]
    np.testing.assert_allclose(exact_clearance(parts, moved(points)), exact_clearance(mixture(), points), atol=1e-9)


def test_lumens_are_one_room_and_structures_are_all_avoided() -> None:
    lumens = [
        capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), 0.01, role="inside"),
        capsule((0.0, 0.0, 0.05), (0.05, 0.0, 0.05), 0.008, role="inside", margin_m=0.001),
    ]
    np.testing.assert_allclose(
        exact_clearance(lumens, [[0, 0, 0.02], [0.03, 0, 0.05], [0.03, 0, 0.02]]),
        [0.01, 0.007, -0.02],
        atol=1e-12,
    )
    points = random_points(1000)
    avoided = [sphere((0.0, 0.0, 0.03), 0.003), sphere((0.02, 0.0, 0.05), 0.002, margin_m=0.001)]
    each = np.array([exact_clearance([part], points) for part in avoided + lumens])
    together = np.minimum(each[:2].min(axis=0), each[2:].max(axis=0))
    np.testing.assert_allclose(exact_clearance(avoided + lumens, points), together)


def test_overlapping_bodies_of_one_mesh_are_solid() -> None:
    vertices, faces = np.asarray(ICOSPHERE.vertices), np.asarray(ICOSPHERE.faces)
    both = trimesh.Trimesh(np.concatenate([vertices, vertices + [0.02, 0, 0]]), [*faces, *(faces + len(vertices))])
    points = random_points(5000)
    in_either = (np.linalg.norm(points[:, None] - [[0, 0, 0], [0.02, 0, 0]], axis=2) < 0.0295).any(axis=1)
    assert (exact_clearance([mesh_part(both)], points[in_either]) < 0).all()


def test_a_side_does_not_depend_on_the_points_asked_for_together() -> None:
    """Points along a way, few of which are asked for their side, have the sides that each has by itself: through bodies
    that overlap, out of them and back, standing still in between."""
    vertices, faces = np.asarray(ICOSPHERE.vertices), np.asarray(ICOSPHERE.faces)
    both = trimesh.Trimesh(np.concatenate([vertices, vertices + [0.02, 0, 0]]), [*faces, *(faces + len(vertices))])
    part = mesh_part(both)
    corners = np.repeat(random_points(12), 2, axis=0)
    for steps in (3, 40, 400):
        share = np.linspace(0, 1, steps)[:, None]
        way = np.concatenate([a + share * (b - a) for a, b in zip(corners[:-1], corners[1:], strict=True)])
        alone = [float(part.shape.distance(point[None])[0]) for point in way[:: max(1, steps // 40)]]
        assert min(alone) < 0 < max(alone)
        np.testing.assert_array_equal(part.shape.distance(way)[:: max(1, steps // 40)], alone)


def test_no_parts_leave_all_clear_and_points_must_be_finite() -> None:
    assert (exact_clearance([], random_points(3)) == np.inf).all()
    assert exact_clearance(mixture(), np.empty((0, 3))).shape == (0,)
    with pytest.raises(InputError, match="finite"):
        exact_clearance(mixture(), [[0.0, np.nan, 0.0]])


def test_trilinear_interpolation_is_of_second_order_away_from_the_medial_axis() -> None:
    directions = random_points(4000)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points = directions * np.random.default_rng(3).uniform(RADIUS_M - 0.004, RADIUS_M + 0.004, (len(directions), 1))
    exact = exact_clearance([sphere()], points)
    spacings = np.array([4e-3, 2e-3, 1e-3])
    errors = [np.abs(built([sphere()], 0.04, h).sample(points) - exact).max() for h in spacings]
    assert 1.8 < np.polyfit(np.log(spacings), np.log(errors), 1)[0] < 2.2
    assert errors[-1] < 1e-3**2 / (4 * (RADIUS_M - 0.006)) * 1.5


def test_nodes_near_the_surface_are_exact_and_those_far_from_it_nearly() -> None:
    h, part = 1e-3, mesh_part(trimesh.creation.box((0.01, 0.006, 0.02)))
    field = built([part], 0.06, h)
    node = np.argwhere(np.ones(field.values_m.shape, dtype=bool))[::7]
    exact = exact_clearance([part], field.origin_m + h * node)
    stored = field.values_m[tuple(node.T)]
    near = np.abs(exact) < 11 * h
    np.testing.assert_allclose(stored[near], exact[near], atol=1e-8)
    assert (stored - exact <= 0.02 * exact)[exact > 0].all()
    assert (exact - stored <= np.sqrt(3) / 2 * 4 * h).all()


def test_sample_agrees_with_exact_clearance() -> None:
    parts, h = mixture(), 1e-3
    field = built(parts, 0.06, h)
    assert field.values_m.dtype == np.float32 and field.values_m.flags.c_contiguous
    points = random_points(30_000, seed=9)
    exact, sampled = exact_clearance(parts, points), field.sample(points)
    near = np.abs(exact) < 0.006  # margins take up to 2 mm of the 11 mm that are exact
    # A law for any 1-Lipschitz function: its trilinear interpolant is off by at most the way to the corners.
    assert (np.abs(sampled - exact)[near] <= np.sqrt(3) / 2 * h).all()


def test_outside_the_grid_the_clearance_is_a_lower_bound() -> None:
    parts = [sphere(), mesh_part(ICOSPHERE, (0.05, 0.0, 0.0))]
    field = built(parts, 0.04, 2e-3)
    points = random_points(5000, half_m=0.12)
    beyond = np.maximum(field.origin_m - points, 0) + np.maximum(points - field.upper_m, 0)
    away = np.linalg.norm(beyond, axis=1)
    inner = np.clip(points, field.origin_m, field.upper_m)
    np.testing.assert_allclose(field.sample(points), field.sample(inner) - away, atol=1e-12)
    excess = field.sample(points) - exact_clearance(parts, points)
    assert excess[away > 0].max() <= (field.sample(inner) - exact_clearance(parts, inner)).max() + 1e-9


def test_progress_rises_to_one_and_grid_covers_the_box() -> None:
    seen: list[float] = []
    field = whole_grid(mixture(), [-0.03, -0.02, -0.01], [0.03, 0.02, 0.0333], 2e-3, progress=seen.append)
    assert seen == sorted(seen) and seen[0] > 0 and seen[-1] == 1.0
    np.testing.assert_allclose(field.origin_m, [-0.03, -0.02, -0.01])
    assert (field.upper_m >= [0.03, 0.02, 0.0333]).all()
    assert (field.upper_m < np.array([0.03, 0.02, 0.0333]) + 4 * 2e-3).all()


def test_bounds_hold_all_reachable_clear_points() -> None:
    R, base = Rotation.random(random_state=4).as_matrix(), np.array([0.01, -0.02, 0.03])
    local = random_points(50_000, half_m=0.25)
    reached = (np.linalg.norm(local, axis=1) < 0.2) & (local[:, 2] >= 0) & (np.hypot(*local[:, :2].T) < 0.08)
    points = local[reached] @ R.T + base
    lower, upper = field_bounds([sphere()], 0.2, base, R, side_m=0.08)
    assert ((points >= lower) & (points <= upper)).all()
    assert (upper - lower <= 0.4 + 1e-12).all()
    lumens = [capsule((0.0, 0.0, 0.0), (0.0, 0.02, 0.2), 0.012, role="inside"), mesh_part(ICOSPHERE, role="inside")]
    narrow_lower, narrow_upper = field_bounds([*lumens, sphere()], 0.2, base, R)
    clear = points[exact_clearance(lumens, points) >= 0]
    assert len(clear) and ((clear >= narrow_lower) & (clear <= narrow_upper)).all()
    assert (narrow_upper - narrow_lower).prod() < (upper - lower).prod()


def test_lumen_out_of_reach_leaves_nothing_clear() -> None:
    parts = [sphere((0.0, 0.0, -0.5), role="inside")]
    field = whole_grid(parts, *field_bounds(parts, 0.2), 1e-3)
    assert (field.sample(random_points(1000, half_m=0.2)) < 0).all()


def test_default_spacing_is_at_most_a_millimetre_where_memory_allows() -> None:
    assert default_spacing_m([0, 0, 0], [0.05, 0.02, 0.2]) == 0.5e-3
    assert default_spacing_m([0, 0, 0], [0.2, 0.2, 0.2]) == pytest.approx(1e-3)
    assert default_spacing_m([0, 0, 0], [0.4, 0.4, 0.4]) == pytest.approx(2e-3)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: AnatomyPart(BALL, role="around"), "role"),  # type: ignore[arg-type]
        (lambda: AnatomyPart(BALL, margin_m=-0.001), "margin_m"),
        (lambda: AnatomyPart(BALL, margin_m=np.nan), "margin_m"),
        (lambda: Sphere(ORIGIN, 0.0), "radius_m"),
        (lambda: Sphere(ORIGIN, np.inf), "radius_m"),
        (lambda: Sphere(ORIGIN, None), "radius_m"),
        (lambda: Sphere((0.0, 0.0), 0.01), "center_m"),
        (lambda: Sphere((0.0, 0.0, np.nan), 0.01), "center_m"),
        (lambda: Sphere(None, 0.01), "center_m"),
        (lambda: Capsule(None, ORIGIN, 0.01), "from_m"),
        (lambda: Capsule(ORIGIN, ORIGIN, -0.01), "radius_m"),
        (lambda: Mesh(None, [[0, 1, 2]]), "vertices_m"),
        (lambda: Mesh(np.zeros((2, 3)), [[0, 1, 2]]), "faces"),
        (lambda: Mesh(np.zeros((3, 3)), np.empty((0, 3))), "faces"),
        (lambda: Mesh(np.full((3, 3), np.nan), [[0, 1, 2]]), "vertices_m"),
    ],
)
def test_malformed_parts_are_refused_by_name(make: Callable[[], Any], named: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.key == named


def test_a_mesh_of_arrays_has_its_inside_within_however_it_is_wound() -> None:
    """Turned inward, or as triangles without a common corner, it is the same body."""
    box = trimesh.creation.box((0.02, 0.01, 0.03))
    corners, faces = np.array(box.vertices), np.array(box.faces)
    soup = Mesh(corners[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)[:, ::-1])
    points, right = random_points(500), Mesh(corners, faces)
    for mesh in (Mesh(corners, faces[:, ::-1]), soup):
        np.testing.assert_allclose(mesh.distance(points), right.distance(points), atol=1e-12)
    assert right.distance(np.zeros((1, 3))) == pytest.approx(-0.005)


@pytest.mark.parametrize("part", mixture(), ids=lambda part: part.shape.kind)
def test_boxes_and_surfaces_hold_the_body(part: AnatomyPart) -> None:
    """No point outside the box is within the body; what is drawn lies on the surface and in the box."""
    lower, upper = part.shape.box()
    points = random_points(20_000)
    outside = ((points < lower) | (points > upper)).any(axis=1)
    assert outside.any() and (part.shape.distance(points[outside]) > 0).all()
    drawn = part.shape.surface()
    assert drawn.vertices_m.min() >= lower.min() - 1e-12 and (drawn.vertices_m <= upper + 1e-12).all()
    used = drawn.vertices_m[np.unique(drawn.faces)]
    size = float(np.linalg.norm(upper - lower))
    assert (part.shape.distance(np.ascontiguousarray(used)) < 1e-9 * size).all()


def test_a_kind_that_says_no_number_is_refused() -> None:
    """NaN compares false with every limit and would pass for clear."""

    class Hollow(Sphere):
        def distance(self, points_m: Array) -> Array:
            return super().distance(points_m) * np.nan

    with pytest.raises(CtrplanError, match="must say a distance for every point"):
        exact_clearance([AnatomyPart(Hollow(ORIGIN, 0.01))], random_points(3))
