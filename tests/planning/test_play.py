"""Play of the drive in plans: what it may move the robot by, the margins it takes, and the certificate that says so."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify
from ctrplan.drive.legs import Collars, distance_from_polyline
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.limits import search_limits
from ctrplan.motion.play import play_reach, play_shift, play_turn
from ctrplan.pipeline.chain import Chain
from ctrplan.planning.inverse_kinematics import inverse_kinematics
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_words import certificate_in_words
from ctrplan.robot.robot import Robot
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.tip_solver import angle_to
from ctrplan.uncertainty.tip_slopes import friction_states

WIDTHS = {"theta_2_deg": 4.0, "theta_3_deg": 3.0, "l_3_mm": 1.0}


def three_tube(scale: float = 1.0, **widths: float) -> Robot:
    given = [f"effects.backlash.{name}={scale * width}" for name, width in (widths or WIDTHS).items()]
    return load_robot(SCENARIOS / "robots" / "three_tube.toml", given)


def configurations(robot: Robot) -> list[tuple[Array, Array]]:
    rng = np.random.default_rng(2)
    thetas = rng.uniform(-1.0, 1.0, (6, 3))  # far from snapping
    return [
        (theta, np.array([0.0, -0.017, l_3])) for theta, l_3 in zip(thetas, rng.uniform(-0.1, -0.04, 6), strict=True)
    ]


def test_a_drive_without_play_moves_nothing() -> None:
    robot = load_robot(SCENARIOS / "robots" / "three_tube.toml")
    assert robot.drive.play is None
    assert all(play_shift(robot, *q) == 0.0 for q in configurations(robot))


def test_widths_of_zero_move_nothing() -> None:
    """Once a robot file whose backlash was 0 ended every bound and plan in an error of a library."""
    robot = three_tube(0.0)
    assert robot.drive.play is not None and not robot.drive.play.any()
    for q in configurations(robot):
        assert play_shift(robot, *q) == play_reach(robot, *q) == play_turn(robot, *q) == 0.0


def test_a_way_to_a_point_is_never_worse_than_it_says() -> None:
    """Once play of the drive counted in plans and in the live view, and in no study, base pose or tube design."""
    robot = three_tube()
    there = robot.solve([0, 1, 2], [0, -0.017, -0.06])
    target, along = there.tip_m, there.tubes[-1].frames[-1][:, 2]
    assert robot.drive.play is not None
    theta_off, l_off = np.split(robot.drive.play[0], 2)
    ways = inverse_kinematics(robot, target, along, direction_tolerance_rad=0.3, starts=40).valid
    rng = np.random.default_rng(4)
    for way in ways[:3]:
        theta, l = robot.drive.collars(way.joints)  # noqa: E741
        off_m = list[float]()
        for a, b in np.sign(rng.uniform(-1, 1, (8, 2, 3))):
            corners = robot.bound(theta + a * theta_off, l + b * l_off).corners
            off_m += [float(np.linalg.norm(corner.tip_m - target)) for corner in corners]
        off_rad = [angle_to(c.tubes[-1].frames[-1][None, :, 2], along)[0] for c in robot.bound(theta, l).corners]
        assert way.tip_error_m + way.bound_m < max(off_m) <= 1.02 * way.worst_m
        assert max(off_rad) <= 1.001 * way.worst_rad
    assert ways


def test_no_place_within_the_play_is_farther_away() -> None:
    robot = three_tube()
    assert robot.drive.play is not None
    theta_off, l_off = np.split(robot.drive.play[0], 2)
    np.testing.assert_allclose(np.degrees(theta_off), [0, 2, 1.5])
    np.testing.assert_allclose(l_off, [0, 0, 0.5e-3])
    rng = np.random.default_rng(3)
    for theta_b, l_b in configurations(robot):
        shift, here = play_shift(robot, theta_b, l_b), robot.solve(theta_b, l_b).tip_m
        sides = rng.uniform(-1, 1, (12, 2, 3))
        sides[:8] = np.sign(sides[:8])
        tips = [robot.solve(theta_b + a * theta_off, l_b + b * l_off).tip_m for a, b in sides]
        assert 0 < np.linalg.norm(np.array(tips) - here, axis=1).max() <= 1.02 * shift


@pytest.mark.parametrize("name", WIDTHS)
def test_the_play_of_one_actuator_moves_the_tip_by_the_shift_at_one_end_of_it(name: str) -> None:
    robot = three_tube(**{name: WIDTHS[name]})
    assert robot.drive.play is not None
    theta_off, l_off = np.split(robot.drive.play[0], 2)
    for theta_b, l_b in configurations(robot):
        here = robot.solve(theta_b, l_b).tip_m
        ends = [robot.solve(theta_b + side * theta_off, l_b + side * l_off).tip_m for side in (1, -1)]
        assert play_shift(robot, theta_b, l_b) == pytest.approx(np.linalg.norm(ends - here, axis=1).max(), rel=1e-6)


def test_the_shift_is_in_proportion_to_small_play_and_adds_up_over_actuators() -> None:
    whole, half = three_tube(0.2), three_tube(0.1)
    single = [three_tube(0.2, **{name: width}) for name, width in WIDTHS.items()]
    for q in configurations(whole):
        shift = play_shift(whole, *q)
        assert play_shift(half, *q) == pytest.approx(shift / 2, rel=0.05)
        assert sum(play_shift(robot, *q) for robot in single) == pytest.approx(shift, rel=1e-6)


def test_the_reach_of_play_is_what_driving_to_both_ends_gives_where_effects_act_on_it() -> None:
    """It was added after the drive's effects, so that an eccentricity behind it never acted on it."""
    given = ["effects.backlash.theta_3_deg=10.0", "effects.eccentricity.sin_3_deg=30.0"]
    robot = load_robot(SCENARIOS / "robots" / "three_tube.toml", given)
    chain, ways = Chain.of(robot), np.array([[0, 0, -1.0, 0, 0, 0], [0, 0, 1.0, 0, 0, 0]])
    for theta, l in configurations(robot):  # noqa: E741 (as in the equations)
        driven = chain.drive(Collars(np.tile(theta, (2, 1)), np.tile(l, (2, 1))), ways)
        here = robot.mechanics.body(*robot.collars(theta, l))[0]
        ends = [robot.mechanics.body(*end)[0] for end in zip(driven.theta, driven.l, strict=True)]
        apart = [[max(np.linalg.norm(b[-1] - a[-1]), distance_from_polyline(b, a).max())
                  for a, b in zip(here, end, strict=True)] for end in ends]  # fmt: skip
        assert play_shift(robot, theta, l) == pytest.approx(np.max(apart, axis=0)[0], rel=1e-9)
        assert play_reach(robot, theta, l) == pytest.approx(np.max(apart), rel=1e-9)
        tangents = [[robot.solve(*at, phi).tip_tangent for phi in friction_states(robot)]
                    for at in (robot.collars(theta, l), *zip(driven.theta, driven.l, strict=True))]  # fmt: skip
        turned = [np.arccos(np.clip(np.sum(np.multiply(tangents[0], end), axis=1), -1, 1)) for end in tangents[1:]]
        assert play_turn(robot, theta, l) == pytest.approx(np.max(turned), rel=1e-6)


def test_the_command_says_what_play_adds(capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--theta-deg", "0", "90", "180", "--l-mm", "0", "-17", "-62.8"]
    call = ["bound", str(SCENARIOS / "robots" / "three_tube.toml"), *where, "--accuracy", "search"]
    assert main([*call, "--json"]) == 0 and json.loads(capsys.readouterr().out)["play_mm"] == 0.0
    assert main(call) == 0 and "play" not in capsys.readouterr().out
    given = ["--set", "effects.backlash.theta_3_deg=4"]
    assert main([*call, *given]) == 0 and "play of the drive may move it by" in capsys.readouterr().out
    assert main([*call, *given, "--json"]) == 0 and json.loads(capsys.readouterr().out)["play_mm"] > 0.5


def certified(robot: Robot) -> tuple[Scenario, Certificate]:
    scenario = replace(load_scenario(SCENARIOS / "ribs.toml"), robot=robot)
    turn = np.radians([0.0, 5.0, -7.0, 0.0])
    return scenario, certify(scenario, np.array([scenario.start, scenario.start + turn]), accuracy="certificate")


def test_a_certificate_has_the_play_in_every_clearance_and_says_so() -> None:
    (tight, plain), (loose, found) = certified(three_tube(1e-9)), certified(three_tube())
    samples, bare = found.samples, plain.samples
    np.testing.assert_allclose(samples.bound_m, bare.bound_m)  # friction is another matter
    ends = [play_shift(loose.robot, *loose.robot.drive.collars(q)) for q in samples.joints[[0, -1]]]
    assert found.worst_play_m >= 0.98 * max(ends) and max(ends) > 0.5e-3
    np.testing.assert_allclose(samples.play_m[[0, -1]], ends, rtol=0.02)  # solved at the ends of every collar's play
    assert found.goal_play_m == found.targets[-1].play_m == samples.play_m[-1]
    assert search_limits(loose).clearance_m > search_limits(tight).clearance_m + 0.5e-3
    lost_m = plain.min_clearance_m - found.min_clearance_m
    assert plain.worst_play_m < 1e-8 and 0.2e-3 < lost_m < found.worst_play_m + 0.2e-3


def test_a_plan_tells_what_play_may_do(plan: Plan) -> None:
    without = " ".join(certificate_in_words(plan))
    certificate = replace(plan.certificate, worst_play_m=2.5e-3, goal_play_m=1.5e-3)
    said = " ".join(certificate_in_words(replace(plan, certificate=certificate)))
    assert "Play" not in without and "Play of the drive may move the robot by up to 2.50 mm" in said
