"""A base whose rotation is known within a ball: clearances are the least over all turns, by any number of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ctrplan import load_scenario
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance_of_many
from ctrplan.anatomy.shape import PartShape
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array
from ctrplan.certificate.anatomy_distance import TURNED_M, AnatomyDistance
from ctrplan.scenario.scenario import Registration

PLATE = trimesh.creation.box(extents=[8e-3, 8e-3, 1e-3])
PLATE.apply_translation([0.03, 0.02, 0.1])
SHAPES: list[PartShape] = [
    Sphere(np.array([0.0, 5e-3, 0.1]), 2e-3),
    Capsule(np.array([-0.01, 0.0, 0.12]), np.array([0.015, 0.01, 0.11]), 0.5e-3),
    Mesh(np.array(PLATE.vertices), np.array(PLATE.faces)),
]


def distance_to(shape: PartShape, sigma_deg: float) -> AnatomyDistance:
    scenario = replace(
        load_scenario("scenarios/ribs.toml"),
        anatomy=(AnatomyPart(shape, "avoid", 0.0),),
        registration=Registration(0.0, np.radians(sigma_deg)),
    )
    result = AnatomyDistance.of(scenario)
    assert result is not None
    return result


def turned(distance: AnatomyDistance, points: Array, count: int) -> Array:
    """(K,) [m] least clearance of points over some turns, most of them as large as they may be."""
    rng = np.random.default_rng(2)
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    angles = distance.turn_rad * np.minimum(1.0, rng.uniform(0.0, 4.0, count))
    every = [points, *(Rotation.from_rotvec(turn).apply(points) for turn in axes * angles[:, None])]
    located = distance.scenario.located(np.concatenate(every))
    return exact_clearance_of_many(distance.scenario.anatomy, located).reshape(len(every), -1).min(axis=0)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.kind)
def test_no_turn_leaves_less_and_some_turn_as_little(shape: PartShape) -> None:
    distance, rng = distance_to(shape, 0.6), np.random.default_rng(1)
    points = np.array([0.0, 0.0, 0.1]) + rng.uniform(-0.025, 0.025, (40, 3))
    least, tried = distance(points, np.full(40, np.inf)), turned(distance, points, 4000)
    assert (least <= tried + 1e-12).all()
    assert (tried - least < TURNED_M + 0.1e-3).all()  # of 4000 turns one comes within 0.1 mm of the worst


def test_what_is_beyond_what_is_needed_is_said_to_be() -> None:
    distance, rng = distance_to(SHAPES[0], 0.6), np.random.default_rng(4)
    points = np.array([0.0, 0.0, 0.1]) + rng.uniform(-0.025, 0.025, (60, 3))
    closely = distance(points, np.full(60, np.inf))
    roughly = distance(points, np.full(60, 4e-3))
    assert (roughly <= closely + 2 * TURNED_M).all()
    assert ((roughly >= 4e-3) == (closely >= 4e-3))[np.abs(closely - 4e-3) > TURNED_M].all()


def test_an_obstacle_ahead_is_no_nearer_by_a_turn_than_its_arc() -> None:
    distance, ahead = distance_to(SHAPES[0], 0.6), np.array([[0.0, 4e-3, 0.08]])
    still = exact_clearance_of_many(distance.scenario.anatomy, distance.scenario.located(ahead))
    reach = distance.turn_rad * np.linalg.norm(ahead)
    assert float((still - distance(ahead, np.array([np.inf])))[0]) < 0.25 * reach


def test_bodies_are_the_least_of_their_points() -> None:
    distance = distance_to(SHAPES[2], 0.4)
    body = np.stack([np.linspace(0, 0.02, 60), np.full(60, 0.018), np.linspace(0.06, 0.098, 60)], axis=1)
    body = np.stack([np.interp(np.linspace(0, 59, 220), np.arange(60), column) for column in body.T], axis=1)
    least = distance.least(body, np.full(220, 1e-3), np.zeros(220, dtype=np.intp), 1)[0]
    at_points = turned(distance, body, 2000).min() - 1e-3
    assert at_points - 0.3e-3 < least <= at_points + 1e-12
