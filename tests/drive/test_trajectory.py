"""Laws of time-parameterised trajectories: on the line, within every limit, time-optimal there, at rest at corners."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ctrplan.drive.trajectory
from ctrplan.drive.drive import Drive, Joint
from ctrplan.drive.legs import distance_from_leg, merge_legs
from ctrplan.drive.trajectory import Trajectory, distance_from_legs, time_parameterise, verify_limits
from ctrplan.errors import InputError, SolverError

FloatArray = NDArray[np.float64]

ruckig: Any = ctrplan.drive.trajectory.ruckig  # type: ignore[attr-defined]  # only ctrplan.drive.trajectory imports it

ROTATION = Joint("rotate inner", "rotation", np.array([0.0, 1.0]), -math.inf, math.inf, 1.0, 4.0, 40.0)
TRANSLATION = Joint("insert inner", "translation", np.array([0.0, 1.0]), -0.1, 0.1, 0.01, 0.05, 0.4)


def drive_of(*joints: Joint) -> Drive:
    return Drive(joints=joints, home_theta_rad=np.zeros(2), home_l_m=np.zeros(2))


PAIR = drive_of(ROTATION, TRANSLATION)


def random_drive(rng: np.random.Generator) -> Drive:
    """One to six joints, limits that bind in any combination."""
    joints = []
    for i in range(rng.integers(1, 7)):
        base = ROTATION if rng.random() < 0.5 else TRANSLATION
        velocity = base.max_velocity * rng.uniform(0.5, 2)
        acceleration = velocity * 10 ** rng.uniform(-0.5, 1.5)
        jerk = acceleration * 10 ** rng.uniform(-0.5, 2)
        limits: dict[str, Any] = {"max_velocity": velocity, "max_acceleration": acceleration, "max_jerk": jerk}
        joints.append(replace(base, name=f"joint {i}", **limits))
    return drive_of(*joints)


def random_waypoints(rng: np.random.Generator, drive: Drive, count: int) -> FloatArray:
    reach = np.where(drive.is_rotation, 4 * np.pi, 0.1) * 10 ** rng.uniform(-3, 0)
    return rng.uniform(-reach, reach, (count, len(drive.names)))


def straight_line_optimum(delta: FloatArray, drive: Drive) -> float:
    """Duration of the shortest rest-to-rest motion along delta: closed form of the seven-phase profile."""
    limits = np.array([drive.max_velocity, drive.max_acceleration, drive.max_jerk])
    v, a, j = (limits[:, delta != 0] / np.abs(delta[delta != 0])).min(axis=1)
    peak = min(a, math.sqrt(v * j))
    if v * (v / peak + peak / j) <= 1:
        return float(1 / v + v / peak + peak / j)
    speed = (math.sqrt((a / j) ** 2 + 4 / a) - a / j) * a / 2
    if speed * j >= a * a:
        return float(2 * (speed / a + a / j))
    return float(4 * (1 / (2 * j)) ** (1 / 3))


def test_limits_line_and_optimum_on_random_legs() -> None:
    rng = np.random.default_rng(1)
    for _ in range(2000):
        drive = random_drive(rng)
        start, end = random_waypoints(rng, drive, 2)
        trajectory = time_parameterise([start, end], drive, period_s=rng.uniform(0.002, 0.05))
        ratios = [ratio for joint in verify_limits(trajectory, drive).values() for ratio in joint.values()]
        assert max(ratios) <= 1 + 1e-12
        assert distance_from_leg(trajectory.position, start, end).max() <= 1e-12
        assert trajectory.duration_s == pytest.approx(straight_line_optimum(end - start, drive), rel=1e-12)


def test_some_limit_is_reached_at_every_leg() -> None:
    """Jerk or what it integrates to is at its limit throughout a time optimum; jerk is where the leg starts."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        drive = random_drive(rng)
        trajectory = time_parameterise(random_waypoints(rng, drive, 2), drive)
        assert np.max(np.abs(trajectory.jerk[0]) / drive.max_jerk) == pytest.approx(1, abs=1e-12)


def test_phase_synchronisation_agrees_where_it_stays_on_the_line() -> None:
    rng = np.random.default_rng(3)
    agreed = 0
    for _ in range(300):
        drive = random_drive(rng)
        start, end = random_waypoints(rng, drive, 2)
        request, answer = ruckig.InputParameter(len(start)), ruckig.Trajectory(len(start))
        request.current_position, request.target_position = start.tolist(), end.tolist()
        request.max_velocity, request.max_acceleration = drive.max_velocity.tolist(), drive.max_acceleration.tolist()
        request.max_jerk, request.synchronization = drive.max_jerk.tolist(), ruckig.Synchronization.Phase
        assert ruckig.Ruckig(len(start)).calculate(request, answer) == ruckig.Result.Working
        trajectory = time_parameterise([start, end], drive)
        samples = np.array([answer.at_time(t)[:2] for t in trajectory.time_s])  # (T, 2, m)
        if distance_from_leg(samples[:, 0], start, end).max() > 1e-12 * np.linalg.norm(end - start):
            continue  # it fell back to Time synchronisation: may be shorter, but is not straight
        agreed += 1
        assert trajectory.duration_s == pytest.approx(answer.duration, rel=1e-12)
        np.testing.assert_allclose(trajectory.position, samples[:, 0], atol=1e-11)
        np.testing.assert_allclose(trajectory.velocity, samples[:, 1], atol=1e-11)
    assert agreed > 100


def test_derivatives_are_those_of_the_positions() -> None:
    """Central differences of a smooth phase: exact for a cubic but for the jerk, so they converge with order 2."""
    waypoints = [[0.0, 0.0], [2.0, 0.01], [1.0, 0.03]]
    names = ("position", "velocity", "acceleration", "jerk")
    for lower, higher in pairwise(names):
        errors = []
        for period_s in (4e-3, 2e-3):
            trajectory = time_parameterise(waypoints, PAIR, period_s)
            values, slopes = getattr(trajectory, lower)[:-1], getattr(trajectory, higher)[:-1]
            jerk = trajectory.jerk[:-1]
            smooth = np.all((jerk[:-2] == jerk[1:-1]) & (jerk[1:-1] == jerk[2:]), axis=1)
            assert smooth.sum() > 100
            difference = (values[2:] - values[:-2]) / (2 * period_s)
            errors.append(np.abs(difference - slopes[1:-1])[smooth].max())
        if lower == "position":  # third derivative: period_s^2 / 6 * jerk
            assert errors[1] == pytest.approx(errors[0] / 4, rel=1e-3)
        else:
            assert max(errors) < 1e-9


def test_duration_is_monotone_in_limits() -> None:
    rng = np.random.default_rng(4)
    for _ in range(300):
        drive = random_drive(rng)
        waypoints = random_waypoints(rng, drive, 4)
        quantity = rng.choice(["max_velocity", "max_acceleration", "max_jerk"])
        i = rng.integers(len(drive.joints))
        limit = {quantity: getattr(drive.joints[i], quantity) * rng.uniform(1, 3)}
        faster = replace(drive.joints[i], **limit)
        stronger = drive_of(*drive.joints[:i], faster, *drive.joints[i + 1 :])
        before, after = (time_parameterise(waypoints, d).duration_s for d in (drive, stronger))
        assert after <= before * (1 + 1e-12)


def test_motion_back_is_the_motion_forth_in_reverse() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        drive = random_drive(rng)
        ends = random_waypoints(rng, drive, 2)
        duration_s = time_parameterise(ends, drive).duration_s
        period_s = duration_s / rng.integers(10, 200)  # a grid that is its own mirror image
        forth, back = time_parameterise(ends, drive, period_s), time_parameterise(ends[::-1], drive, period_s)
        np.testing.assert_allclose(forth.position, back.position[::-1], atol=1e-11)
        np.testing.assert_allclose(forth.velocity, -back.velocity[::-1], atol=1e-10)
        np.testing.assert_allclose(forth.velocity, forth.velocity[::-1], atol=1e-10)  # and it is its own mirror image


def test_scaling_laws() -> None:
    """Farther is never shorter, never more than proportionally longer; all scales together change nothing."""
    rng = np.random.default_rng(6)
    for _ in range(300):
        drive = random_drive(rng)
        ends = random_waypoints(rng, drive, 2) / 2
        once, twice = (time_parameterise(k * ends, drive).duration_s for k in (1, 2))
        assert once * (1 - 1e-12) <= twice <= 2 * once * (1 + 1e-12)
        slow = {"max_velocity": 1 / 2, "max_acceleration": 1 / 4, "max_jerk": 1 / 8}
        slowed = [replace(joint, **{k: getattr(joint, k) * f for k, f in slow.items()}) for joint in drive.joints]
        assert time_parameterise(ends, drive_of(*slowed)).duration_s == pytest.approx(2 * once, rel=1e-12)


def test_collinear_joins_are_passed_at_speed() -> None:
    start, end = np.array([0.3, -0.02]), np.array([7.3, 0.05])
    single = time_parameterise([start, end], PAIR)
    for fractions in ([0, 0.2, 1], [0, 0, 1e-7, 0.5, 0.5, 0.75, 1, 1], np.linspace(0, 1, 500)):
        divided = time_parameterise([start + f * (end - start) for f in fractions], PAIR)
        assert divided.duration_s == pytest.approx(single.duration_s, rel=1e-12)
        assert (divided.stops, len(divided.leg_end_s)) == (0, 1)
        inner = slice(1, -1)
        assert np.abs(divided.velocity[inner]).max(axis=1).min() > 0


def test_corners_are_stops() -> None:
    waypoints = np.array([[0, 0], [2, 0], [2, 0.03], [-1, 0.03], [3, 0.03]], dtype=float)
    legs = [time_parameterise(pair, PAIR).duration_s for pair in pairwise(waypoints)]
    for period_s in (0.01, 0.0037):
        trajectory = time_parameterise(waypoints, PAIR, period_s)
        assert trajectory.stops == 3
        np.testing.assert_allclose(trajectory.leg_end_s, np.cumsum(legs), rtol=1e-14)
        for stop_s, corner in zip(trajectory.leg_end_s, waypoints[1:], strict=True):
            nearest = np.argmin(np.abs(trajectory.time_s - stop_s))
            away_s = abs(trajectory.time_s[nearest] - stop_s)
            limit = np.array([ROTATION.max_jerk, TRANSLATION.max_jerk])
            assert np.all(np.abs(trajectory.velocity[nearest]) <= limit * away_s**2 / 2 + 1e-15)
            assert np.all(np.abs(trajectory.position[nearest] - corner) <= limit * away_s**3 / 6 + 1e-15)


def test_velocity_is_exactly_zero_at_a_sampled_stop() -> None:
    """With period_s = duration / N of the first of two mirror-image legs, the stop is a sample."""
    period_s = time_parameterise([[0, 0], [1, 0]], PAIR).duration_s / 64
    trajectory = time_parameterise([[0, 0], [1, 0], [0, 0]], PAIR, period_s)
    assert trajectory.time_s[64] == trajectory.leg_end_s[0]
    assert not trajectory.velocity[[0, 64, 128]].any()
    np.testing.assert_array_equal(trajectory.position[[0, 64, 128], 0], [0, 1, 0])


def test_grid_is_uniform_and_ends_with_the_motion() -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        waypoints = random_waypoints(rng, PAIR, 3)
        period_s = 10 ** rng.uniform(-2.5, 0.5)
        trajectory = time_parameterise(waypoints, PAIR, period_s)
        np.testing.assert_array_equal(trajectory.time_s[:-1], np.arange(len(trajectory.time_s) - 1) * period_s)
        assert trajectory.time_s[-1] == trajectory.leg_end_s[-1] == trajectory.duration_s
        if trajectory.duration_s > period_s / 2:
            assert 0.5 - 1e-9 <= (trajectory.time_s[-1] - trajectory.time_s[-2]) / period_s <= 1.5 + 1e-9
        np.testing.assert_array_equal(trajectory.position[[0, -1]], waypoints[[0, -1]])
        for values in (trajectory.velocity, trajectory.acceleration, trajectory.jerk):
            assert not values[-1].any()
        assert not trajectory.velocity[0].any() and not trajectory.acceleration[0].any()


def test_windings_are_kept() -> None:
    trajectory = time_parameterise([[-3 * np.pi, 0], [40 * np.pi, 0]], PAIR)
    assert np.all(np.diff(trajectory.position[:, 0]) > 0)
    assert trajectory.position[-1, 0] == 40 * np.pi


@pytest.mark.parametrize("waypoints", [[[0.5, 0.01]], [[0.5, 0.01]] * 3, [[0.5, 0.01], [0.5, 0.01 + 1e-14]]])
def test_no_motion_is_one_sample_at_rest(waypoints: list[list[float]]) -> None:
    trajectory = time_parameterise(waypoints, PAIR)
    assert (trajectory.duration_s, trajectory.stops, len(trajectory.leg_end_s)) == (0, 0, 0)
    np.testing.assert_array_equal(trajectory.position, [[0.5, 0.01]])
    np.testing.assert_array_equal(trajectory.time_s, [0])
    assert distance_from_legs(trajectory, np.array([[0.5, 0.01]])) == 0


def test_merged_legs_pass_every_waypoint() -> None:
    rng = np.random.default_rng(8)
    for _ in range(300):
        corners = rng.uniform(-1, 1, (rng.integers(2, 6), 3)) * [10, 10, 0.1]
        dense = [corners[:1]]
        for a, b in pairwise(corners):
            fractions = np.unique(rng.random(rng.integers(0, 30)))
            dense += [a + fractions[:, None] * (b - a), b[None]]
        np.testing.assert_array_equal(merge_legs(np.concatenate(dense)), corners)


def test_a_fine_curve_is_not_straightened() -> None:
    """Not even where each waypoint, taken alone, is within the tolerance of the leg that would pass it."""
    for count, turn in ((2000, 1.0), (5000, 1e-5), (5000, 1e-7)):
        angle = np.linspace(0, turn, count)
        arc = np.column_stack([np.sin(angle), 2 * np.sin(angle / 2) ** 2]) / turn
        corners = merge_legs(arc)
        where = [int(np.flatnonzero((arc == corner).all(axis=1))[0]) for corner in corners]
        for i, k in pairwise(where):
            assert distance_from_leg(arc[i : k + 1], arc[i], arc[k]).max() <= 1.1e-9 * np.linalg.norm(arc[k] - arc[i])


@pytest.mark.parametrize(("offset", "legs"), [(0.9e-9, 1), (1.1e-9, 2)])
@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_merging_has_a_relative_tolerance(length: float, offset: float, legs: int) -> None:
    points = length * np.array([[0, 0], [0.3, offset], [1, 0]])
    assert len(merge_legs(points)) == legs + 1


@pytest.mark.parametrize("back", [1e-11, 0.5, 1.0, 2.0])
def test_a_reversal_is_a_corner_however_short(back: float) -> None:
    points = np.array([[0.0], [1.0], [1.0 - back], [3.0]])
    np.testing.assert_array_equal(merge_legs(points), points)


def test_long_fine_runs_far_from_zero_are_one_leg() -> None:
    points = np.array([100.0, -70.0]) + np.linspace(0, 0.01, 20_000)[:, None] * [1.0, 0.3]
    assert len(merge_legs(points)) == 2


@pytest.mark.parametrize(
    ("waypoints", "words"),
    [
        ([], ["waypoints", "(K, 2)", "rotate inner, insert inner"]),
        ([[], []], ["waypoints", "(2, 0)"]),
        ([[0.0, 0.0, 0.0]], ["waypoints", "(1, 3)", "(K, 2)"]),
        ([0.0, 0.0], ["waypoints", "(2,)"]),
        ([[0.0, 0.0], [0.0]], ["waypoints", "same count"]),
        ([["a", 0.0]], ["waypoints", "numbers"]),
        ([[0, 0], [math.nan, 0]], ["waypoint.2.rotate inner = nan rad", "finite"]),
        ([[0, math.inf]], ["waypoint.1.insert inner = inf m", "finite"]),
        ([[0, 0], [9, 0.11]], ["waypoint.2.insert inner = 0.11 m", "between -0.1 and 0.1 m"]),
        ([[0, 0], [9, -0.11]], ["waypoint.2.insert inner = -0.11 m", "between -0.1 and 0.1 m"]),
    ],
)
def test_bad_waypoints_are_named(waypoints: list[list[float]], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        time_parameterise(waypoints, PAIR)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_rounding_over_a_limit_is_no_fault() -> None:
    trajectory = time_parameterise([[0.0, -0.1 - 1e-15], [1.0, 0.1 + 1e-15]], PAIR)
    assert trajectory.stops == 0


@pytest.mark.parametrize("period_s", [0, -0.01, math.nan, math.inf, 1e-9])
def test_useless_periods_are_refused(period_s: float) -> None:
    with pytest.raises(InputError, match=r"period_s = .* s: .*\."):
        time_parameterise([[0, 0], [1, 0]], PAIR, period_s)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("quantity", ["max_velocity", "max_acceleration", "max_jerk"])
def test_useless_limits_are_refused(quantity: str, value: float) -> None:
    limit: dict[str, Any] = {quantity: value}
    with pytest.raises(InputError, match=f"joint.2.{quantity} = .* m/s.*: must be a positive, finite number"):
        time_parameterise([[0, 0], [1, 0]], drive_of(ROTATION, replace(TRANSLATION, **limit)))


@pytest.mark.parametrize("quantity", ["velocity", "acceleration", "jerk"])
def test_exceeded_limits_are_found(quantity: str) -> None:
    trajectory = time_parameterise([[0.0, 0.0], [1.0, 0.02]], PAIR)
    limit: dict[str, Any] = {f"max_{quantity}": getattr(TRANSLATION, f"max_{quantity}") / 1.5}
    weaker = drive_of(ROTATION, replace(TRANSLATION, **limit))
    with pytest.raises(SolverError, match=f"'insert inner' reaches .* times its {quantity} limit of .* m/s"):
        verify_limits(replace(trajectory, **{quantity: getattr(trajectory, quantity) * [1, 2]}), weaker)


def test_positions_out_of_range_are_found() -> None:
    trajectory = time_parameterise([[0.0, 0.0], [1.0, 0.02]], PAIR)
    with pytest.raises(SolverError, match="'insert inner' is at .* must lie between"):
        verify_limits(trajectory, drive_of(ROTATION, replace(TRANSLATION, upper=0.015)))


def test_nan_in_a_trajectory_is_found() -> None:
    trajectory = time_parameterise([[0.0, 0.0], [1.0, 0.02]], PAIR)
    with pytest.raises(SolverError, match="nan times"):
        verify_limits(replace(trajectory, velocity=trajectory.velocity * np.nan), PAIR)


@pytest.mark.parametrize("kind", [ruckig.RuckigError, ValueError])  # ValueError: what its enum makes of some results
def test_ruckigs_errors_become_ours(monkeypatch: pytest.MonkeyPatch, kind: type[Exception]) -> None:

    class Failing:
        def __init__(self, dofs: int) -> None:
            pass

        def calculate(self, request: object, answer: object) -> object:
            raise kind("\n[ruckig] error in step 1")

    monkeypatch.setattr(ruckig, "Ruckig", Failing)
    with pytest.raises(SolverError, match=r"^ruckig found no profile for a leg: \[ruckig\] error in step 1\.$"):
        time_parameterise([[0, 0], [1, 0]], PAIR)


def test_a_result_that_is_no_success_is_not_taken_for_one(monkeypatch: pytest.MonkeyPatch) -> None:

    class Refusing:
        def __init__(self, dofs: int) -> None:
            pass

        def calculate(self, request: object, answer: object) -> object:
            return ruckig.Result.ErrorInvalidInput

    monkeypatch.setattr(ruckig, "Ruckig", Refusing)
    with pytest.raises(SolverError, match="ErrorInvalidInput"):
        time_parameterise([[0, 0], [1, 0]], PAIR)


def test_leaving_the_line_is_found() -> None:
    waypoints = np.array([[0, 0], [1, 0.02], [0, 0.02]])
    trajectory = time_parameterise(waypoints, PAIR)
    bent = trajectory.position.copy()
    bent[40, 1] += 1e-6
    moved: Trajectory = replace(trajectory, position=bent)
    assert distance_from_legs(moved, waypoints) == pytest.approx(1e-6, rel=1e-2)


def test_profiles_are_checked_between_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where no sample would see it: the period is longer than the motion."""
    profile = ctrplan.drive.trajectory._ruckig_profile
    monkeypatch.setattr(ctrplan.drive.trajectory, "_ruckig_profile", lambda limits: profile(1.01 * limits))
    with pytest.raises(SolverError, match="misses its end or its limits"):
        time_parameterise([[0, 0], [1, 0]], PAIR, period_s=100)


@pytest.mark.parametrize(("quantity", "rule"), [(0, "leaves its straight"), (1, "velocity limit"), (3, "jerk limit")])
def test_trajectories_are_checked(monkeypatch: pytest.MonkeyPatch, quantity: int, rule: str) -> None:
    sample = ctrplan.drive.trajectory._sample

    def wrong(*arguments: Any) -> FloatArray:
        motion = sample(*arguments)
        motion[quantity, 50, 1] += [1e-9, 0.011, 0, 0.41][quantity]
        return motion

    monkeypatch.setattr(ctrplan.drive.trajectory, "_sample", wrong)
    with pytest.raises(SolverError, match=rule):
        time_parameterise([[0.0, 0.0], [3.0, 0.02]], PAIR)


def joined(trajectory: Trajectory, order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Largest speed, acceleration and jerk (m,) of the pieces by which a controller joins samples: 3 or 5."""
    worst = [np.zeros(trajectory.position.shape[1]) for _ in range(3)]
    h = np.diff(trajectory.time_s)
    for k, step in enumerate(h.tolist()):
        ends = [(trajectory.position[i], trajectory.velocity[i], trajectory.acceleration[i]) for i in (k, k + 1)]
        given = [x for end in ends for x in end[: 2 if order == 3 else 3]]
        rows = [
            [math.perm(n, d) * t ** (n - d) if n >= d else 0.0 for n in range(order + 1)]
            for t in (0.0, 1.0)
            for d in range(2 if order == 3 else 3)
        ]
        scaled = [x * step ** (i % (len(given) // 2)) for i, x in enumerate(given)]
        c = np.linalg.solve(np.array(rows), np.array(scaled))
        t = np.linspace(0, 1, 21)
        for d in range(1, 4):
            powers = np.array(
                [[math.perm(n, d) * x ** (n - d) if n >= d else 0.0 for n in range(order + 1)] for x in t]
            )
            worst[d - 1] = np.maximum(worst[d - 1], np.abs(powers @ c).max(axis=0) / step**d)
    return worst[0], worst[1], worst[2]


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("seed", range(4))
def test_samples_of_a_joinable_motion_may_be_joined_by_polynomials(order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    drive = random_drive(rng) if seed else PAIR
    waypoints = random_waypoints(rng, drive, 4) if seed else np.array([[0, 0], [1, 0.05], [0.2, 0.1]])
    trajectory = time_parameterise(waypoints, drive, joinable=True)
    limits = drive.max_velocity, drive.max_acceleration, drive.max_jerk
    for worst, limit in zip(joined(trajectory, order), limits, strict=True):
        assert (worst <= limit * (1 + 1e-5)).all()


def test_without_it_quintics_leave_the_limit_of_jerk() -> None:
    """Why plans are joinable."""
    trajectory = time_parameterise([[0, 0], [1, 0.05], [0.2, 0.1]], PAIR)
    assert (joined(trajectory, 5)[2] / PAIR.max_jerk).max() > 1.1


def test_a_joinable_motion_is_little_longer_and_as_good() -> None:
    rng = np.random.default_rng(5)
    for _ in range(40):
        drive = random_drive(rng)
        waypoints = random_waypoints(rng, drive, 3)
        shortest = time_parameterise(waypoints, drive)
        made = time_parameterise(waypoints, drive, joinable=True)
        legs = len(made.leg_end_s)
        assert shortest.duration_s - 1e-9 <= made.duration_s <= shortest.duration_s + 7 * 0.01 * legs + 1e-9
        verify_limits(made, drive)
        np.testing.assert_allclose(made.leg_end_s / 0.01, np.round(made.leg_end_s / 0.01), atol=1e-6)
        np.testing.assert_array_equal(made.position[-1], shortest.position[-1])
        at_rest = np.round(made.leg_end_s[:-1] / 0.01).astype(int)
        assert np.abs(made.velocity[at_rest]).max(initial=0.0) < 1e-9
