"""Clearance over every friction state: bounds hold against brute force, and refuse no more than they say."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made_up_input import FUZZ
from places import ROBOTS

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import _contradictions, certify, finished
from ctrplan.certificate.friction_cube import LESS_M, CubeQuery, Needed, cell_clearances, cube_minima, minima_of_cubes
from ctrplan.certificate.friction_states import UNEVEN_FRICTION_M, Cell, Solved, State, corner_states, mesh_allowance_m
from ctrplan.certificate.other_equilibria import other_start
from ctrplan.certificate.walked_legs import walk_legs
from ctrplan.certificate.walked_piece import walk_pieces
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import PathPrediction
from ctrplan.scenario.scenario import Scenario

ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")


class Spheres:
    """Clearance to the nearest of some spheres."""

    def __init__(self, centres: Array, radius: float) -> None:
        self.centres, self.radius = centres, radius

    def __call__(self, points: Array, needed: Array) -> Array:
        distance: Array = np.linalg.norm(points[:, None] - self.centres, axis=2).min(axis=1) - self.radius
        return distance


def curled(phi: Array) -> Array:
    """(S, N, 3) made-up bodies that bend with the states of two pairs, and not in proportion."""
    s = np.linspace(0, 0.1, 60)
    a, b = phi[:, :1], phi[:, 1:2]
    x = s**2 * (1.2 * a + 0.5 * np.sin(1.2 * b) + 0.3 * a * b + 0.4 * a**2)
    y = s**2 * (0.8 * b + 0.4 * np.cos(a) + 0.2 * b**2)
    return np.stack([x, y, np.broadcast_to(s, x.shape)], axis=2)


def solved(states: Sequence[State]) -> list[Solved]:
    """Solved states whose stability and strain are all equal."""
    return [Solved(body, 1.0, 0.01) for body in curled(np.array(states))]


@pytest.mark.parametrize("seed", range(40))
def test_what_is_enough_is_so_for_every_state_and_little_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius = np.full(60, 1e-3)
    everywhere = np.array(list(itertools.product(np.linspace(-1, 1, 41), repeat=2)))
    bodies = curled(everywhere)
    state, point = rng.integers(len(everywhere)), rng.integers(30, 60)
    spheres = Spheres(bodies[state, point] + rng.uniform(-6e-3, 6e-3, (1, 3)), 2e-3)
    true = float((spheres(bodies.reshape(-1, 3), np.zeros(1)) - 1e-3).min())
    states = [(0.0, 0.0), *corner_states(2)]
    for enough in (true - 5e-3, true - 1e-3, true + 1e-3):
        known = dict(zip(states, solved(states), strict=True))
        found = cube_minima(CubeQuery(known, radius, solved, Needed(enough)), spheres)
        assert found.clearance_m < enough or true >= found.clearance_m - 1e-9
        assert found.clearance_m >= enough or true < enough + 0.6e-3
    for more in (0.3e-3, 1e-3, 3e-3):  # more than there is is asked for: what is said is still a lower bound
        known = dict(zip(states, solved(states), strict=True))
        asked = CubeQuery(known, radius, solved, Needed(true + more), floor_m=-0.1)
        assert true - 0.6e-3 - 2 * LESS_M <= cube_minima(asked, spheres).clearance_m <= true + 1e-9


def test_a_state_without_an_equilibrium_is_no_clearance_at_all() -> None:
    states = [(0.0, 0.0), *corner_states(2)]
    known = dict(zip(states, solved(states), strict=True))
    near = Spheres(curled(np.array([[0.5, 0.5]]))[:, -1], 1e-3)
    nowhere = Solved(np.full((60, 3), np.nan), np.nan, np.nan)
    asked = CubeQuery(known, np.full(60, 1e-3), lambda phi: [nowhere] * len(phi), Needed(0.0))
    assert cube_minima(asked, near).clearance_m == -np.inf


@pytest.mark.parametrize("leap_mm", [0.0, 5.0, 20.0])
def test_where_bodies_leap_from_state_to_state_a_fold_is_told_and_no_shape_between(leap_mm: float) -> None:
    """A body 2.2 mm within an obstacle was told of, halfway between two branches that keep 7.7 mm from it."""
    fold = np.array([leap_mm * 1e-3, 0.0, 0.0])

    def leaping(states: Sequence[State]) -> list[Solved]:
        of_each = zip(states, solved(states), strict=True)
        return [replace(one, body_m=one.body_m + fold * (phi[1] > 0.34)) for phi, one in of_each]

    states = [(0.0, 0.0), *corner_states(2)]
    known = dict(zip(states, leaping(states), strict=True))
    halfway = Spheres(curled(np.array([[0.0, 0.34]]))[:, -1] + fold / 2, 0.2e-3)
    found = cube_minima(CubeQuery(known, np.full(60, 0.1e-3), leaping, Needed(0.0), floor_m=0.0), halfway)
    assert found.stability == (0.0 if leap_mm else 1.0)
    assert (found.clearance_m < 0) != bool(leap_mm)


def test_configurations_that_are_looked_at_together_are_found_as_alone() -> None:
    """Bodies of several lengths, what is asked of them differs too; and no more distances are asked for."""
    rng = np.random.default_rng(3)
    spheres = Spheres(rng.uniform([-0.02, -0.02, 0.03], [0.02, 0.02, 0.1], (6, 3)), 2e-3)
    states = [(0.0, 0.0), *corner_states(2)]

    def shorter(count: int) -> CubeQuery:
        def cut(phi: Sequence[State]) -> list[Solved]:
            return [replace(one, body_m=one.body_m[:count]) for one in solved(phi)]

        known = dict(zip(states, cut(states), strict=True))
        return CubeQuery(known, np.full(count, 1e-3), cut, Needed(float(rng.uniform(-4e-3, 4e-3))))

    points = list[int]()

    def counted(point_m: Array, enough_m: Array) -> Array:
        points.append(len(point_m))
        return spheres(point_m, enough_m)

    asked = [shorter(int(count)) for count in rng.integers(20, 60, 12)]
    together = minima_of_cubes(asked, counted)
    of_all = sum(points)
    points.clear()
    for one, found in zip(asked, together, strict=True):
        alone = cube_minima(one, counted)
        assert (found.clearance_m, found.phi, found.solves) == (alone.clearance_m, alone.phi, alone.solves)
    assert of_all <= sum(points)


def test_cells_that_are_too_near_are_so_whether_their_least_is_asked_or_not() -> None:
    rng = np.random.default_rng(5)
    spheres = Spheres(rng.uniform([-0.02, -0.02, 0.03], [0.02, 0.02, 0.1], (6, 3)), 2e-3)
    cells = [cell for first in Cell((-1.0, -1.0), (1.0, 1.0), 0).halves() for cell in first.halves()]
    shapes = np.array([[one.body_m for one in solved([*cell.corners, cell.middle])] for cell in cells])
    bodies = np.concatenate([shapes, np.full((*shapes.shape[:3], 1), 1e-3)], axis=3)
    enough = rng.uniform(-3e-3, 6e-3, len(cells))
    least, some = (
        cell_clearances(cells, bodies, np.full(len(cells), 60), spheres, enough, np.full(len(cells), asked))
        for asked in (True, False)
    )
    is_enough = [one.clearance_m >= limit for one, limit in zip(least, enough, strict=True)]
    assert 0 < sum(is_enough) < len(cells)
    for one, other, kept in zip(least, some, is_enough, strict=True):
        assert other.clearance_m == one.clearance_m if kept else other.clearance_m >= one.clearance_m
    assert is_enough == [one.clearance_m >= limit for one, limit in zip(some, enough, strict=True)]


def joints(*values: float) -> Array:
    """Joints of the three-tube robot from three rotations in deg and a translation in mm."""
    return np.array([*np.radians(values[:3]), values[3] * 1e-3])


def with_sphere(q: Array, center_mm: Sequence[float], radius_mm: float) -> Scenario:
    """A scenario that rests at joints (m,) beside a sphere."""
    names = {joint.name: value / joint.si_per_unit for joint, value in zip(ROBOT.drive.joints, q.tolist(), strict=True)}
    sphere = {"kind": "sphere", "center_mm": list(center_mm), "radius_mm": radius_mm}
    content = {"robot": "three_tube.toml", "start": names, "goal": {"joints": names}, "anatomy": [sphere]}
    return scenario_from_dict(content, file=str(ROBOTS / "made_up.toml"))


def test_a_body_between_the_corners_is_seen() -> None:
    """Once 0.14 mm of clearance were certified where the body at phi = (0.5, -0.5) ran 2.35 mm deep into the sphere."""
    q = joints(0, 90, 180, -28.8)
    case = with_sphere(q, (-1.2, 32.7, 195.9), 1.5)
    found = certify(case, q[None])
    assert not found.valid and "a shape that friction allows comes" in found.problems[0]
    body = ROBOT.mechanics.friction_bodies(*ROBOT.drive.collars(q), [[0.5, -0.5]])
    depth = 1.5e-3 + body.radius_m - np.linalg.norm(body.point_m[0] - [-1.2e-3, 32.7e-3, 195.9e-3], axis=1)
    assert depth.max() > 2e-3  # it does run into the sphere
    assert found.min_clearance_m < -1e-3


@pytest.mark.parametrize("seed", range(4) if FUZZ else [2])
def test_no_friction_state_has_less_clearance_than_certified(seed: int) -> None:
    """Spheres near the bodies of random friction states: a valid certificate holds against a grid of 17 x 17 states."""
    rng = np.random.default_rng(seed)
    q = joints(*rng.uniform(-180, 180, 3), rng.uniform(-60, -5))
    theta_b, l_b = ROBOT.drive.collars(q)
    states = np.array(list(itertools.product(np.linspace(-1, 1, 17), repeat=2)))
    bodies = ROBOT.mechanics.friction_bodies(theta_b, l_b, states, accuracy="certificate")
    assert bodies.solved.all()
    valid = 0
    for away_mm in (3.0, 5.0, 8.0, 14.0) if FUZZ else (5.0, 14.0):
        side = rng.standard_normal(3)
        middle = bodies.point_m[rng.integers(len(states)), -1 - rng.integers(40)]
        center = middle + away_mm * 1e-3 * side / np.linalg.norm(side)
        found = certify(with_sphere(q, center * 1e3, 1.0), q[None], accuracy="certificate")
        true = (np.linalg.norm(bodies.point_m - center, axis=2) - 1e-3 - bodies.radius_m).min()
        assert not found.valid or found.min_clearance_m <= true + 1e-6
        valid += found.valid
        assert found.valid or true < 2e-3 or "another equilibrium" in found.problems[0]
    assert valid


def test_a_body_between_the_states_that_were_looked_at_is_seen() -> None:
    """More clearance was asked for than there is. What the first states have was taken for what all have: 0.01 mm were
    certified where a body ran 0.37 mm deep into the sphere."""
    q = joints(-150.40109769555826, 155.0023352598973, -76.57774978760264, -24.87930732587258)
    center_mm = np.array([-51.42518230775368, -35.62135135603236, 185.55444768507317])
    walk = walk_legs(with_sphere(q, center_mm.tolist(), 1.0), q[None])
    states = np.array(list(itertools.product(np.linspace(-1, 1, 17), repeat=2)))
    bodies = ROBOT.mechanics.friction_bodies(*ROBOT.drive.collars(q), states, accuracy="certificate")
    true = (np.linalg.norm(bodies.point_m - center_mm * 1e-3, axis=2) - 1e-3 - bodies.radius_m).min()
    assert true < -0.3e-3
    assert walk.problems and walk.samples.clearance_m.min() <= true


def test_bodies_in_friction_states_are_those_of_single_solves() -> None:
    theta_b, l_b = np.radians([0.0, 90.0, 180.0]), np.array([0.0, -0.017, -0.0628])
    phi = np.array(list(itertools.product((-1.0, -0.3, 0.0, 0.7), repeat=2)))
    found = ROBOT.mechanics.friction_bodies(theta_b, l_b, phi)
    assert found.solved.all() and found.point_m.shape[:2] == (len(phi), len(found.radius_m))
    for state, body in zip(phi, found.point_m, strict=True):
        np.testing.assert_allclose(body[-1], ROBOT.solve(theta_b, l_b, state).tip_m, atol=1e-9)


def test_a_start_with_a_second_equilibrium_is_told() -> None:
    """An approach by turns of 90 deg once left the robot 20.1 mm away where a bound of 3.74 mm was certified."""
    q = joints(69.388, 113.694, -56.0136, -82.526)
    case = with_sphere(q, (-80.0, 29.4, 149.8), 3.0)
    sentence = other_start(case, q)
    assert (
        "another stable equilibrium" in sentence and "18.2 mm away, where friction moves the tip by 3.74 mm" in sentence
    )
    found = certify(case, q[None])
    assert not found.valid and found.problems[0] == f"{sentence}."
    assert other_start(replace(case, start_friction="released"), q) == ""  # nothing came before
    assert other_start(case, joints(0, 0, 0, -28.8)) == ""  # aligned tubes have one equilibrium


def test_half_the_motion_is_taken_off_on_both_sides_of_a_sample() -> None:
    """Once a leap counted at the sample after it only."""
    case = with_sphere(joints(0, 0, 0, -28.8), (0.0, 60.0, 100.0), 1.0)
    (piece,) = walk_pieces(
        case, JointSpace.of(case), np.array([joints(0, 0, 0, -28.8), joints(0, 0, 20, -28.8)]), "search", None
    )
    motion = piece.samples.motion_m
    assert len(motion) > 3 and motion[0] == 0
    offset = piece.offset_m(case, "search") - mesh_allowance_m(case.robot, "search") - UNEVEN_FRICTION_M
    np.testing.assert_allclose(offset[:-1], np.maximum(motion[:-1], motion[1:]) / 2, atol=1e-15)


def test_a_bent_drive_is_followed_and_not_its_chord() -> None:
    """With an eccentric joint collars do not move in proportion; the walk once took the chord of 40 mm."""
    bent = robot_from_dict(
        {**ROBOT.content, "effects": {"eccentricity": {"sin_3_deg": 10.0}}}, file=str(ROBOTS / "bent.toml")
    )
    a, b = joints(0, 0, 0, -28.8), joints(0, 0, 90, -28.8)
    case = replace(with_sphere(a, (0.0, 90.0, 100.0), 1.0), robot=bent)
    for piece in walk_pieces(case, JointSpace.of(case), np.array([a, b]), "search", None):
        rows = piece.way[0] + piece.samples.fraction[:, None] * (piece.way[-1] - piece.way[0])
        np.testing.assert_allclose(piece.joints, rows, atol=1e-12)
        np.testing.assert_allclose(piece.theta_b, bent.drive.collars(rows)[0], atol=np.radians(0.01))


@pytest.mark.parametrize("sample", [0, 2])
def test_a_simulated_robot_beyond_its_bound_is_a_contradiction_wherever_it_is(sample: int) -> None:
    """The start once did not count."""
    case = with_sphere(joints(0, 0, 0, -28.8), (0.0, 60.0, 100.0), 1.0)
    samples = certify(case, np.array([joints(0, 0, 0, -28.8), joints(0, 0, 20, -28.8)])).samples
    still = np.zeros((1, len(samples.leg), 3))
    calm = PathPrediction(still, still, still[..., :2], 0)
    assert _contradictions(calm, samples) == []
    predicted = samples.bound_m.copy()
    predicted[sample] += 5e-3
    assert "5.00 mm beyond" in _contradictions(calm, replace(samples, predicted_m=predicted))[0]


def test_a_walk_that_asks_for_little_clearance_refuses_nothing_else() -> None:
    """It knows less of what is left at the least, never more than there is."""
    legs = np.array([joints(0, 60, 0, -28.8), joints(0, 60, 12, -28.8)])
    tip = ROBOT.mechanics.friction_bodies(*ROBOT.drive.collars(legs[0]), [[0.0, 0.0]]).point_m[0, -1] * 1e3
    for away_mm in (1.5, 12.0):
        case = with_sphere(legs[0], (tip + [0.0, 0.0, away_mm]).tolist(), 1.0)
        hasty, whole = walk_legs(case, legs, spare_m=0.5e-3), walk_legs(case, legs)
        assert hasty.problems == whole.problems
        stated, expected = finished(hasty), finished(whole)
        assert stated.problems == expected.problems and stated.spare_m == 0.5e-3 and expected.spare_m == np.inf
        assert bool(whole.problems) == (away_mm < 4)
        if not whole.problems:
            assert 0.5e-3 <= hasty.samples.clearance_m.min() <= whole.samples.clearance_m.min()
