"""Inverse kinematics as laws: what was reached is found again, solutions are solutions, branches are connected."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_input import FUZZ
from places import SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.errors import NoAnswerError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_robot_or_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.reach import _branches, reach
from ctrplan.reports.live_state import LiveState
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.tip_solver import REACHED_M, TipSolver, TipTarget, angle_to, target_in_robot_frame
from ctrplan.storage.toml_document import read_document

ROBOTS = SCENARIOS / "robots"


def solver(name: str) -> TipSolver:
    robot = load_robot(ROBOTS / f"{name}.toml")
    return TipSolver(JointSpace.of_robot(robot), robot.mechanics)


@pytest.mark.parametrize(("name", "share"), [("three_tube", 0.9), ("table_5_pair", 0.9), ("table_1_pair", 0.9)])
def test_reachable_targets_are_reached_from_random_starts(name: str, share: float) -> None:
    solve, rng = solver(name), np.random.default_rng(3)
    tips, _ = solve.tips(solve.space.sample(rng, 150))
    found = solve.solve(TipTarget(tips), solve.space.sample(rng, 150))
    assert np.mean(found.error_m <= REACHED_M) >= share
    assert solve.space.allowed(found.joints)
    again, tangents = solve.tips(found.joints)
    np.testing.assert_allclose(found.error_m, np.linalg.norm(again - tips, axis=1), atol=1e-12)
    np.testing.assert_allclose(found.tangent, tangents, atol=1e-12)


def test_a_robot_that_only_turns_as_a_whole_reaches_a_circle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its only joint turns all tubes: no tip beside another is solved for derivatives."""
    assert main(["init", "robot", str(tmp_path / "r.toml"), "--tube", "2.64x2.39,0,150,265"]) == 0
    robot = load_robot(tmp_path / "r.toml")
    tip = robot.zero_clearance([0.7], [0]).tip_m * 1e3
    assert main(["ik", str(tmp_path / "r.toml"), "--tip-mm", *map(str, tip.tolist())]) == 0
    assert main(["ik", str(tmp_path / "r.toml"), "--tip-mm", "0", "0", "140"]) == 1
    assert "out of reach" in capsys.readouterr().err


def test_tips_are_those_of_the_shape() -> None:
    for name in ("three_tube", "three_tube_calibrated", "table_4_pair"):
        solve = solver(name)
        theta_b, l_b = solve.space.drive.collars(solve.space.sample(np.random.default_rng(1), 12))
        tips, tangents, _ = solve.mechanics.tips(theta_b, l_b)
        for row, (theta, l) in enumerate(zip(theta_b, l_b, strict=True)):  # noqa: E741
            shape = solve.mechanics.zero_clearance(theta, l)
            np.testing.assert_allclose(tips[row], shape.tip_m, atol=1e-8)
            np.testing.assert_allclose(tangents[row], shape.tip_tangent, atol=1e-7)


def test_few_states_are_probed_on_the_way_where_the_models_part() -> None:
    """Nearly every configuration between the ribs needs a second step: what the first leads to is not worth a bound."""
    checker = MotionChecker(ctrplan.load_scenario(SCENARIOS / "ribs.toml"))
    target, begun = TipTarget(target_in_robot_frame(checker.scenario)), checker.calls
    result = reach(checker, target, 1e-4, np.random.default_rng(0), 400)
    assert len(result.configurations) >= 40
    assert checker.calls - begun < 2 * len(result.configurations)


def test_jacobian_agrees_with_central_differences_and_turns_exactly() -> None:
    solve, step = solver("three_tube"), 1e-4
    q = solve.space.sample(np.random.default_rng(5), 6)
    q[:, 3] = np.clip(q[:, 3], -0.08, -0.002)
    jacobian = solve.jacobian(q, *solve.tips(q))
    for j in range(q.shape[1]):
        ahead, behind = (np.hstack(solve.tips(q + sign * step * np.eye(q.shape[1])[j])) for sign in (1, -1))
        np.testing.assert_allclose(jacobian[:, :, j], (ahead - behind) / (2 * step), rtol=2e-3, atol=2e-4)
    assert solve.common_rotation is not None
    tips, tangents = solve.tips(q)
    about_z = np.hstack([np.cross([0, 0, 1], tips), np.cross([0, 0, 1], tangents)])
    np.testing.assert_allclose(jacobian @ solve.common_rotation, about_z, atol=1e-9)


def test_direction_is_kept_within_its_tolerance() -> None:
    solve, rng = solver("three_tube"), np.random.default_rng(8)
    tip, tangent = solve.tips(solve.space.sample(rng, 1))
    target = TipTarget(tip[0], tangent[0], math.radians(4))
    found = solve.solve(target, solve.space.sample(rng, 150))
    reached = found.reached(target)
    assert reached.sum() >= 20
    assert np.degrees(angle_to(found.tangent[reached], tangent[0])).max() <= 4


def test_nested_translations_are_kept_by_a_robot_whose_tubes_all_translate() -> None:
    content = read_document(ROBOTS / "three_tube.toml").content
    del content["joint"]
    robot = robot_from_dict(content)
    space, rng = JointSpace.of_robot(robot), np.random.default_rng(2)
    solve = TipSolver(space, robot.mechanics)
    starts = space.projected(rng.uniform(-0.2, 0.1, (200, 6)), np.zeros((200, 6)) + bare_scenario(robot).start)
    assert space.allowed(starts)
    tips, _ = solve.tips(starts[:40])
    found = solve.solve(TipTarget(tips), starts[40:80])
    assert space.allowed(found.joints) and np.mean(found.error_m <= REACHED_M) > 0.5


@pytest.mark.parametrize("name", ["ribs", "three_tube"])
def test_configurations_hold_what_they_promise(name: str) -> None:
    file = ROBOTS / f"{name}.toml" if name == "three_tube" else SCENARIOS / f"{name}.toml"
    scenario = load_robot_or_scenario(file)
    checker = MotionChecker(scenario)
    target = TipTarget(scenario.base_R.T @ (np.array([0.034, -0.047, 0.2]) - scenario.base_position_m))
    found = reach(checker, target, 0.5e-3, np.random.default_rng(0))
    assert len(found.configurations) >= 5
    bounds = [c.bound_m for c in found.configurations]
    assert bounds == sorted(bounds)
    for c in found.configurations[:4]:
        bound = scenario.robot.bound(*scenario.robot.drive.collars(c.joints))
        assert np.linalg.norm(bound.frictionless.tip_m - target.tip_m) <= 0.5e-3
        assert bound.position_m == pytest.approx(c.bound_m, abs=1e-6)
        assert bound.frictionless.stability == pytest.approx(c.stability, abs=1e-4)
        assert c.valid == checker.state(c.joints).valid
    assert math.isinf(found.configurations[0].clearance_m) == (not scenario.anatomy)


def test_mirrored_target_of_a_planar_pair_has_two_branches_of_equal_bound() -> None:
    """Tubes curved in one plane: a solution's mirror image reaches the mirrored tip, so branches come in pairs."""
    content = read_document(ROBOTS / "table_5_pair.toml").content
    for tube in content["tube"]:
        for section in tube["section"]:
            section["curvature_x_per_m"] = 0
    scenario = bare_scenario(robot_from_dict(content))
    found = reach(MotionChecker(scenario), TipTarget(np.array([0.05, 0.01, 0.2])), 1e-3, np.random.default_rng(0))
    labels = found.branches()
    assert sorted(set(labels.tolist())) == [0, 1]
    best = [next(c for c, b in zip(found.configurations, labels, strict=True) if b == k) for k in (0, 1)]
    assert best[0].bound_m == pytest.approx(best[1].bound_m, rel=0.05)
    first, second = (np.diff(c.joints[:2])[0] for c in best)  # inner against outer
    assert math.remainder(first + second, 2 * math.pi) == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize("name", ["table_5_pair", "table_1_pair", "three_tube"])
def test_every_branch_of_a_multi_start_is_found(name: str) -> None:
    """Solves from four times as many other starts lead to no branch that is not known."""
    robot = load_robot(ROBOTS / f"{name}.toml")
    space, rng = JointSpace.of_robot(robot), np.random.default_rng(12)
    drawn = space.sample(rng, 3 if FUZZ else 2)
    tips = robot.mechanics.tips_with_friction(
        *robot.drive.collars(drawn), np.zeros((len(drawn), robot.n - 1))
    ).position_m
    for tip in tips:
        target, checker = TipTarget(tip), MotionChecker(bare_scenario(robot))
        known, more = (reach(checker, target, 1e-4, np.random.default_rng(k), 400 * k) for k in (1, 4))
        assert known.configurations
        together = replace(known, configurations=known.configurations + more.configurations).branches()
        count = len(known.configurations)
        assert set(together[count:].tolist()) <= set(together[:count].tolist())


@pytest.mark.parametrize("seed", [0, 2])
def test_a_branch_at_the_end_of_a_joint_is_found_though_the_first_step_leads_away(seed: int) -> None:
    """The outer tube starts at its limit of 180 deg and is turned back by 17 deg for the clearance of the tubes."""
    scenario = load_robot_or_scenario(SCENARIOS / "ribs.toml")
    found = ctrplan.inverse_kinematics(scenario, scenario.goal.tip_m, seed=seed)
    assert len(set(found.branches)) == 2
    assert max(c.joints[0] for c in found.configurations) > math.radians(160)


def test_branches_do_not_depend_on_the_order_of_configurations() -> None:
    solve, rng = solver("three_tube"), np.random.default_rng(3)
    tip = solve.tips(solve.space.sample(rng, 1))[0]
    solutions = solve.solve(TipTarget(tip[0]), solve.space.sample(rng, 60))
    q = solutions.joints[solutions.error_m <= REACHED_M]
    labels, order = _branches(solve, TipTarget(tip[0]), q), rng.permutation(len(q))
    again = _branches(solve, TipTarget(tip[0]), q[order])
    assert len(set(zip(labels[order].tolist(), again.tolist(), strict=True))) == len(set(labels.tolist()))
    assert labels[0] == 0 and list(dict.fromkeys(labels.tolist())) == list(range(labels.max() + 1))


def test_ik_prints_a_table_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["ik", str(ROBOTS / "table_5_pair.toml"), "--tip-mm", "50", "10", "200", "--tolerance-mm", "1"]
    assert main(arguments) == 0
    table = capsys.readouterr().out.splitlines()
    assert "2 configurations in 2 branches" in table[0] and "rotate inner (deg)" in table[1] and len(table) == 5
    assert main([*arguments, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["reachable"] and content["branches"] == 2
    for entry in content["configurations"]:
        assert math.dist(entry["tip_mm"], [50, 10, 200]) == pytest.approx(entry["tip_error_mm"], abs=1e-3)
        assert entry["valid"] and entry["bound_position_mm"] > 0 and entry["clearance_mm"] is None


@pytest.mark.parametrize(
    ("extra", "code", "words"),
    [
        (["--tip-mm", "300", "0", "100"], 1, r"out of reach, the nearest tip found is \d+ mm away at \["),
        (["--tip-mm", "nan", "0", "100"], 2, "--tip-mm = nan mm: must be a number from"),
        (["--tip-mm", "0", "0", "100", "--direction", "0", "0", "0"], 2, "--direction.*zero"),
        (["--tip-mm", "0", "0", "100", "--tolerance-mm", "0"], 2, "--tolerance-mm"),
        (["--tip-mm", "0", "0", "100", "--starts", "0"], 2, "--starts"),
        (["--tip-mm", "0", "0", "100", "--direction-tolerance-deg", "3"], 2, "goes with --direction"),
        (["--tip-mm", "50", "10", "200", "--direction", "0", "0", "-1"], 1, "deg from --direction"),
    ],
)
def test_ik_refusals_are_one_sentence(
    extra: list[str], code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ik", str(ROBOTS / "table_5_pair.toml"), "--tolerance-mm", "1", *extra]) == code
    sentence = capsys.readouterr().err.strip()
    assert sentence.count("\n") == 0
    assert re.search(words, sentence), sentence


def test_the_command_keeps_the_limits_that_the_live_view_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the little more clearance that a search keeps."""
    asked = []

    def reach(checker: MotionChecker, *_: object) -> None:
        asked.append(checker.limits)
        raise NoAnswerError("enough")

    monkeypatch.setattr("ctrplan.planning.inverse_kinematics.reach", reach)
    file = str(ROBOTS / "three_tube.toml")
    assert main(["ik", file, "--tip-mm", "34", "-47", "200"]) == 1
    assert asked == [LiveState(load_robot_or_scenario(file)).checker.limits]
