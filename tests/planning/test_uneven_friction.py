"""Friction that differs along a contact: the worst that is found is not beaten by chance, and certificates count it."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROBOTS

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.certificate import uneven_friction
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.certify import certify
from ctrplan.certificate.uneven_friction import PARTS, Uneven, worst_uneven_friction
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.scenario.scenario import Scenario

ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")
Q = np.array([*np.radians([-68.0, -28.0, 118.0]), -30e-3])
THETA_B, L_B = ROBOT.drive.collars(Q)
ALL = [1.0, -1.0]


def beside(point_m: Array, away_m: Array) -> Scenario:
    """The robot at rest with a sphere of 1 mm."""
    names = {j.name: value / j.si_per_unit for j, value in zip(ROBOT.drive.joints, Q.tolist(), strict=True)}
    sphere = {"kind": "sphere", "center_mm": ((point_m + away_m) * 1e3).tolist(), "radius_mm": 1.0}
    content = {"robot": "three_tube.toml", "start": names, "goal": {"joints": names}, "anatomy": [sphere]}
    return scenario_from_dict(content, file=str(ROBOTS / "made_up.toml"))


def test_parts_of_equal_friction_are_the_uniform_state() -> None:
    phi = np.random.default_rng(0).uniform(-1, 1, (6, 2))
    uniform = ROBOT.mechanics.friction_bodies(THETA_B, L_B, phi)
    parts = ROBOT.mechanics.friction_bodies(THETA_B, L_B, np.repeat(phi[:, None], 5, axis=1))
    np.testing.assert_allclose(parts.point_m, uniform.point_m, atol=1e-9)
    np.testing.assert_allclose(parts.stability, uniform.stability, rtol=1e-6)


def test_friction_where_nothing_follows_it_moves_nothing_before_it() -> None:
    """Torsion comes from the contact beyond a place: friction of the last part alone turns the robot, but less."""
    last, all_ = np.zeros((PARTS, 2)), np.zeros((PARTS, 2))
    last[-1], all_[:] = 1.0, 1.0
    rest, alone, whole = ROBOT.mechanics.friction_bodies(
        THETA_B, L_B, np.array([np.zeros((PARTS, 2)), last, all_])
    ).point_m
    assert 0 < np.linalg.norm(alone[-1] - rest[-1]) < np.linalg.norm(whole[-1] - rest[-1])


@pytest.mark.parametrize(
    "phi", [np.zeros((2, 0, 2)), np.zeros((1, 3, 3)), np.full((1, 2, 2), 1.5), np.zeros((1, 1, 1, 2))]
)
def test_states_of_a_wrong_shape_are_refused(phi: Array) -> None:
    with pytest.raises(InputError, match="phi"):
        ROBOT.mechanics.friction_bodies(THETA_B, L_B, phi)


@pytest.mark.parametrize("seed", range(3))
def test_no_random_uneven_state_comes_nearer_than_the_worst_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = np.sign(rng.uniform(-1, 1, (150, PARTS, 2)))
    bodies = ROBOT.mechanics.friction_bodies(THETA_B, L_B, states)
    side = rng.standard_normal(3)
    scenario = beside(bodies.point_m[0, -20], 4e-3 * side / np.linalg.norm(side))
    distance = AnatomyDistance.of(scenario)
    assert distance is not None
    found = worst_uneven_friction(distance, THETA_B, L_B)
    center = scenario.anatomy[0].shape.center_m
    by_hand = (np.linalg.norm(bodies.point_m - center, axis=2) - bodies.radius_m).min() - 1e-3
    worst = ROBOT.mechanics.friction_bodies(THETA_B, L_B, found.phi[None])
    least = (np.linalg.norm(worst.point_m - center, axis=2) - worst.radius_m).min() - 1e-3
    assert found.nearer_m >= 0 and least <= by_hand + 0.02e-3


def test_certificates_take_off_what_uneven_friction_takes_beyond_its_allowance(monkeypatch: pytest.MonkeyPatch) -> None:
    body = ROBOT.mechanics.friction_bodies(THETA_B, L_B, [ALL]).point_m[0]
    scenario = beside(body[-1], np.array([0.0, 0.0, 2.9e-3]))
    before = certify(scenario, Q[None]).min_clearance_m
    assert 0.3e-3 < before < uneven_friction.NEAR_LIMIT_M
    monkeypatch.setattr(uneven_friction, "worst_uneven_friction", lambda *_: Uneven(0.35e-3, np.zeros((PARTS, 2))))
    assert certify(scenario, Q[None]).min_clearance_m == pytest.approx(before - 0.3e-3, abs=0.06e-3)
    nearer = beside(body[-1], np.array([0.0, 0.0, 2.6e-3]))  # what it takes is asked of friction states, then
    assert 0.0 <= certify(nearer, Q[None]).min_clearance_m < 0.05e-3
