"""A tube that is bent at a place: the same as a file that says so, with exact derivatives, and told by its tips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints
from places import ROBOTS

from ctrplan.diagnosis import CATALOGUE, diagnose
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.mechanics.shapes import largest_plate_moment, plate_moment
from ctrplan.mechanics.tube import TubeSection
from ctrplan.robot.magnitudes import straightened_strain
from ctrplan.robot.named_numbers import value_of, with_values
from ctrplan.robot.robot import Robot

ROBOT = pair_robot()
BEND = {"tube.2.section.2.cell.3.x_rad": 0.05, "tube.2.section.2.cell.3.y_rad": -0.02}
OTHERS = ("curvature_x_per_m", "curvature_y_per_m", "gradient", "length_m")


def written_out(x_rad: float, y_rad: float) -> Robot:
    """The pair whose inner tube is said to be bent over 14 mm from 58 mm on, section by section."""
    content = dict(ROBOT.content)
    tube = content["tube"][1]
    whole = tube["section"][1]
    pieces = [28.0, 14.0, 28.0]
    sections = [whole | {"length_mm": length} for length in pieces]
    sections[1] |= {"curvature_x_per_m": x_rad / 14e-3, "curvature_y_per_m": whole["curvature_y_per_m"] + y_rad / 14e-3}
    inner = tube | {"section": [tube["section"][0], *sections]}
    return robot_from_dict(content | {"tube": [content["tube"][0], inner]})


def test_a_kink_is_a_section_of_another_precurvature() -> None:
    data = waypoints(ROBOT, 6)
    joints = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    for one, other in zip(
        (with_values(ROBOT, BEND), ROBOT), (written_out(0.05, -0.02), written_out(0.0, 0.0)), strict=True
    ):
        tips = [robot.mechanics.tips_with_friction(*joints, np.zeros((data.count, 1))) for robot in (one, other)]
        np.testing.assert_allclose(tips[0].position_m, tips[1].position_m, atol=2e-5)  # other elements
    assert value_of(with_values(ROBOT, BEND), next(iter(BEND))) == 0.05


def test_pieces_keep_length_and_drawn_precurvature() -> None:
    section = TubeSection(0.07, 1.0, 9.0, 0.4, bent=((2, 0.0, 0.0), (5, 0.0, 0.0)))
    assert section.cells == 5 and [len(s.pieces) for s in (section, replace(section, bent=()))] == [4, 1]
    assert sum(piece.length_m for piece in section.pieces) == pytest.approx(0.07, abs=1e-15)
    begin = 0.0
    for piece in section.pieces:
        for x in (0.0, 0.3, 1.0):
            own = piece.curvature_y_per_m * (1 + piece.gradient * (2 * x - 1))
            drawn = 9.0 * (1 + 0.4 * (2 * (begin + x * piece.length_m) / 0.07 - 1))
            assert own == pytest.approx(drawn, rel=1e-12)
        begin += piece.length_m


@pytest.mark.parametrize("name", [*BEND, *(f"tube.2.section.2.{key}" for key in OTHERS)])
def test_derivatives_are_exact_beside_a_kink(name: str) -> None:
    robot = with_values(ROBOT, {**BEND, "tube.2.section.2.gradient": 0.1})
    joints = np.array([[0.0, 2.0], [0.0, -1.0]]), np.array([[-0.004, -0.015], [-0.002, -0.02]])
    still = np.zeros((2, 1))
    by = robot.mechanics.tips_with_friction(*joints, still, parameters=[name]).position_by[:, :, 0]
    h, value = (1e-7 if "length" in name else 1e-5), value_of(robot, name)
    beside = [with_values(robot, {name: value + step}).mechanics.tips_with_friction(*joints, still) for step in (h, -h)]
    difference = (beside[0].position_m - beside[1].position_m) / (2 * h)
    np.testing.assert_allclose(by, difference, atol=1e-6 * np.abs(difference).max())


def test_a_cell_that_is_none_is_refused() -> None:
    for name in ("tube.2.section.2.cell.6.x_rad", "tube.2.section.2.cell.1.z_rad", "tube.2.section.3.cell.1.x_rad"):
        with pytest.raises(InputError, match="no such parameter of the robot"):
            with_values(ROBOT, {name: 0.1})


@pytest.mark.parametrize("place", [2, 4])
def test_a_kink_is_named_with_its_place(place: int) -> None:
    """Made by the effect: a file with a tube that is bent there gives the same tips."""
    data = measured(ROBOT, waypoints(ROBOT, 24), {"kink": {f"across_2_2_{place}_deg": 4.0}})
    diagnosis = diagnose(ROBOT, data)
    assert diagnosis.verdict == "named" and [t.name for t in diagnosis.listed] == ["kink"]
    assert diagnosis.listed[0].parameters[0].name.endswith(f"_2_2_{place}_deg")
    content = diagnosis.robot_content()
    low, high = content["effects"]["kink"]["ci95"][f"across_2_2_{place}_deg"]
    assert low - (high - low) / 2 < 4.0 < high + (high - low) / 2 and robot_from_dict(content).effects["kink"]


def test_every_cell_is_a_variant_and_a_straight_section_has_none() -> None:
    variants = CATALOGUE["kink"].variants(ROBOT, waypoints(ROBOT, 2))
    places = [f"1_1_{c}" for c in range(1, 5)] + [f"2_2_{c}" for c in range(1, 6)]
    assert variants == [[f"along_{place}_deg", f"across_{place}_deg"] for place in places]


def test_a_bend_within_the_drawn_plane_has_no_name() -> None:
    """A precurvature that varies along its section does the same."""
    data = measured(ROBOT, waypoints(ROBOT, 24), {"kink": {"along_2_2_4_deg": 6.0}})
    diagnosis = diagnose(ROBOT, data, without=["varying_precurvature"])
    assert not diagnosis.listed and [t.name for t in diagnosis.together] == ["kink"]
    assert diagnosis.gap.after.rms_m < 1.2 * diagnosis.gap.floor_m < diagnosis.gap.before.rms_m / 1.5


def test_of_many_parameters_the_likeliest_and_examples_are_named() -> None:
    with pytest.raises(
        InputError, match=r"unknown parameter, did you mean .*_1_deg\? \d+ are known: along_1_"
    ) as raised:
        load_robot(ROBOTS / "three_tube.toml", ["effects.kink={along_3_9_1_deg=5}"])
    assert len(str(raised.value)) < 250


def test_what_a_bent_tube_asks_of_its_plate_and_of_its_material_is_asked_of_pieces() -> None:
    """The moment on the guide with the kink there, and the strain of the tube held straight."""
    bent, written = with_values(ROBOT, BEND), written_out(0.05, -0.02)
    theta_b, l_b = np.array([[0.3, -1.1]]), np.array([[-0.07, -0.075]])  # the guide is 65 to 75 mm along the inner tube
    np.testing.assert_allclose(plate_moment(bent.tubes, theta_b, l_b), plate_moment(written.tubes, theta_b, l_b))
    assert not np.allclose(plate_moment(bent.tubes, theta_b, l_b), plate_moment(ROBOT.tubes, theta_b, l_b))
    assert largest_plate_moment(bent.tubes) == pytest.approx(largest_plate_moment(written.tubes))
    assert straightened_strain(bent.tubes[1]) == pytest.approx(straightened_strain(written.tubes[1]))


def test_across_bends_out_of_the_plane_of_what_was_drawn_whichever_that_is() -> None:
    outer, inner = ROBOT.tubes
    drawn = np.array([3.0, 4.0])
    sections = [inner.sections[0], replace(inner.sections[1], curvature_x_per_m=3.0, curvature_y_per_m=4.0)]
    turned = ROBOT.with_(tubes=(outer, replace(inner, sections=sections)))
    angle = np.radians(2.0)
    bend = CATALOGUE["kink"].mechanics
    along, across = (np.array([*bend({f"{way}_2_2_3_deg": angle}, turned).values()]) for way in ("along", "across"))
    np.testing.assert_allclose(along, angle * drawn / 5)
    assert along @ across == pytest.approx(0.0, abs=1e-15) and np.linalg.norm(across) == pytest.approx(angle)
