"""A start is certified for every robot within what its file states, also where one of these stands on another branch.

Intervals of precurvature, at whose ends the same turns leave another stable shape, or snap on the way.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from made_up_input import FUZZ
from stated_plans import bent
from wound_robots import beyond_m, wound

import ctrplan
from ctrplan.certificate.friction_states import BEYOND_BOUND_M
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Goal
from ctrplan.scenario.start_branch import standing

STATED = [(1.45, 1.9, 185), (1.3, 1.9, 185), (1.4, 2.2, 195)]  # precurvature, its most, and where
TURNS = [(turns, *stated) for turns in ("absolute", "unknown") for stated in STATED][: 6 if FUZZ else 4]


def stated_pair(factor: float, ends: tuple[float, float], friction: float = 0.2) -> tuple[Robot, list[Robot]]:
    """The bent pair whose inner precurvature is in an interval, in shares of its own, and the pairs at its ends."""
    pair = bent(factor)
    content = {**pair.content, "contact": [{"friction_coefficient": friction}]}
    most = content["tube"][1]["section"][1]["curvature_y_per_m"]
    interval = {"tube.2.section.2.curvature_per_m": [share * most for share in ends]}
    stated = robot_from_dict({**content, "uncertainty": {"ci95": interval}}, file=pair.path)
    others = []
    for share in ends:
        other = copy.deepcopy(content)
        other["tube"][1]["section"][1]["curvature_y_per_m"] = share * most
        others.append(robot_from_dict(other, file=pair.path))
    return stated, others


def test_a_start_that_intervals_may_leave_on_another_branch_is_refused() -> None:
    """The pair stays wound past where its tubes are opposed; bent less, within its interval, it snaps on the way."""
    start = np.array([0, np.radians(215), -29.6e-3])
    for least, is_refused in ((0.99, False), (0.4, True)):
        robot, _ = stated_pair(2.5, (least, 1.0))
        scenario = standing(wound(robot, start, start, start_friction="released"))
        assert scenario.robot.guide is not None
        certificate = ctrplan.certify(scenario, np.array([start, start]))
        assert ("may end by what is stated of" in next(iter(certificate.problems), "")) == is_refused


@pytest.mark.parametrize(("turns", "factor", "most", "at_deg"), TURNS)
def test_a_start_is_refused_where_a_robot_within_its_interval_has_another_shape(
    turns: Any, factor: float, most: float, at_deg: float
) -> None:
    """The file's pair has one shape at every angle; bent more, as its interval allows, it stays wound past 180 deg."""
    robot, others = stated_pair(factor, (0.999, most / factor), friction=0.01)
    start = np.array([0, np.radians(at_deg), -29.6e-3])
    path = np.array([start, start + [0, np.radians(3), 0]])
    theta, l = robot.drive.collars(start)  # noqa: E741 (as in the equations)
    assert len(robot.equilibria(theta, l).stable) == 1
    scenario = bare_scenario(robot).with_(
        start=start, goal=Goal(joints=path[-1]), start_turns=turns, start_friction="released"
    )
    certificate = ctrplan.certify(scenario, path)
    beyond = [beyond_m(other, certificate, start, np.random.default_rng(3))[0] for other in others]
    assert max(beyond) > 10 * BEYOND_BOUND_M
    assert not certificate.valid and "by what is stated of" in certificate.problems[0]


def test_no_robot_at_an_end_of_an_interval_leaves_the_bound_on_a_branch() -> None:
    """Bent less by a tenth the wound pair's tip moves 2 mm farther than bent more by it."""
    robot, others = stated_pair(2.09, (0.8975, 1.1025), friction=0.0)
    start = np.array([0, np.radians(218.4), -32.7e-3])
    path = np.array([start, start - [0, np.radians(20), 0]])
    certificate = ctrplan.certify(wound(robot, start, path[-1]), path)
    assert certificate.valid, certificate.problems
    for other in others:
        most, snaps = beyond_m(other, certificate, start, np.random.default_rng(4))
        assert most < BEYOND_BOUND_M and not snaps


@pytest.mark.parametrize("width", [0.02, 0.1] if FUZZ else [0.1])
def test_no_combination_of_many_intervals_snaps_on_a_certified_way(width: float) -> None:
    """The inner precurvature in six parts, each in an interval: all at their lower ends, the wound pair snaps first."""
    content, parts = copy.deepcopy(bent(2.2).content), 6
    content["contact"] = [{"friction_coefficient": 0.0}]
    straight, curved = content["tube"][1]["section"]
    content["tube"][1]["section"] = [straight, *({**curved, "length_mm": curved["length_mm"] / parts},) * parts]
    most = curved["curvature_y_per_m"]
    ends = {f"tube.2.section.{k + 2}.curvature_per_m": [(1 - width) * most, (1 + width) * most] for k in range(parts)}
    robot = robot_from_dict({**content, "uncertainty": {"ci95": ends}}, file=bent(2.2).path)
    softest = copy.deepcopy(content)
    softest["tube"][1]["section"] = [
        straight,
        *({**part, "curvature_y_per_m": (1 - width) * most} for part in content["tube"][1]["section"][1:]),
    ]
    other, start = robot_from_dict(softest, file=robot.path), np.array([0, np.radians(185), -29.6e-3])
    angles = np.append([0.0, start[1]], np.radians(np.arange(200, 240, 0.25)))
    driven = other.history().follow(*other.drive.collars(np.array([[0, angle, start[2]] for angle in angles])))
    snap_deg = float(np.degrees(angles[np.flatnonzero(driven.snaps)[0]]))
    for beyond_deg in (-0.5, 0.0, 0.5, 3.0) if FUZZ else (-0.5, 0.5):
        path = np.array([start, [0, np.radians(snap_deg + beyond_deg), start[2]]])
        for way in (path, path[::-1]):  # there, and back by a robot that was wound up so far
            assert ctrplan.certify(wound(robot, way[0], way[-1]), way).valid == (beyond_deg < 0)
