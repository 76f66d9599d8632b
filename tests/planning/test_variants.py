"""What a robot may be besides its file: none that the file allows comes nearer than certified, and little is lost."""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ball_scenes import FRICTIONLESS, certified, joints, robot, scene
from made_up_input import FUZZ
from places import ROBOTS

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.base.arrays import CHI95, Array, alike, shares_of_length
from ctrplan.certificate.certify import certify
from ctrplan.certificate.variants import Variants
from ctrplan.drive.drive import STEP_M, STEP_RAD
from ctrplan.drive.legs import Collars, distance_from_polyline
from ctrplan.drive.trajectory import driven_ways, time_parameterise
from ctrplan.effects.learned.parts import LARGEST
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.pipeline.chain import Chain
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Goal, Registration
from ctrplan.storage.toml_document import read_document

PLAY = {"effects": {"backlash": {"theta_3_deg": 4.0}}}
# The inner tube turns by 8 deg while it is pushed through the middle of its travel.
BUMP = {
    "stage": "drive",
    "acts_on": "the rotation of tube 3",
    "bump_3_of_5_l_3_deg": 12.0,
    "range": {"l_3": [-104, -65]},
}
CURVED = {"uncertainty": {"ci95": {"tube.3.section.2.curvature_per_m": [16.3636, 20.0]}}}
LATE = {"effects": {"drive_lag": {"theta_s": 0.4}}}


def test_a_curvature_s_interval_counts_where_the_tip_passes_and_not_only_where_the_base_is_narrow() -> None:
    """Twelve rows along the way told of the sphere at the base each, and the tip hit the other one by 1.8 mm."""
    ends = joints(-5, -5, -5, -30), joints(5, 5, 5, -30)
    spheres = ([3.62, 0.0, 8.0], 1.0), ([85.224, 0.0, 169.736], 1.0)
    case = scene(robot(**CURVED), *ends, *spheres, start_friction="released")
    assert certified(replace(case, robot=robot())).valid
    hit = certified(case)
    assert "too close to the anatomy" in hit.problems[0] and hit.narrowest is not None
    assert hit.narrowest.part.startswith("anatomy.2")  # not by the one at the base
    way = ends[0] + np.linspace(0, 1, 140)[:, None] * (ends[1] - ends[0])
    at = ctrplan.plan_uncertainty(case, way).closest
    assert at is not None and at.chance_touch.stated > 0.1  # it said less than 0.04 %, of the sphere at the base


def test_play_counts_everywhere_on_the_way_and_only_in_its_own_direction() -> None:
    """It was solved at three places of 40 mm, and taken off in every direction."""
    ends = joints(-57.2958, -57.2958, 106.2042, -58), joints(57.2958, 57.2958, 264.7958, -58)
    loose = robot(**PLAY, **FRICTIONLESS)
    near = ([32.3973, -16.3128, 172.7416], 0.5)
    found = certified(scene(loose, *ends, near))
    assert not found.valid and -1.0e-3 < found.min_clearance_m < -0.39e-3  # a robot at the end of its play: -0.39 mm
    assert found.worst_play_m > 8e-3
    assert certified(scene(robot(**FRICTIONLESS), *ends, near)).valid


def test_play_does_not_refuse_what_is_free() -> None:
    """What the tip has was taken off points 5 mm from the plate, which then curled back to it."""
    loose = robot(effects={"backlash": {f"theta_{i}_deg": 6.0 for i in (1, 2, 3)}})
    assert certified(scene(loose, joints(0, 0, 0, -30), joints(0, 0, 17.2, -30))).valid


def test_play_of_three_drives_along_an_obstacle_takes_nothing_of_the_clearance_across() -> None:
    """All that play allows passes a sphere at 0.6 mm, sideways. The length of a third play refused it."""
    play = {"theta_1_deg": 1.5, "theta_2_deg": 2.5, "theta_3_deg": 4.0}
    ends = joints(0, 0, 40, -50), joints(0, 0, 41, -50)
    case = scene(robot(effects={"backlash": play}, **FRICTIONLESS), *ends, ([70.257, 9.204, 162.81], 1.0))
    result = certified(replace(case, start_friction="released"))
    assert result.valid
    assert 0 < result.min_clearance_m < 0.6e-3


def test_a_term_of_the_drive_that_turns_a_tube_while_it_is_pushed_is_followed() -> None:
    bent = robot(effects={"learned_theta_3": BUMP})
    ends = joints(0, 0, 125, -69.5), joints(0, 0, 125, -31.5)
    sphere = ([41.0533, 16.451, 176.448], 0.5)
    assert certified(scene(robot(), *ends, sphere)).valid
    assert not certified(scene(bent, *ends, sphere)).valid


def test_late_rotations_are_followed_in_time() -> None:
    late = robot(**LATE)
    ends = joints(-22.9183, -22.9183, -22.9183, -60), joints(22.9183, 22.9183, 22.9183, -30)
    sphere = ([82.535, 16.2795, 166.588], 0.5)
    assert certified(scene(robot(), *ends, sphere)).valid
    found = certified(scene(late, *ends, sphere))
    assert not found.valid
    np.testing.assert_allclose(found.samples.joints[[0, -1]], ends, atol=1e-12)


def test_a_late_drive_leaves_its_legs_by_its_speed_times_the_delay() -> None:
    late, corners = robot(**LATE), np.array([joints(0, 0, 0, -60), joints(40, 40, 40, -30)])
    ((leg, way),) = driven_ways(late.drive, corners)
    assert leg == 0 and np.array_equal(late.drive.joint_late_s, [0.4, 0.4, 0.4, 0.0])
    np.testing.assert_allclose(way[[0, -1]], corners, atol=1e-12)
    share = (way - corners[0]) / (corners[1] - corners[0])
    behind = (share[:, 3] - share[:, 0]) * 30e-3
    assert np.all(np.diff(share, axis=0) >= -1e-12)
    assert behind.min() >= -1e-12 and 3e-3 < behind.max() <= 10e-3 * 0.4 + 1e-9  # 10 mm/s at most, 0.4 s
    both = robot(effects={"drive_lag": {"theta_s": 0.2, "l_s": 0.2}})
    ((_, straight),) = driven_ways(both.drive, corners)
    np.testing.assert_array_equal(straight, corners)  # all late alike: on the legs


def test_a_late_drive_is_followed_between_the_samples_of_its_timing() -> None:
    """What is sampled twice a leg is driven as what is sampled every 10 ms: joints go straight between samples."""
    late, corners = robot(**LATE), np.array([joints(0, 0, 0, -60), joints(40, 40, 40, -30)])
    each = time_parameterise(corners, late.drive)
    timing = replace(each, time_s=each.time_s[[0, -1]], position=each.position[[0, -1]])
    ((_, way),) = driven_ways(late.drive, corners, timing)
    at_s = np.linspace(0, timing.duration_s + 0.4, 500)
    share = np.interp(at_s[:, None] - late.drive.joint_late_s, timing.time_s, [0.0, 1.0])
    driven = corners[0] + share * (corners[1] - corners[0])
    steps = np.where(late.drive.is_rotation, STEP_RAD, STEP_M)
    assert distance_from_polyline(driven / steps, way / steps).max() < 1


def test_a_delay_that_is_known_by_an_interval_is_play_by_speed() -> None:
    lag = {"drive_lag": {"theta_s": 0.1, "ci95": {"theta_s": [0.05, 0.2]}}}
    box = Variants.of(bare_scenario(robot(effects=lag)), joints(0, 30, 60, -40)[None])
    np.testing.assert_allclose(np.sum(box.late, axis=0), [*[np.radians(60) * 0.1] * 3, 0])  # at 60 deg/s


@pytest.mark.parametrize("deg_s, is_known", [(1800, False), (600, True)])
def test_a_delay_by_whole_turns_at_full_speed_is_refused(deg_s: float, is_known: bool) -> None:
    """Its ends stand where the middle does, and nothing was taken off: a ball beside a helix that the tube is turned
    along at 720 of 1800 deg/s was certified at 0.18 mm, and a drive late by 0.4 s hits it by 0.1.
    """
    table = copy.deepcopy(dict(read_document(ROBOTS / "three_tube.toml").content))["joint"]
    table[2]["max_velocity_deg_s"] = deg_s
    lag = {"drive_lag": {"theta_s": 0.2, "ci95": {"theta_s": [0.0, 0.4]}}}
    fast = robot(**FRICTIONLESS, joint=table, effects=lag)
    result = certified(scene(fast, joints(0, 20, 60, -30), joints(0, 20, 62, -30)))
    assert ("half a turn" not in "".join(result.problems)) == is_known


def test_a_late_joint_takes_along_what_the_drive_adds_where_it_is() -> None:
    """A built term turned the inner tube by where its translation was commanded, 2.6 deg off at the ends of a delay."""
    lag = {"drive_lag": {"l_s": 0.2, "ci95": {"l_s": [0.0, 0.4]}}}
    late, q = robot(effects={**lag, "learned_theta_3": BUMP}), joints(0, 0, 100, -45)
    box = Variants.of(bare_scenario(late), q[None])
    for side in (-1.0, 1.0):
        there = q + side * np.array([0, 0, 0, 0.2 * late.drive.max_velocity[3]])
        for found, collars in zip(box.collars(box.end(0, side), q[None]), late.drive.collars(there), strict=True):
            np.testing.assert_allclose(found[0], collars, atol=1e-12)


def test_a_late_drive_waits_where_it_rests_for_what_follows_late() -> None:
    """The way after a target then begins at the joints from which its certificate begins."""
    corners = np.array([joints(0, 0, 0, -60), joints(40, 0, 0, -60), joints(40, 0, 0, -30)])
    for joinable in (True, False):
        fast, slow = (
            time_parameterise(corners, of.drive, rests=[1], joinable=joinable) for of in (robot(), robot(**LATE))
        )
        np.testing.assert_allclose(slow.leg_end_s - fast.leg_end_s, [0.4, 0.4], atol=1e-9)
        waiting = (slow.time_s > fast.leg_end_s[0]) & (slow.time_s < slow.leg_end_s[0])
        assert waiting.sum() > 30 and np.all(slow.position[waiting] == corners[1])
        assert np.abs(slow.velocity[waiting]).max() < 1e-12
        through = time_parameterise(corners, robot(**LATE).drive, joinable=joinable)
        np.testing.assert_allclose(through.leg_end_s, fast.leg_end_s, atol=1e-9)  # corners are no rests


@pytest.mark.parametrize("seed", range(3) if FUZZ else [2])
def test_no_robot_that_the_file_allows_comes_nearer_than_certified(seed: int) -> None:
    """An interval, play, a base that is off, and friction: at the ends and inside; and little is lost."""
    rng = np.random.default_rng(seed)
    ci95 = {"tube.3.section.2.curvature_per_m": [17.6, 18.6]}
    loose = robot(uncertainty={"ci95": ci95}, effects={"backlash": {"theta_2_deg": 1.5}})
    start = np.append(rng.uniform(-2, 2, 3), -40e-3)
    goal = start + np.append(rng.uniform(-0.3, 0.3, 3), 0.0)
    tip = loose.solve(*loose.drive.collars((start + goal) / 2)).tip_m
    away, stated = _unit(rng), -np.inf
    apart = (10e-3, 13e-3, 16e-3, 20e-3, 25e-3, 30e-3, 40e-3)
    for apart_m in apart[0 if FUZZ else 1 :]:  # the nearest ball that is certified
        ball = (1e3 * (tip + apart_m * away)).tolist(), 3.0
        case = scene(loose, start, goal, ball, registration=Registration(0.1e-3, 0.001))
        if (found := certified(case)).valid:
            stated = found.min_clearance_m
            break
    assert case.goal.joints is not None
    variants = Variants.of(case, np.array([start, case.goal.joints]))
    assert variants.count == 2
    least, base, center = np.inf, variants.base, case.anatomy[0].shape.center_m  # type: ignore[attr-defined]
    states = np.array([*itertools.product((-1.0, 1.0), repeat=2), *rng.uniform(-1, 1, (2, 2))])
    points = [*itertools.product((-1.0, 1.0), repeat=2), *map(tuple, rng.uniform(-1, 1, (4, 2)).tolist())]
    for point, share in itertools.product(points, np.linspace(0, 1, 7)):
        at = variants.configuration(point, start + share * (goal - start), "search")
        bodies = at.bodies(states, spacing_m=0.5e-3)
        apart = np.linalg.norm(bodies.point_m - center, axis=2) - 3e-3 - bodies.radius_m
        nearer = base.shift_m + base.rotation_rad * np.linalg.norm(
            np.cross(bodies.point_m, center), axis=2
        ) / np.linalg.norm(bodies.point_m - center, axis=2)
        least = min(least, float((apart - nearer).min()))
        assert (
            bodies.stability.min() >= found.min_stability - 1e-4 and bodies.max_strain.max() <= found.max_strain + 1e-6
        )
    assert 0 <= stated <= least
    assert least - stated < 1.2e-3  # meshes, steps between samples, and small axes that are added up


def test_what_takes_clearance_is_said_by_cause() -> None:
    """The parts add up from the frictionless robot to the certificate; each takes more where more of it is stated."""
    start, goal = joints(0, 47, 80, -40), joints(0, 48, 80, -40)
    plain = robot()
    tip = plain.solve(*plain.drive.collars((start + goal) / 2)).tip_m
    ball = ((tip + [3e-3, 9e-3, 2e-3]) * 1e3).tolist(), 3.0

    def taken(play_deg: float, per_m: float, sigma_mm: float) -> dict[str, float]:
        changes = {"effects": {"backlash": {"theta_2_deg": play_deg}}} if play_deg else {}
        if per_m:
            changes["uncertainty"] = {"ci95": {"tube.3.section.2.curvature_per_m": [18.1818 - per_m, 18.1818 + per_m]}}
        case = scene(robot(**changes), start, goal, ball, registration=Registration(sigma_mm * 1e-3, 0.0))
        result = certified(case)
        assert result.narrowest is not None
        parts = dict(result.narrowest.taken_m)
        at = plain.mechanics.friction_states(*plain.drive.collars(result.narrowest.joints), accuracy="certificate")
        bodies = at.bodies(np.zeros((1, 2)), spacing_m=0.25e-3)
        apart = np.linalg.norm(bodies.point_m[0] - np.array(ball[0]) * 1e-3, axis=1) - 3e-3 - bodies.radius_m
        assert sum(parts.values()) == pytest.approx(apart.min() - result.min_clearance_m, abs=0.02e-3)
        assert min(parts.values()) >= 0
        return parts

    little, much = taken(2.0, 0.2, 0.1), taken(4.0, 0.4, 0.2)
    play, curvature = "play and delay of the drive", "precurvature of tube 3"
    assert little.keys() - taken(0, 0, 0).keys() == {play, curvature, "registration"}
    for cause in (play, curvature, "registration"):
        assert 0 < little[cause] < much[cause]


def _unit(rng: np.random.Generator) -> Array:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def test_the_box_of_a_robot_without_intervals_is_empty_and_its_middle_is_the_file() -> None:
    plain, at = robot(), joints(0, 30, 60, -40)
    assert Variants.of(bare_scenario(plain), at[None]).count == 0
    loose = Variants.of(bare_scenario(robot(**PLAY)), at[None])
    theta_b, l_b = loose.collars(loose.end(-1), at[None])
    np.testing.assert_array_equal([theta_b[0], l_b[0]], plain.drive.collars(at))
    moved, _ = loose.collars(loose.end(0), at[None])
    np.testing.assert_allclose(moved - theta_b, [[0, 0, np.radians(2.0)]], atol=1e-12)


def test_points_of_another_body_stand_at_the_same_shares_of_the_length() -> None:
    rng = np.random.default_rng(0)
    body = np.cumsum(rng.uniform(0, 1, (40, 3)), axis=0)
    coarse = alike(body[None], body[::3])[0]
    np.testing.assert_allclose(shares_of_length(coarse), shares_of_length(body[::3]), atol=0.02)
    np.testing.assert_array_equal(coarse[[0, -1]], body[[0, -1]])


@pytest.mark.parametrize("stated_deg", [0.0, 2.0, 6.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_play_that_is_known_by_an_interval_reaches_to_both_sides(stated_deg: float, side: float) -> None:
    """It was a displacement to one side: of 0 deg in the file and up to 6 in the interval half was left out."""
    play = {"effects": {"backlash": {"theta_3_deg": stated_deg, "ci95": {"theta_3_deg": [0.0, 6.0]}}}}
    q, turned = joints(0, 30, 100, -45), joints(0, 30, 100 + side * 3, -45)
    plain = robot(**FRICTIONLESS)
    tip, farthest = (plain.solve(*plain.drive.collars(at)).tip_m for at in (q, turned))
    ball = Sphere(farthest + 1.5e-3 * (farthest - tip) / np.linalg.norm(farthest - tip), 1e-3)
    case = replace(bare_scenario(robot(**FRICTIONLESS, **play)), start=q, anatomy=(AnatomyPart(ball),))
    case = replace(case, goal=Goal(joints=q, tip_m=None, tolerance_m=1e-3))
    assert not certify(case, q[None], restart=False).valid
    assert certify(replace(case, robot=plain), q[None], restart=False).valid


@pytest.mark.parametrize("inner_mm", [0.0, -86.4])
def test_play_counts_where_a_limit_lets_it_move_to_one_side_alone(inner_mm: float) -> None:
    """One end of a small axis was looked at, which at home is stopped by the tube around: nothing was taken off."""
    play = robot(**FRICTIONLESS, effects={"backlash": {"l_3_mm": 0.3}})
    ends = joints(0, 30, 100, inner_mm), joints(0, 31, 100, inner_mm)
    play_m = certified(scene(play, *ends)).samples.play_m
    np.testing.assert_allclose(play_m, 0.15e-3, atol=0.01e-3)


def test_a_built_property_moves_the_robot_farther_than_it_did_in_its_data() -> None:
    """A margin as large as the tip's largest shift in the data, near home, was all that stood for it: 0.5 of 2.4 mm."""
    table = {"slope_l_3_percent": 5.0, "range": {"l_3": [-104, -90]}, "largest_mm": 0.5}
    plain, built = robot(**FRICTIONLESS), robot(**FRICTIONLESS, effects={"learned_curvature_3": table})
    ends = joints(0, 0, 60, -12), joints(0, 0, 62, -12)
    content = copy.deepcopy(dict(plain.content))
    for section in content["tube"][2]["section"]:  # beyond its range the term is held at the edge: 5 % more
        section["curvature_y_per_m"] *= 1.05
    tips = [one.solve(*plain.drive.collars(ends[1])).tip_m for one in (plain, robot_from_dict(content))]
    away = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    ball = (1e3 * (tips[1] + (0.3e-3 + plain.tubes[2].outer_diameter_m / 2) * away)).tolist(), 0.5
    assert certified(scene(plain, *ends, ball)).valid
    (problem,) = certified(scene(built, *ends, ball)).problems
    assert "too close" in problem


def test_a_robot_may_be_homed_anew_before_a_motion() -> None:
    """Zeros that its file has of later homings were left out: a plan held for the first one alone."""
    later, at = {"homing_shift": {"theta_3_2_deg": 3.0, "theta_3_3_deg": -5.0}}, joints(0, 20, 60, -30)
    plain, homed = robot(**FRICTIONLESS), robot(**FRICTIONLESS, effects=later)
    shifted = at - [0, 0, np.radians(5.0), 0]
    tips = [plain.solve(*plain.drive.collars(q)).tip_m for q in (at, shifted)]
    away = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    ball = (1e3 * (tips[1] + (0.3e-3 + plain.tubes[2].outer_diameter_m / 2) * away)).tolist(), 0.5
    ends = at, joints(0, 20.2, 60.2, -30)
    assert certified(scene(plain, *ends, ball)).valid
    (problem,) = certified(scene(homed, *ends, ball)).problems
    assert "too close" in problem


PULLED = {"tip_load": {"force_y_N": 0.1, "ci95": {"force_y_N": [0.0, 0.2]}}}
STANDS = Registration(0.2e-3, np.radians(0.3))


@pytest.mark.parametrize("room_mm, is_clear", [(-0.1, False), (1.0, True)])
def test_a_turn_of_the_registration_turns_the_anatomy_and_not_the_loads(room_mm: float, is_clear: bool) -> None:
    """Loads keep their direction in the robot's frame; how well it is known is what their own interval says."""
    at, end = joints(0, 20, 40, -30), joints(0, 22, 42, -30)
    pulled, strongest = robot(**FRICTIONLESS, effects=PULLED), {"tip_load": {"force_y_N": 0.2}}
    shape = robot(**FRICTIONLESS, effects=strongest).solve(*pulled.drive.collars(end))
    weak = robot(**FRICTIONLESS, effects={"tip_load": {"force_y_N": 0.1}}).solve(*pulled.drive.collars(end))
    assert np.linalg.norm(shape.tip_m - weak.tip_m) > 0.5e-3
    out = np.cross(np.cross(shape.tip_m, shape.tip_m - weak.tip_m), shape.tip_m)  # across the lever of a turn
    out /= np.linalg.norm(out)
    reach_m = CHI95 * (STANDS.position_sigma_m + STANDS.rotation_sigma_rad * np.linalg.norm(shape.tip_m))
    room_m = room_mm * 1e-3 + pulled.tubes[-1].outer_diameter_m / 2 + reach_m
    ball = (1e3 * (shape.tip_m + (room_m + 0.5e-3) * out)).tolist(), 0.5
    assert certified(scene(pulled, at, end, ball, registration=STANDS)).valid == is_clear


ECCENTRIC = {"eccentricity": {"sin_3_deg": 30.0}}


@pytest.mark.parametrize("effects", [{**PLAY["effects"], **ECCENTRIC}, {**ECCENTRIC, **PLAY["effects"]}])
def test_effects_after_play_act_on_what_it_left(effects: Any) -> None:
    """Collars at an end of the box are those of a drive that came from that side."""
    loose, at = robot(effects=effects), joints(20, 10, 0, -40)
    case = scene(loose, at, joints(20, 10, 5, -40))
    variants, chain, behind = Variants.of(case, np.array([at])), Chain.of(loose), np.array([0, 0, -1.0, 0, 0, 0])
    for side in (1.0, -1.0):
        theta_b, l_b = variants.collars(variants.end(0, side), at[None])
        theta, l = (part[None] for part in loose.drive.commanded(at))  # noqa: E741 (as in the equations)
        simulated = chain.drive(Collars(theta, l), side * behind[None])
        np.testing.assert_allclose(theta_b, simulated.theta, atol=1e-12)
        np.testing.assert_allclose(l_b, simulated.l, atol=1e-12)


@pytest.mark.parametrize("half_mm", [0.5, 1.0])
def test_a_term_that_acts_between_the_places_that_are_looked_at_is_found(half_mm: float) -> None:
    """A bump within a millimetre or two of the way, of no size but by its interval: no sample was where it acts."""
    middle, key = -61.3, "bump_3_of_5_l_3_deg"
    bump = {**BUMP, key: 10.0, "range": {"l_3": [middle - half_mm, middle + half_mm]}}
    wide = robot(**FRICTIONLESS, effects={"learned_theta_3": bump})
    maybe = robot(**FRICTIONLESS, effects={"learned_theta_3": {**bump, key: 0.0, "ci95": {key: [-10.0, 10.0]}}})
    at = joints(0, 20, 60, middle + 34)
    tips = [one.solve(*one.drive.collars(at), accuracy="certificate").tip_m for one in (maybe, wide)]
    away = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    reached = tips[1] + (0.2e-3 + wide.tubes[2].outer_diameter_m / 2) * away
    case = scene(maybe, joints(0, 20, 60, -45), joints(0, 20, 60, -10), ((1e3 * reached).tolist(), 0.5))
    assert not certified(case).valid


FREE = {"backlash": {"theta_2_deg": 8.0}}
COUPLED = {
    "stage": "drive",
    "acts_on": "the rotation of tube 3",
    "sin_3_theta_2_deg": 25.0,
    "range": {"theta_2": [-180, 180]},
}
BY_WAY = {"stage": "drive", "acts_on": "the rotation of tube 2", "sign_theta_1_deg": 4.0}
BOTH = {**FRICTIONLESS, "effects": {**FREE, "learned_theta_3": COUPLED, "learned_theta_2_way": BY_WAY}}


def test_a_collar_may_stand_on_another_side_at_each_place_of_its_play() -> None:
    """What turns the inner tube stands between the places: it follows the first alone. Both counted on one side."""
    loose, at = robot(**BOTH), joints(0, 0, 60, -30)
    variants, chain = Variants.of(scene(loose, at, at), np.array([at])), Chain.of(loose)
    theta, l = (part[None] for part in loose.drive.commanded(at))  # noqa: E741 (as in the equations)
    corners = [variants.collars(point, at[None])[0][0] for point in itertools.product((1.0, -1.0), repeat=2)]
    for outer, middle in itertools.product((1.0, -1.0), repeat=2):
        stands = chain.drive(Collars(theta, l), np.array([[outer, middle, 0, 0, 0, 0]])).theta[0]
        assert min(np.abs(corner - stands).max() for corner in corners) < np.radians(4.0 * (LARGEST - 1)) + 1e-12


def test_a_ball_that_two_places_of_play_reach_is_refused() -> None:
    loose = robot(**BOTH)
    at, end = joints(0, 0, 60, -30), joints(0, 0.3, 60.2, -30)
    theta, l = (part[None] for part in loose.drive.commanded(end))  # noqa: E741 (as in the equations)
    ways = np.array([[0, 0, 0, 0, 0, 0], [1, -1, 0, 0, 0, 0], [1, 1, 0, 0, 0, 0]])
    none, same, other = (Chain.of(loose).drive(Collars(theta, l), way[None]) for way in ways)
    tips = [loose.solve(one.theta[0], one.l[0], accuracy="certificate").tip_m for one in (none, same, other)]
    along = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    off = tips[2] - tips[0] - along * (along @ (tips[2] - tips[0]))
    reached = tips[2] + (0.2e-3 + loose.tubes[2].outer_diameter_m / 2) * off / np.linalg.norm(off)
    assert not certified(scene(loose, at, end, ((1e3 * reached).tolist(), 0.5))).valid


def test_a_ball_that_amplified_play_reaches_is_refused() -> None:
    ball = [74.03395692, 14.43749258, 166.86139617], 0.5
    contact = [{"friction_coefficient": 0.1}] * 2
    loose = robot(contact=contact, effects={"backlash": {"theta_3_deg": 10.0}, **ECCENTRIC})
    result = certified(scene(loose, joints(0, 0, -20, -40), joints(0, 0, 20, -40), ball))
    assert not result.valid and any("too close" in problem for problem in result.problems)
