"""Thousands of primitives: the same clearances as when every one is asked, in a fraction of the time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from ctrplan.anatomy.clearance_grid import anatomy_field
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance, exact_clearance_of_many, nearby
from ctrplan.anatomy.shapes.sphere import Sphere


def spheres(count: int, seed: int, lumens: int = 0) -> list[AnatomyPart]:
    random = np.random.default_rng(seed)
    parts = []
    for k in range(count):
        inside = k < lumens
        shape = Sphere(
            random.uniform(-0.1, 0.1, 3), random.uniform(0.02, 0.05) if inside else random.uniform(1e-4, 4e-3)
        )
        parts.append(AnatomyPart(shape, "inside" if inside else "avoid", random.uniform(0, 1e-3)))
    return parts


@pytest.mark.parametrize("lumens", [0, 30])
def test_clearances_of_many_parts_are_those_of_asking_all(lumens: int) -> None:
    parts, points = spheres(300, 1, lumens), np.random.default_rng(2).uniform(-0.12, 0.12, (2000, 3))
    np.testing.assert_array_equal(exact_clearance_of_many(parts, points), exact_clearance(parts, points))


@pytest.mark.parametrize("places", [1, 3, 40])
@pytest.mark.parametrize("radius_m", [1e-4, 5e-3, 0.05])
def test_boxes_leave_out_no_part_that_matters(places: int, radius_m: float) -> None:
    """Around every place the parts left decide all clearances."""
    random = np.random.default_rng(places)
    parts, centres = spheres(400, 5, 10), random.uniform(-0.12, 0.12, (places, 3))
    for centre, few in zip(centres, nearby(parts, centres, radius_m), strict=True):
        apart = random.normal(size=(50, 3))
        points = centre + radius_m * apart / np.linalg.norm(apart, axis=1)[:, None]
        np.testing.assert_array_equal(exact_clearance(few, points), exact_clearance(parts, points))


def test_a_field_of_three_thousand_spheres_takes_seconds_and_is_exact_near_them(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
    parts, begun, told = spheres(3000, 3), time.monotonic(), list[float]()
    field = anatomy_field(
        parts, [-0.04] * 3, [0.04] * 3, 1e-3, base_position_m=[0, 0, 0], reach_m=0.1, progress=told.append
    )
    assert time.monotonic() - begun < 40
    assert told == sorted(told) and told[-1] == 1.0
    nodes = np.random.default_rng(4).integers(0, 81, (400, 3))
    points = field.origin_m + field.spacing_m * nodes
    inside = np.all((points >= -0.04) & (points <= 0.04), axis=1)
    exact, kept = exact_clearance(parts, points[inside]), field.sample(points[inside])
    near = exact < 5e-3
    assert near.sum() > 50
    np.testing.assert_allclose(kept[near], exact[near], rtol=0, atol=1e-7)
