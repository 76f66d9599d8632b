"""What the pictures show is the model's robot, in the anatomy's frame, at the right time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import joints_at, leg_end_s, sample_time_s
from ctrplan.reports.live_state import LiveState
from ctrplan.reports.looks import view_box
from ctrplan.reports.plan_motion import scene_figure, start_figure
from ctrplan.reports.plan_scene import goal_tip, plan_scene, tip_path
from ctrplan.reports.reach_page import ReachScene, reach_figure
from ctrplan.reports.robot_surface import end_rings, plate, pose, tube_surface

TURN = Rotation.from_euler("xyz", [40, -70, 110], degrees=True)
SHIFT_M = np.array([0.02, -0.05, 0.11])


@pytest.fixture(scope="module")
def turned(plan: Plan) -> Plan:
    return replace(plan, scenario=replace(plan.scenario, base_R=TURN.as_matrix(), base_position_m=SHIFT_M))


def test_turned_base_turns_everything(plan: Plan, turned: Plan) -> None:
    for here, there in zip(plan_scene(plan, 3).path, plan_scene(turned, 3).path, strict=True):
        for a, b in zip((*here.tubes, here.envelope), (*there.tubes, there.envelope), strict=True):
            np.testing.assert_allclose(moved(a.centreline_m), b.centreline_m, atol=1e-12)
            np.testing.assert_allclose(TURN.apply(a.tangent), b.tangent, atol=1e-12)
            np.testing.assert_array_equal(a.radius_m, b.radius_m)
        np.testing.assert_allclose(moved(here.corners_m), there.corners_m, atol=1e-12)
    np.testing.assert_allclose(moved(tip_path(plan)), tip_path(turned), atol=1e-12)
    before, after = plate(plan.scenario), plate(turned.scenario)
    np.testing.assert_allclose(moved(before.centreline_m), after.centreline_m, atol=1e-12)


def test_tubes_lie_where_the_model_has_them(plan: Plan) -> None:
    robot, q = plan.scenario.robot, plan.legs[-1].end
    bound, shown = robot.bound(*robot.drive.collars(q)), pose(plan.scenario, q)
    for rod, tube, data in zip(shown.tubes, bound.frictionless.tubes, robot.tubes, strict=True):
        np.testing.assert_allclose(rod.centreline_m[-1], tube.centreline_m[-1], atol=1e-12)
        at_plate = [np.interp(0.0, tube.s_m, column) for column in tube.centreline_m.T]
        np.testing.assert_allclose(rod.centreline_m[0], at_plate, atol=1e-6)
        np.testing.assert_array_equal(rod.radius_m, data.outer_diameter_m / 2)
    tips = [corner.tip_m for corner in bound.corners]
    np.testing.assert_allclose(shown.corners_m[:, -1], tips, atol=1e-12)
    assert np.linalg.norm(shown.corners_m[:, -1] - shown.tip_m, axis=1).max() == pytest.approx(bound.position_m)
    assert shown.bound_m == bound.position_m


def test_envelope_holds_every_corner_shape_and_drops_with_the_tubes(plan: Plan) -> None:
    scenario, q = plan.scenario, plan.legs[-1].end
    robot, shown = scenario.robot, pose(scenario, q)
    innermost, outermost = robot.tubes[-1].outer_diameter_m / 2, robot.tubes[0].outer_diameter_m / 2
    assert shown.envelope.radius_m[-1] == pytest.approx(shown.bound_m + innermost)
    assert shown.envelope.radius_m[0] >= outermost
    grown = pose(replace(scenario, robot=replace(robot, model_error_m=0.002)), q)
    np.testing.assert_allclose(grown.envelope.radius_m - shown.envelope.radius_m, 0.002, atol=1e-12)
    line, radius = shown.envelope.centreline_m, shown.envelope.radius_m
    for corner in shown.corners_m:
        gap = np.linalg.norm(corner[:, None] - line, axis=2) + innermost - radius
        assert gap.min(axis=1).max() < 0.1e-3


def test_frames_follow_the_trajectory(plan: Plan) -> None:
    frames = plan_scene(plan, 5).path
    assert frames[0].time_s == 0 and frames[-1].time_s == pytest.approx(plan.trajectory.duration_s)
    np.testing.assert_allclose(frames[0].tip_m, tip_path(plan)[0], atol=0.3e-3)
    np.testing.assert_allclose(frames[-1].tip_m, tip_path(plan)[-1], atol=0.3e-3)
    shapes = {(len(pose.tubes), pose.envelope.centreline_m.shape, pose.corners_m.shape) for pose in frames}
    assert len(shapes) == 1


def test_a_motion_without_time_is_one_frame(make_plan: Callable[..., Plan]) -> None:
    assert len(plan_scene(make_plan([[0, 0], [0, 0]], robot="robots/table_1_pair.toml")).path) == 1


def test_samples_are_passed_when_the_trajectory_is_there(plan: Plan) -> None:
    time_s = sample_time_s(plan)
    assert np.all(np.diff(time_s) >= 0) and time_s[0] == 0
    np.testing.assert_allclose(joints_at(plan.trajectory, time_s), plan.certificate.samples.joints, atol=2e-3)
    np.testing.assert_allclose(joints_at(plan.trajectory, leg_end_s(plan)), plan.waypoints[1:], atol=1e-6)


def test_legs_in_one_direction_end_in_passing(make_plan: Callable[..., Plan]) -> None:
    plan = make_plan([[0, 0], [20, -30], [60, -90]], robot="robots/table_1_pair.toml")
    assert plan.trajectory.stops == 0
    np.testing.assert_allclose(joints_at(plan.trajectory, leg_end_s(plan)), plan.waypoints[1:], atol=1e-9)


def test_goal_is_the_tip_asked_for_or_the_last_one(plan: Plan, turned: Plan) -> None:
    np.testing.assert_array_equal(goal_tip(plan), plan.scenario.goal.tip_m)
    goal = replace(plan.scenario.goal, tip_m=None, joints=turned.waypoints[-1])
    by_joints = replace(turned, scenario=replace(turned.scenario, goal=goal))
    np.testing.assert_array_equal(goal_tip(by_joints), tip_path(turned)[-1])


def test_view_shows_the_robot_and_no_more_anatomy_than_is_near() -> None:
    robot, organ = np.array([[0, 0, 0], [0.01, 0, 0.1]]), np.array([[-1, -0.02, 0.0], [1, 0.02, 0.1]])
    lower, upper = view_box(robot, organ)
    assert np.all(lower < robot.min(axis=0)) and np.all(upper > robot.max(axis=0))
    assert lower[0] > -0.1 and upper[0] < 0.1 and lower[1] < -0.02 < 0.02 < upper[1]


def test_view_of_a_flat_scene_is_a_box() -> None:
    lower, upper = view_box(np.array([[0, 0, 0], [0, 0, 0.1]]), np.empty((0, 3)))
    assert (upper - lower).min() > 0.3 * (upper - lower).max()


def moved(points_m: np.ndarray) -> np.ndarray:
    return TURN.apply(points_m.reshape(-1, 3)).reshape(points_m.shape) + SHIFT_M


def test_a_tube_that_others_hide_has_a_ring_at_its_end(plan: Plan) -> None:
    """Tubes 1 and 2 of this robot end at one place: tube 2 would never be seen."""
    shown = pose(plan.scenario, plan.legs[-1].end)
    outer, middle, inner = end_rings(shown)
    assert middle.radius_m.min() > shown.tubes[0].radius_m.max() and not inner.radius_m.any()
    assert not outer.radius_m.any()
    assert np.linalg.norm(middle.centreline_m[-1] - shown.tubes[1].centreline_m[-1]) < 0.05 * 0.15
    counts = {len(tube_surface(shown, tube, 10).vertices_m) for tube in range(3)}
    assert counts == {len(tube_surface(pose(plan.scenario, plan.legs[0].start), 1, 10).vertices_m)}


@pytest.mark.parametrize(("frame", "left", "back"), [("RAS", "L → R", "P → A"), ("LPS", "R → L", "A → P")])
def test_letters_at_the_axes_say_the_patients_frame(frame: Frame, left: str, back: str, plan: Plan) -> None:
    scene = plan_scene(replace(plan, scenario=replace(plan.scenario, frame=frame)), 2)
    axes = scene_figure(scene).layout.scene
    assert (axes.xaxis.title.text, axes.yaxis.title.text) == (f"x, {left} (mm)", f"y, {back} (mm)")
    assert axes.zaxis.title.text == "z, I → S (mm)"
    ends = [trace.text[-1] for trace in scene_figure(scene).data if trace.name == "axes"]
    assert [end.split(",")[0] for end in ends] == [left[-1], back[-1], "S"] and ends[0].endswith(" mm")
    assert scene_figure(plan_scene(plan, 2)).layout.scene.xaxis.title.text == "x (mm)"


def test_plain_figures_are_figures_of_plotly(plan: Plan) -> None:
    """Which refuses keys and values that plotly.js would leave out without a word."""
    scene = plan_scene(plan, 2)
    branches = ReachScene(plan.scenario, (), (0,), goal_tip(plan), ((0, scene.goal),))
    for figure in (start_figure(scene), reach_figure(branches), LiveState(plan.scenario).figure()):
        checked = go.Figure(figure)
        assert len(checked.data) == len(figure["data"]) and checked.layout.scene.aspectmode == "manual"
    with pytest.raises(ValueError, match="lightning"):
        go.Figure({"data": [{"type": "mesh3d", "lightning": {}}]})
