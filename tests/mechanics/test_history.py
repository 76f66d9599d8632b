"""Laws of path history: what any quasi-static motion with Coulomb friction obeys, whatever the numbers."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import HistoryOptions, Status
from ctrplan.mechanics.tube import TubeSection
from ctrplan.robot.robot import Robot

PAIR, THREE = load_robot(ROBOTS / "table_5_pair.toml"), load_robot(ROBOTS / "three_tube.toml")
HALVED = HistoryOptions(
    rotation_rad=HistoryOptions.rotation_rad / 2,
    translation_m=HistoryOptions.translation_m / 2,
    state_change=HistoryOptions.state_change / 2,
)
MM = 1e-3


@pytest.fixture
def robot(request: pytest.FixtureRequest) -> Robot:
    """By name: what a mark holds, pytest holds beyond the end of Python."""
    return {"pair": PAIR, "three": THREE}[request.param]


def path(robot: Robot, seed: int, legs: int = 4, turn_rad: float = 1.5) -> tuple[Array, Array]:
    """Waypoints (K, n) of rotations, translations and both, in turn."""
    rng, n = np.random.default_rng(seed), robot.n
    theta_b, l_b = np.zeros((legs + 1, n)), np.tile([0.0, -0.017, -0.034][:n], (legs + 1, 1))
    theta_b[0, 1:], l_b[:, -1] = rng.uniform(-1, 1, n - 1), -0.07
    for k in range(1, legs + 1):
        theta_b[k:, 1:] += rng.uniform(-turn_rad, turn_rad, n - 1) * (k % 3 != 2)
        l_b[k:, -1] += rng.uniform(-8, 8) * MM * (k % 3 != 1)
    return theta_b, l_b


@pytest.mark.parametrize("robot", ["pair", "three"], indirect=True)
def test_a_released_start_is_the_frictionless_solution_and_a_loaded_one_its_corner(robot: Robot) -> None:
    theta_b, l_b = (rows[0] for rows in path(robot, 1))
    bound = robot.bound(theta_b, l_b)
    step = robot.history("released").advance(theta_b, l_b)
    assert step.deviation_m < 1e-9 and step.steps == step.snaps == 0
    for signs, corner in zip(itertools.product((1, -1), repeat=robot.n - 1), bound.corners, strict=True):
        loaded = robot.history(signs).advance(theta_b, l_b)
        np.testing.assert_allclose(loaded.shape.tip_m, corner.tip_m, atol=1e-6 * MM)
        np.testing.assert_allclose(loaded.shape.tip_tangent, corner.tip_tangent, atol=1e-8)
        assert loaded.shape.tip_tangent @ loaded.frictionless.tip_tangent > np.cos(bound.tangent_rad + 1e-6)


def test_a_start_in_a_corner_may_be_an_array() -> None:
    theta_b, l_b = (rows[0] for rows in path(THREE, 1))
    tips = [THREE.history(start).advance(theta_b, l_b).shape.tip_m for start in ((1, -1), np.array([1, -1]))]
    np.testing.assert_array_equal(*tips)


@pytest.mark.parametrize("robot", ["pair", "three"], indirect=True)
def test_a_full_rotation_reaches_the_corner(robot: Robot) -> None:
    """90 deg of every pair saturate friction, as in Section V; neighbours turn each other's tubes a little."""
    for signs in itertools.product((1, -1), repeat=robot.n - 1):
        goal, l_b = path(robot, 2)[0][0], path(robot, 2)[1][0]
        history = robot.history()
        history.advance(goal - np.pi / 2 * np.cumsum([0, *signs]), l_b)
        reached = history.advance(goal, l_b)
        corner = robot.bound(goal, l_b).corners[[*itertools.product((1, -1), repeat=robot.n - 1)].index(signs)]
        assert np.linalg.norm(reached.shape.tip_m - corner.tip_m) < 0.05 * MM
        for sign, pair in zip(signs, reached.friction, strict=True):
            assert pair.force_N @ (1 - sign * pair.phi) < 0.02 * pair.force_N.sum()


def test_going_on_from_a_saved_state_gives_the_same_tips() -> None:
    theta_b, l_b = path(THREE, 3)
    history = THREE.history()
    history.follow(theta_b[:3], l_b[:3])
    state = history.save()
    first = history.follow(theta_b[3:], l_b[3:])
    other = THREE.history((1, -1))  # whatever it did before is gone
    other.follow(theta_b[:1] + 1, l_b[:1])
    for again in (history, other):
        again.restore(state)
        second = again.follow(theta_b[3:], l_b[3:])
        np.testing.assert_array_equal(second.position_m, first.position_m)
        np.testing.assert_array_equal(second.phi, first.phi)


def test_a_common_rotation_rotates_the_tips() -> None:
    theta_b, l_b = path(THREE, 4)
    turn = 0.8
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    one, other = THREE.history().follow(theta_b, l_b), THREE.history().follow(theta_b + turn, l_b)
    np.testing.assert_allclose(other.position_m, one.position_m @ R.T, atol=1e-6)
    np.testing.assert_allclose(other.tangent, one.tangent @ R.T, atol=1e-4)
    np.testing.assert_allclose(other.phi, one.phi, atol=1e-3)


def mirrored(robot: Robot) -> Robot:
    """In the x-z plane, in which curvature about x changes sign."""
    tubes = tuple(
        replace(
            tube,
            sections=tuple(TubeSection(s.length_m, -s.curvature_x_per_m, s.curvature_y_per_m) for s in tube.sections),
        )
        for tube in robot.tubes
    )
    return replace(robot, tubes=tubes)


@pytest.mark.parametrize("robot", ["pair", "three"], indirect=True)
def test_a_mirrored_path_mirrors_the_tips_and_turns_friction_round(robot: Robot) -> None:
    theta_b, l_b = path(robot, 5)
    one, other = robot.history().follow(theta_b, l_b), mirrored(robot).history().follow(-theta_b, l_b)
    np.testing.assert_allclose(other.position_m, one.position_m * [1, -1, 1], atol=1e-6)
    np.testing.assert_allclose(other.phi, -one.phi, atol=1e-3)


@pytest.mark.parametrize("robot", ["pair", "three"], indirect=True)
def test_the_energy_of_rotations_balances_and_no_contact_gains_any(robot: Robot) -> None:
    theta_b, l_b = path(robot, 6, legs=3)
    history = robot.history()
    history.advance(theta_b[0], l_b[0])
    rng, turned = np.random.default_rng(6), theta_b[0].copy()
    for _ in range(4):
        turned[1:] += rng.uniform(1, 3, robot.n - 1) * rng.choice([-1, 1], robot.n - 1)
        energy = history.advance(turned, l_b[0]).energy
        spent = energy.elastic_J + energy.breakaway_J + energy.loss_J
        assert abs(energy.work_J - spent) < 0.01 * max(abs(energy.work_J), abs(energy.elastic_J), energy.loss_J)
        assert energy.loss_J > 0
        assert energy.smallest_loss_J > -1e-15


@pytest.mark.parametrize("robot", ["pair", "three"], indirect=True)
def test_half_the_step_gives_the_same_tips(robot: Robot) -> None:
    for seed in range(2):
        theta_b, l_b = path(robot, 7 + seed, legs=3)
        one, other = robot.history().follow(theta_b, l_b), robot.history(options=HALVED).follow(theta_b, l_b)
        assert np.linalg.norm(one.position_m - other.position_m, axis=1).max() < 0.05 * MM


def test_friction_stays_within_coulombs_limit() -> None:
    theta_b, l_b = path(THREE, 10, legs=6)
    history = THREE.history()
    for waypoint in zip(theta_b, l_b, strict=True):
        for pair in history.advance(*waypoint).friction:
            assert np.all(np.hypot(pair.phi, pair.psi) <= 1 + 1e-9) and np.all(pair.force_N >= 0)
            assert np.all(np.abs(pair.phi) <= 1)


def test_slip_comes_from_the_base() -> None:
    """When the inner tube's base turns, friction turns round near the base first, and region by region outwards."""
    theta_b, l_b = np.radians([0.0, 120.0]), np.array([0.0, -0.0604])
    history = PAIR.history((-1,))
    history.advance(theta_b, l_b)
    turned_deg = np.full(3, np.nan)
    for turn_deg in range(1, 41, 2):
        (pair,) = history.advance(theta_b + [0, np.radians(turn_deg)], l_b).friction
        for k, (begin_m, end_m) in enumerate(((0, 0.04), (0.1, 0.14), (0.15, 0.168))):
            there = (pair.s_m > begin_m) & (pair.s_m < end_m)
            phi = pair.force_N[there] @ pair.phi[there] / pair.force_N[there].sum()
            if np.isnan(turned_deg[k]) and phi > 0:
                turned_deg[k] = turn_deg
    assert np.all(np.diff(turned_deg) > 2), turned_deg  # finite: all have turned round


def test_translation_releases_what_rotation_has_loaded() -> None:
    theta_b, l_b = np.radians([0.0, 60.0]), np.array([0.0, -0.0604])
    history = PAIR.history((1,))
    loaded_m = history.advance(theta_b, l_b).deviation_m
    assert history.advance(theta_b, l_b + [0, 10 * MM]).deviation_m < 0.1 * loaded_m


def test_tubes_that_are_locked_in_translation_keep_their_friction() -> None:
    """Tubes 1 and 2 of the robot move together: tube 3 releases its own pair alone."""
    theta_b, l_b = np.radians([0, 60, 100]), np.array([0, -0.017, -0.06])
    history = THREE.history((1, 1))
    history.advance(theta_b, l_b)
    locked, free = history.advance(theta_b, l_b - [0, 0, 10 * MM]).friction
    assert locked.force_N @ locked.phi > 0.2 * locked.force_N.sum()  # all but what less torsion takes away
    assert abs(free.force_N @ free.phi) < 0.05 * free.force_N.sum()
    assert np.all(np.abs(locked.psi) < 1e-9)


def test_an_oscillation_of_decreasing_amplitude_releases() -> None:
    """Section V-A: nearer to the frictionless solution than a tenth of the bound."""
    theta_b, l_b = np.radians([0.0, 100.0]), np.array([0.0, -0.0604])
    step = PAIR.history("oscillated").advance(theta_b, l_b)
    assert step.deviation_m < 0.1 * PAIR.bound(theta_b, l_b).position_m


def test_without_friction_there_is_no_history() -> None:
    slippery = load_robot(
        ROBOTS / "three_tube.toml", ["contact.1.friction_coefficient=0", "contact.2.friction_coefficient=0"]
    )
    theta_b, l_b = path(slippery, 11)
    found = slippery.history((1, -1)).follow(theta_b, l_b)
    free = slippery.bound_many(theta_b, l_b, threads=1)
    np.testing.assert_allclose(found.position_m, free.tip_m, atol=1e-6 * MM)


def test_waypoints_one_by_one_or_in_one_call_are_the_same() -> None:
    theta_b, l_b = path(PAIR, 12)
    together, history = PAIR.history().follow(theta_b, l_b), PAIR.history()
    for k, waypoint in enumerate(zip(theta_b, l_b, strict=True)):
        np.testing.assert_array_equal(history.advance(*waypoint).shape.tip_m, together.position_m[k])


def test_past_a_fold_the_robot_snaps_and_goes_on() -> None:
    """Opposed and retracted far enough, the tip can't follow a whole turn of the base without a jump."""
    turns = np.radians(np.arange(0, 361, 20.0))
    theta_b = np.column_stack([np.zeros_like(turns), np.zeros_like(turns), turns])
    l_b = np.tile([0.0, -0.017, -0.115], (len(turns), 1))
    found = THREE.history().follow(theta_b, l_b)
    assert np.all(found.status != Status.FAILED)
    assert found.snaps.sum() == 1
    jump_mm = np.linalg.norm(np.diff(found.position_m, axis=0), axis=1) / MM
    assert jump_mm.argmax() + 1 == found.snaps.argmax()


def test_tips_beside_are_the_corners_of_the_branch() -> None:
    theta_b, l_b = (rows[0] for rows in path(THREE, 13))
    history = THREE.history((1, -1))
    with pytest.raises(InputError, match="before its first advance"):
        history.tip_beside((0, 0))
    history.advance(theta_b, l_b)
    bound = THREE.bound(theta_b, l_b)
    np.testing.assert_allclose(history.tip_beside((0, 0)), bound.frictionless.tip_m, atol=1e-5 * MM)
    np.testing.assert_allclose(history.tip_beside((-1, 1)), bound.corners[2].tip_m, atol=1e-5 * MM)
    np.testing.assert_allclose(history.advance(theta_b, l_b).shape.tip_m, bound.corners[1].tip_m, atol=1e-5 * MM)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the memory of the process from Linux")
def test_shapes_do_not_drift_where_breaks_of_the_mesh_pass_each_other() -> None:
    """Without friction the shape depends on the joints alone, however often collars went through the front plate."""
    robot, rng = load_robot(ROBOTS / "three_tube_insertion.toml"), np.random.default_rng(0)
    home = np.array([-1.1, 2.1, 2.2, -0.8e-3, -43e-3])  # the outermost collar is just behind the plate
    history, frictionless = robot.history(), robot.solve(*robot.drive.collars(home)).tip_m
    history.advance(*robot.drive.collars(home))
    for _ in range(20):
        away = home + np.concatenate([rng.uniform(-0.2, 0.2, 3), rng.uniform(-8e-3, 8e-3, 2)])
        away = np.clip(away, robot.drive.lower, robot.drive.upper)
        history.follow(*robot.drive.collars(np.array([away, home])))
        np.testing.assert_allclose(history.tip_beside([0.0, 0.0]), frictionless, atol=1e-9)


def test_memory_does_not_grow_with_the_path() -> None:
    theta_b = np.radians([[0.0, 100.0 + 10 * (k % 2)] for k in range(12)])
    l_b = np.array([[0.0, -0.0604 - 1e-3 * (k % 2)] for k in range(12)])
    history = PAIR.history()
    memory_kB = []
    for _ in range(4):
        history.follow(theta_b, l_b)
        memory_kB.append(resident_kB())
    assert memory_kB[-1] - memory_kB[0] < 500


def resident_kB() -> int:
    """Resident memory of this process in kB, the core's memory included."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def test_a_state_goes_with_its_robot_and_accuracy() -> None:
    three, pair = THREE.history(), PAIR.history()
    three.advance([0, 1, 2], [0, -0.017, -0.07])
    pair.advance([0, 2], [0, -0.06])
    other = load_robot(ROBOTS / "table_5_pair.toml", ["contact.1.clearance_mm=0.06"]).history()
    for history, state in ((pair, three.save()), (three, pair.save()), (other, pair.save())):
        with pytest.raises(InputError, match="its own robot"):
            history.restore(state)
    with pytest.raises(InputError, match="its own robot"):
        PAIR.history(accuracy="certificate").restore(pair.save())
    with pytest.raises(InputError, match="History.save"):
        pair.restore(None)  # type: ignore[arg-type]


def test_joints_that_change_afterwards_change_no_step() -> None:
    """Such as an array that a loop writes into."""
    history, theta_b = PAIR.history(), np.zeros(2)
    steps = []
    for turn in (0.0, 0.5, 1.0):
        theta_b[1] = turn
        steps.append(history.advance(theta_b, [0, -0.06]).theta_b[1])
    saved = history.save()
    theta_b[1] = 9.0
    assert steps == [0.0, 0.5, 1.0]
    assert saved.theta_b[1] == 1.0


def test_threads_that_share_a_history_break_nothing() -> None:
    history = THREE.history()
    history.advance([0, 1, 2], [0, -0.017, -0.07])

    def turn(k: int) -> bool:
        step = history.advance([0, 1 + 0.3 * np.sin(k), 2 + 0.5 * np.cos(k)], [0, -0.017, -0.07 - 0.01 * (k % 3)])
        return bool(np.all(np.isfinite(step.shape.tip_m)))

    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(turn, range(60)))


@pytest.mark.parametrize(
    ("start", "words"), [("resting", "oscillated"), ((1, 1), "1 values"), ((2.0,), r"\[-1, 1\]"), ((), "1 values")]
)
def test_start_states_are_checked(start: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        PAIR.history(start)  # type: ignore[arg-type]


def test_a_history_refuses_what_does_not_nest() -> None:
    history = PAIR.history()
    with pytest.raises(InputError):
        history.advance([0, 0], [0, 0.02])
    with pytest.raises(InputError):
        history.follow([[0, 0], [0, 0]], [[0, -0.06], [0, 0.01]])
    with pytest.raises(InputError):
        PAIR.history(options=HistoryOptions(breakaway_m=0)).advance([0, 0], [0, -0.06])
