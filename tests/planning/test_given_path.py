"""`ctrplan.certify`: a path as it is, if it is the scenario's; what is not is one sentence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from stated_plans import in_si, scene_of, sphere, table_ii

import ctrplan
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.errors import InputError
from ctrplan.scenario.scenario import Goal, Scenario

START, GOAL = [0, 0, 0, -60], [0, 6, 9, -58]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return scene_of(table_ii(), START, GOAL, sphere([60, -40, 150], 5))


@pytest.fixture(scope="module")
def way(scenario: Scenario) -> Any:
    """(4, m) with a detour that an improved path would not have."""
    return in_si(scenario.robot, [START, [0, 6, 0, -60], [0, 6, 0, -58], GOAL])


def test_a_path_is_certified_as_it_is(scenario: Scenario, way: Any) -> None:
    certificate = ctrplan.certify(scenario, way)
    assert certificate.valid and certificate.samples.leg[-1] == 2
    np.testing.assert_allclose(certificate.samples.joints[[0, -1]], way[[0, -1]])
    for corner in way:
        assert np.abs(certificate.samples.joints - corner).max(axis=1).min() < 1e-9


def test_a_trajectory_is_its_way(scenario: Scenario, way: Any) -> None:
    trajectory = ctrplan.time_parameterise(way, scenario.robot.drive)
    of_path, of_trajectory = (ctrplan.certify(scenario, each) for each in (way, trajectory))
    assert of_trajectory.min_clearance_m == pytest.approx(of_path.min_clearance_m, abs=1e-6)
    assert ctrplan.certify(scenario, way, timing=trajectory).valid
    with pytest.raises(InputError, match="timing, sample .*: leaves the legs by"):
        ctrplan.certify(scenario, way[[0, -1]], timing=trajectory)


def moved(scenario: Scenario, rows: Any, row: int, joint: int, by: float) -> Any:
    other = np.array(rows)
    other[row, joint] += by * scenario.robot.drive.joints[joint].si_per_unit
    return other


@pytest.mark.parametrize(
    "row, joint, by, sentence",
    [
        (0, 1, 0.1, "must begin at the scenario's start, but rotate middle is 0.1 deg away"),
        (0, 2, 360, "must begin at the scenario's start, but rotate inner is 360 deg away"),
        (-1, 3, -1, "must end at the scenario's goal, but translate inner is 1 mm away"),
    ],
)
@pytest.mark.parametrize("ask", [ctrplan.certify, lambda scenario, path: ctrplan.reorder(path, scenario)])
def test_other_motions_are_refused(
    ask: Any, row: int, joint: int, by: float, sentence: str, scenario: Scenario, way: Any
) -> None:
    with pytest.raises(InputError) as refused:
        ask(scenario, moved(scenario, way, row, joint, by))
    assert sentence in str(refused.value) and "\n" not in str(refused.value)


def test_limits_are_kept(scenario: Scenario, way: Any) -> None:
    with pytest.raises(InputError, match="row 1: rotate outer = 200 deg: must be within -180 and 180 deg"):
        ctrplan.certify(scenario, moved(scenario, way, 1, 0, 200))


@pytest.mark.parametrize(
    "rows, sentence",
    [
        (lambda way: way[:1], r"path: must be of shape \(K, 4\) with K >= 2, not \(1, 4\)"),
        (lambda way: way.ravel(), r"path: must be of shape \(K, 4\) with K >= 2, not \(16,\)"),
        (lambda way: np.where(np.eye(4), np.nan, way), "path: row 0: rotate outer = nan deg: must be finite"),
        (lambda way: np.where(np.eye(4)[::-1], np.inf, way), "row 0: translate inner = inf mm: must be finite"),
        (lambda way: way + [0, 0, 1e4, 0], "row 0: rotate inner = 572958 deg: must be from -360000 to 360000 deg"),
    ],
)
def test_what_is_no_path_is_a_sentence(rows: Any, sentence: str, scenario: Scenario, way: Any) -> None:
    """A path of 1e9 rad once was walked for as long as anybody waited."""
    for ask in (lambda path: ctrplan.certify(scenario, path), lambda path: ctrplan.reorder(path, scenario)):
        with pytest.raises(InputError, match=sentence):
            ask(rows(way))


def with_sample(trajectory: Any, name: str, value: float) -> Any:
    """The trajectory with a number in the middle of its times or joint values."""
    values = getattr(trajectory, name).copy()
    values[len(values) // 2] = value
    return replace(trajectory, **{name: values})


TIMINGS: dict[str, tuple[Any, str]] = {
    "no trajectory": (lambda t: t.position, "timing = <ndarray>: must be a Trajectory"),
    "a joint value that is none": (lambda t: with_sample(t, "position", np.nan), r"timing, sample \d+: must be finite"),
    "a time that is none": (lambda t: with_sample(t, "time_s", np.nan), r"timing, sample \d+: must be finite"),
    "a clock that runs backwards": (
        lambda t: replace(t, time_s=t.time_s[::-1]),
        "must be later than the sample before",
    ),
    "a clock that stands": (lambda t: replace(t, time_s=0 * t.time_s), "time_s, sample 2 .*later than the sample"),
    "fewer times": (lambda t: replace(t, time_s=t.time_s[1:]), "must have times .* and joint values .*, not"),
    "no samples": (lambda t: replace(t, time_s=t.time_s[:0], position=t.position[:0]), "must have times"),
    "ends early": (lambda t: replace(t, time_s=t.time_s[:-5], position=t.position[:-5]), "be at the end of the legs"),
    "a leg left out": (lambda t: replace(t, time_s=t.time_s[[0, -1]], position=t.position[[0, -1]]), "out of order"),
    "goes back": (lambda t: with_sample(t, "position", t.position[0]), "out of order"),
    "other joints": (lambda t: replace(t, names=t.names[::-1]), "timing: must drive rotate outer"),
}


@pytest.mark.parametrize("given, sentence", TIMINGS.values(), ids=TIMINGS)
@pytest.mark.parametrize("late", ["0", "0.4"])
def test_what_is_no_timing_of_the_path_is_a_sentence(
    given: Any, sentence: str, late: str, scenario: Scenario, way: Any
) -> None:
    """Backward and broken clocks once were certified."""
    robot = table_ii(f"effects.drive_lag.theta_s={late}")
    with pytest.raises(InputError, match=sentence) as refused:
        ctrplan.certify(replace(scenario, robot=robot), way, timing=given(ctrplan.time_parameterise(way, robot.drive)))
    assert "\n" not in str(refused.value)


def tip_goal(scenario: Scenario, joints: Any, **changes: Any) -> Goal:
    tip = scenario.robot.solve(*scenario.robot.drive.collars(joints))
    given = {"joints": None, "tip_m": tip.tip_m, "direction": tip.tip_tangent, "direction_tolerance_rad": np.radians(5)}
    return replace(scenario.goal, **{**given, **changes})


def test_tip_and_direction_of_the_goal_count(scenario: Scenario, way: Any) -> None:
    here = tip_goal(scenario, way[-1])
    assert ctrplan.certify(replace(scenario, goal=here), way).valid
    turned = replace(here, direction=-here.direction)
    with pytest.raises(InputError, match="must end in the goal's direction.*180 deg off"):
        ctrplan.certify(replace(scenario, goal=turned), way)
    beside = replace(here, tip_m=here.tip_m + [0.0, 0.02, 0.0])
    certificate = ctrplan.certify(replace(scenario, goal=beside), way)
    assert not certificate.valid and any("from the target" in problem for problem in certificate.problems)


def test_targets_are_passed_in_their_order(scenario: Scenario, way: Any) -> None:
    first, second = (tip_goal(scenario, way[k], name=f"target {k}", table=f"target.{k}") for k in (1, 2))
    tour = replace(scenario, via=(first, second))
    assert [target.leg for target in ctrplan.certify(tour, way).targets] == [0, 1, 2]
    with pytest.raises(InputError, match="must pass the targets in their order"):
        ctrplan.certify(replace(scenario, via=(second, first)), way)


def test_a_drive_that_follows_late_needs_a_timing_by_which_it_is_followed(scenario: Scenario, way: Any) -> None:
    late = replace(scenario, robot=table_ii("effects.drive_lag.theta_s=0.4"))
    with pytest.raises(InputError, match=r"effects.drive_lag.*0.4 s late.*give its timing"):
        ctrplan.certify(late, way)
    straight = np.array([way[0], way[-1]])
    fast = ctrplan.time_parameterise(straight, late.robot.drive)
    slow = replace(fast, time_s=20 * fast.time_s, duration_s=20 * fast.duration_s, leg_end_s=20 * fast.leg_end_s)
    apart = []
    for timing in (fast, slow):
        driven = ctrplan.certify(late, straight, timing=timing).samples.joints
        np.testing.assert_allclose(driven[[0, -1]], straight[[0, -1]], atol=1e-9)
        apart.append(distance_from_polyline(driven, straight).max())
    assert apart[1] < apart[0] / 10  # a slow motion hardly leaves its leg
    faster = replace(fast, time_s=fast.time_s / 2)  # by delays that are intervals more would be behind than is allowed
    with pytest.raises(InputError, match="timing: turns or moves rotate .* times as fast as it can go"):
        ctrplan.certify(late, straight, timing=faster)
    with pytest.raises(InputError, match="period_s"):
        ctrplan.reorder(straight, late, period_s=0.02)
