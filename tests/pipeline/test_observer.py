"""Laws of following a robot: what agrees with measured tips is kept, whatever the robot did before."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.history import HistoryPath
from ctrplan.robot.observer import Observer
from ctrplan.robot.observer_histories import start_states
from ctrplan.robot.robot import Robot
from ctrplan.robot.slow_states import SlowOffset, SlowParameter

PAIR, THREE = load_robot(ROBOTS / "table_5_pair.toml"), load_robot(ROBOTS / "three_tube.toml")
STARTS = {2: (0.4,), 3: (0.4, -0.7)}  # on no grid that a bank begins with
NOISE_M = 0.1e-3
HELD = 0.95


@pytest.fixture(params=["pair", "three"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return {"pair": PAIR, "three": THREE}[request.param]


def small_steps(robot: Robot, count: int = 40) -> tuple[Array, Array]:
    """Rotations to and fro and translations, too short to wipe out at once what was before."""
    phase, n = np.linspace(0, 2 * np.pi, count), robot.n
    theta = np.outer(1.0 + 0.12 * np.sin(phase), np.arange(n))
    l_b = np.tile([0.0, -0.06] if n == 2 else [0.0, -0.017, -0.06], (count, 1))
    l_b[:, -1] += 0.3e-3 * np.sin(3 * phase)
    return theta, l_b


def truth_of(robot: Robot) -> tuple[Array, Array, HistoryPath]:
    theta, l_b = small_steps(robot)
    return theta, l_b, robot.history(STARTS[robot.n]).follow(theta, l_b)


def test_with_perfect_measurements_the_interval_shrinks_and_holds_the_truth(robot: Robot) -> None:
    theta, l_b, truth = truth_of(robot)
    observer = robot.observer(NOISE_M)
    steps = [observer.observe(*row) for row in zip(theta, l_b, truth.position_m, strict=True)]
    width = np.array([np.max(step.tip.high_m - step.tip.low_m) for step in steps])
    before = np.max(steps[0].expected.high_m - steps[0].expected.low_m)
    held = [
        np.all((step.tip.low_m <= tip) & (tip <= step.tip.high_m))
        for step, tip in zip(steps, truth.position_m, strict=True)
    ]
    assert np.all(steps[0].expected.low_m <= truth.position_m[0])  # nothing is known, every corner is possible
    assert np.all(steps[0].expected.high_m >= truth.position_m[0])
    assert np.mean(held) >= HELD
    assert np.median(width[-10:]) < 0.15 * before
    assert np.median(width[-10:]) < 6 * NOISE_M


def test_the_friction_state_is_recovered(robot: Robot) -> None:
    theta, l_b, truth = truth_of(robot)
    observer = robot.observer(NOISE_M)
    for row in zip(theta, l_b, truth.position_m, truth.tangent, strict=True):
        last = observer.observe(*row)
    assert np.abs(last.friction - truth.phi[-1]).max() < 0.1
    assert np.linalg.norm(last.tip.position_m - truth.position_m[-1]) < NOISE_M


def test_one_step_ahead_the_observer_is_nearer_than_a_released_history(robot: Robot) -> None:
    theta, l_b, truth = truth_of(robot)
    seen = truth.position_m + NOISE_M * np.random.default_rng(1).standard_normal(truth.position_m.shape)
    observer, released = robot.observer(NOISE_M), robot.history().follow(theta, l_b).position_m
    ahead = np.array([observer.observe(*row).expected.position_m for row in zip(theta, l_b, seen, strict=True)])
    off, off_released = (np.linalg.norm(tips - truth.position_m, axis=1)[1:] for tips in (ahead, released))
    assert np.sqrt(np.mean(off**2)) < 0.3 * np.sqrt(np.mean(off_released**2))


def test_a_history_that_started_as_the_robot_did_is_followed_exactly() -> None:
    theta, l_b = small_steps(THREE)
    truth = THREE.history((1.0, -1.0)).follow(theta, l_b)
    observer = THREE.observer(NOISE_M)
    for row in zip(theta, l_b, truth.position_m, strict=True):
        last = observer.observe(*row)
    np.testing.assert_allclose(last.tip.position_m, truth.position_m[-1], atol=1e-7)
    np.testing.assert_allclose(last.friction, truth.phi[-1], atol=1e-6)


def test_predict_changes_nothing_and_says_what_the_step_finds() -> None:
    theta, l_b, truth = truth_of(THREE)
    asked, other = THREE.observer(NOISE_M), THREE.observer(NOISE_M)
    for k in range(6):
        asked.observe(theta[k], l_b[k], truth.position_m[k])
        other.observe(theta[k], l_b[k], truth.position_m[k])
        along = asked.predict(theta[k : k + 3] + 0.2, l_b[k : k + 3])
        assert along.position_m.shape == along.low_m.shape == (3, 3)
        ahead = asked.predict(theta[k + 1], l_b[k + 1])
    a, b = (one.observe(theta[6], l_b[6], truth.position_m[6]) for one in (asked, other))
    for name in ("position_m", "low_m", "high_m", "tangent"):
        np.testing.assert_array_equal(getattr(a.tip, name), getattr(b.tip, name))
        np.testing.assert_allclose(getattr(a.expected, name), getattr(ahead, name), atol=1e-12)


def test_a_slow_offset_is_told_from_friction() -> None:
    theta, l_b, truth = truth_of(PAIR)
    shift = np.array([0.8e-3, -0.5e-3, 0.3e-3])
    rng = np.random.default_rng(2)
    seen = truth.position_m + shift + NOISE_M * rng.standard_normal(truth.position_m.shape)
    observer = PAIR.observer(NOISE_M, offset=SlowOffset(1e-3))
    for row in zip(theta, l_b, seen, strict=True):
        last = observer.observe(*row)
    assert np.linalg.norm(observer.state().offset_m - shift) < 0.4 * np.linalg.norm(shift)
    assert np.linalg.norm(last.tip.position_m - truth.position_m[-1] - shift) < 2 * NOISE_M


@pytest.mark.parametrize("first", [0, 15])
def test_one_tip_that_is_far_off_is_told_and_not_followed(robot: Robot, first: int) -> None:
    """Once an observer was 18 mm wide for 30 steps, and 2.5 times as far off, after one tip 50 mm beside the others."""
    theta, l_b, truth = truth_of(robot)
    seen = truth.position_m + NOISE_M * np.random.default_rng(2).standard_normal(truth.position_m.shape)
    bad = seen.copy()
    bad[first] += (0.03, -0.02, 0.035)
    widths = []
    for tips in (seen, bad):
        observer = robot.observer(NOISE_M)
        steps = [observer.observe(*row) for row in zip(theta, l_b, tips, strict=True)]
        assert [k for k, step in enumerate(steps) if step.set_aside] == ([first] if tips is bad else [])
        off = np.array([step.tip.position_m for step in steps]) - truth.position_m
        widths.append(np.array([np.max(step.tip.high_m - step.tip.low_m) for step in steps]))
        assert np.linalg.norm(off[first + 8 :], axis=1).max() < 10 * NOISE_M
    assert np.all(widths[1][first + 8 :] < 1.5 * widths[0][first + 8 :].max())


def test_tips_that_stay_far_off_are_believed_from_the_second_on() -> None:
    """A tracker that was moved, or a robot that is another: what is said of it must not stay sure of itself."""
    theta, l_b, truth = truth_of(PAIR)
    observer, moved = PAIR.observer(NOISE_M), np.where(np.arange(len(theta)) < 10, 0.0, 0.05)[:, None] * [1.0, 0, 0]
    steps = [observer.observe(*row) for row in zip(theta, l_b, truth.position_m + moved, strict=True)]
    assert [k for k, step in enumerate(steps) if step.set_aside] == [10]
    assert steps[9].unexplained_m < 1e-3 and steps[12].unexplained_m > 5e-3


def test_the_same_seed_gives_the_same_answers() -> None:
    theta, l_b, truth = truth_of(THREE)

    def tips(seed: int) -> Array:
        observer = THREE.observer(0.02e-3, seed=seed)  # noise below what the bank can tell: others are tried
        rows = zip(theta[:10], l_b[:10], truth.position_m[:10], strict=True)
        return np.array([observer.observe(*row).tip.position_m for row in rows])

    np.testing.assert_array_equal(tips(3), tips(3))
    assert not np.array_equal(tips(3), tips(4))


def test_threads_change_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    theta, l_b, truth = truth_of(THREE)
    slow = [SlowParameter("contact.1.friction_coefficient", 0.1)]
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("CTRPLAN_THREADS", threads)
        observer = THREE.observer(NOISE_M, slow=slow)
        rows = zip(theta[:8], l_b[:8], truth.position_m, strict=False)
        steps = [observer.observe(*row) for row in rows]
        ahead = observer.predict(theta[8:11], l_b[8:11])
        found.append(np.concatenate([ahead.position_m.ravel(), *(np.r_[s.tip.low_m, s.friction] for s in steps)]))
    np.testing.assert_array_equal(found[0], found[1])


def test_without_measurements_nothing_is_ruled_out() -> None:
    theta, l_b = small_steps(PAIR, 3)
    observer = PAIR.observer(NOISE_M)
    for row in zip(theta, l_b, strict=True):
        step = observer.observe(*row)
        np.testing.assert_array_equal(step.tip.position_m, step.expected.position_m)
    corners = [PAIR.history((sign,)).follow(theta, l_b).position_m[-1] for sign in (1.0, -1.0)]
    for tip in corners:
        assert np.all((step.tip.low_m <= tip + 1e-9) & (tip - 1e-9 <= step.tip.high_m))


@pytest.mark.parametrize("pairs", [0, 1, 2, 3, 6])
def test_a_bank_begins_with_every_corner(pairs: int) -> None:
    states = start_states(pairs, 9, np.random.default_rng(0))
    assert len({tuple(state) for state in states}) == len(states) >= min(9, 3**pairs)
    assert any(not state.any() for state in states) and all(np.all(np.abs(state) <= 1) for state in states)
    if 0 < pairs < 6:
        assert sum(bool(np.all(np.abs(state) == 1)) for state in states) == 2**pairs


@pytest.mark.parametrize("noise", [0.0, -1e-3, np.nan, "0.1"])
def test_noise_is_above_zero(noise: float) -> None:
    with pytest.raises(InputError, match="position_sigma_m = .*: must be a number from"):
        PAIR.observer(noise)


GOOD = ([0.0, 1.0], [0.0, -0.06], [0.0, 0.0, 0.1], [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("argument", "value", "sentence"),
    [
        (0, [0.0, 1.0, 2.0], r"must have shape \(2,\)"),
        (1, [0.0, np.nan], "finite"),
        (1, [0.0, 0.01], "tube"),
        (2, [0.0, 0.1], "position_m: must be three finite numbers"),
        (2, [0.0, np.nan, 0.1], "position_m: must be three finite numbers"),
        (2, None, "tangent: needs a position"),
        (3, [0.0, 0.0, 9.0], "tangent: must be a unit vector"),
    ],
)
def test_bad_input_is_refused_before_anything_moves(argument: int, value: object, sentence: str) -> None:
    observer, other = PAIR.observer(NOISE_M), PAIR.observer(NOISE_M)
    before = [one.observe(*GOOD) for one in (observer, other)]
    wrong = list(GOOD)
    wrong[argument] = value  # type: ignore[call-overload]
    with pytest.raises(InputError, match=sentence) as refusal:
        observer.observe(*wrong)
    assert str(refusal.value).count("\n") == 0
    after = [one.observe([0.0, 1.1], *GOOD[1:]) for one in (observer, other)]
    np.testing.assert_array_equal(after[0].tip.position_m, after[1].tip.position_m)
    assert before[0].histories == before[1].histories


@pytest.mark.parametrize("ask", [Observer.state, lambda observer: observer.predict(*GOOD[:2])])
def test_before_the_first_step_nothing_is_known(ask) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="knows nothing before its first step"):
        ask(PAIR.observer(NOISE_M))


def test_noise_must_come_from_somewhere() -> None:
    assert PAIR.measurement is None
    with pytest.raises(InputError, match=r"noise: must be given, the robot's file has no \[measurement\]"):
        PAIR.observer()


def test_walker_history_and_observer_take_collars_by_the_same_names() -> None:
    """Whoever moves a robot on is told where its collars are: effects of the drive are in `Robot.collars` alone."""
    from inspect import signature

    robot = load_robot(ROBOTS / "table_1_pair.toml", ["effects.homing_offset={theta_2_deg=20}"])
    walker, history, observer = robot.walker(), robot.history(), robot.observer(NOISE_M)
    for moved in (walker.bound, history.advance, observer.observe, observer.predict, robot.bound, robot.solve):
        assert list(signature(moved).parameters)[:2] == ["theta_b", "l_b"]
    theta_b, l_b = robot.collars([0.0, 1.0], robot.drive.home_l_m)
    assert theta_b[1] == pytest.approx(1 + np.radians(20))
    tip = robot.solve(theta_b, l_b).tip_m
    seen = observer.observe(theta_b, l_b)
    np.testing.assert_allclose(walker.bound(theta_b, l_b).tip_m, tip, atol=1e-6)
    np.testing.assert_allclose(history.advance(theta_b, l_b).shape.tip_m, tip, atol=1e-6)
    reach = robot.bound(theta_b, l_b).position_m
    assert np.linalg.norm(seen.tip.position_m - tip) <= reach + 1e-6
    other = np.linalg.norm(robot.solve([0.0, 1.0], l_b).tip_m - tip)
    assert other > 2 * reach


def test_what_no_tip_can_be_is_refused_before_anything_moves() -> None:
    theta, l_b, truth = truth_of(PAIR)
    observer, other = PAIR.observer(NOISE_M), PAIR.observer(NOISE_M)
    for each in (observer, other):
        each.observe(theta[0], l_b[0], truth.position_m[0])
    with pytest.raises(InputError, match="position_m.* are these millimetres?"):
        observer.observe(theta[1], l_b[1], 1e3 * truth.position_m[1])
    with pytest.raises(InputError, match="must have a row to predict"):
        observer.predict(np.zeros((0, 2)), np.zeros((0, 2)))
    with pytest.raises(InputError, match="must be a list of SlowParameter"):
        PAIR.observer(NOISE_M, slow=SlowParameter("theta_b.1", sigma=0.1))  # type: ignore[arg-type]
    here, there = (each.observe(theta[1], l_b[1], truth.position_m[1]).tip for each in (observer, other))
    np.testing.assert_array_equal(here.position_m, there.position_m)
    np.testing.assert_array_equal(here.high_m, there.high_m)
