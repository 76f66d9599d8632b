"""What uncertain parameters, registration and unexplained errors do to certificates and to what a plan promises."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from places import ROOT, SCENARIOS
from scipy import stats

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import Array, alike
from ctrplan.certificate.certificate import CertificateSamples
from ctrplan.certificate.walked_legs import walk_legs
from ctrplan.commands.plan import _summary
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.limits import search_limits
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_page import uncertainty_section
from ctrplan.scenario.scenario import Goal, Registration, Scenario
from ctrplan.uncertainty.body_clearance import bodies_at, body_at
from ctrplan.uncertainty.parameters import uncertain_parameters
from ctrplan.uncertainty.result import Uncertainty
from ctrplan.uncertainty.worst_case import wilson

INTERVALS = [
    "robot.uncertainty.ci95.tube.3.section.2.curvature_per_m=[17.9, 18.5]",
    "robot.uncertainty.ci95.tube.2.poisson_ratio=[0.25, 0.35]",
    "robot.effects.friction.mu_1=0.2",
    "robot.effects.friction.ci95.mu_1=[0.18, 0.22]",
    "robot.effects.homing_offset.ci95.theta_2_deg=[-0.4, 0.4]",
]
REGISTRATION = ["base.position_sigma_mm=0.2", "base.rotation_sigma_deg=0.1"]
SCHEMA = json.loads((ROOT / "docs" / "plan.schema.json").read_text(encoding="utf-8"))


def ribs(*overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / "ribs.toml", overrides)


def path(scenario: Scenario, count: int = 60) -> Array:
    turn = np.radians([0.0, 25.0, -30.0, 0.0])
    joints: Array = scenario.start + np.linspace(0, 1, count)[:, None] * turn
    return joints


def walked(scenario: Scenario) -> CertificateSamples:
    turn = np.radians([0.0, 8.0, -8.0, 0.0])
    return walk_legs(scenario, np.array([scenario.start, scenario.start + turn])).samples


@pytest.fixture(scope="module")
def uncertain() -> Scenario:
    return ribs(*INTERVALS, *REGISTRATION)


@pytest.fixture(scope="module")
def samples(uncertain: Scenario) -> CertificateSamples:
    """What is uncertain along a short way."""
    return walked(uncertain)


@pytest.fixture(scope="module")
def along(uncertain: Scenario) -> Uncertainty:
    """What is uncertain on its path."""
    return ctrplan.plan_uncertainty(uncertain, path(uncertain))


@pytest.fixture(scope="module")
def pair() -> Scenario:
    """Two tubes without friction whose tip is exactly where it shall be, a large sphere 1 mm before it."""
    plain = load_scenario(SCENARIOS / "pair_free.toml", ["robot.contact.1.friction_coefficient=0"])
    robot = plain.robot
    tip = robot.solve(*robot.drive.collars(plain.start)).tip_m
    return replace(plain, goal=Goal(None, tip, 1e-3))


def test_without_intervals_nothing_changes() -> None:
    plain = ribs()
    exact = ribs(INTERVALS[2], "robot.effects.friction.ci95.mu_1=[0.2, 0.2]", "base.position_sigma_mm=0")
    for scenario in (plain, exact):
        samples = walked(scenario)
        assert not samples.parameter_bound_m.any() and not samples.parameter_clearance_m.any()
        assert search_limits(scenario).clearance_m == search_limits(plain).clearance_m


def test_a_certificate_has_what_is_uncertain_in_its_figures_and_says_how_much(
    uncertain: Scenario, samples: CertificateSamples
) -> None:
    bare = walked(ribs("robot.effects.friction.mu_1=0.2", "robot.effects.homing_offset.theta_2_deg=0"))
    assert not bare.parameter_bound_m.any() and not bare.parameter_clearance_m.any()
    assert samples.parameter_stability.min() > 0 and samples.parameter_strain.min() > 0
    assert samples.parameter_bound_m.min() > 0.2e-3 and samples.parameter_clearance_m.min() > 0.5e-3
    assert samples.stability.min() < bare.stability.min() and samples.max_strain.max() > bare.max_strain.max()
    lost = bare.clearance_m.min() - samples.clearance_m.min()
    assert 0.2e-3 < lost < samples.parameter_clearance_m.max() + 0.2e-3
    assert search_limits(uncertain).clearance_m > search_limits(ribs()).clearance_m + 0.5e-3


def test_figures_get_worse_with_every_interval(samples: CertificateSamples) -> None:
    narrow = [text.replace("[-0.4, 0.4]", "[-0.2, 0.2]") for text in INTERVALS]
    before, after = walked(ribs(*narrow, *REGISTRATION)), samples
    assert after.clearance_m.min() < before.clearance_m.min() and after.stability.min() < before.stability.min()
    assert after.parameter_bound_m.max() > before.parameter_bound_m.max()


def test_bounds_of_a_path_are_those_of_its_configurations(uncertain: Scenario, samples: CertificateSamples) -> None:
    """To first order: differences across intervals against derivatives."""
    theta, l = uncertain.robot.drive.commanded(samples.joints[[0, -1]])  # noqa: E741 (as in the equations)
    alone = ctrplan.bound_with_parameters(uncertain.robot, theta, l)
    added = alone.position_m - alone.friction_m
    np.testing.assert_allclose(samples.parameter_bound_m[[0, -1]], added, atol=0.1e-3)


def test_no_robot_within_the_intervals_loses_more_clearance_than_allowed(uncertain: Scenario) -> None:
    parameters, joints = uncertain_parameters(uncertain.robot), path(uncertain)[[30]]
    (body,) = bodies_at(replace(uncertain, registration=Registration()), parameters, joints)
    rng = np.random.default_rng(2)
    for signs in np.sign(rng.standard_normal((20, parameters.count))):
        offset = signs * parameters.half_width
        moved = alike(body_at(parameters, offset, body.theta, body.l)[0], body.spread.point_m[0]).reshape(-1, 3)
        least = body.clearance_at(moved, np.arange(len(moved))).min()
        assert least >= body.least_m - body.allowance_m


def test_a_margin_that_only_the_intervals_break_is_refused_in_a_sentence_that_says_so(
    uncertain: Scenario, samples: CertificateSamples
) -> None:
    at = int(np.argmin(samples.stability))
    margin = float(samples.stability[at] + samples.parameter_stability[at] / 2)
    strict = replace(uncertain, margins=replace(uncertain.margins, stability=margin))
    turn = np.radians([0.0, 8.0, -8.0, 0.0])
    problems = walk_legs(strict, np.array([strict.start, strict.start + turn])).problems
    assert any("stability" in text and "intervals and play" in text for text in problems)


def test_causes_add_up_and_are_ranked(along: Uncertainty) -> None:
    found = along
    assert found.closest is not None
    for causes in (found.goal.contributors, found.closest.contributors):
        shares = [cause.share_m for cause in causes]
        assert shares == sorted(shares, reverse=True)
    assert sum(c.share_m for c in found.goal.contributors) == pytest.approx(found.goal.worst_m, rel=1e-9)
    lost = found.closest.nominal_m - found.closest.worst_m
    assert sum(c.share_m for c in found.closest.contributors) == pytest.approx(lost, rel=1e-9)
    by_name = {c.name: c for c in found.goal.contributors}
    assert by_name["registration"].saved_m == pytest.approx(by_name["registration"].share_m, rel=0.05)
    assert found.goal.sentence.startswith(f"{found.goal.worst_m * 1e3:.1f} mm, of which ")


def test_what_measuring_takes_off_is_what_the_worst_case_is_without() -> None:
    with_both, without = ribs(*INTERVALS, *REGISTRATION), ribs(*INTERVALS)
    joints = path(with_both)[-1]
    whole, less = (ctrplan.plan_uncertainty(s, joints).goal for s in (with_both, without))
    saved = {c.name: c.saved_m for c in whole.contributors}["registration"]
    second = whole.beyond_first_order_m - less.beyond_first_order_m
    assert whole.worst_m - less.worst_m - second == pytest.approx(saved, abs=1e-6)


def test_linear_chances_agree_with_solves(uncertain: Scenario, along: Uncertainty) -> None:
    joints = path(uncertain)
    miss = along.goal.quantile_any_friction_m
    goal = replace(uncertain.goal, tolerance_m=miss - 0.3e-3)
    found = ctrplan.plan_uncertainty(replace(uncertain, goal=goal), joints)
    assert found.goal.chance_any_friction is not None and found.closest is not None
    assert 0.05 < found.goal.chance_any_friction.share < 0.95
    for chance in (found.goal.chance_any_friction, found.closest.chance_margin, found.closest.chance_touch):
        assert chance.is_confirmed


def test_registration_alone_misses_by_a_chi_distribution(pair: Scenario) -> None:
    sigma = 0.5e-3
    scenario = replace(pair, registration=replace(pair.registration, position_sigma_m=sigma))
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal
    assert found.chance_any_friction is not None
    low, high = found.chance_any_friction.low, found.chance_any_friction.high
    assert low <= stats.chi(3).sf(1e-3 / sigma) <= high
    assert found.quantile_any_friction_m == pytest.approx(sigma * stats.chi(3).ppf(0.95), rel=0.03)
    assert found.worst_m == pytest.approx(sigma * stats.chi(3).ppf(0.95), rel=1e-4)
    assert [c.name for c in found.contributors if c.share_m > 1e-9] == ["registration"]


def test_a_turned_base_misses_by_its_lever(pair: Scenario) -> None:
    scenario = replace(pair, registration=replace(pair.registration, rotation_sigma_rad=0.004))
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal
    lever = float(np.linalg.norm(pair.goal.tip_m))
    assert found.worst_m == pytest.approx(0.004 * stats.chi(3).ppf(0.95) * lever, rel=1e-4)
    across = 0.004 * lever * stats.chi(2).ppf(0.95)  # a rotation about the lever itself moves nothing
    assert found.quantile_any_friction_m == pytest.approx(across, rel=0.03)


def test_registration_alone_touches_a_sphere_as_often_as_the_normal_says(pair: Scenario) -> None:
    robot, sigma, room = pair.robot, 0.5e-3, 0.6e-3
    shape = robot.solve(*robot.drive.collars(pair.start))
    center = shape.tip_m + shape.tip_tangent * (30e-3 + shape.radius_m[-1] + room)
    ball = AnatomyPart(Sphere(center, 30e-3), "avoid", 0.0)
    scenario = replace(pair, anatomy=(ball,), registration=replace(pair.registration, position_sigma_m=sigma))
    found = ctrplan.plan_uncertainty(scenario, scenario.start).closest
    assert found is not None
    assert found.nominal_m == pytest.approx(room, abs=0.1e-3)  # by the grid
    assert found.chance_touch.share == pytest.approx(stats.norm.sf(found.nominal_m / sigma), abs=0.015)
    assert found.chance_touch.is_confirmed


def test_one_pose_in_twenty_exceeds_what_calibration_left_unexplained(pair: Scenario) -> None:
    scenario = replace(pair, robot=replace(pair.robot, model_error_m=1e-3))
    found = ctrplan.plan_uncertainty(scenario, scenario.start).goal
    assert found.chance_any_friction is not None
    assert found.chance_any_friction.low <= 0.05 <= found.chance_any_friction.high
    assert found.worst_m == pytest.approx(1e-3)


def test_wilson_intervals_cover_as_they_should() -> None:
    rng, share = np.random.default_rng(3), 0.07
    ends = [wilson(rng.random(200) < share) for _ in range(1000)]
    assert np.mean([low <= share <= high for low, high in ends]) == pytest.approx(0.95, abs=0.025)
    assert wilson(np.zeros(200, bool))[0] == 0.0
    assert wilson(np.ones(200, bool))[1] == 1.0  # it was 1 - 1e-16, so that certain misses passed for contradicted


@pytest.fixture(scope="module")
def uncertain_plan(make_plan: Callable[..., Plan]) -> Plan:
    plan = make_plan(goal={"tip_mm": [38, 66, 182], "tolerance_mm": 1.0}, base={"position_sigma_mm": 0.3})
    return replace(plan, uncertainty=ctrplan.plan_uncertainty(plan))


def test_a_plan_says_what_is_uncertain_everywhere(uncertain_plan: Plan) -> None:
    assert uncertain_plan.uncertainty is not None
    written = uncertain_plan.to_json()["uncertainty"]
    Draft202012Validator({**SCHEMA["properties"]["uncertainty"], "$defs": SCHEMA["$defs"]}).validate(written)
    assert written["goal"]["chance_by_history"]["share"] == uncertain_plan.uncertainty.goal.chance_by_history.share  # type: ignore[union-attr]
    page = uncertainty_section(uncertain_plan)
    assert uncertain_plan.uncertainty.goal.sentence in page and "registration" in page and "█" in page
    said = _summary(Path("out"), uncertain_plan, ())
    assert "chance to miss tolerance" in said and uncertain_plan.uncertainty.goal.sentence in said


def test_a_plan_of_which_nothing_is_uncertain_says_nothing(plan: Plan) -> None:
    assert plan.to_json()["uncertainty"] is None and uncertainty_section(plan) == ""


def test_nonsense_is_refused(pair: Scenario, plan: Plan) -> None:
    unknown = np.full(len(pair.start), np.nan)
    for of, joints in ((pair, None), (pair, [0.0]), (pair, unknown), (3, None), (plan, pair.start)):
        with pytest.raises(InputError):
            ctrplan.plan_uncertainty(of, joints)  # type: ignore[arg-type]
