"""Friction states of samples between solved ones: what is taken off covers what interpolation is off by."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from places import ROBOTS

import ctrplan
from ctrplan.certificate.friction_states import LOOK_EVERY, Solved, State, corner_states, corner_weights
from ctrplan.certificate.sample_states import SampleStates, StatesBetween
from ctrplan.certificate.variants import Variants
from ctrplan.certificate.walked_piece import walked
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.scenario.joint_space import JointSpace

ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")
INNER: list[State] = list(itertools.product((-0.5, 0.0, 0.5), repeat=2))


@pytest.fixture(scope="module")
def solved() -> list[SampleStates]:
    """Samples of a leg that turns tubes against one another."""
    start, turn = np.radians([20.0, 60.0, -40.0, 0.0]), np.radians([-32.0, 24.0, 48.0, 0.0])
    start[3] = -30e-3
    names = {joint.name: value / joint.si_per_unit for joint, value in zip(ROBOT.drive.joints, start, strict=True)}
    content = {"robot": "three_tube.toml", "start": names, "goal": {"joints": names}}
    scenario = scenario_from_dict(content, file=str(ROBOTS / "made_up.toml"))
    way = np.array([start, start + turn])
    piece = walked(Variants.of(scenario, way), JointSpace.of(scenario), 0, way, "search")
    return [SampleStates(scenario, piece, k, "search") for k in range(len(piece.l_b))]


def between(solved: list[SampleStates], sample: int, accuracy: Accuracy) -> tuple[StatesBetween, SampleStates]:
    """A sample from the fourths beside it, and the same solved."""
    own = SampleStates(solved[0].scenario, solved[0].piece, sample, accuracy)
    first = sample - sample % LOOK_EVERY
    ends = solved[first], solved[first + LOOK_EVERY]
    return StatesBetween(own.known, ends, (sample - first) / LOOK_EVERY, accuracy != "search"), own


@pytest.mark.parametrize("accuracy", ["search", "certificate"])
def test_solved_bodies_are_within_what_is_taken_off(solved: list[SampleStates], accuracy: Accuracy) -> None:
    assert len(solved) > 20
    for sample in (1, 6, 11, 14, 19):
        interpolated, own = between(solved, sample, accuracy)
        for guess, true in zip(interpolated(INNER), own(INNER), strict=True):
            apart = np.linalg.norm(guess.body_m - true.body_m, axis=1)
            assert np.all(apart <= guess.doubt_m + 1e-6)
            assert np.max(guess.doubt_m) < 1e-3  # and it says something


def test_a_solved_sample_is_itself(solved: list[SampleStates]) -> None:
    interpolated, own = between(solved, 8, "search")
    for guess, true in zip(interpolated(INNER), own(INNER), strict=True):
        np.testing.assert_allclose(guess.body_m, true.body_m, atol=1e-12)


def test_beside_a_sign_corner_a_body_is_the_corner_s(solved: list[SampleStates]) -> None:
    """Corners were solved: their bodies bend away from themselves by nothing."""
    interpolated, own = between(solved, 9, "search")
    corners = corner_states(2)
    known = own.known.solved
    for guess, state in zip(interpolated([(0.999, 0.999)]), corners[:1], strict=True):
        np.testing.assert_allclose(guess.body_m, known[state].body_m, atol=2e-5)


def test_without_an_equilibrium_beside_it_a_sample_has_no_body(solved: list[SampleStates]) -> None:
    class Nowhere(SampleStates):
        def __call__(self, phi: Iterable[State]) -> list[Solved]:
            return [replace(one, body_m=np.full_like(one.body_m, np.nan)) for one in super().__call__(phi)]

    interpolated, _ = between(solved, 9, "search")
    lost = Nowhere(solved[8].scenario, solved[8].piece, 8, "search")
    broken = replace(interpolated, ends=(lost, interpolated.ends[1]))
    assert all(np.isnan(one.body_m).any() for one in broken(INNER))


def test_corner_weights_are_those_of_multilinear_interpolation() -> None:
    phi = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    weights, corners = corner_weights(phi), np.array(corner_states(3))
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(weights @ corners, phi, atol=1e-15)
    np.testing.assert_allclose(corner_weights(corners), np.eye(8), atol=1e-15)
