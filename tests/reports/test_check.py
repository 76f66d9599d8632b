"""`ctrplan check` says what a file means, flags what is in another unit, and draws tubes to scale."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints, write_csv
from PIL import Image
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.reports.object_figures import _bent_line

THREE = ROBOTS / "three_tube.toml"


def test_a_robot_in_numbers_that_a_person_knows() -> None:
    result = ctrplan.check(THREE)
    robot = load_robot(THREE)
    for i, tube in enumerate(robot.tubes, start=1):
        inertia = math.pi / 64 * (tube.outer_diameter_m**4 - tube.inner_diameter_m**4)
        young = tube.bending_stiffness_Nm2 / inertia / 1e9
        assert result.facts[f"tube.{i}.youngs_modulus_GPa"] == pytest.approx(young)
        assert result.facts[f"tube.{i}.shear_modulus_GPa"] == pytest.approx(young / 2 / (1 + tube.poisson_ratio))
        strain = tube.outer_diameter_m / 2 * max(s.curvature_per_m for s in tube.sections)
        assert result.facts[f"tube.{i}.straightened_strain"] == pytest.approx(strain)
    assert "bent by a radius of 55 mm over 86.4 mm (90 deg)" in result.text
    assert "the innermost tip 150 to 236.4 mm along" in result.text
    assert "0.0425 mm radial clearance" in result.text and result.text.endswith("Nothing is in doubt.")
    assert result.flags == () and 0 < result.facts["bound_median_mm"] <= result.facts["bound_largest_mm"]
    assert result.bound is not None
    assert result.bound.position_m * 1e3 == pytest.approx(result.facts["bound_largest_mm"], rel=1e-6)
    assert len(repr(result).splitlines()) <= 30


def test_an_object_is_looked_at_as_its_file_is() -> None:
    robot = load_robot(THREE)
    assert ctrplan.check(robot).text == ctrplan.check(THREE).text
    with pytest.raises(InputError, match="subject = 7: must be a file, a Robot"):
        ctrplan.check(7)  # type: ignore[arg-type]


def test_flags_end_in_exit_code_1_and_are_in_the_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = dict(load_robot(THREE).content)
    content["tube"] = [
        dict(tube, bending_stiffness_Nm2=tube["bending_stiffness_Nm2"] * 1e6) for tube in content["tube"]
    ]
    write_robot(tmp_path / "r.toml", content)
    assert main(["check", str(tmp_path / "r.toml")]) == 1
    told = capsys.readouterr().out
    assert told.count("is it in N mm^2?") == 3 and "3 in doubt, marked by !." in told
    assert main(["check", str(tmp_path / "r.toml"), "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)["flags"]) == 3
    assert main(["bound", str(tmp_path / "r.toml"), "--theta-deg", "0", "0", "0", "--l-mm", "0", "-17", "-34"]) == 0
    warned = [line for line in capsys.readouterr().err.splitlines() if "Young" in line]
    assert len(warned) == 1 and "2 more numbers in doubt: ctrplan check" in warned[0]


def test_pictures_are_written_and_show_something(tmp_path: Path) -> None:
    assert main(["check", str(THREE), "-o", str(tmp_path / "out")]) == 0
    for name in ("tubes.png", "bound.png"):
        pixels = np.asarray(Image.open(tmp_path / "out" / name).convert("L"))
        assert min(pixels.shape) > 400 and (pixels < 200).mean() > 0.005


def test_tubes_are_drawn_by_their_own_arcs() -> None:
    tube = load_robot(THREE).tubes[2]
    line, normal = _bent_line(tube)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(tube.length_m)
    np.testing.assert_allclose(
        line[-1], [0.184 + 0.055 * math.sin(0.0864 / 0.055), -0.055 * (1 - math.cos(0.0864 / 0.055))], atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1)
    low, high = load_robot(THREE).drive.travel_m
    np.testing.assert_allclose(low, [0, -0.017, -0.1204])
    np.testing.assert_allclose(high, [0, -0.017, -0.034])


def test_a_scenario_says_how_far_its_goal_is_and_how_large_its_parts_are() -> None:
    text = ctrplan.check(SCENARIOS / "vessel.toml").text
    assert "goal: tip at (51, 2, 168) mm within 1 mm, 176 mm from the base, 65 % of the robot's length" in text
    assert "anatomy.1: vessel.stl, (85.88, 31.96, 204.9) mm across, to stay inside, margin 0.5 mm" in text


def test_measurements_need_their_robot_and_say_how_far_off_it_is(tmp_path: Path) -> None:
    robot = pair_robot()
    data = measured(robot, waypoints(robot, 5))
    write_csv(tmp_path / "a.csv", data)
    result = ctrplan.check(tmp_path / "a.csv", robot=robot)
    assert result.kind == "measurements" and result.facts["poses"] == data.count
    assert result.facts["error_median_mm"] < 0.5 and result.flags == ()
    write_csv(tmp_path / "b.csv", replace(data, position_m=data.position_m[:, [1, 2, 0]]))
    (flag,) = ctrplan.check(tmp_path / "b.csv", robot=robot).flags
    assert "The columns of positions are not x, y, z but hold them as (z, x, y)" in flag
    with pytest.raises(InputError, match="robot: is needed: say the robot that was measured"):
        ctrplan.check(tmp_path / "a.csv")
