"""Where a plan's robot comes closest to the anatomy: three numbers that a person can compare, and laws for them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from ctrplan.anatomy.parts import surface_distance
from ctrplan.certificate.certificate import Certificate, Closest, joined_certificates
from ctrplan.certificate.certify import certify
from ctrplan.certificate.friction_states import TIGHT_M
from ctrplan.certificate.narrow_samples import closely_solved
from ctrplan.certificate.walked_piece import narrowest_of, walk_pieces
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import joints_at
from ctrplan.scenario.joint_space import JointSpace

KINDS = ("nominal", "closest", "narrowest")
WAYPOINTS_DEG_MM = [[0, 60, 110, -30], [0, 60, 110, -20]]
SPHERES = [([20.0, 75.0, 182.0], 8.0, 1.0), ([60.0, 32.0, 165.0], 12.0, 0.5)]  # centre, radius, margin [mm]
MOVED_MM = np.array([30.0, -20.0, 50.0])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of a turn about z

PlanMaker = Callable[..., Plan]
Moved = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@pytest.fixture(scope="module")
def near(make_plan: PlanMaker) -> Plan:
    """A short way between two spheres; nobody changes it."""
    return make_plan(WAYPOINTS_DEG_MM, anatomy=spheres(lambda point_mm: point_mm))


@pytest.fixture
def place(near: Plan, request: pytest.FixtureRequest) -> Closest:
    return places(near.certificate)[KINDS.index(request.param)]


of_every_kind = pytest.mark.parametrize("place", KINDS, indirect=True)


def spheres(moved: Moved) -> list[dict[str, Any]]:
    return [
        {"kind": "sphere", "center_mm": moved(np.array(center)).tolist(), "radius_mm": radius, "margin_mm": margin}
        for center, radius, margin in SPHERES
    ]


def places(certificate: Certificate) -> list[Closest]:
    found = [getattr(certificate, kind) for kind in KINDS]
    assert all(isinstance(one, Closest) for one in found)
    return found


def test_friction_and_allowances_only_take_off(near: Plan) -> None:
    nominal, closest, narrowest = places(near.certificate)
    assert nominal.clearance_m > closest.clearance_m > near.certificate.min_clearance_m
    assert narrowest.clearance_m >= closest.clearance_m
    assert not nominal.phi.any() and closest.phi.any()


@of_every_kind
def test_a_place_lies_on_the_robot(near: Plan, place: Closest) -> None:
    """The equilibrium of its joints and friction state has its point, and its tube is the outermost there."""
    scenario, mechanics = near.scenario, near.scenario.robot.mechanics
    shape = mechanics.solve(*scenario.robot.drive.collars(place.joints), place.phi, accuracy="certificate")
    tube = shape.tubes[place.tube - 1]
    along_m = np.linspace(0.0, tube.s_m[-1], 5001)
    line = CubicHermiteSpline(tube.s_m, tube.centreline_m, tube.frames[:, :, 2])(along_m)
    apart = np.linalg.norm(line @ scenario.base_R.T + scenario.base_position_m - place.point_m, axis=1)
    assert apart.min() < 0.05e-3
    assert all(outer.s_m[-1] < along_m[np.argmin(apart)] + 1e-4 for outer in shape.tubes[: place.tube - 1])


@of_every_kind
def test_distance_less_margin_is_the_clearance(near: Plan, place: Closest) -> None:
    number = int(place.part.removeprefix("anatomy.").split(" ")[0])
    part, tube = near.scenario.anatomy[number - 1], near.scenario.robot.tubes[place.tube - 1]
    distance = float(surface_distance(part, place.point_m[None])[0]) - tube.outer_diameter_m / 2
    assert place.distance_m == pytest.approx(distance, abs=1e-9)
    assert place.clearance_m == pytest.approx(distance - part.margin_m, abs=1e-9)


@of_every_kind
def test_the_trajectory_is_there_at_the_time(near: Plan, place: Closest) -> None:
    there = joints_at(near.trajectory, np.array([near.time_of(place)]))[0]
    np.testing.assert_allclose(there, place.joints, atol=1e-3)


def test_plan_json_says_places_and_times(near: Plan) -> None:
    content = near.to_json()["certificate"]
    for kind, one in zip(KINDS, places(near.certificate), strict=True):
        assert content[kind]["time_s"] == near.time_of(one)
        assert content[kind]["point_m"] == one.point_m.tolist() and content[kind]["tube"] == one.tube


def test_least_certified_clearance_is_left_at_its_place(near: Plan) -> None:
    """Within what a certificate does not tell apart."""
    samples, narrowest = near.certificate.samples, places(near.certificate)[2]
    rows = samples.path_mm == narrowest.path_mm
    assert samples.clearance_m[rows].min() <= near.certificate.min_clearance_m + TIGHT_M


def test_base_and_anatomy_moved_together_move_the_place(near: Plan, make_plan: PlanMaker) -> None:
    """The room knows no origin and no axes."""

    def moved(point_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        found: NDArray[np.float64] = QUARTER @ point_mm + MOVED_MM
        return found

    base = {"position_mm": MOVED_MM.tolist(), "quaternion_wxyz": [0.5**0.5, 0.0, 0.0, 0.5**0.5]}
    there = make_plan(WAYPOINTS_DEG_MM, anatomy=spheres(moved), base=base).certificate
    for one, other in zip(places(near.certificate), places(there), strict=True):
        assert (one.tube, one.part, one.leg) == (other.tube, other.part, other.leg)
        assert other.clearance_m == pytest.approx(one.clearance_m, abs=1e-6)
        np.testing.assert_allclose(other.point_m * 1e3, moved(one.point_m * 1e3), atol=0.01)
        np.testing.assert_array_equal(other.phi, one.phi)
    assert there.min_clearance_m == pytest.approx(near.certificate.min_clearance_m, abs=1e-6)


def test_both_meshes_say_the_same(near: Plan) -> None:
    fine = certify(near.scenario, near.waypoints, accuracy="certificate")
    for one, other in zip(places(near.certificate), places(fine), strict=True):
        assert other.clearance_m == pytest.approx(one.clearance_m, abs=0.1e-3)
    assert fine.min_clearance_m == pytest.approx(near.certificate.min_clearance_m, abs=0.1e-3)


def test_a_tour_has_the_places_of_its_narrowest_stage_and_the_start_of_its_first(near: Plan) -> None:
    second = near.certificate
    wide = {
        kind: replace(one, clearance_m=one.clearance_m + 1e-3) for kind, one in zip(KINDS, places(second), strict=True)
    }
    first = replace(second, start_friction="released", min_clearance_m=second.min_clearance_m + 1e-3, **wide)
    tour, legs = joined_certificates([first, second]), int(first.samples.leg[-1]) + 1
    assert tour.start_friction == "released" and tour.min_clearance_m == second.min_clearance_m
    for one, of_stage in zip(places(tour), places(second), strict=True):
        assert one.clearance_m == of_stage.clearance_m and one.leg == of_stage.leg + legs
        assert one.path_mm == pytest.approx(of_stage.path_mm + first.length_mm)


def test_a_path_that_touches_has_places_too(make_plan: PlanMaker) -> None:
    center, radius, margin = SPHERES[1]
    through = [{"kind": "sphere", "center_mm": center, "radius_mm": radius + 12, "margin_mm": margin}]
    refused = make_plan(WAYPOINTS_DEG_MM, anatomy=through).certificate
    assert not refused.valid and places(refused)[1].clearance_m < 0


def test_free_space_has_no_places(make_plan: PlanMaker) -> None:
    free = make_plan([[0, 0], [60, -120]], robot="robots/table_1_pair.toml")
    content = free.to_json()["certificate"]
    assert all(getattr(free.certificate, kind) is None and content[kind] is None for kind in KINDS)
    assert np.isinf(free.certificate.min_clearance_m)


def test_no_corner_shape_of_the_path_comes_closer(make_plan: PlanMaker) -> None:
    """Samples that are narrow only by what is taken off for the mesh are not taken for the narrowest."""
    room = {"kind": "sphere", "role": "inside", "center_mm": [5.0, 0.0, 95.0], "radius_mm": 125.0}
    plan = make_plan([[100, 160, 210, -30], [150, 210, 260, -30]], anatomy=[room])
    scenario, samples = plan.scenario, plan.certificate.samples
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=scenario.robot.n - 1)))
    least_m = np.inf
    for joints in samples.joints[::4]:
        bodies = scenario.robot.mechanics.friction_bodies(*scenario.robot.drive.collars(joints), corners)
        points = bodies.point_m @ scenario.base_R.T + scenario.base_position_m
        apart = -surface_distance(scenario.anatomy[0], points.reshape(-1, 3)).reshape(points.shape[:2])
        least_m = min(least_m, float((apart - bodies.radius_m).min()))
    assert places(plan.certificate)[1].clearance_m <= least_m + 0.05e-3


def test_where_a_path_is_narrow_everywhere_both_meshes_leave_the_same(make_plan: PlanMaker) -> None:
    """The robot turns as a whole about the axis of a tube around it. Once no more than 60 samples were solved again."""
    around = {"kind": "capsule", "role": "inside", "from_mm": [0, 0, -100], "to_mm": [0, 0, 300], "radius_mm": 80}
    scenario = make_plan([[0, 60, 110, -30]], anatomy=[around]).scenario
    legs = scenario.start + np.array([np.zeros(4), np.radians([34.0, 34.0, 34.0, 0.0])])
    coarse, fine = (
        walk_pieces(scenario, JointSpace.of(scenario), legs, accuracy, None) for accuracy in ("search", "certificate")
    )
    assert sum(len(piece.l_b) for piece in coarse) > 64
    assert abs(narrowest_of(closely_solved(scenario, coarse, np.inf)) - narrowest_of(fine)) < TIGHT_M / 2
