"""Chances of missing a direction, targets on the way and a line: laws, and virtual robots solved by themselves."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from made_up_input import thorough
from places import ROOT, SCENARIOS
from scipy import stats
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.certificate.certificate import joined_certificates
from ctrplan.certificate.certify import certify
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.files.plan_folder import _made
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.play import play_turn
from ctrplan.plans.plan import Plan, _plain
from ctrplan.plans.uncertainty import judged
from ctrplan.reports.plan_page import uncertainty_section
from ctrplan.reports.words import uncertainty_rows
from ctrplan.scenario.prediction import start_states
from ctrplan.scenario.scenario import Goal, Registration, Scenario
from ctrplan.uncertainty.drawn_poses import BeyondFirstOrder, DrawnPoses
from ctrplan.uncertainty.parameters import uncertain_parameters
from ctrplan.uncertainty.result import Uncertainty
from ctrplan.uncertainty.target import TargetPose, end_stop
from ctrplan.uncertainty.tip_slopes import poses_at
from ctrplan.uncertainty.worst_case import CHI95, Chance, Draws, chance, wilson

SCHEMA = json.loads((ROOT / "docs" / "plan.schema.json").read_text(encoding="utf-8"))
CURVED = [
    "robot.uncertainty.ci95.tube.2.section.2.curvature_per_m=[12.4, 12.84]",
    "robot.uncertainty.ci95.tube.1.section.2.curvature_per_m=[3.4, 3.55]",
]
NO_FRICTION = "robot.contact.1.friction_coefficient=0"
FRICTION = ["robot.effects.friction.mu_1=0.2", "robot.effects.friction.ci95.mu_1=[0.17, 0.23]"]
TOLERANCE_M, TOLERANCE_RAD = 1.0e-3, np.radians(1.0)


def pair(*overrides: str, turned_deg: float = 0.0, off_m: float = 0.0) -> Scenario:
    """A pair whose goal is its tip's position and direction at the start, off along x and turned about y by so much."""
    plain = load_scenario(SCENARIOS / "pair_free.toml", overrides)
    shape = plain.robot.solve(*plain.robot.drive.collars(plain.start))
    aside = np.cross(shape.tip_tangent, [0.0, 1.0, 0.0])
    axis = aside / np.linalg.norm(aside)
    direction = Rotation.from_rotvec(np.radians(turned_deg) * axis).apply(shape.tip_tangent)
    tip = shape.tip_m + [off_m, 0, 0]
    return replace(plain, goal=Goal(None, tip, TOLERANCE_M, direction, TOLERANCE_RAD))


def registered(scenario: Scenario, sigma_m: float = 0.0, sigma_rad: float = 0.0) -> Scenario:
    return replace(scenario, registration=Registration(sigma_m, sigma_rad))


def chances_of(scenario: Scenario, *tolerances: tuple[float, float]) -> list[Chance]:
    """Chances of missing the start's goal by more than tolerances [m], [rad], in the worst friction state."""
    parameters, registration = uncertain_parameters(scenario.robot), scenario.registration
    draws = Draws.of(parameters, registration, scenario.robot.model_error_m)
    drawn = DrawnPoses.of(parameters, draws, *scenario.robot.drive.commanded(scenario.start[None]))
    found = []
    for off_m, turned_rad in tolerances:
        goal = replace(scenario.goal, tolerance_m=off_m, direction_tolerance_rad=turned_rad)
        stop = judged(scenario, drawn, end_stop(goal, 0), 0, None)
        found.append(chance(*stop.any_friction.missed(stop.aim)))
    return found


def test_a_turned_base_turns_the_tangent_by_a_rayleigh_distribution() -> None:
    sigma = np.radians(0.5)
    scenario = registered(pair(NO_FRICTION), sigma_rad=sigma)
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal.turn
    assert found is not None and found.chance_by_history is None
    exact = float(np.exp(-((TOLERANCE_RAD / sigma) ** 2) / 2))
    assert found.chance_any_friction.low <= exact <= found.chance_any_friction.high
    assert found.quantile_any_friction_rad == pytest.approx(sigma * stats.rayleigh.ppf(0.95), rel=0.03)
    assert found.worst_rad == pytest.approx(sigma * CHI95, rel=2e-3)  # 2 asin(c / 2) of the chord
    assert [c.name for c in found.contributors if c.share_rad > 1e-9] == ["registration"]
    assert found.contributors[0].saved_rad == pytest.approx(found.worst_rad)


def test_a_shifted_base_turns_nothing() -> None:
    scenario = registered(pair(NO_FRICTION), sigma_m=5e-3)
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal
    assert found.turn is not None and found.turn.chance_any_friction.share == 0 and found.turn.worst_rad < 1e-6
    assert found.chance_any_friction is not None and found.chance_any_friction.share > 0.9  # by position alone


@pytest.mark.parametrize(
    ("turned_deg", "off_m", "expected"), [(0, 0, 0), (2.5, 0, 1), (0, 2.5e-3, 1), (0.9, 0.9e-3, 0)]
)
def test_without_spread_a_target_is_met_or_missed(turned_deg: float, off_m: float, expected: float) -> None:
    scenario = pair(NO_FRICTION, turned_deg=turned_deg, off_m=off_m)
    found = ctrplan.plan_uncertainty(registered(scenario, sigma_m=1e-9, sigma_rad=1e-9), scenario.start).goal
    assert found.chance_any_friction is not None and found.chance_any_friction.stated == expected


def test_chances_fall_with_both_tolerances_and_are_no_less_than_each_alone() -> None:
    scenario = registered(pair(*CURVED), 0.3e-3, np.radians(0.3))
    shares = chances_of(scenario, *((m, np.radians(3.0)) for m in (0.5e-3, 1e-3, 2e-3, 3e-3, 5e-3)))
    turned = chances_of(scenario, *((3e-3, np.radians(deg)) for deg in (0.5, 1.0, 2.0, 3.0, 6.0)))
    for found in ([one.share for one in chances] for chances in (shares, turned)):
        assert found == sorted(found, reverse=True) and found[0] > found[-1]
    off, away, both = chances_of(scenario, (2e-3, np.pi), (1.0, np.radians(2)), (2e-3, np.radians(2)))
    assert max(off.share, away.share) <= both.share <= off.share + away.share


def test_a_scene_that_is_turned_and_moved_as_a_whole_has_the_same_chances() -> None:
    scenario = registered(pair(*CURVED, *FRICTION), 0.2e-3, np.radians(0.2))
    R, shift, goal = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix(), np.array([0.1, -0.2, 0.3]), scenario.goal
    assert goal.tip_m is not None and goal.direction is not None
    moved = replace(
        scenario,
        base_R=R @ scenario.base_R,
        base_position_m=R @ scenario.base_position_m + shift,
        goal=replace(goal, tip_m=R @ goal.tip_m + shift, direction=R @ goal.direction),
    )
    here, there = (ctrplan.plan_uncertainty(s, s.start).goal for s in (scenario, moved))
    assert here.turn is not None and there.turn is not None
    assert here.chance_any_friction == there.chance_any_friction
    assert here.turn.chance_any_friction == there.turn.chance_any_friction
    np.testing.assert_allclose(
        [there.worst_m, there.turn.worst_rad, there.turn.quantile_any_friction_rad],
        [here.worst_m, here.turn.worst_rad, here.turn.quantile_any_friction_rad],
        rtol=1e-8,
    )


def test_chances_are_those_of_robots_solved_one_by_one() -> None:
    """Own draws, own registration as a true rotation, the robot's plain solver."""
    scenario = registered(pair(*CURVED, NO_FRICTION, turned_deg=0.5, off_m=0.4e-3), 0.25e-3, np.radians(0.25))
    parameters, rng, count = uncertain_parameters(scenario.robot), np.random.default_rng(8), 500
    offsets, collars = parameters.drawn(rng, count), scenario.robot.drive.collars(scenario.start)
    goal = scenario.goal
    assert goal.tip_m is not None and goal.direction is not None
    off, turned = np.empty(count), np.empty(count)
    for k, offset in enumerate(offsets):
        shape = parameters.robot_at(offset).solve(*collars)
        turn = Rotation.from_rotvec(scenario.registration.rotation_sigma_rad * rng.standard_normal(3))
        shift = scenario.registration.position_sigma_m * rng.standard_normal(3)
        off[k] = np.linalg.norm(turn.apply(shape.tip_m) + shift - goal.tip_m)
        turned[k] = np.arccos(min(float(turn.apply(shape.tip_tangent) @ goal.direction), 1.0))
    tolerances = ((1.0e-3, np.radians(0.9)), (0.8e-3, np.radians(4)), (9e-3, np.radians(0.6)))
    for (off_m, turned_rad), found in zip(tolerances, chances_of(scenario, *tolerances), strict=True):
        missed = (off > off_m) | (turned > turned_rad)
        low, high = wilson(missed)
        assert 0.05 < missed.mean() < 0.95
        assert low - 0.01 <= found.share <= high + 0.01
    quantile = ctrplan.plan_uncertainty(scenario, scenario.start).goal.turn
    assert quantile is not None
    assert quantile.quantile_any_friction_rad == pytest.approx(np.quantile(turned, 0.95), rel=0.08)


def test_causes_of_a_turn_add_up_and_friction_and_curvature_are_among_them() -> None:
    scenario = registered(pair(*CURVED, *FRICTION), 0.2e-3, np.radians(0.2))
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal.turn
    assert found is not None
    shares = [cause.share_rad for cause in found.contributors]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(found.worst_rad, rel=1e-9)
    assert {"friction", "registration", "precurvature of tube 2"} <= {cause.name for cause in found.contributors}
    assert found.sentence.startswith(f"{np.degrees(found.worst_rad):.1f} deg, of which ")


def test_no_robot_within_its_box_is_turned_further_than_the_worst_case() -> None:
    scenario = pair(*CURVED, *FRICTION, turned_deg=0.7)
    found, parameters = (
        ctrplan.plan_uncertainty(scenario, scenario.start).goal.turn,
        uncertain_parameters(scenario.robot),
    )
    assert found is not None and scenario.goal.direction is not None
    rng, collars = np.random.default_rng(3), scenario.robot.drive.collars(scenario.start)
    turned = []
    for signs in np.sign(rng.standard_normal((12, parameters.count))):
        robot = parameters.robot_at(signs * parameters.half_width)
        theta_b, l_b = (np.tile(row, (3, 1)) for row in collars)
        states = robot.mechanics.tips_with_friction(theta_b, l_b, np.array([[0.0], [1.0], [-1.0]]))
        turned.append(np.arccos(np.clip(states.tangent @ scenario.goal.direction, -1, 1)).max())
    assert max(turned) <= found.worst_rad + 1e-4
    assert max(turned) > 0.9 * found.worst_rad  # one of twelve is nearly the worst


def test_play_of_the_drive_turns_the_tangent_too() -> None:
    still, loose = pair(), pair("robot.effects.backlash.theta_2_deg=2.0")
    collars = still.robot.drive.collars(still.start)
    assert play_turn(still.robot, *collars) == 0
    here = still.robot.solve(*collars).tip_tangent
    ends = [still.robot.solve(collars[0] + [0, side * np.radians(1.0)], collars[1]).tip_tangent for side in (1, -1)]
    turned = max(float(np.arccos(min(float(end @ here), 1.0))) for end in ends)
    assert turned <= play_turn(loose.robot, *collars) < 1.5 * turned + 1e-3


def test_what_solves_leave_is_a_quadratic_that_other_robots_confirm() -> None:
    """First order alone stated chances up to 4 points too small, and the same rest for all draws 4 too large."""
    wide = [
        "robot.uncertainty.ci95.tube.2.bending_stiffness_Nm2=[0.0062, 0.0162]",
        "robot.uncertainty.ci95.tube.2.section.2.curvature_per_m=[11.6, 13.6]",
        "robot.uncertainty.ci95.tube.1.bending_stiffness_Nm2=[0.035, 0.066]",
    ]
    scenario = pair(*wide, NO_FRICTION)
    parameters, q = uncertain_parameters(scenario.robot), scenario.start + [0.0, 1.5, 0.01]
    theta, l = scenario.robot.drive.commanded(q[None])  # noqa: E741 (as in the equations)
    drawn = DrawnPoses.of(parameters, Draws.of(parameters, scenario.registration, 0.0), theta, l)
    others = parameters.drawn(np.random.default_rng(4), 100)
    linear = drawn.slopes.pose[0] + np.einsum("scp,mp->msc", drawn.slopes.pose_by[0], others)
    left = np.array([poses_at(parameters, offset, theta, l)[0] for offset in others]) - linear
    still = left - replace(drawn.beyond, remainder=0 * drawn.beyond.remainder).at(others / parameters.sigma, 0)
    assert np.sqrt(np.mean(left[..., :3] ** 2)) > 0.1e-3
    assert np.sqrt(np.mean(still[..., :3] ** 2)) < 0.3 * np.sqrt(np.mean(left[..., :3] ** 2))


@pytest.mark.parametrize("count", [2, 30])
def test_a_quadratic_comes_back_and_robots_without_an_equilibrium_stay_lost(count: int) -> None:
    """With thirty parameters products of two are left out, and come back as the rest of the solved draws."""
    rng = np.random.default_rng(2)
    z = rng.standard_normal((200, count))
    found = (0.3 * z[:, 0] ** 2 - 0.2 * z[:, 1] ** 2)[:, None, None] * np.ones((1, 1, 6))
    found[7] = np.nan
    fitted, fresh = BeyondFirstOrder.of(z, found), rng.standard_normal((400, count))
    np.testing.assert_allclose(fitted.at(z, 0)[:200], found[:, 0])
    at = fitted.at(fresh, 0)[:, 0]
    assert np.isnan(at[[7, 207]]).all() and np.isnan(at).sum() == 2
    expected = 0.3 * fresh[:, 0] ** 2 - 0.2 * fresh[:, 1] ** 2
    assert np.nanmax(np.abs(at - expected)) < 0.05
    lost = BeyondFirstOrder.of(z, np.full((200, 1, 6), np.nan))
    assert np.isnan(lost.at(fresh, 0)).all()


# --- plans: targets on the way, lines, histories ---

VIA_DEG_MM, END_DEG_MM = [25.0, 60.0, -22.0], [10.0, 130.0, -10.0]


def tour(plan: Plan, tolerance_m: float, *overrides: str, model_error_m: float = 0.0) -> Plan:
    """A pair past a first target to a last one, both where the frictionless tip is."""
    plain = load_scenario(SCENARIOS / "pair_free.toml", overrides)
    robot = replace(plain.robot, model_error_m=model_error_m)
    joints = np.array([VIA_DEG_MM, END_DEG_MM]) * [joint.si_per_unit for joint in robot.drive.joints]
    tips = [robot.solve(*robot.drive.collars(q)).tip_m for q in joints]
    via, goal = Goal(None, tips[0], tolerance_m, name="first"), Goal(None, tips[1], tolerance_m)
    scenario = replace(plain, robot=robot, via=(via,), goal=goal)
    return driven(plan, scenario, joints)


def driven(plan: Plan, scenario: Scenario, joints: Array) -> Plan:
    """A plan made by hand of another one: a straight leg to each target."""
    stages, start = [], scenario.start
    for goal, end in zip(scenario.targets, joints, strict=True):
        stages.append(certify(replace(scenario.stage_from(start), goal=goal), np.array([start, end])))
        start = end
    return replace(plan, scenario=scenario, certificate=joined_certificates(stages))


@pytest.fixture(scope="module")
def toured(plan: Plan) -> Callable[[float, float], Plan]:
    made = tour(plan, 1e-3, *CURVED, *FRICTION)

    def with_tolerances(first_m: float, last_m: float) -> Plan:
        (via,), goal = made.scenario.via, made.scenario.goal
        tours = replace(made.scenario, via=(replace(via, tolerance_m=first_m),), goal=replace(goal, tolerance_m=last_m))
        return replace(made, scenario=registered(tours, 0.2e-3, np.radians(0.1)))

    return with_tolerances


@pytest.fixture(scope="module")
def tour_found(toured: Callable[[float, float], Plan]) -> Uncertainty:
    return ctrplan.plan_uncertainty(toured(0.6e-3, 0.7e-3))


def test_each_target_has_its_own_chance_and_all_together_one(tour_found: Uncertainty) -> None:
    found = tour_found
    (via,), goal, both = found.via, found.goal, found.tour
    assert both is not None and both.targets == 2 and both.chance_by_history is not None
    assert via.name == "first" and via.sample is not None and goal.sample is not None and via.sample < goal.sample
    for chances in ("chance_any_friction", "chance_by_history"):
        each = [getattr(miss, chances).share for miss in (via, goal)]
        assert max(each) <= getattr(both, chances).share <= min(1.0, sum(each))
    assert 0.02 < via.chance_by_history.share < 0.98 and 0.02 < goal.chance_by_history.share < 0.98  # type: ignore[union-attr]


def test_what_is_uncertain_of_a_tour_is_written_read_and_told(toured: Callable[[float, float], Plan]) -> None:
    plan = toured(0.6e-3, 0.7e-3)
    goal = replace(plan.scenario.goal, direction=np.array([0.0, 0.6, 0.8]), direction_tolerance_rad=0.4)
    plan = replace(plan, scenario=replace(plan.scenario, goal=goal))
    plan = replace(plan, uncertainty=ctrplan.plan_uncertainty(plan))
    written = _plain(plan.uncertainty.to_json())  # type: ignore[union-attr]
    Draft202012Validator({**SCHEMA["properties"]["uncertainty"], "$defs": SCHEMA["$defs"]}).validate(written)
    again = replace(plan, uncertainty=_made(Uncertainty, written))
    assert _plain(again.uncertainty.to_json()) == written  # type: ignore[union-attr]
    rows = uncertainty_rows(again)
    assert plan.uncertainty is not None and plan.uncertainty.goal.turn is not None
    assert rows["turned at worst"] == f"by {plan.uncertainty.goal.turn.sentence}"
    assert "by the direction alone" in rows["chance to miss tolerance"] and "chance to miss target 1" in rows
    assert "% with friction as predicted" in rows["chance to meet all targets"]
    page = uncertainty_section(again)
    assert "Causes at target 1 (first)" in page and "Causes of the turn at the goal" in page and "°" in page


def test_a_target_that_nobody_misses_leaves_the_chance_of_the_other(toured: Callable[[float, float], Plan]) -> None:
    found = ctrplan.plan_uncertainty(toured(1.0, 0.7e-3))
    assert found.tour is not None and found.via[0].chance_by_history is not None
    assert found.via[0].chance_by_history.share == 0
    assert found.tour.chance_by_history == found.goal.chance_by_history
    assert found.tour.chance_any_friction == found.goal.chance_any_friction


def test_a_target_on_the_way_is_judged_as_if_it_were_the_goal(
    toured: Callable[[float, float], Plan], tour_found: Uncertainty
) -> None:
    plan, here = toured(0.6e-3, 0.7e-3), tour_found.via[0]
    q = plan.certificate.samples.joints[here.sample]
    alone = replace(plan.scenario, goal=plan.scenario.via[0], via=())
    there = ctrplan.plan_uncertainty(alone, q).goal
    assert here.chance_any_friction == there.chance_any_friction  # nothing is unexplained: the same draws
    assert (here.worst_m, here.contributors) == (there.worst_m, there.contributors)


def test_unexplained_errors_of_two_targets_are_two_draws(plan: Plan) -> None:
    found = ctrplan.plan_uncertainty(tour(plan, 0.5e-3, NO_FRICTION, model_error_m=0.5e-3)).tour
    assert found is not None and found.chance_any_friction.share == pytest.approx(1 - 0.95**2, abs=0.01)


def test_chances_by_history_are_those_of_robots_that_drive_the_path(toured: Callable[[float, float], Plan]) -> None:
    """Own draws and a history each, from start states drawn evenly; the registration left out."""
    plan = toured(1e-9, 1e-9)
    plan = replace(plan, scenario=registered(plan.scenario))
    scenario, samples, parameters = plan.scenario, plan.certificate.samples, uncertain_parameters(plan.scenario.robot)
    rows = np.unique(
        np.append(np.arange(0, len(samples.leg), 12), [np.flatnonzero(samples.leg == 0)[-1], len(samples.leg) - 1])
    )
    first = int(np.searchsorted(rows, np.flatnonzero(samples.leg == 0)[-1]))
    collars, starts = scenario.robot.drive.collars(samples.joints[rows]), start_states(scenario)
    rng, count = np.random.default_rng(5), 200
    off = np.empty((count, 2))
    for k, offset in enumerate(parameters.drawn(rng, count)):
        history = parameters.robot_at(offset).history(starts[rng.integers(len(starts))])  # type: ignore[arg-type]
        tips = history.follow(*collars).position_m[[first, -1]]
        off[k] = [np.linalg.norm(tip - goal.tip_m) for tip, goal in zip(tips, scenario.targets, strict=True)]
    level = np.quantile(off, [0.3, 0.8], axis=0)
    for share, (first_m, last_m) in zip((0.3, 0.8), level, strict=True):
        found = ctrplan.plan_uncertainty(replace(plan, scenario=registered(toured(first_m, last_m).scenario)))
        (via,), both = found.via, found.tour
        assert both is not None and both.chance_by_history and via.chance_by_history and found.goal.chance_by_history
        for stated, missed in (
            (via.chance_by_history, off[:, 0] > first_m),
            (found.goal.chance_by_history, off[:, 1] > last_m),
            (both.chance_by_history, (off[:, 0] > first_m) | (off[:, 1] > last_m)),
        ):
            low, high = wilson(missed)
            assert low - 0.02 <= stated.share <= high + 0.02, (share, stated)
        assert both.chance_any_friction.share >= both.chance_by_history.share


@thorough("test_chances_by_history_are_those_of_robots_that_drive_the_path")
def test_a_line_is_missed_where_the_tip_leaves_it_on_the_way_or_at_its_end(plan: Plan) -> None:
    plain = registered(load_scenario(SCENARIOS / "pair_free.toml", [*CURVED, NO_FRICTION]), 0.2e-3)
    robot, drive = plain.robot, plain.robot.drive
    joints = np.array([VIA_DEG_MM, END_DEG_MM]) * [joint.si_per_unit for joint in drive.joints]
    between = joints[0] + np.linspace(0, 1, 15)[:, None] * (joints[1] - joints[0])
    line = np.array([robot.solve(*drive.collars(q)).tip_m for q in between])
    begin = Goal(None, line[0], 0.5e-3, name="line, beginning")
    goal = Goal(None, line[-1], 0.5e-3, line_m=line, name="line")
    along = ctrplan.plan_uncertainty(driven(plan, replace(plain, via=(begin,), goal=goal), joints))
    ends = ctrplan.plan_uncertainty(driven(plan, replace(plain, via=(begin,), goal=replace(goal, line_m=None)), joints))
    whole, end = along.goal, ends.goal
    assert whole.chance_by_history and end.chance_by_history
    assert whole.chance_any_friction.share >= end.chance_any_friction.share > 0.01  # type: ignore[union-attr]
    assert whole.chance_by_history.share >= end.chance_by_history.share
    assert whole.worst_m >= end.worst_m


def test_an_aim_measures_lines_as_polylines_and_directions_as_angles() -> None:
    rng = np.random.default_rng(1)
    line, direction = rng.standard_normal((4, 3)), np.array([0.0, 0.6, 0.8])
    aim = TargetPose(line[-1], 1.0, direction, 0.1, line)
    tips = rng.standard_normal((5, 2, 3))
    np.testing.assert_allclose(aim.off_m(tips, is_end=False)[:, 1], distance_from_polyline(tips[:, 1], line))
    np.testing.assert_allclose(aim.off_m(tips, is_end=True), np.linalg.norm(tips - line[-1], axis=2))
    for tip in tips.reshape(-1, 3):
        nearest = aim.nearest_m(tip, is_end=False)
        assert np.linalg.norm(nearest - tip) == pytest.approx(float(distance_from_polyline(tip[None], line)[0]))
    turn = partial(Rotation.from_rotvec, np.array([0.3, 0.0, 0.0]))
    assert aim.turned_rad(2.0 * turn().apply(direction)[None]) == pytest.approx(0.3)
