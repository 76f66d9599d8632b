"""The judge keeps what holds, and finds each claim that was broken by hand."""

from __future__ import annotations

import csv
import shlex
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from claimed_plans import claiming, scene
from scipy.spatial.transform import Rotation
from stated_plans import moved_to, scene_of, sphere, stated, table_ii

from ctrplan.__main__ import main
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.audit.audited_plan import ALLOWED
from ctrplan.audit.scene import write_scene
from ctrplan.audit.verify import Verification, verify
from ctrplan.certificate.certificate import Certificate
from ctrplan.errors import InputError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.plans.plan import Plan
from ctrplan.scenario.joint_space import bare_scenario

LITTLE = 4_000  # units of work
SHORT_WAYPOINTS = [[0, 0, 0, -80], [0, 8, 12, -80], [0, 8, 12, -77]]


@pytest.fixture(scope="module")
def short(make_plan: Callable[..., Plan]) -> Plan:
    """A short way beside a sphere."""
    return make_plan(SHORT_WAYPOINTS, anatomy=[{"kind": "sphere", "center_mm": [68, 5, 147], "radius_mm": 15}])


@pytest.fixture(scope="module")
def judged(short: Plan) -> Verification:
    return verify(short, work=LITTLE)


def test_what_holds_is_kept(judged: Verification) -> None:
    assert judged.is_kept and judged.counterexample is None
    assert {found.claim for found in judged.worst} == set(ALLOWED)
    for found in judged.worst:
        assert np.isfinite(found.value) and np.isfinite(found.stated) and found.leg in (1, 2)
        assert 0 <= found.time_s <= judged.plan.time_s[-1]


def test_what_is_found_can_be_solved_again(short: Plan, judged: Verification) -> None:
    """The clearance from the core's own body points, which the judge does not use."""
    found = next(found for found in judged.worst if found.claim == "clearance")
    assert found.before is None
    collars = short.scenario.robot.drive.collars(found.joints)
    body = short.scenario.robot.mechanics.friction_bodies(
        *collars, np.array([found.phi]), spacing_m=1e-4, accuracy="certificate"
    )
    (part,) = short.scenario.anatomy
    assert isinstance(part.shape, Sphere)
    away = np.linalg.norm(body.point_m[0] - part.shape.center_m, axis=1) - part.shape.radius_m - body.radius_m
    assert found.value == pytest.approx(away.min(), abs=2e-6)


def test_more_work_never_finds_less_and_the_same_work_the_same(short: Plan, judged: Verification) -> None:
    first, again = (verify(short, work=LITTLE // 4) for _ in range(2))
    more = judged
    assert again.work == first.work < more.work
    for one, same in zip(first.worst, again.worst, strict=True):
        assert one.value == same.value and np.array_equal(one.joints, same.joints)
        assert {found.claim: found for found in more.worst}[one.claim].excess >= one.excess


def test_moving_everything_together_changes_nothing(short: Plan, judged: Verification) -> None:
    R, shift = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.array([0.1, -0.2, 0.05])
    scenario = short.scenario
    (part,) = scenario.anatomy
    assert isinstance(part.shape, Sphere)
    sphere = replace(part, shape=Sphere(R @ part.shape.center_m + shift, part.shape.radius_m))
    moved = replace(scenario, anatomy=(sphere,), base_R=R @ scenario.base_R, base_position_m=shift)
    found = verify(moved_to(WrittenPlan.of(short), moved), work=LITTLE)
    for here, there in zip(judged.worst, found.worst, strict=True):
        assert there.value == pytest.approx(here.value, abs=1e-8)
        np.testing.assert_allclose(there.point_m, R @ here.point_m + shift, atol=1e-7)


def test_a_sphere_put_in_is_found(short: Plan, judged: Verification) -> None:
    """Beside the tip of a state between the corners, where the certificate was made without it."""
    q = short.waypoints[1]
    body = short.scenario.robot.solve(*short.scenario.robot.drive.collars(q), [0.5, -0.5], accuracy="certificate")
    sphere = AnatomyPart(Sphere(body.tip_m + [0, 1.5e-3, 0], 1e-3))
    written = moved_to(WrittenPlan.of(short), replace(short.scenario, anatomy=(sphere,)))
    found = verify(written, work=LITTLE)
    assert found.counterexample is not None and found.counterexample.claim == "clearance"
    assert found.counterexample.value < 0 and not found.is_kept
    assert np.linalg.norm(found.counterexample.point_m - body.tip_m) < 5e-3


def with_figure(plan: Plan, *path: str, value: Any) -> WrittenPlan:
    written = WrittenPlan.of(plan)
    owner = written.certificate
    for key in path[:-1]:
        owner = owner[key]
    owner[path[-1]] = value
    return written


def test_a_clearance_raised_by_hand_is_found_out_twice(short: Plan) -> None:
    """By the figure that does not come out again, and by the robot that comes nearer than claimed."""
    certificate = short.certificate
    found = verify(with_figure(short, "min_clearance_m", value=certificate.min_clearance_m + 5e-3), work=LITTLE)
    assert "certificate.min_clearance_m" in [d.figure for d in found.differences]
    assert "clearance" in [broken.claim for broken in found.broken]
    little = verify(with_figure(short, "min_clearance_m", value=certificate.min_clearance_m + 0.1e-3), work=1)
    assert [d.figure for d in little.differences] == ["certificate.min_clearance_m"] and not little.is_kept


def test_a_bound_lowered_by_hand_is_found_out_twice(short: Plan) -> None:
    lowered = 0.5 * short.certificate.samples.bound_m
    found = verify(with_figure(short, "samples", "bound_m", value=lowered.tolist()), work=LITTLE)
    assert [d.figure for d in found.differences] == ["certificate.samples.bound_m"]
    assert [broken.claim for broken in found.broken] == ["bound"]


@pytest.mark.parametrize(
    "figure, value", [("min_stability", 50.0), ("max_strain", 0.001), ("valid", False), ("problems", ["It is wrong."])]
)
def test_other_figures_changed_by_hand_are_found_out(short: Plan, figure: str, value: Any) -> None:
    found = verify(with_figure(short, figure, value=value), work=300)
    assert not found.is_kept


def test_settings_of_the_plan_changed_by_hand_are_found_out(short: Plan) -> None:
    written = WrittenPlan.of(short)
    written.content["margins"]["stability"] = 0.0
    written.content["trajectory"]["duration_s"] *= 0.9
    figures = [d.figure for d in verify(written, work=1).differences]
    assert figures == ["margins.stability", "trajectory.duration_s"]


def test_a_trajectory_faster_than_the_drive_is_found_out(short: Plan) -> None:
    written = WrittenPlan.of(short)
    differences = verify(replace(written, time_s=0.5 * written.time_s), work=1).differences
    assert differences and all("largest speed of joint" in difference.figure for difference in differences)


def test_friction_states_between_corners_are_found() -> None:
    """A sphere that no corner comes near, but states between them do (H1 of issue 23)."""
    start = [-133.0, -121.3, 101.0, -18.3]
    given = scene(start, [-38.52, -15.42, 189.42], 2.35, 0.3)
    robot = given.robot
    tip = robot.solve(*robot.drive.collars(given.start), [0.6, 0.3], accuracy="certificate").tip_m
    sphere = AnatomyPart(Sphere(tip + [0, 0, 1.5e-3], 1e-3))
    plan = claiming(replace(given, anatomy=(sphere,)), [-133.0, -123.0, 101.0, -18.3], raised)
    found = verify(plan, work=LITTLE)
    assert found.counterexample is not None and found.counterexample.claim == "clearance"
    assert found.counterexample.value < 0


def raised(certificate: Certificate) -> Certificate:
    return replace(certificate, min_clearance_m=0.14e-3)


@pytest.fixture(scope="module")
def second_branch() -> Verification:
    """H2 of issue 23: small turns before the start leave the robot 20 mm away, inside the obstacle."""
    given = scene([69.388, 113.694, -56.0136, -82.526], [-8.1, 29.4, 149.8], 3.0, 0.5)
    return verify(claiming(given, [69.388, 113.694, -53.0, -82.526]), work=12_000)


def test_second_equilibria_before_the_start_are_found(second_branch: Verification) -> None:
    assert {"clearance", "bound"} <= {broken.claim for broken in second_branch.broken}
    worst = second_branch.counterexample
    assert worst is not None and worst.before is not None and worst.value < -3e-3


def test_a_scene_of_a_history_replays(second_branch: Verification, tmp_path: Path) -> None:
    found = second_branch.counterexample
    assert found is not None
    _, simulate = write_scene(tmp_path, second_branch, found)
    assert main(shlex.split(simulate)[1:]) == 0
    with (tmp_path / "replay" / "poses.csv").open() as stream:
        *_, last = csv.DictReader(stream)
    assert float(last["deviation_mm"]) > 15 and float(last["bound_mm"]) < 5


def test_what_was_found_before_an_interruption_is_kept(short: Plan) -> None:
    stop, asked = threading.Event(), [0]

    def progress(stage: str, share: float) -> None:
        asked[0] += stage == "hunting"
        if asked[0] > 3:
            stop.set()

    found = verify(short, progress=progress, interrupted=stop)
    assert found.interrupted and found.worst and found.work < LITTLE


BESIDE = ([0, 0, 0, -80], [68, 5, 147], 15, 0.0)


def test_play_of_the_drive_is_taken_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """With it the robot comes nearer to the sphere; what was found, by the hunt alone, is at an end of the play."""
    monkeypatch.setattr("ctrplan.audit.verify._recomputed", lambda *_: ((), ""))
    widths = [f"effects.backlash.theta_{k}_deg=8" for k in (1, 2, 3)]
    least = []
    for play in ((), widths):
        given = scene_of(table_ii(*play), [0, 0, 0, -80], [0, 2, 3, -80], sphere([49, 24, 147], 15))
        found = verify(stated(given, 0.0), work=LITTLE)
        least.append(next(found for found in found.worst if found.claim == "clearance"))
    assert not least[0].play and set(map(abs, least[1].play[:3])) == {1.0} and not any(least[1].play[3:])
    assert least[1].value < least[0].value - 0.3e-3


def test_parameters_at_the_ends_of_their_intervals_are_told_beside_the_claims_that_do_not_cover_them() -> None:
    overrides = ["contact.1.friction_coefficient=[0.1, 0.2]", "effects.joint_scale.theta_3=0.01"]
    given = scene(*BESIDE, *overrides, "effects.joint_scale.ci95={theta_3 = [-0.5, 0.02]}")
    plan = claiming(given, [0, 2, 3, -80], lambda c: replace(c, min_clearance_m=0.0))
    found = verify(plan, work=LITTLE)
    assert not found.broken and {f.claim for f in found.beside} >= {"strain", "stability"}
    for beside in found.beside:
        assert "effects.joint_scale.theta_3" in beside.parameters or "contact.1" in beside.parameters


def test_a_single_tube_is_judged_on_the_exact_geometry() -> None:
    """It has no friction states: its clearance to a capsule is that of its own shape, a circle's arc."""
    section = {"length_mm": 50, "curvature_x_per_m": 0, "curvature_y_per_m": 10.0}
    tube = {"outer_diameter_mm": 2, "inner_diameter_mm": 1.8, "bending_stiffness_Nm2": 0.01, "poisson_ratio": 0.3}
    robot = robot_from_dict({"tube": [{**tube, "section": [section]}], "contact": []})
    rod = Capsule(np.array([0.03, -0.01, 0.03]), np.array([0.03, 0.01, 0.03]), 2e-3)
    scenario = replace(bare_scenario(robot), anatomy=(AnatomyPart(rod),))
    found = verify(claiming(scenario, [0, 0]), work=3_000, accuracy="exact")
    assert found.is_kept
    (least,) = (f for f in found.worst if f.claim == "clearance")
    away = np.hypot(0.03 - 0.1, 0.03) - 0.1  # of the axis from the circle about (0.1, 0, 0)
    assert least.value == pytest.approx(abs(away) - 2e-3 - 1e-3, abs=1e-6)


def test_files_that_are_no_plan_are_refused() -> None:
    with pytest.raises(InputError, match="must be the path of a plan"):
        verify(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="time_s"):
        verify("plan.json", time_s=0)
