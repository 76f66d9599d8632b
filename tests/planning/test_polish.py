"""Local improvement of a path: what it goes down by, what it keeps, and that it never gets dearer."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.drive.legs import merge_legs, new_legs
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.compensate import CLOSE_M, aimed, brought_to_goal
from ctrplan.planning.goal_states import goal_state
from ctrplan.planning.search.path_model import NearPlaces, PathModel, _valleys, levels_of, slope_along
from ctrplan.planning.search.polish import FOLLOWED_M, LEAST_GAIN_MM, Polish
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.prediction import TIP_TOLERANCE_M, end_middle_m, frictionless_tips, predict_end, start_states
from ctrplan.scenario.scenario import CostTerm, Goal, Scenario
from ctrplan.scenario.tip_solver import target_in_robot_frame

START, GOAL = np.radians([0, 0, 0, 0]), np.append(np.radians([20.0, 80.0, 130.0]), -20e-3)
START[3] = -60e-3


@pytest.fixture(scope="module")
def case() -> Scenario:
    """Three tubes in free space, whose goal is a tip: four joints leave one to spare."""
    bare = bare_scenario(load_scenario(SCENARIOS / "vessel.toml").robot)
    tip = bare.robot.solve(*bare.robot.drive.collars(GOAL)).tip_m
    return replace(bare, start=START, goal=Goal(None, tip, 1e-3), anatomy=())


@pytest.fixture(scope="module")
def checker(case: Scenario) -> MotionChecker:
    return MotionChecker(case)


def roundabout() -> Array:
    """Legs of either kind by turns, with detours."""
    rotations = np.radians([[0, 0, 0], [50, 20, -30], [-20, 90, 60], [20, 80, 130]])
    corners = [START]
    for turn, l_m in zip(rotations[1:], (-45e-3, -30e-3, -20e-3), strict=True):
        corners += [np.append(turn, corners[-1][3]), np.append(turn, l_m)]
    return np.array(corners)


def miss_m(scenario: Scenario, corners: Array) -> Array:
    """(3,) from where the tip with friction ends, simulated from every start, to the target."""
    return target_in_robot_frame(scenario) - end_middle_m(scenario, corners)


def test_the_model_s_slope_is_that_of_length_and_worst_case(case: Scenario) -> None:
    """By differences of the whole path's price, whose curvature the model overestimates where lengths alone have it."""
    plain = replace(case, cost=replace(case.cost, error_along=0.0))
    checker, path = MotionChecker(plain), roundabout()
    levels = levels_of(checker, path, moves_goal=True)
    model = PathModel(checker, path, levels, [])
    assert levels.has_goal and levels.spread.shape == (7, 4, 3 + 3 + 1 + 1 + 4)

    def price_mm(step: Array, weight: float) -> float:
        corners = path + levels.spread @ step / checker.space.weights_mm
        length = sum(checker.space.length_mm(d) for d in np.diff(corners, axis=0))
        goal = checker.mechanics.bound(*checker.space.drive.collars(corners[-1])).position_m
        return plain.cost.path * length + weight * MM_PER_M * goal

    for k, unit in enumerate(np.eye(model.size)):
        up, down = (price_mm(h * unit, plain.cost.error_goal) for h in (1e-3, -1e-3))
        assert model.slope[k] == pytest.approx((up - down) / 2e-3, rel=1e-4, abs=1e-4)
    inner = levels.level < levels.level[-1]
    for step in np.random.default_rng(0).normal(size=(20, model.size)) * inner:
        promised_mm = price_mm(0 * step, 0.0) - model.gain_mm(step)
        assert price_mm(step, 0.0) <= promised_mm + 1e-9 and model.gain_mm(step) < -model.slope @ step


def test_the_slope_of_the_error_along_the_way_is_that_of_the_bound_s_integral(
    case: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By differences, where friction stays fully loaded; three places of a leg integrate it to some per cent."""
    checker, path = MotionChecker(case), roundabout()
    monkeypatch.setattr(checker, "errors", lambda corners, samples: samples.position_m)
    levels = levels_of(checker, path, moves_goal=True)
    slope = slope_along(checker, path, levels, checker.known_walk(path))

    def integral_mm(step: Array) -> float:
        corners = path + levels.spread @ step / checker.space.weights_mm
        samples = checker.known_walk(corners)
        return checker.price(corners, samples, samples.position_m)[1]

    by = [(integral_mm(h) - integral_mm(-h)) / 0.2 for h in 0.1 * np.eye(len(slope))]
    np.testing.assert_allclose(slope, np.array(by) * case.cost.error_along, atol=0.05 * np.abs(by).max())
    free = MotionChecker(replace(case, cost=replace(case.cost, error_along=0.0)))
    assert not slope_along(free, path, levels, free.known_walk(path)).any()


@pytest.fixture(scope="module")
def beside(case: Scenario) -> MotionChecker:
    """A ball 2 mm beside the tip after two legs of the way round, which passes it on three."""
    body, radius = case.robot.mechanics.body(*case.robot.drive.collars(roundabout()[2]))
    tangent = body[0, -1] - body[0, -2]
    away = np.cross(np.cross(tangent, [0.0, 0.0, 1.0]), tangent)
    centre = body[0, -1] + (2e-3 + radius[-1] + 15e-3) * away / np.linalg.norm(away)
    return MotionChecker(replace(case, anatomy=(AnatomyPart(Sphere(centre, 15e-3), "avoid", 0.0),)), reserve_m=0.0)


@pytest.mark.parametrize("turn", [np.eye(3), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])])
def test_near_places_agree_with_differences_of_what_is_left(beside: MotionChecker, turn: Array) -> None:
    """What the model says of each place's room, beside the place solved again a little farther on, whatever the base.

    Distances of the model are a grid's, whose slope differs by some per cent from the ball's.
    """
    ball = beside.scenario.anatomy[0].shape
    assert isinstance(ball, Sphere)
    turned = (AnatomyPart(Sphere(turn @ ball.center_m, ball.radius_m), "avoid", 0.0),)
    beside = MotionChecker(replace(beside.scenario, base_R=turn, anatomy=turned), reserve_m=0.0)
    path, weights_mm = roundabout(), beside.space.weights_mm
    samples = replace(beside.known_walk(path), nearest_phi=np.zeros((0, 2)))  # shapes of corners alone
    contacts = list(NearPlaces(beside).along(path, samples))
    levels = levels_of(beside, path, moves_goal=True)
    model = PathModel(beside, path, levels, contacts)
    assert contacts and {contact.leg for contact in contacts} >= {1, 2, 3}
    places = [(contact.leg, contact.fraction) for contact in contacts]
    nearest = [min(c.room_mm for c, at in zip(contacts, places, strict=True) if at == place) for place in places]
    for contact in (c for c, least in zip(contacts, nearest, strict=True) if c.room_mm == least):
        q = path[contact.leg] + contact.fraction * (path[contact.leg + 1] - path[contact.leg])
        rooms = beside.clearance(q + 0.02 * np.vstack([np.eye(4), -np.eye(4)]) / weights_mm).clearance_m * MM_PER_M
        by = (rooms[:4] - rooms[4:]) / 0.04
        np.testing.assert_allclose(contact.by_joints, by, atol=0.08 * np.linalg.norm(by))
        joint = int(np.argmax(np.abs(by)))
        held = np.flatnonzero(levels.spread[contact.leg, joint] * levels.spread[contact.leg + 1, joint])
        row = model.rows[contacts.index(contact)]
        assert len(held) == 0 or row[held[0]] == pytest.approx(-contact.by_joints[joint])


def test_a_body_has_a_place_wherever_it_is_too_close(beside: MotionChecker) -> None:
    """Pushed along its own track it passes what is near all the time: the nearest place alone only moves on."""
    path = roundabout()
    walked = beside.known_walk(path)
    room_m = walked.clearance_m - beside.limits.clearance_m
    leg = int(walked.segment[np.argmin(room_m)])
    flat = replace(walked, clearance_m=np.where(walked.segment == leg, -0.3e-3, room_m) + beside.limits.clearance_m)
    places = {(place.leg, place.fraction) for place in NearPlaces(beside).along(path, flat)}
    on_leg = walked.fraction[walked.segment == leg]
    assert len(on_leg) > 2 and places >= {(leg, float(fraction)) for fraction in on_leg}


def test_a_moved_place_is_what_the_model_says_of_it(beside: MotionChecker) -> None:
    """Places of a path before a correction limit the one after it, too: what mends one place undoes no other."""
    path = roundabout()
    levels = levels_of(beside, path, moves_goal=True)
    places = list(NearPlaces(beside).along(path, beside.known_walk(path)))
    model = PathModel(beside, path, levels, places)
    step = np.random.default_rng(0).normal(size=model.size)
    for place in places:
        row = PathModel(beside, path, levels, [place]).rows[0]
        moved = place.moved(levels.spread @ step)
        assert moved.room_mm == pytest.approx(place.room_mm - row @ step) and moved.by_joints is place.by_joints


def test_a_step_stays_within_what_the_model_limits_and_leaves_the_tip(beside: MotionChecker) -> None:
    path = roundabout()
    walked = beside.known_walk(path)
    walked = replace(walked, clearance_m=walked.clearance_m - 0.05e-3)  # as where an interpolated shape is nearest
    contacts = list(NearPlaces(beside).along(path, walked))
    for contact in contacts:  # the nearest shape there counts as the walk's
        at = (walked.segment == contact.leg) & (walked.fraction == contact.fraction)
        least = min(c.room_mm for c in contacts if (c.leg, c.fraction) == (contact.leg, contact.fraction))
        assert least == pytest.approx(float(walked.clearance_m[at][0] - beside.limits.clearance_m) * MM_PER_M)
    model = PathModel(beside, path, levels_of(beside, path, moves_goal=True), contacts)
    for step in (model.step(0.05), model.step(1.0), model.nearest(np.ones(model.size))):
        assert step is not None and (model.rows @ step <= model.room_mm + 1e-9).all()
        goal = model.levels.spread[-1] @ step / beside.space.weights_mm
        assert np.linalg.norm(model.slopes.tip_by[0] @ goal) < 1e-9
        assert model.gain_mm(step) <= model.gain_mm(model.step(1e-6)) + 1e-6  # type: ignore[arg-type]


def test_room_beside_a_walked_path_is_foreseen(beside: MotionChecker) -> None:
    """It is the walk's where the path is walked, else within a quarter of a millimetre mostly some 3 mm away."""
    path = roundabout()
    walked, levels = beside.known_walk(path), levels_of(beside, path, moves_goal=True)
    near = NearPlaces(beside)
    own = near.foreseen(path, path, walked)
    assert own
    room_mm = (walked.clearance_m - beside.limits.clearance_m) * MM_PER_M
    for place in own:
        row = np.flatnonzero((walked.segment == place.leg) & (walked.fraction == place.fraction))
        assert place.room_mm == pytest.approx(room_mm[row[0]])
    off = list[float]()
    for step in np.random.default_rng(0).normal(size=(20, levels.spread.shape[2])):
        moved = path + levels.spread @ step / beside.space.weights_mm
        places = near.foreseen(moved, path, walked) if beside.space.allowed(moved) else None
        if places:
            room = beside.known_walk(moved).clearance_m.min() - beside.limits.clearance_m
            off.append(abs(min(place.room_mm for place in places) - room * MM_PER_M))
    assert len(off) > 8 and np.median(off) < 0.25
    turned = np.array([0.3, 0.0, 0.0, 0.0])
    assert None in (near.foreseen(path + turned, path, walked), near.foreseen(path - turned, path, walked))


def test_a_walk_that_ends_on_its_way_has_a_model_as_far_as_it_goes(beside: MotionChecker) -> None:
    """A walk that is a little too close on a leg, and unstable on the next, ends there: its model knows those legs."""
    path = roundabout()
    walked, levels = beside.known_walk(path), levels_of(beside, path, moves_goal=True)
    for last in (0, 2):
        ended = walked.at_rows(np.flatnonzero(walked.segment <= last))
        slope = slope_along(beside, path, levels, ended)
        places = list(NearPlaces(beside).along(path, ended))
        model = PathModel(beside, path, levels, places, slope)
        assert np.isfinite(model.slope).all() and {place.leg for place in places} <= set(range(last + 1))
        later = levels.spread[: last + 2].sum(axis=(0, 1)) == 0
        assert later.any() and not slope[later].any()


def test_a_place_is_a_valley_that_rises_on_either_side() -> None:
    rooms_mm = np.array([1.0, 0.5, 0.6, 0.45, 0.9, 0.3, 0.31])
    assert _valleys(1e-3 * rooms_mm) == [3, 5]  # the ridge of 0.1 mm parts nothing
    assert _valleys(1e-3 * rooms_mm[::-1]) == [1, 3]
    assert _valleys(1e-3 * rooms_mm[:2]) == [1] and _valleys(np.zeros(3)) == [0]


def test_room_is_foreseen_at_limits_of_joints(beside: MotionChecker) -> None:
    """Slopes are differences on the side that is allowed, as those of the same place where there is no limit."""
    path = roundabout()
    drive = beside.scenario.robot.drive
    joint = replace(drive.joints[0], lower=-2 * np.pi, upper=float(path[:, 0].max()))
    at_limit = replace(drive, joints=(joint, *drive.joints[1:]))
    limited = MotionChecker(
        replace(beside.scenario, robot=replace(beside.scenario.robot, drive=at_limit)), reserve_m=0.0
    )
    walked = beside.known_walk(path)
    free, kept = (NearPlaces(checker).foreseen(path, path, walked) for checker in (beside, limited))
    assert free and kept and len(free) == len(kept)
    for a, b in zip(free, kept, strict=True):
        np.testing.assert_allclose(a.by_joints, b.by_joints, atol=0.05 * np.linalg.norm(a.by_joints))
    assert any((a.by_joints != b.by_joints).any() for a, b in zip(free, kept, strict=True))


def test_a_correction_mends_and_costs_no_more_than_the_least_that_does(beside: MotionChecker) -> None:
    path, rng = roundabout(), np.random.default_rng(0)
    walked = beside.known_walk(path)
    short = replace(walked, clearance_m=walked.clearance_m - walked.clearance_m.min() - 0.2e-3)
    levels = levels_of(beside, path, moves_goal=True)
    model = PathModel(beside, path, levels, list(NearPlaces(beside).along(path, short)), rng.normal(size=11 + 1))
    least, mended = model.nearest(np.zeros(model.size)), model.correction()
    assert least is not None and mended is not None and np.linalg.norm(least) > 0.05
    assert (model.rows @ mended <= model.room_mm + 1e-9).all()
    assert model.gain_mm(mended) > model.gain_mm(least)
    assert np.linalg.norm(mended) < 3 * np.linalg.norm(least)


def test_a_path_that_comes_too_close_is_put_right(case: Scenario, beside: MotionChecker) -> None:
    """Where the way round leaves 0.3 mm less than is required, which no search from there would accept."""
    path = roundabout()
    room_m = beside.known_walk(path).clearance_m.min()
    robot = replace(case.robot, model_error_m=float(room_m) + 0.3e-3)
    checker = MotionChecker(replace(beside.scenario, robot=robot), reserve_m=0.0)
    assert not checker.along(path).valid
    polish = Polish(checker, path, 0)
    assert polish.cost_mm == np.inf
    turns = iter(range(1))
    polish.run(lambda: next(turns, None) is None)
    motion = checker.along(polish.corners)
    assert motion.valid and motion.room_m < 0.3e-3
    assert checker.cost_mm(motion, ends_at_goal=True) == pytest.approx(polish.cost_mm)
    apart = np.linalg.norm((polish.corners - path) * checker.space.weights_mm, axis=1)
    assert apart.max() < 5.0  # mm: no more than it takes


def test_corrections_keep_the_places_of_those_before(beside: MotionChecker, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that mends half of what is too close: the next model has what the last had, moved, beside its own."""
    path, correction, models = roundabout(), PathModel.correction, list[PathModel]()

    def half(model: PathModel) -> Array | None:
        models.append(model)
        step = correction(model)
        return None if step is None else step / 2

    monkeypatch.setattr(PathModel, "correction", half)
    room_m = beside.known_walk(path).clearance_m.min()
    robot = replace(beside.scenario.robot, model_error_m=float(room_m) + 0.3e-3)
    Polish(MotionChecker(replace(beside.scenario, robot=robot), reserve_m=0.0), path, 0).put_right()
    assert len(models) > 2
    for before, model in itertools.pairwise(models):
        delta = (model.corners - before.corners) * beside.space.weights_mm
        kept = model.places[-len(before.places) :]
        assert len(model.places) > len(kept) > 0
        assert [place.room_mm for place in kept] == [place.moved(delta).room_mm for place in before.places]


def test_a_roundabout_way_gets_shorter_and_ends_at_the_target(case: Scenario, checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    before, costs = polish.cost_mm, [polish.cost_mm]

    def is_over() -> bool:
        costs.append(polish.cost_mm)
        return len(costs) > 300

    polish.run(is_over)
    assert costs == sorted(costs, reverse=True) and polish.cost_mm < 0.8 * before
    assert len(polish.corners) < len(roundabout()) and np.array_equal(polish.corners, merge_legs(polish.corners))
    np.testing.assert_array_equal(polish.corners[0], START)
    assert np.isfinite(goal_state(checker, polish.corners[-1]).bound_m)
    motion = checker.along(polish.corners)
    assert motion.valid and checker.cost_mm(motion, ends_at_goal=True) == pytest.approx(polish.cost_mm)


def test_a_goal_of_joints_or_of_another_s_choice_stays(case: Scenario, checker: MotionChecker) -> None:
    fixed = Polish(MotionChecker(replace(case, goal=Goal(GOAL, None, 1e-3))), roundabout(), 0)
    chosen = Polish(checker, roundabout(), 0, moves_goal=False)
    for polish in (fixed, chosen):
        turns = iter(range(60))
        polish.run(lambda turns=turns: next(turns, None) is None)  # type: ignore[misc]
        np.testing.assert_array_equal(polish.corners[-1], GOAL)


def test_a_path_that_is_over_at_once_stays_as_it_is(checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    polish.run(lambda: True)
    np.testing.assert_array_equal(polish.corners, merge_legs(roundabout()))


def test_a_path_is_polished_where_compensation_will_bring_it(case: Scenario, checker: MotionChecker) -> None:
    """The tip with friction arrives from there, the frictionless one from where it is brought back to."""
    robot, target = case.robot, case.goal.tip_m
    assert target is not None
    path = roundabout()[:-1]  # ends with a turn, which leaves friction
    path[-1] = GOAL
    other, moved = aimed(checker, path)

    def off_mm(corners: Array) -> float:
        middle = predict_end(robot, corners, start_states(case))[0].end_middle_m
        return float(np.linalg.norm(middle - target)) * MM_PER_M

    assert other is not checker and off_mm(path) > 0.2 and off_mm(moved) < TIP_TOLERANCE_M * MM_PER_M
    back = brought_to_goal(checker, moved)
    assert back is not None
    tip = robot.mechanics.tips_with_friction(*robot.drive.collars(back[-1:]), np.zeros((1, robot.n - 1))).position_m[0]
    assert np.linalg.norm(tip - target) < CLOSE_M
    to_joints = MotionChecker(replace(case, goal=replace(case.goal, tip_m=None, joints=GOAL)))
    assert aimed(to_joints, path) == (to_joints, path)


def test_the_goal_follows_friction_at_the_end_of_the_path(case: Scenario, checker: MotionChecker) -> None:
    """An aimed path is polished to where its tip with friction is at the target, a plain one to where it is not."""
    robot, target = case.robot, case.goal.tip_m
    path = roundabout()[:-1]  # ends with a turn, which leaves friction
    path[-1] = GOAL
    _, moved = aimed(checker, path)
    polished = {is_aimed: Polish(checker, moved, 0, is_aimed=is_aimed) for is_aimed in (True, False)}
    off_mm = {}
    for is_aimed, polish in polished.items():
        turns = iter(range(200))
        polish.run(lambda turns=turns: next(turns, None) is None)  # type: ignore[misc]
        middle = predict_end(robot, polish.corners, start_states(case))[0].end_middle_m
        off_mm[is_aimed] = float(np.linalg.norm(middle - target)) * MM_PER_M
    assert len(polished[True].trail) > 1 and polished[True].cost_mm < 0.9 * Polish(checker, moved, 0).cost_mm
    assert off_mm[True] <= FOLLOWED_M * MM_PER_M + LEAST_GAIN_MM and off_mm[True] < off_mm[False] / 2
    miss = Polish(checker, roundabout(), 0, is_aimed=True)
    beyond_mm = max(0.0, float(np.linalg.norm(miss_m(checker.scenario, miss.corners))) - FOLLOWED_M) * MM_PER_M
    plain_mm = Polish(checker, roundabout(), 0).cost_mm
    assert miss.cost_mm - plain_mm == pytest.approx((case.cost.error_goal + case.cost.path) * beyond_mm)


def test_the_next_aim_is_nearer_to_where_friction_takes_it(case: Scenario, checker: MotionChecker) -> None:
    """By half a millimetre at most, and anew once there is another path."""
    path = roundabout()[:-1]  # ends with a turn, which leaves friction
    path[-1] = GOAL
    polish = Polish(checker, roundabout(), 0, is_aimed=True)
    for other in (None, path):
        assert other is None or polish._takes(other)
        off_m = miss_m(checker.scenario, polish.corners)
        shift_m = polish._aim_m - frictionless_tips(case.robot, polish.corners[-1:])[0][0]
        assert np.linalg.norm(off_m) > 0.1e-3
        assert np.linalg.norm(shift_m) == pytest.approx(min(FOLLOWED_M, float(np.linalg.norm(off_m))))
        assert np.linalg.norm(off_m - shift_m) == pytest.approx(max(float(np.linalg.norm(off_m)) - FOLLOWED_M, 0.0))


def test_a_path_of_other_legs_is_aimed_anew_before_it_is_priced(
    case: Scenario, checker: MotionChecker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another last leg leaves other friction, which steps would follow too late; a small miss is left to them."""
    path, offered = roundabout()[:-1], list[Array]()
    path[-1] = GOAL
    for is_aimed, followed_m in ((False, 1e-4), (True, 1e-4), (True, 1.0)):
        monkeypatch.setattr("ctrplan.planning.search.polish.FOLLOWED_M", followed_m)
        offered.append(Polish(checker, roundabout(), 0, is_aimed=is_aimed)._aimed_anew(path))
    plain, anew, small = offered
    np.testing.assert_array_equal(plain, path)
    np.testing.assert_array_equal(small, path)
    assert np.linalg.norm(miss_m(case, anew)) < TIP_TOLERANCE_M < 1e-4 < np.linalg.norm(miss_m(case, path))


def test_a_step_that_is_dearer_only_for_where_friction_takes_its_tip_is_aimed_anew(
    case: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction at the end of the new path is another: with the tip brought back it is cheaper, and it is taken."""
    monkeypatch.setattr("ctrplan.planning.search.polish.FOLLOWED_M", 1e-4)
    strict = MotionChecker(replace(case, cost=replace(case.cost, error_goal=1000.0)))
    path, polish = roundabout()[:-1], Polish(strict, roundabout(), 0, is_aimed=True)
    path[-1] = GOAL
    before_mm = polish.cost_mm
    assert polish._priced_mm(path) < before_mm and not polish._takes(path)
    assert polish._takes_corrected(path) and polish.cost_mm < before_mm
    assert np.linalg.norm(miss_m(strict.scenario, polish.corners)) < TIP_TOLERANCE_M


TURNED = CostTerm("turned", 100.0, lambda q: np.abs(q[:, 1]))
WITHDRAWN = CostTerm("withdrawn", 1e4, lambda q: GOAL[3] - q[:, 3])


@pytest.mark.parametrize("term", [TURNED, WITHDRAWN])
def test_legs_are_divided_where_that_pays(case: Scenario, term: CostTerm) -> None:
    """Half of a turn follows an insertion during which it is dear; half of an insertion precedes a turn alike."""
    bare = replace(case, goal=Goal(GOAL, None, 1e-3), cost=replace(case.cost, error_along=0.0))
    path = np.array([START, np.append(GOAL[:3], START[3]), GOAL])
    whole, divided = Polish(MotionChecker(bare), path, 0), Polish(MotionChecker(replace(bare, terms=(term,))), path, 0)
    before_mm = divided.cost_mm
    for polish in (whole, divided):
        turns = iter(range(2))  # nothing can be left out: the first steps divide
        polish.run(lambda turns=turns: next(turns, None) is None)  # type: ignore[misc]
    np.testing.assert_array_equal(whole.corners, path)
    assert divided.cost_mm < before_mm and len(divided.corners) == 5
    is_turned, is_slid = (np.diff(divided.corners, axis=0) != 0)[:, [1, 3]].T
    assert np.array_equal(is_turned, ~is_slid)
    np.testing.assert_array_equal(divided.corners[[0, -1]], path[[0, -1]])


def test_new_legs_are_those_that_changed(checker: MotionChecker) -> None:
    polish = Polish(checker, roundabout(), 0)
    for rows in ([2], [2, 3], [5], list(range(1, 7))):
        moved = polish.corners.copy()
        moved[rows, :] += 1e-3
        np.testing.assert_array_equal(new_legs(moved, polish.corners), moved[rows[0] - 1 : rows[-1] + 2])
    shorter = np.delete(polish.corners, 3, axis=0)
    np.testing.assert_array_equal(new_legs(shorter, polish.corners), shorter[2:4])
