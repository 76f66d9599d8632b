"""A certificate checks itself: what it says comes out again, and what was changed afterwards is found out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.certificate.certificate import Certificate, joined_certificates
from ctrplan.certificate.certify import certify
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import Leg
from ctrplan.scenario.scenario import Goal, Scenario

MESHES: tuple[Accuracy, Accuracy] = ("search", "certificate")
TURN_RAD_M = np.array([0.0, np.radians(6.0), np.radians(-8.0), 0.003])


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Past the ribs, a short way from the start."""
    given = ctrplan.load_scenario(SCENARIOS / "ribs.toml")
    return replace(given, goal=Goal(given.start + TURN_RAD_M, None, 1e-3))


@pytest.fixture(scope="module")
def driven(scenario: Scenario) -> Plan:
    return ctrplan.reorder(np.array([scenario.start, scenario.start + TURN_RAD_M]), scenario)


@pytest.fixture(scope="module")
def walked(driven: Plan) -> Plan:
    """The driven plan with its legs walked again, once for all tests that compare figures with the walk."""
    assert driven.certificate.walk_again is not None
    return replace(driven, certificate=replace(driven.certificate, walk_again=cache(driven.certificate.walk_again)))


def test_a_plan_is_confirmed_and_walked_on_the_certificate_mesh(walked: Plan) -> None:
    found, stated = walked.recheck(), walked.certificate
    assert stated.valid and found.is_confirmed and found.differences == ()
    assert found.sentence == "Confirmed: every figure came out again, and the legs are valid on the certificate mesh."
    assert found.stated is stated
    assert 0 < abs(found.fresh.max_strain - stated.max_strain) < 1e-3  # another mesh
    # what a person compares does not depend on it
    assert found.fresh.min_clearance_m == pytest.approx(stated.min_clearance_m, abs=0.1e-3)
    assert found.fresh.goal_bound_m == pytest.approx(stated.goal_bound_m, abs=0.05e-3)


def doubled(certificate: Certificate, column: str) -> Certificate:
    values = getattr(certificate.samples, column)
    return replace(certificate, samples=replace(certificate.samples, **{column: 2 * values}))


TAMPERED: dict[str, Callable[[Certificate], Certificate]] = {
    "min_clearance_m": lambda c: replace(c, min_clearance_m=c.min_clearance_m + 0.05e-3),
    "goal_bound_m": lambda c: replace(c, goal_bound_m=0.9 * c.goal_bound_m),
    "goal_predicted_tip_m": lambda c: replace(c, goal_predicted_tip_m=c.goal_predicted_tip_m + 1e-4),
    "snaps": lambda c: replace(c, snaps=1),
    "valid": lambda c: replace(c, valid=False),
    "problems": lambda c: replace(c, problems=("It looks wrong.",)),
    "targets.1.bound_m": lambda c: replace(c, targets=(replace(c.targets[0], bound_m=0.0),)),
    "targets": lambda c: replace(c, targets=()),
    "samples.stability": lambda c: doubled(c, "stability"),
    "samples.clearance_m": lambda c: doubled(c, "clearance_m"),
}


@pytest.mark.parametrize("figure", TAMPERED)
def test_a_figure_that_was_changed_is_found_out(walked: Plan, figure: str) -> None:
    found = TAMPERED[figure](walked.certificate).recheck()
    assert not found.is_confirmed and figure in [difference.figure for difference in found.differences]
    assert found.sentence.startswith("Not confirmed: ") and "is stated as" in found.sentence


def test_texts_that_differ_are_both_said(walked: Plan) -> None:
    closest = walked.certificate.closest
    assert closest is not None
    found = replace(walked.certificate, closest=replace(closest, part="anatomy.7 (elsewhere)")).recheck()
    assert f"is stated as anatomy.7 (elsewhere) and found to be {closest.part}" in found.sentence


def test_a_plan_that_drives_something_else_is_found_out(walked: Plan) -> None:
    elsewhere = np.array([0.0, 0.0, 1e-3, 0.0])
    last = walked.legs[-1]
    legs = (*walked.legs[:-1], Leg(last.start, last.end + elsewhere, last.kind))
    position = walked.trajectory.position + np.linspace(0, 1, len(walked.trajectory.time_s))[:, None] * elsewhere
    changed: dict[str, dict[str, Any]] = {
        "legs": {"legs": legs},
        "trajectory": {"trajectory": replace(walked.trajectory, position=position)},
        "ends of the trajectory": {"trajectory": replace(walked.trajectory, position=walked.trajectory.position[:-50])},
    }
    for what, change in changed.items():
        found = replace(walked, **change).recheck()
        figures = [difference.figure for difference in found.differences]
        assert f"distance of the {what} from the certified path" in figures and not found.is_confirmed


def test_what_holds_on_a_coarse_mesh_alone_is_not_confirmed(scenario: Scenario) -> None:
    """The least stability differs between the meshes; a margin between both is kept on one of them."""
    content = scenario.robot.content
    contacts = [{**contact, "friction_coefficient": 0.0} for contact in content["contact"]]
    slippery = robot_from_dict({**content, "contact": contacts}, file=scenario.robot.path)
    for turn in (1, 2, 3, 4):
        end = scenario.start + TURN_RAD_M * (0, turn, -turn, 1)
        there = replace(scenario, robot=slippery, goal=Goal(end, None, 1e-3))
        path = np.array([scenario.start, end])
        coarse, fine = (certify(there, path, accuracy=mesh).min_stability for mesh in MESHES)
        if coarse > fine:
            break
    assert coarse > fine
    strict = replace(there, margins=replace(there.margins, stability=(coarse + fine) / 2))
    certificate = certify(strict, path)
    found = certificate.recheck()
    assert certificate.valid and found.differences == () and not found.is_confirmed
    assert found.sentence.startswith("Not confirmed on the certificate mesh: On leg 1: stability")


def test_a_path_that_is_not_valid_is_confirmed_not_to_be(scenario: Scenario) -> None:
    strict = replace(scenario, margins=replace(scenario.margins, stability=1e3))
    found = certify(strict, np.array([scenario.start, scenario.start + TURN_RAD_M])).recheck()
    assert found.is_confirmed and found.sentence.startswith("Confirmed, but not valid on the certificate mesh: ")


def test_stages_are_walked_again_one_by_one() -> None:
    """A pair stands for every robot: what is asked depends on none."""
    scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
    middle, end = scenario.start + [0.0, 0.1, 0.0], scenario.start + [0.0, 0.1, 0.003]
    first = certify(replace(scenario, goal=Goal(middle, None, 1e-3)), np.array([scenario.start, middle]))
    second = certify(replace(scenario, start=middle), np.array([middle, end]), starts=first.end_states)
    joined = joined_certificates([first, second])
    assert joined.walk_again is not None
    joined = replace(joined, walk_again=cache(joined.walk_again))
    assert joined.recheck().is_confirmed
    assert not replace(joined, cost_mm=first.cost_mm).recheck().is_confirmed


def test_figures_without_legs_cannot_be_checked(plan: Plan) -> None:
    with pytest.raises(InputError, match="certificate: holds no legs to walk again"):
        replace(plan.certificate, walk_again=None).recheck()
