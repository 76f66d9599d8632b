"""Planning as laws: order of motions, validity, costs that fall, answers that say why there is none."""

from __future__ import annotations

import importlib
import math
import pickle
import sys
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up_input import FUZZ
from ompl import base as ob
from ompl import geometric as og
from places import SCENARIOS
from small_scenarios import pair_past_a_sphere, pair_without_named_joints
from stated_plans import bent

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.certificate.certify import certify
from ctrplan.certificate.friction_states import SEARCH_MESH_M, SPACING_M, TIGHT_M, bound_allowance_m
from ctrplan.certificate.walked_piece import walk_pieces
from ctrplan.drive.trajectory import verify_limits
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.shapes import Status
from ctrplan.motion.checker import Motion, MotionChecker, invalid
from ctrplan.planning.goal_states import goal_states
from ctrplan.planning.reordering import as_given, assemble, rotations_first
from ctrplan.planning.search.ompl_set_up import MotionValidity, StateReader, Validity, state_space
from ctrplan.planning.search.stage_search import Answer, Progress
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.scenario import Goal, Scenario


def scenario(name: str, *overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / f"{name}.toml", overrides)


@pytest.fixture(scope="module")
def told() -> list[Progress]:
    """What the planner said while `past` was planned."""
    return []


@pytest.fixture(scope="module")
def past(told: list[Progress]) -> ctrplan.Plan:
    """A plan past a sphere to where the tip shall be."""
    return ctrplan.plan(pair_past_a_sphere(), seed=0, progress=told.append)


@pytest.fixture(scope="module")
def snap() -> ctrplan.Plan:
    """A pair so curved that its inner tube snaps where it is turned past the outer one's bend."""
    start, goal = (np.array([0.0, np.radians(angle), -0.04]) for angle in (120.0, 240.0))
    case = bare_scenario(bent(1.6)).with_("planner.time_s=0.2", start=start, goal=Goal(joints=goal))
    return ctrplan.plan(case, seed=0)


def test_the_time_of_a_plan_is_split_by_what_took_it(past: ctrplan.Plan) -> None:
    assert list(past.clock_s_by)[:3] == ["preparation", "search", "ending and compensation"]
    assert sum(past.clock_s_by.values()) == pytest.approx(past.clock_s) and past.clock_s > past.first_certified_s > 0
    assert past.clock_s_by["search"] == max(past.clock_s_by.values())


def test_a_plan_travels_to_another_process(past: ctrplan.Plan) -> None:
    """All but the friction states that it ended with, which stay where they were simulated."""
    again = pickle.loads(pickle.dumps(past))
    assert again.certificate.goal_bound_m == past.certificate.goal_bound_m and again.seed == past.seed
    assert again.scenario.sha256 == past.scenario.sha256 and len(again.legs) == len(past.legs)
    with pytest.raises(ctrplan.InputError, match="no legs to walk again"):
        again.certificate.recheck()


def check(plan: ctrplan.Plan) -> None:
    """What every plan keeps."""
    space, start = JointSpace.of(plan.scenario), plan.scenario.start
    assert plan.certificate.valid and not plan.certificate.problems
    np.testing.assert_array_equal(plan.legs[0].start, start)
    for before, after in zip(plan.legs[:-1], plan.legs[1:], strict=True):
        np.testing.assert_array_equal(before.end, after.start)
    assert space.allowed(plan.waypoints)
    assert plan.style == "rotations before translations"
    assert all(leg.kind in ("rotation", "translation") for leg in plan.legs)
    samples = plan.certificate.samples
    assert samples.motion_m.max() <= SPACING_M
    assert samples.stability.min() >= plan.scenario.margins.stability
    assert samples.clearance_m.min() >= plan.scenario.robot.model_error_m
    assert all(
        ratio <= 1 + 1e-9
        for row in verify_limits(plan.trajectory, plan.scenario.robot.drive).values()
        for ratio in row.values()
    )
    np.testing.assert_allclose(plan.trajectory.position[-1], plan.legs[-1].end, atol=1e-9)


def test_plan_past_obstacles_reaches_its_target(past: ctrplan.Plan) -> None:
    check(past)
    assert past.certificate.goal_tip_error_m <= past.scenario.goal.tolerance_m
    target = past.scenario.goal.tip_m
    reached = past.scenario.robot.bound(*past.scenario.robot.drive.collars(past.legs[-1].end))
    assert target is not None and np.linalg.norm(reached.frictionless.tip_m - target) <= past.scenario.goal.tolerance_m
    assert reached.position_m == pytest.approx(past.certificate.samples.bound_m[-1], abs=1e-6)
    closely = past.scenario.robot.bound(*past.scenario.robot.drive.collars(past.legs[-1].end), accuracy="certificate")
    allowance = bound_allowance_m(past.scenario.robot, "certificate")
    assert 0 < allowance < 0.05e-3
    assert past.certificate.goal_bound_m == pytest.approx(closely.position_m + allowance, abs=1e-6)


def test_cost_that_weighs_the_error_more_prefers_goals_with_less() -> None:
    checker = MotionChecker(scenario("ribs"))
    goals = goal_states(checker, np.random.default_rng(0))
    motions = [checker.motion(checker.scenario.start, goal.joints) for goal in goals]
    valid = [motion for motion in motions if motion.valid]
    lengths, errors = (np.array([getattr(m, key) for m in valid]) for key in ("length_mm", "end_bound_m"))
    caring, blind = (errors[np.argmin(lengths + weight * errors * 1e3)] for weight in (200, 0))
    assert caring < blind


def test_progress_of_a_search_only_rises(past: ctrplan.Plan, told: list[Progress]) -> None:
    shares = [progress.fraction for progress in told if progress.stage == "search"]
    assert np.all(np.diff(shares) >= 0) and shares[0] < 0.5 < shares[-1] <= 1
    costs = [progress.best_cost_mm for progress in told if progress.best_cost_mm is not None]
    assert costs[-1] <= costs[0]


def test_bound_aware_plan_ends_with_less_error_than_blind_one(tmp_path: Path) -> None:
    # how much less is the user's choice: here the target matters most
    weights = ({"error_goal": 100.0}, {"error_along": 0.0, "error_goal": 0.0})
    aware, blind = (ctrplan.plan(pair_without_named_joints(tmp_path, 0.3, **cost), seed=0) for cost in weights)
    assert aware.certificate.goal_bound_m < 0.5 * blind.certificate.goal_bound_m


def test_plan_goes_round_where_the_straight_line_snaps(snap: ctrplan.Plan) -> None:
    checker = MotionChecker(snap.scenario)
    assert snap.scenario.goal.joints is not None
    straight = checker.along(np.array([snap.scenario.start, snap.scenario.goal.joints]))
    assert not straight.valid and "unstable" in straight.reason
    check(snap)


def test_walk_reports_a_snap_it_was_not_told_about(snap: ctrplan.Plan) -> None:
    """On a coarse walk too, a jump between branches ends as UNSTABLE, never as a long step."""
    assert snap.scenario.goal.joints is not None
    corners = np.array([snap.scenario.start, snap.scenario.goal.joints])
    samples = snap.scenario.robot.mechanics.check_path(*snap.scenario.robot.drive.collars(corners))
    assert samples.status[-1] == Status.UNSTABLE and samples.fraction[-1] < 1


@pytest.mark.parametrize("name", ["RRT*", "RRTConnect"])
def test_other_planners(name: str) -> None:
    plan = ctrplan.plan(pair_past_a_sphere(name=name, time_s=0.3), seed=1)
    check(plan)
    assert plan.planner == name and np.isfinite(plan.certificate.min_clearance_m)


def test_reorder_puts_rotations_first_at_no_higher_cost() -> None:
    case = scenario("pair_free")
    rng = np.random.default_rng(2)
    checker = MotionChecker(case)
    tried = 0
    for _ in range(40):
        if tried == (4 if FUZZ else 2):
            break
        path = np.concatenate(
            [[case.start], case.start + np.cumsum(rng.uniform(-1, 1, (4, 3)) * [0.4, 0.6, 8e-3], axis=0)]
        )
        if not checker.along(path).valid:
            continue
        tried += 1
        plan = ctrplan.reorder(path, replace(case, goal=Goal(path[-1], None, 1e-3)))
        assert plan.reorder.cost_after_mm <= plan.reorder.cost_before_mm + 1e-9
        assert plan.reorder.stops_after == len(plan.legs) - 1
        np.testing.assert_allclose(plan.waypoints[0], path[0])
        np.testing.assert_allclose(plan.waypoints[-1], path[-1], atol=1e-12)
        for kind, following in zip(plan.legs[:-1], plan.legs[1:], strict=True):
            assert not (kind.kind == following.kind == "translation")
    assert tried >= 2


def test_reorder_swaps_a_translation_before_a_rotation() -> None:
    """Friction loaded by the rotation stays in the pair if it comes last; the L-shaped motion is at least as cheap."""
    case = scenario("pair_free")
    start = case.start
    path = np.array([start, start + [0, 0, 0.01], start + [0, 0.5, 0.01]])
    result = rotations_first(MotionChecker(case), path)
    np.testing.assert_allclose(result.after[-1], path[-1])
    assert result.motion_after.length_mm == pytest.approx(result.motion_before.length_mm)
    assert result.motion_after.end_error_m < 0.01 * result.motion_before.end_error_m


def test_reordering_a_path_that_goes_nowhere_is_a_leg_of_no_length() -> None:
    case = scenario("pair_free")
    plan = ctrplan.reorder([case.start, case.start], replace(case, goal=Goal(case.start, None, 1e-3)))
    np.testing.assert_array_equal(plan.waypoints, [case.start, case.start])
    assert plan.certificate.length_mm == plan.trajectory.duration_s == plan.certificate.stops == 0


def test_legs_that_go_on_in_one_direction_are_no_stop() -> None:
    case = scenario("pair_free")
    corners = case.start + np.array([[0.0, 0, 0], [0, 0.1, 0], [0, 0.3, 0], [0, 0.3, 0.01]])
    given = as_given(MotionChecker(case), corners)
    plan = assemble(case, [given], certify(case, corners), planner="given path", seed=0, clock_s=0.0)
    assert len(plan.legs) == 3 and plan.certificate.stops == plan.trajectory.stops == 1


def test_progress_of_a_certificate_is_told_by_one_thread() -> None:
    case, told = scenario("pair_free"), list[tuple[int, float]]()
    corners = case.start + np.linspace(0, 1, 9)[:, None] * [1.0, 3.0, 0.04]
    certify(case, corners, progress=lambda share: told.append((threading.get_ident(), share)))
    assert {thread for thread, _ in told} == {threading.get_ident()}
    assert [share for _, share in told] == pytest.approx(np.arange(1, len(told) + 1) / len(told)) and len(told) > 4


@pytest.mark.parametrize("path", ["abc", [[0, 1], [2]], [[0, 0, 0]], [[0, 0], [1, 1]], [[0, 0, 0], [math.nan, 0, 0]]])
def test_reorder_refuses_what_is_no_path(path: object) -> None:
    with pytest.raises(InputError, match="path"):
        ctrplan.reorder(path, scenario("pair_free"))  # type: ignore[arg-type]


def test_joint_space_takes_the_short_way_round_only_where_unlimited() -> None:
    space = JointSpace.of(scenario("ribs"))
    a, b = np.radians([170.0, 170.0, 170.0, 0]), np.radians([-170.0, -170.0, -170.0, 0])
    delta = np.degrees(space.difference(a, b))
    np.testing.assert_allclose(delta, [-340, 20, 20, 0], atol=1e-9)
    rng = np.random.default_rng(0)
    for p, q in zip(space.sample(rng, 20), space.sample(rng, 20), strict=True):
        corners = space.corners(p, q, "rotations before translations")
        assert np.array_equal(corners[0], p) and np.allclose(space.difference(corners[-1], q), 0, atol=1e-12)
        legs = sum(space.length_mm(leg) for leg in np.diff(corners, axis=0))
        assert legs == pytest.approx(space.length_mm(space.difference(p, q)))  # the L is no longer than the diagonal
        turned = corners[1] - corners[0]
        assert not np.any(turned[~space.drive.is_rotation])


def test_certificate_sees_an_obstacle_the_search_never_had(past: ctrplan.Plan) -> None:
    """A sphere put into the way of a tip is found where it is, by as much as the tip enters it."""
    tip_m, radius_m = past.certificate.samples.tip_m, 3e-3
    center_m = past.scenario.base_R @ tip_m[len(tip_m) // 2] + past.scenario.base_position_m
    found = certify(replace(past.scenario, anatomy=(AnatomyPart(Sphere(center_m, radius_m)),)), past.waypoints)
    assert not found.valid and found.min_clearance_m <= -radius_m
    assert any("too close to the anatomy" in problem for problem in found.problems)


# A piece of a plan past the ribs, about where it is narrowest: 2.2 mm from them.
NARROW = np.array([[-9.344, 176.206, -51.850, -69.706], [-9.344, 176.206, -51.850, -67.559]])


def test_certificate_measures_distances_and_asks_no_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """No grid can fool it: a wider margin is missed by as much as it is wider, and by what lies between two points."""
    monkeypatch.setattr("ctrplan.motion.checker.anatomy_grid", lambda _: pytest.fail("a grid was asked"))
    cases = [scenario("ribs", f"anatomy.1.margin_mm={mm}") for mm in (1, 4)]
    narrow = NARROW * [joint.si_per_unit for joint in cases[0].robot.drive.joints]
    cases = [replace(case, start=narrow[0], goal=Goal(narrow[-1], None, 1e-3)) for case in cases]
    near, far = (walk_pieces(case, JointSpace.of(case), narrow, "search", None) for case in cases)
    least = [min(float(piece.clearance_m.min()) for piece in pieces) for pieces in (near, far)]
    assert 3e-3 - 1e-9 <= least[0] - least[1] <= 3.01e-3
    found = [certify(case, narrow) for case in cases]
    assert found[0].valid and not found[1].valid
    # of every friction state; the certificate mesh's allowance is smaller than that of the walk
    assert least[0] - TIGHT_M - 1e-9 <= found[0].min_clearance_m <= least[0] + SEARCH_MESH_M


def test_a_path_that_fails_when_all_its_clearance_is_asked_for_is_no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search asks for half a millimetre, which nothing should pass that the whole certificate refuses."""
    planner: Any = importlib.import_module("ctrplan.planning.planner")
    real = planner.certify

    def refusing(*arguments: Any, **keywords: Any) -> Any:
        return replace(real(*arguments, **keywords), valid=False, problems=("Refused by the test.",))

    monkeypatch.setattr(planner, "certify", refusing)
    with pytest.raises(NoAnswerError, match="no path in time passed its certificate: Refused by the test"):
        ctrplan.plan(scenario("pair_free", "planner.time_s=0.3"), seed=0)


@pytest.mark.parametrize(
    ("offsets_mm", "kept"),
    [
        ([2.0, 0.1, 0.0], 1),
        ([0.4, 0.0, 0.0], 0),
        ([2.0, 2.0, 0.0], 2),
        ([2.0, np.nan, 0.0], 2),
        ([2.0, np.nan, 9.0], 0),
    ],
)
def test_of_certified_paths_the_cheapest_as_it_arrives_is_kept(
    offsets_mm: list[float], kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An offset that compensation leaves costs 10 mm a millimetre, as an error at the goal; one is invalid."""
    planner: Any = importlib.import_module("ctrplan.planning.planner")
    case, asked = scenario("pair_free"), list[int]()

    def candidate(k: int, cost_mm: float, valid: bool = True) -> Any:
        return SimpleNamespace(k=k, cost_mm=cost_mm, certificate=SimpleNamespace(valid=valid))

    def finished(_: Scenario, stages: Any, *rest: Any) -> Any:
        asked.append(stages[-1].best.k)
        if np.isnan(offsets_mm[stages[-1].best.k]):
            raise NoAnswerError("fails when all its clearance is asked for")
        by_cause = SimpleNamespace(offset_m=offsets_mm[stages[-1].best.k] / 1e3)
        return SimpleNamespace(certificate=SimpleNamespace(arrival=SimpleNamespace(by_cause=by_cause)))

    monkeypatch.setattr(planner, "_finish", finished)
    best = candidate(0, 100.0)
    dearer = (candidate(3, 101.0, valid=False), candidate(1, 105.0), candidate(2, 107.0))
    weighed = replace(case, cost=replace(case.cost, error_goal=10.0))
    _, stages = planner._cheapest_as_driven(weighed, [Answer(best, best, dearer)], True, lambda _: None)
    assert stages[-1].best.k == kept and stages[-1].first is best
    worth = 1 if offsets_mm[0] < 0.5 else 2 if kept == 1 else 3  # those that cannot be cheaper are not compensated
    assert asked == list(range(worth))


def test_simultaneous_motion_is_a_named_fallback(monkeypatch: pytest.MonkeyPatch) -> None:
    real = MotionChecker.motion

    def refuse_l_shapes(self: MotionChecker, a: np.ndarray, b: np.ndarray) -> Motion:
        return real(self, a, b) if self.style == "simultaneous" else invalid("refused by the test")

    monkeypatch.setattr(MotionChecker, "motion", refuse_l_shapes)
    # the package exports a function of the module's name
    monkeypatch.setattr(
        sys.modules["ctrplan.planning.reordering"], "_pieces", lambda checker, corners, i, j: [corners[i : j + 1]]
    )
    plan = ctrplan.plan(scenario("pair_free", "planner.time_s=0.3"), seed=0)
    assert plan.style == "simultaneous" and any("simultaneously" in note for note in plan.notes)
    assert plan.certificate.valid


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["cost.max_error_goal_mm=0.01"], "no goal state keeps the required worst-case error of 0.01 mm"),
        (
            ["goal.direction=[0, 0, -1]", "goal.direction_tolerance_deg=5"],
            "deg from goal.direction, beyond its tolerance",
        ),
    ],
)
def test_no_answer_says_why(overrides: list[str], words: str) -> None:
    with pytest.raises(NoAnswerError, match=words) as caught:
        ctrplan.plan(scenario("ribs", *overrides), time_s=0.5)
    assert caught.value.exit_code == 1 and str(caught.value).count("\n") == 0


def test_path_outside_limits_is_refused_with_joint_and_row() -> None:
    case = scenario("pair_free")
    with pytest.raises(
        NoAnswerError, match=r"path: not valid: row 1: translate inner = 70 mm: must be within -43 and 43.4"
    ):
        ctrplan.reorder([case.start, [0, 0, 0.07]], case)


def test_tip_goal_of_a_robot_whose_tubes_all_translate(tmp_path: Path) -> None:
    """The goal's configurations touch the nesting limits."""
    check(ctrplan.plan(pair_without_named_joints(tmp_path)))


def test_unstable_start_is_refused() -> None:
    case = scenario("snap", 'start={"rotate outer"=0, "rotate middle"=0, "rotate inner"=180, "translate inner"=-86.4}')
    with pytest.raises(NoAnswerError, match="start: the start state is not valid: elastically unstable"):
        ctrplan.plan(case, time_s=0.5)


def test_objective_in_a_set_up_of_ones_own() -> None:
    """A user's own space information and planner optimise the bound through the objective of the library."""
    case = scenario("pair_free")
    checker = MotionChecker(case)
    space = state_space(checker.space)
    information = ob.SpaceInformation(space)
    read = StateReader(checker.space)
    validity, motions = Validity(information, checker, read), MotionValidity(information, checker, read)
    information.setStateValidityChecker(validity)
    information.setMotionValidator(motions)
    information.setup()
    start, goal = information.allocState(), information.allocState()
    assert case.goal.joints is not None
    read.write(start, case.start)
    read.write(goal, case.goal.joints)
    objective = ctrplan.planning.BoundObjective(information, case, goals=[read(goal)])
    cost = objective.motionCost(start, goal).value()
    motion = checker.motion(read(start), read(goal))
    assert motion.valid and cost == pytest.approx(checker.cost_mm(motion, ends_at_goal=True))
    assert motion.length_mm < cost and motion.length_mm <= objective.motionCostHeuristic(start, goal).value() <= cost
    elsewhere = information.allocState()
    read.write(elsewhere, case.start + 0.3 * (case.goal.joints - case.start))
    assert objective.motionCost(start, elsewhere).value() == pytest.approx(
        checker.cost_mm(checker.motion(read(start), read(elsewhere)), ends_at_goal=False)
    )
    definition = ob.ProblemDefinition(information)
    definition.addStartState(start)
    target = ob.GoalStates(information)
    target.addState(goal)
    definition.setGoal(target)
    definition.setOptimizationObjective(objective)
    planner = og.RRTstar(information)
    planner.setGoalBias(0.5)
    planner.setRange(space.getMaximumExtent())
    planner.setProblemDefinition(definition)
    planner.setup()
    calls = iter(range(10**6))
    planner.solve(ob.PlannerTerminationCondition(lambda: next(calls) > 8))
    path = definition.getSolutionPath()
    assert path is not None and definition.hasExactSolution()
    corners = np.array([read(path.getState(k)) for k in range(path.getStateCount())])
    np.testing.assert_allclose(corners[[0, -1]], [read(start), read(goal)], atol=1e-9)
    motions = [checker.motion(a, b) for a, b in pairwise(corners)]
    costs = [checker.cost_mm(m, ends_at_goal=k == len(motions) - 1) for k, m in enumerate(motions)]
    assert all(m.valid for m in motions) and path.cost(objective).value() == pytest.approx(sum(costs))
    assert objective.is_goal(read(goal)) and not objective.is_goal(read(start))
