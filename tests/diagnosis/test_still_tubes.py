"""Tubes that never move: what can't be told of their joints is no candidate, stays where it is, and is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration.calibrate import calibrate
from ctrplan.diagnosis import CATALOGUE, diagnose
from ctrplan.diagnosis.term_pieces import pieces
from ctrplan.diagnosis.workbench import candidates
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 14)
DRIVE = {name: effect for name, effect in CATALOGUE.items() if effect.stage == "drive"}


def still(kind: str) -> Measurements:
    """The plan without any rotation, or without any translation, as it would be measured."""
    at = {"theta": replace(PLAN, theta_commanded=np.tile([0.0, 1.0], (len(PLAN.sequence), 1)))}
    at["l"] = replace(PLAN, l_commanded=np.tile([0.0, -0.012], (len(PLAN.sequence), 1)))
    return measured(ROBOT, at[kind])


@pytest.mark.parametrize(("kind", "moving"), [("theta", "l"), ("l", "theta")])
def test_no_effect_of_a_joint_that_never_moves_is_asked_for(kind: str, moving: str) -> None:
    data = still(kind)
    known = candidates(ROBOT, data, DRIVE)
    asked = {(t.name, q.name) for t in known.terms for q in t.parameters if t.name != "homing_offset"}
    assert not {one for one in asked if one[1].startswith(f"{kind}_2")}
    assert ("joint_scale", f"{moving}_2") in asked
    built = [part for piece in pieces(ROBOT, data) for part in piece.parts]
    assert not [part for part in built if f"{kind}_2" in part] and [part for part in built if f"{moving}_2" in part]


def test_why_it_can_not_be_asked_for_is_told() -> None:
    reasons = candidates(ROBOT, still("theta"), DRIVE).not_testable
    assert reasons["eccentricity"] == "no tube turns"
    found = diagnose(ROBOT, still("l"), catalogue={name: CATALOGUE[name] for name in ("joint_scale", "backlash")})
    assert found.verdict == "no_missing_effect" and "effects" not in found.robot_content()


def test_what_only_a_rotation_would_show_stays_where_it_was_and_is_told() -> None:
    """Tubes that never turn against each other don't twist: nothing tells their Poisson's ratios."""
    turned, fixed = (calibrate(ROBOT, data).combinations[0] for data in (measured(ROBOT, PLAN), still("theta")))
    assert set(fixed.parameters) <= {"poisson_ratio_1", "poisson_ratio_2"} and not fixed.is_known
    assert fixed.posterior_share > 0.99 > turned.posterior_share
