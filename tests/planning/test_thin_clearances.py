"""Thin clearances: little more than what is unknown of the model is taken off, and never more stated than there is."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ctrplan import Robot, Scenario, Sphere, load_robot
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import certify
from ctrplan.scenario.joint_space import bare_scenario

ROBOTS = Path(__file__).parents[2] / "scenarios" / "robots"
RADIUS_M = 3e-3
PAIR_WAY = np.array([[0.2, 1.4, 0.01], [0.25, 1.5, 0.011]])
THREE_WAY = np.array([[0.1, 0.9, 1.9, -0.02], [0.11, 0.92, 1.92, -0.0195]])


def everywhere(robot: Robot, way: Array) -> tuple[Array, Array]:
    """Points (K, 3) and radii (K,) of a robot on its way (2, m), in a grid of friction states, with exact geometry."""
    states = np.array(list(itertools.product(np.linspace(-1, 1, 5), repeat=robot.n - 1)))
    points, radii = [], []
    for share in np.linspace(0, 1, 9):
        at = robot.drive.collars(way[0] + share * (way[1] - way[0]))
        bodies = robot.mechanics.friction_states(*at, accuracy="exact").bodies(states, spacing_m=0.5e-3)
        assert bodies.solved.all()
        points.append(bodies.point_m.reshape(-1, 3))
        radii.append(np.tile(bodies.radius_m, len(states)))
    return np.concatenate(points), np.concatenate(radii)


def beside(robot: Robot, way: Array, left_m: float) -> Scenario:
    """A motion past a ball beside the tip, which leaves so much to all that the robot fills on its way."""
    points, radii = everywhere(robot, way)
    tip = points[np.argmax(np.linalg.norm(points, axis=1))]
    outward = np.cross(tip, [0.3, 0.5, 0.1]) / np.linalg.norm(np.cross(tip, [0.3, 0.5, 0.1]))
    near, far = 0.0, 40e-3
    while far - near > 1e-7:
        middle = (near + far) / 2
        room = np.linalg.norm(points - (tip + middle * outward), axis=1) - RADIUS_M - radii
        near, far = (middle, far) if room.min() < left_m else (near, middle)
    case, part = bare_scenario(robot), AnatomyPart(Sphere(tip + far * outward, RADIUS_M), "avoid", 0.0)
    return replace(case, start=way[0], goal=replace(case.goal, joints=way[1], tip_m=None), anatomy=(part,))


@pytest.mark.parametrize(
    ("name", "way", "left_mm"), [("table_5_pair", PAIR_WAY, 0.25), ("three_tube", THREE_WAY, 0.25)]
)
def test_a_quarter_of_a_millimetre_is_enough(name: str, way: Array, left_mm: float) -> None:
    """Friction included: what is left to all of its states, by brute force. Half a millimetre was asked for before."""
    robot = load_robot(ROBOTS / f"{name}.toml")
    certificate = certify(beside(robot, way, left_mm * 1e-3), way, restart=False)
    assert certificate.valid, certificate.problems
    assert certificate.min_clearance_m < left_mm * 1e-3
    assert not certify(beside(robot, way, -0.01e-3), way, restart=False).valid


def test_wide_clearances_between_tubes_take_nothing_where_their_geometry_is_exact() -> None:
    """The model of first order in them takes 0.45 mm off this pair's clearances."""
    robot = load_robot(ROBOTS / "table_5_pair.toml", ["contact.1.clearance_mm=1.0"])
    certificate = certify(beside(robot, PAIR_WAY, 0.3e-3), PAIR_WAY, restart=False)
    assert certificate.valid, certificate.problems
