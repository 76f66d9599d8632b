"""plan.png is drawn without a display, at its size, for every kind of plan."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image
from places import ROBOTS

from ctrplan.files.robot_file import load_robot
from ctrplan.plans.plan import Plan
from ctrplan.reports import looks
from ctrplan.reports.plan_picture import plan_figure, write_plan_png
from ctrplan.reports.plan_scene import PlanScene, plan_scene


@pytest.fixture(scope="module")
def figure(scene: PlanScene) -> Figure:
    return plan_figure(scene)


def panel(figure: Figure, label: str) -> Axes:
    return next(ax for ax in figure.axes if ax.get_ylabel() == label)


def test_png_has_its_size_and_is_not_blank(scene: PlanScene, tmp_path: Path) -> None:
    write_plan_png(tmp_path / "plan.png", scene)
    with Image.open(tmp_path / "plan.png") as image:
        assert image.size == (1600, 1000)
        assert len(np.unique(np.asarray(image.convert("L")))) > 50
    assert [path.name for path in tmp_path.iterdir()] == ["plan.png"]


def test_no_global_state(figure: Figure) -> None:
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


def test_every_axis_has_its_unit(figure: Figure) -> None:
    scene, *others = figure.axes
    assert {axis.get_label_text() for axis in (scene.xaxis, scene.yaxis, scene.zaxis)} == {"x (mm)", "y (mm)", "z (mm)"}
    labels = {
        "clearance (mm)",
        "stability",
        "error (mm)",
        "position (deg)",
        "position (mm)",
        "speed (% of limit)",
    }
    assert {ax.get_ylabel() for ax in others} == labels


def test_curves_are_the_plan(figure: Figure, plan: Plan) -> None:
    error = [line.get_ydata() for line in panel(figure, "error (mm)").lines if len(line.get_ydata()) > 2]
    np.testing.assert_allclose(error[0], plan.certificate.samples.bound_m * 1e3)
    np.testing.assert_allclose(error[1], plan.certificate.samples.predicted_m * 1e3)
    drawn = [line.get_ydata() for line in panel(figure, "position (deg)").lines if len(line.get_ydata()) > 2]
    rotations = np.degrees(plan.trajectory.position[:, plan.scenario.robot.drive.is_rotation])
    np.testing.assert_allclose(np.array(drawn).T, rotations)


def test_legs_are_shaded_by_kind(figure: Figure, plan: Plan) -> None:
    shades = [patch.get_facecolor() for patch in panel(figure, "error (mm)").patches]
    ends = [patch.get_x() + patch.get_width() for patch in panel(figure, "error (mm)").patches]
    assert len(set(shades)) == len(plan.legs)
    np.testing.assert_allclose(ends, plan.trajectory.leg_end_s)


def test_names_are_not_typeset(scene: PlanScene, tmp_path: Path) -> None:
    plan = scene.plan
    drive = plan.scenario.robot.drive
    joints = tuple(replace(joint, name=f"_$\\frac{{{k}$ <b>") for k, joint in enumerate(drive.joints))
    robot = replace(plan.scenario.robot, drive=replace(drive, joints=joints))
    scenario = replace(plan.scenario, name="$\\undefined{$ & <i>" * 20, robot=robot)
    write_plan_png(tmp_path / "plan.png", replace(scene, plan=replace(plan, scenario=scenario)))


def test_free_space_shows_strain_instead_of_clearance(make_plan: Callable[..., Plan]) -> None:
    plan = make_plan([[0, 0], [60, -120]], robot="robots/table_1_pair.toml", cost={"max_error_goal_mm": 2.0})
    labels = [ax.get_ylabel() for ax in plan_figure(plan_scene(plan)).axes]
    assert "strain (%)" in labels and "clearance (mm)" not in labels and "position (mm)" not in labels


def test_motion_without_time_is_drawn(make_plan: Callable[..., Plan], tmp_path: Path) -> None:
    write_plan_png(tmp_path / "plan.png", plan_scene(make_plan([[0, 0], [0, 0]], robot="robots/table_1_pair.toml")))


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_joints_of_a_kind_differ_in_colour(path: Path) -> None:
    drive = load_robot(path).drive
    coloured = list(zip(drive.is_rotation.tolist(), looks.joint_colours(drive), strict=True))
    assert len(set(coloured)) == len(coloured)
