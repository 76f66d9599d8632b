"""Arrival: the set of friction states along a motion, what it adds up to, how plans end and what they claim."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shlex
import signal
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arriving_pair import (
    GOAL,
    PATH,
    SHORT,
    START,
    TURNED_LAST,
    arrival,
    arrival_of,
    certified,
    pair,
    plain_arrival,
)
from made_up_input import FUZZ
from places import SCENARIOS
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.__main__ import main
from ctrplan.certificate import arrival as arrivals
from ctrplan.certificate.arrival import friction_variants
from ctrplan.certificate.certificate import Certificate, joined_certificates
from ctrplan.certificate.certify import certify
from ctrplan.certificate.other_equilibria import _windings, other_start
from ctrplan.commands import plan as plan_command
from ctrplan.commands.plan import Command, _replanned
from ctrplan.commands.terminal import ProgressBar
from ctrplan.drive.drive import ExecutionTolerance
from ctrplan.files.file_content import base_key
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.friction import FrictionLaw
from ctrplan.mechanics.history import HistoryOptions
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.base_pose import BaseFrame, as_written
from ctrplan.planning.compensate import compensate
from ctrplan.planning.endings import Settled, erase
from ctrplan.scenario.prediction import TIP_TOLERANCE_M, ball_centre, predict, predict_end, start_states, step_error
from ctrplan.scenario.scenario import CostTerm, Registration


def test_shares_add_up_and_states_are_erased_by_slip() -> None:
    long, short = plain_arrival(), plain_arrival(SHORT)
    for found in (long, short):
        assert found.error_m == pytest.approx(found.by_cause.total_m)
        assert sum(share for _, share in found.by_cause.ranked) == pytest.approx(found.error_m)
    assert long.spread_m < 1e-6 and long.erased[0].leg == 0 and long.erased[0].kept < 0.01
    assert short.spread_m > 1e-3 and short.erased[0].leg is None and short.erased[0].kept > 0.5
    assert long.by_cause.past_m < 1e-6 < short.by_cause.past_m


def test_an_arrival_keeps_a_goal_whose_tolerance_is_no_less_than_its_error() -> None:
    """A valid certificate does not say that: its middle arrives."""
    found, goal = plain_arrival(), pair().goal
    assert found.keeps(replace(goal, tolerance_m=found.error_m))
    assert not found.keeps(replace(goal, tolerance_m=0.99 * found.error_m))
    assert not replace(found, error_rad=0.2).keeps(replace(goal, tolerance_m=1.0, direction_tolerance_rad=0.1))


def test_the_set_along_the_motion_is_in_the_samples() -> None:
    samples = certified(PATH).samples
    assert samples.friction_spread.shape == (len(samples.leg), 1)
    assert samples.friction_spread[0, 0] == pytest.approx(1.0) and samples.friction_spread[-1, 0] < 1e-3
    assert np.all(samples.spread_m <= samples.bound_m + TIP_TOLERANCE_M)
    assert np.all(samples.spread_m[samples.leg == 1] < 1e-5)


def test_the_share_of_steps_covers_what_finer_steps_change() -> None:
    """Histories of a sixteenth of the steps end within it, whether the past is erased or not; it is no fixed length."""
    case, shares = pair(), list[float]()
    finer = HistoryOptions(rotation_rad=0.05 / 16, translation_m=0.5e-3 / 16, state_change=0.05 / 16)
    for path in (PATH, SHORT, np.array([START, GOAL])):
        starts = start_states(case)
        joints = np.vstack([path[:1], *(np.linspace(a, b, 40)[1:] for a, b in itertools.pairwise(path))])
        coarse, ends = predict_end(case.robot, joints, starts)
        shares.append(step_error(case.robot, joints, ends, starts))
        for start, tip in zip(starts, coarse.tip_m[:, -1], strict=True):
            history = case.robot.history(start, options=finer)  # type: ignore[arg-type]
            assert np.linalg.norm(history.follow(*case.robot.drive.collars(joints)).position_m[-1] - tip) <= shares[-1]
    assert max(shares) < TIP_TOLERANCE_M


def test_fewer_states_before_never_arrive_worse() -> None:
    unknown, released = plain_arrival(SHORT), arrival(pair('start.friction="released"'), SHORT)
    assert released.spread_m == 0 and released.error_m <= unknown.error_m
    assert unknown.restart == 0 and released.restart is None  # an interrupted run needs the start as stated


def test_stages_go_on_with_the_states_that_the_one_before_left() -> None:
    case = pair()
    first = certify(replace(case, goal=replace(case.goal, tip_m=None, joints=PATH[1])), PATH[:2])
    second = certify(replace(case, start=PATH[1]), PATH[1:], starts=first.end_states)
    whole, tour = certified(PATH), joined_certificates([first, second])
    assert tour.arrival is not None and whole.arrival is not None
    np.testing.assert_allclose(tour.arrival.middle_m, whole.arrival.middle_m, atol=TIP_TOLERANCE_M)
    assert tour.arrival.erased[0].leg == whole.arrival.erased[0].leg == 0
    apart = certify(replace(case, start=PATH[1]), PATH[1:])  # nothing is known of the leg before
    assert apart.arrival is not None and apart.samples.friction_spread[0, 0] == pytest.approx(1.0)


def test_a_run_begun_again_at_the_restart_arrives_as_well() -> None:
    case = pair()
    found = plain_arrival()
    assert found.restart == 1  # the last translation is long
    tips = predict(case.robot, PATH[found.restart :], start_states(case)).tip_m[:, -1]
    assert np.linalg.norm(tips - found.middle_m, axis=1).max() <= TIP_TOLERANCE_M


def test_what_is_stated_counts() -> None:
    case, plain = pair(), plain_arrival()
    located = replace(case, registration=Registration(position_sigma_m=1e-3))
    assert arrival(located).by_cause.registration_m == pytest.approx(2.795483e-3)
    remembered = replace(case, robot=replace(case.robot, friction_memory=0.2))
    kept = arrival(remembered)
    assert kept.error_m - plain.error_m == pytest.approx(kept.by_cause.memory_m) and kept.by_cause.memory_m > 0.5e-3
    unexplained = replace(case, robot=replace(case.robot, model_error_m=0.3e-3))
    assert arrival(unexplained).by_cause.unexplained_m == 0.3e-3


def test_execution_counts_by_the_drives_tolerance() -> None:
    case, shares = pair(), []
    for factor in (0.0, 1.0, 5.0):
        tolerance = ExecutionTolerance(np.radians(0.2) * factor, 0.05e-3 * factor)
        drive = replace(case.robot.drive, execution=tolerance)
        shares.append(arrival(replace(case, robot=replace(case.robot, drive=drive)), TURNED_LAST).by_cause.execution_m)
    assert shares[0] == 0 < shares[1] < shares[2]
    exact = pair("robot.execution.rotation_deg=0", "robot.execution.translation_mm=0")
    assert exact.robot.drive.execution == ExecutionTolerance(0.0, 0.0)


def test_coefficients_anywhere_in_their_interval_arrive_inside() -> None:
    case = pair("robot.contact.1.friction_coefficient=[0.1, 0.3]")
    certificate, exact = certify(case, TURNED_LAST), plain_arrival(TURNED_LAST)
    found = arrival_of(certificate)
    assert len(friction_variants(case.robot)) == 3 and not friction_variants(pair().robot)
    assert found.by_cause.coefficients_m > 1e-3 and exact.by_cause.coefficients_m == 0
    rng = np.random.default_rng(3)
    for mu in rng.uniform(0.1, 0.3, 6):
        contact = replace(case.robot.contacts[0], friction_coefficient=(mu, mu))
        tip = predict(replace(case.robot, contacts=(contact,)), TURNED_LAST, ["released"]).tip_m[0, -1]
        away = np.linalg.norm(case.base_R @ tip + case.base_position_m - case.goal.tip_m)
        assert away <= found.error_m
    middle = compensate(MotionChecker(case), TURNED_LAST, certificate).certificate.arrival
    assert middle is not None and middle.by_cause.offset_m < 0.1e-3 and middle.error_m < 0.75 * found.error_m


@cache
def short_ended() -> tuple[Certificate, Settled]:
    """A turn too short to erase anything, certified, and with an ending that does; nobody changes them."""
    case = replace(pair(), start=SHORT[0])
    before = certify(case, SHORT)
    return before, erase(MotionChecker(case), SHORT, before)


def test_an_ending_erases_what_the_path_does_not() -> None:
    before, ended = short_ended()
    assert before.arrival is not None and ended.certificate.arrival is not None
    assert ended.certificate.valid and ended.certificate.arrival.spread_m < 1e-5 < before.arrival.spread_m
    np.testing.assert_allclose(ended.corners[-1], SHORT[-1], atol=1e-12)
    assert "mm of cost" in ended.note and len(ended.corners) > len(SHORT)
    already = certified(PATH)
    assert erase(MotionChecker(pair()), PATH, already).corners is PATH


def test_endings_heed_terms_of_the_cost() -> None:
    """A term that is dear where the cheapest ending goes leads to another one."""
    case = replace(pair(), start=SHORT[0])
    usual = short_ended()[1].corners
    turned = usual[len(SHORT)] - SHORT[-1]  # where the first leg of the ending leads

    def beyond(states: np.ndarray) -> np.ndarray:
        return np.maximum(0.0, (states - SHORT[-1]) @ turned) / (turned @ turned)

    dear = replace(case, terms=(CostTerm("beyond", 1000.0, beyond),))
    other = erase(MotionChecker(dear), SHORT, certify(dear, SHORT)).corners
    assert len(other) > len(SHORT) and beyond(other[len(SHORT) :]).max() < 0.1 < beyond(usual[len(SHORT) :]).max()


def test_where_no_ending_is_allowed_the_larger_set_is_said() -> None:
    """A drive that can neither turn far enough nor slide."""
    case = replace(pair(), start=SHORT[0])
    low, high = np.minimum(*SHORT) - 0.01, np.maximum(*SHORT) + 0.01
    joints = [replace(j, lower=a, upper=b) for j, a, b in zip(case.robot.drive.joints, low, high, strict=True)]
    joints[2] = replace(joints[2], lower=GOAL[2] - 1e-4, upper=GOAL[2] + 1e-4)
    drive = replace(case.robot.drive, joints=tuple(joints))
    locked = replace(case, robot=replace(case.robot, drive=drive))
    ended = erase(MotionChecker(locked), SHORT, certify(locked, SHORT))
    assert ended.corners is SHORT and "No ending within limits and margins makes tubes 1-2 slip" in ended.note


def test_the_friction_law_carries_the_ends_of_the_interval() -> None:
    law, rng = FrictionLaw(np.array([0.5, 0.8]), np.array([1e-3, np.inf])), np.random.default_rng(0)
    for _ in range(20 if FUZZ else 6):
        theta, slide = np.zeros((6, 3)), np.zeros((6, 3))
        turns = rng.uniform(-1, 1, (5, 3)) * rng.integers(0, 2, (5, 1))
        theta[1:], slide[1:, 2] = np.cumsum(turns, axis=0), np.cumsum(rng.uniform(0, 1e-3, 5) * ~turns.any(axis=1))
        fine = np.linspace(0, 5, 400)
        rows = [np.stack([np.interp(fine, range(6), c) for c in part.T], axis=1) for part in (theta, slide)]
        ends = law.follow(*rows, np.array([[-1.0, -1.0], [1.0, 1.0]]))[-1]
        np.testing.assert_allclose(law.unknown_after(np.ones(2), theta, slide), (ends[1] - ends[0]) / 2, atol=0.01)
    assert np.all(law.unknown_after(np.zeros(2), theta, slide) == 0)


def test_the_smallest_ball_holds_all_points() -> None:
    rng = np.random.default_rng(1)
    for count in (1, 2, 5, 40):
        points = rng.normal(size=(count, 3))
        centre = ball_centre(points)
        radius = np.linalg.norm(points - centre, axis=1).max()
        for _ in range(30):
            other = np.linalg.norm(points - centre - rng.normal(scale=0.1, size=3), axis=1).max()
            assert radius <= other + 0.01 * max(radius, 1e-9)


@pytest.fixture(scope="module")
def planned() -> ctrplan.Plan:
    return ctrplan.plan(pair("planner.time_s=0.2"))


def test_plans_are_compensated_and_say_where_they_arrive(planned: ctrplan.Plan) -> None:
    found, compensation = planned.certificate.arrival, planned.compensation
    assert found is not None and compensation is not None and found.by_cause.offset_m < TIP_TOLERANCE_M
    assert compensation.error_with_m == pytest.approx(found.error_m)
    assert planned.certificate.recheck().is_confirmed


def test_random_pasts_arrive_inside_the_claim(planned: ctrplan.Plan) -> None:
    """A small sample of benchmarks/run.py arrival hunt."""
    robot, found = planned.scenario.robot, planned.certificate.arrival
    assert found is not None and planned.scenario.goal.tip_m is not None
    rng, start = np.random.default_rng(5), planned.waypoints[0]
    for _ in range(8):
        before = start + np.array([*rng.uniform(-3, 3, 2), 0.0]) * rng.choice([0.1, 1.0])
        rows = np.array([before, start, *planned.waypoints[1:]])
        tip = robot.history().follow(*robot.drive.collars(rows)).position_m[-1]
        located = planned.scenario.base_R @ tip + planned.scenario.base_position_m
        assert np.linalg.norm(located - planned.scenario.goal.tip_m) <= found.error_m


def test_windings_are_as_far_as_joints_have_room_for() -> None:
    """Whole turns of the inner tube, and the outer one to either limit."""
    robot = pair().robot
    unlimited = int(robot.drive.is_unlimited.sum())
    turns = np.array(_windings(robot, START))[:, 0] / np.pi
    assert unlimited and all(min(abs(turns - whole)) < 1e-9 for whole in (-2, 2))
    outer = robot.drive.names.index("rotate outer")
    ends = [robot.drive.lower[outer], robot.drive.upper[outer]] - START[outer]
    assert all(min(abs(turns - end / np.pi)) < 1e-9 for end in ends)
    inside = load_scenario(SCENARIOS / "vessel.toml").robot
    outer = inside.drive.names.index("rotate outer")
    assert not inside.drive.is_unlimited[outer] and len(_windings(inside, np.zeros(len(inside.drive.names)))) == 8


def test_a_robot_that_may_be_wound_up_is_refused_at_its_start() -> None:
    """Friction and joints the same, and another shape: bound 9 mm, where a past with a whole turn is elsewhere."""
    bent = [
        f"robot.tube.{i}.section.{k}.curvature_y_per_m={curvature}" for i, k, curvature in ((1, 2, 3.471), (2, 2, 60.0))
    ]
    case = load_scenario(SCENARIOS / "pair_free.toml", bent)
    wound = [q for q in np.radians(np.arange(90, 180, 15)) if other_start(case, np.array([0.0, q, -0.02]))]
    assert wound
    with pytest.raises(ctrplan.NoAnswerError, match="another stable equilibrium with clearance and friction"):
        ctrplan.plan(replace(case, start=np.array([0.0, wound[0], -0.02])), time_s=0.3)


def test_simulate_reads_the_trajectory_as_it_is(planned: ctrplan.Plan, tmp_path: Path) -> None:
    planned.save(tmp_path / "plan", ["csv"])
    header = (tmp_path / "plan" / "trajectory.csv").read_text().splitlines()[0].split(",")
    assert header[-3:] == ["leg", "erases", "restart"]
    robot, lines = SCENARIOS / "robots" / "table_5_pair.toml", (tmp_path / "plan" / "trajectory.csv").read_text()
    (tmp_path / "some.csv").write_text("".join(lines.splitlines(keepends=True)[::8]))  # with the header
    assert main(["simulate", str(robot), str(tmp_path / "some.csv"), "-o", str(tmp_path / "sim")]) == 0
    table = np.genfromtxt(tmp_path / "plan" / "trajectory.csv", delimiter=",", names=True)
    assert table["restart"].sum() == 1 and set(table["leg"]) == set(range(1, len(planned.legs) + 1))
    assert planned.certificate.arrival is not None
    erasing = planned.certificate.arrival.erased[0].leg
    assert erasing is not None and set(table["leg"][table["erases"] == 1]) == {erasing + 1}


def test_a_path_of_someone_elses_leads_from_start_to_goal() -> None:
    """Paths that began elsewhere, ended elsewhere or missed the direction were certified."""
    case = load_scenario(SCENARIOS / "pair_free.toml")
    there = replace(case, start=START, goal=replace(case.goal, joints=GOAL))
    assert ctrplan.reorder(PATH, there).certificate.valid
    for path, words in ((PATH + [0.1, 0, 0], "must begin at the scenario's start"), (PATH[:2], "must end at the")):
        with pytest.raises(ctrplan.InputError, match=words):
            ctrplan.reorder(path, there)
    aimed = replace(pair(), start=START)
    direction = np.array([0.0, 1.0, 0.0])
    aimed = replace(aimed, goal=replace(aimed.goal, direction=direction, direction_tolerance_rad=0.05))
    with pytest.raises(ctrplan.InputError, match="deg off"):
        ctrplan.reorder(PATH, aimed)


INTERVALS = ("[0.3, 0.1]", "[0.2]", "[0.1, 0.2, 0.3]", "[-0.1, 0.2]", "[nan, 0.2]", "[]", "['a', 0.2]")


@pytest.mark.parametrize("interval", INTERVALS)
def test_an_interval_of_friction_that_is_none_is_refused(interval: str) -> None:
    with pytest.raises(ctrplan.InputError, match=r"contact\.1\.friction_coefficient.* must be a .*number"):
        load_scenario(SCENARIOS / "pair_free.toml", [f"robot.contact.1.friction_coefficient={interval}"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ('planner.settle="sometimes"', "planner.settle = 'sometimes': must be one of auto, none, oscillate"),
        ("planner.settle=true", "must be one of auto, none, oscillate"),
        ("robot.friction_memory=1.5", "friction_memory = 1.5: must be from 0 to 1"),
        ("robot.execution.rotation_deg=-1", "execution.rotation_deg = -1 deg: must be from 0 to"),
        ("robot.execution.rotation=0.2", r"unknown key, expected rotation_deg \(in deg\)"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(override: str, words: str) -> None:
    with pytest.raises(ctrplan.InputError, match=words):
        load_scenario(SCENARIOS / "pair_free.toml", [override])


def amber(folder: Path) -> list[str]:
    """A command whose plan may miss its target."""
    tip = (pair().goal.tip_m * 1e3).round(3).tolist()
    given = ["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(folder), "--quiet", "--no-report"]
    keys = (f"goal={{tip_mm={tip}, tolerance_mm=0.06}}", "base.position_sigma_mm=0.5", "planner.time_s=0.2")
    return given + [word for key in keys for word in ("--set", key)]


def line_of(text: str, what: str) -> tuple[float, list[str]]:
    """The number and the words to type of a lever."""
    (line,) = [line for line in text.splitlines() if f"{what}: ctrplan" in line]
    return float(line.split()[0]), shlex.split(line.split(f"{what}: ")[1])[1:]


def test_a_line_to_type_is_what_its_number_was_computed_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_command, "LEVERS_S", 0.01)  # of the second run, whose levers nobody reads
    keys = tuple(word for word in amber(tmp_path) if "=" in word)
    command = Command(str(SCENARIOS / "pair_free.toml"), keys, 3, is_compensated=False, allow_outside=False)
    better = command.with_keys("goal.tolerance_mm=0.07", "planner.time_s=0.1")
    assert sum(text.startswith("planner.time_s") for text in better.overrides) == 1
    error_m, _, same = _replanned(better)
    # The search is counted: its time is a key.
    given = argparse.Namespace(output=tmp_path / "a b", time=5.0, no_report=True)
    assert same is better and main([*shlex.split(better.line(given))[1:], "--quiet"]) == 3
    content = json.loads((tmp_path / "a b" / "plan.json").read_text())
    assert content["certificate"]["arrival"]["error_m"] == pytest.approx(error_m, rel=1e-9)
    assert content["seed"] == 3 and content["compensation"] is None


def test_levers_end_in_time_and_say_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_command, "LEVERS_S", 0.01)
    assert main(amber(tmp_path)) == 3  # a safe plan was written, which may miss its target
    text = capsys.readouterr().out
    assert "may end" in text and (tmp_path / "plan.json").exists()
    assert "not computed (not within 0.01 s): another path and goal state, another base" in text
    off_mm, line = line_of(text, "a registration twice as good")
    assert off_mm > 0 and "base.position_sigma_mm=0.25" in line
    assert main([*shlex.split(text.split("another tolerance: ")[1].splitlines()[0])[1:], "--quiet"]) == 0


def test_ctrl_c_during_the_levers_keeps_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    show = ProgressBar.show

    def pressing(bar: ProgressBar, stage: str, fraction: float, note: str = "") -> None:
        show(bar, stage, fraction, note)
        if stage == "what would help" and fraction < 0.5:
            assert (tmp_path / "plan.json").exists()
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ProgressBar, "show", pressing)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(amber(tmp_path)) == 3
    finally:
        signal.signal(signal.SIGINT, previous)
    assert "not computed (interrupted): another path and goal state, another base" in capsys.readouterr().out
    assert json.loads((tmp_path / "plan.json").read_text())["certificate"]["valid"] is True


def test_a_base_may_be_set_by_one_key() -> None:
    case, rng = load_scenario(SCENARIOS / "vessel.toml", ["base.position_sigma_mm=0.5"]), np.random.default_rng(0)
    for R in Rotation.random(3, rng).as_matrix():
        pose = as_written(BaseFrame(rng.uniform(-0.1, 0.1, 3), R))  # as all that are tried
        there = load_scenario(SCENARIOS / "vessel.toml", [base_key(case, pose)])
        np.testing.assert_array_equal(there.base_position_m, pose.position_m)
        np.testing.assert_array_equal(there.base_R, pose.R)
        assert there.registration == case.registration


def test_a_detour_counts_as_if_it_were_driven_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inexact execution is simulated until it is forgotten: the rest of the motion adds nothing."""
    for path in (PATH, TURNED_LAST):
        short = plain_arrival(path).by_cause.execution_m
        with monkeypatch.context() as patched:
            patched.setattr(arrivals, "COMPARED_EVERY", 10_000)
            whole = arrival(pair(), path).by_cause.execution_m
        assert short == pytest.approx(whole, abs=0.1 * TIP_TOLERANCE_M)


@pytest.mark.parametrize(("rest", "is_forgotten"), [([0.0, 0.0, 2e-4], False), ([1.5, 0.0, 0.0], True)])
def test_a_detour_ends_where_its_own_history_does(rest: list[float], is_forgotten: bool) -> None:
    """What is left of it after the rest of the motion; nothing where that slips far enough."""
    robot = pair().robot
    turn = np.linspace(GOAL - [0.0, 0.5, 0.0], GOAL, 6)
    joints = np.vstack([turn, turn[-1] + np.linspace(0, 1, 3 * arrivals.COMPARED_EVERY)[1:, None] * rest])
    row, beyond = len(turn) - 1, np.array([0.0, 0.4, 0.0])
    prediction, _ = predict_end(robot, joints, ["released"], keep=[row])
    (state,) = (state for kept, state in prediction.states if kept == row)
    detour = np.array([GOAL + beyond, GOAL])
    end_m = arrivals._end_of(robot, joints, prediction, state, detour, row)
    history = robot.history(accuracy=prediction.accuracy)
    history.restore(state)
    whole = history.follow(*robot.drive.collars(np.vstack([detour, joints[row + 1 :]])))
    np.testing.assert_allclose(end_m, whole.position_m[-1], atol=TIP_TOLERANCE_M)
    away_m = float(np.linalg.norm(end_m - prediction.tip_m[0, -1]))
    assert away_m < TIP_TOLERANCE_M if is_forgotten else away_m > 10 * TIP_TOLERANCE_M
