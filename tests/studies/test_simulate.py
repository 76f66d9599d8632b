"""`ctrplan simulate`: tables that say what the history says, and refusals in one sentence."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from places import ROBOTS

from ctrplan.__main__ import main
from ctrplan.commands.simulate import start_state
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.measurement.joint_path import JointPath
from ctrplan.reports.path_pictures import simulation_figure
from ctrplan.robot.robot import Robot
from ctrplan.studies.simulate import poses_csv, simulate

PAIR = str(ROBOTS / "table_5_pair.toml")
HEADER = "theta_1_rad,theta_2_rad,l_1_m,l_2_m"
ROWS = ["0,0.5,0,-0.0604", "0,2.1,0,-0.0604", "0,2.1,0,-0.0504"]


def write_path(folder: Path, *lines: str) -> str:
    (folder / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(folder / "path.csv")


def rows(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_poses_are_those_of_the_history(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_path(tmp_path, HEADER, *ROWS)
    assert main(["simulate", PAIR, path, "-o", str(tmp_path / "out"), "--start", "-1"]) == 0
    found = capsys.readouterr()
    assert "3 of 3 rows simulated" in found.out and "largest friction error" in found.out and found.err == ""
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"SHA256SUMS", "poses.csv", "simulate.png"}
    assert (tmp_path / "out" / "simulate.png").read_bytes()[:4] == b"\x89PNG"
    robot = load_robot(PAIR)
    history = robot.history((-1,))
    table = rows(tmp_path / "out" / "poses.csv")
    for row, values in zip(table, ROWS, strict=True):
        joints = np.array([float(value) for value in values.split(",")])
        step, bound = history.advance(joints[:2], joints[2:]), robot.bound(joints[:2], joints[2:])
        assert [float(row[name]) for name in HEADER.split(",")] == joints.tolist()
        tip_m = [float(row[name]) for name in ("x_m", "y_m", "z_m")]
        np.testing.assert_allclose(tip_m, step.shape.tip_m, atol=2e-6)  # the same path in other steps
        assert float(row["deviation_mm"]) == pytest.approx(step.deviation_m * 1e3, abs=2e-3)
        assert float(row["bound_mm"]) == pytest.approx(bound.position_m * 1e3, rel=1e-9)
        assert row["snaps"] == "0" and row["status"] == "CONVERGED"
    assert float(table[0]["phi_1"]) == -1
    assert float(table[1]["phi_1"]) > 0.9 and abs(float(table[2]["phi_1"])) < 0.1


def test_poses_can_be_read_as_a_path_and_every_run_starts_afresh(tmp_path: Path) -> None:
    lines = [f"{run},{k},{row}" for run in (3, 5) for k, row in enumerate(ROWS, start=10 * run)]
    path = load_joint_path(write_path(tmp_path, f"sequence,time_s,{HEADER}", *lines), load_robot(PAIR))
    result = simulate(load_robot(PAIR), path, "released")
    assert result.is_complete
    text = poses_csv(result)
    again = load_joint_path(write_path(tmp_path, *text.splitlines()), load_robot(PAIR))
    np.testing.assert_array_equal(again.theta_commanded, path.theta_commanded)
    np.testing.assert_array_equal(again.sequence, [3, 3, 3, 5, 5, 5])
    np.testing.assert_array_equal(again.time_s, path.time_s)
    first, second = (result.position_m[(result.place >= a) & (result.place <= a + 2)] for a in (0, 3))
    np.testing.assert_array_equal(first, second)
    assert result.deviation_m[result.waypoints[[0, 3]]].max() < 1e-9


def test_figure_shows_deviation_under_the_bound(tmp_path: Path) -> None:
    robot = load_robot(PAIR)
    result = simulate(robot, load_joint_path(write_path(tmp_path, HEADER, *ROWS), robot), (1,))
    deviation, friction = simulation_figure(result).axes
    assert "(mm)" in deviation.get_ylabel() and "row" in friction.get_xlabel()
    (line,) = (line for line in deviation.lines if line.get_label() == "predicted tip deviation")
    np.testing.assert_allclose(line.get_ydata(), result.deviation_m * 1e3)
    assert np.all(result.deviation_m <= 1.01 * result.bounds.position_m + 5e-5)


def test_an_oscillation_starts_near_the_frictionless_solution(tmp_path: Path) -> None:
    robot = load_robot(PAIR)
    result = simulate(robot, load_joint_path(write_path(tmp_path, HEADER, ROWS[0]), robot), "oscillated")
    assert 0 < result.deviation_m[0] < 0.2 * result.bounds.position_m[0]


TIMED = ["time_s," + HEADER, *(f"{3 * k},{row}" for k, row in enumerate(ROWS))]


def with_effects(**effects: dict[str, float]) -> Robot:
    return robot_from_dict(dict(load_robot(PAIR).content) | {"effects": effects})


def test_effects_of_the_drive_move_the_collars(tmp_path: Path) -> None:
    robot = with_effects(homing_offset={"theta_2_deg": 5.0}, joint_scale={"l_2": -0.01}, backlash={"theta_2_deg": 4.0})
    plain = load_robot(PAIR)
    path = load_joint_path(write_path(tmp_path, HEADER, *ROWS), robot)
    found = simulate(robot, path, (-1,))
    at = found.waypoints
    np.testing.assert_array_equal(found.theta_commanded[at], path.theta_commanded)  # the table shows what was commanded
    lost = np.radians(2.0) * np.array([0, 1, 1])  # nothing is known before the first turn
    np.testing.assert_allclose(
        found.collars.theta[at, 1], path.theta_commanded[:, 1] + np.radians(5.0) - lost, atol=1e-12
    )
    np.testing.assert_allclose(found.collars.l[at, 1], 0.99 * path.l_commanded[:, 1], atol=1e-12)
    driven = JointPath(found.collars.theta, found.collars.l, np.zeros(len(found.place), int))
    same = simulate(plain, driven, (-1,))
    np.testing.assert_allclose(found.position_m, same.position_m[same.waypoints], atol=2e-6)
    assert found.measured is None and "measured_x_m" not in poses_csv(found)


def test_what_a_tracker_would_report_stands_beside_the_tip(tmp_path: Path) -> None:
    turn, rate = np.radians(3.0), 7200.0
    robot = with_effects(drift={"shift_y_mm_per_h": rate}, base_misalignment={"rotation_z_deg": 3.0, "shift_x_mm": 2.0})
    path = load_joint_path(write_path(tmp_path, *TIMED), robot)
    found, plain = simulate(robot, path), simulate(load_robot(PAIR), path)
    np.testing.assert_array_equal(found.position_m, plain.position_m)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    assert found.measured is not None and path.time_s is not None
    at = found.waypoints
    shift = path.time_s[:, None] * [0, rate / 3.6e6, 0]
    expected = (plain.position_m[at] + shift) @ R.T + [2e-3, 0, 0]
    np.testing.assert_allclose(found.measured.position[at], expected, atol=1e-12)
    np.testing.assert_allclose(found.measured.frame[at, :, 2], plain.tangent[at] @ R.T, atol=1e-12)
    table = list(csv.DictReader(poses_csv(found).splitlines()))
    assert float(table[2]["measured_y_m"]) == found.measured.position[at[2], 1] != float(table[2]["y_m"])


def test_a_lag_reports_tips_of_an_earlier_time(tmp_path: Path) -> None:
    path = load_joint_path(write_path(tmp_path, *TIMED), load_robot(PAIR))
    found = simulate(with_effects(lag={"tau_s": 0.3}), path)
    assert found.measured is not None
    at = found.waypoints
    np.testing.assert_array_equal(found.measured.position[0], found.position_m[0])  # a run starts at rest
    behind = found.position_m[at[1]] - found.measured.position[at[1]]
    speed = (found.position_m[at[1]] - found.position_m[at[1] - 1]) / (3.0 / (at[1] - at[0]))
    np.testing.assert_allclose(behind, 0.3 * speed, rtol=1e-9)


def test_an_offset_sensor_draws_a_circle_about_a_tube_that_turns_freely(tmp_path: Path) -> None:
    robot = with_effects(sensor_offset={"offset_x_mm": 3.0})
    path = load_joint_path(write_path(tmp_path, HEADER, "0,0.3,0,-0.0604", "1.1,1.4,0,-0.0604"), robot)
    found = simulate(robot, path)
    assert found.measured is not None
    at = found.waypoints
    offset = found.measured.position[at] - found.position_m[at]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 3e-3, rtol=1e-9)
    R = np.array([[np.cos(1.1), -np.sin(1.1), 0], [np.sin(1.1), np.cos(1.1), 0], [0, 0, 1]])
    np.testing.assert_allclose(offset[1], R @ offset[0], atol=2e-5)  # all tubes turned together


def test_effects_that_need_a_time_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(dict(with_effects(lag={"tau_s": 0.1}).content)))
    path = write_path(tmp_path, HEADER, *ROWS)
    assert main(["simulate", str(tmp_path / "robot.toml"), path, "-o", str(tmp_path / "out")]) == 0
    warning = capsys.readouterr().err
    assert "time_s" in warning and "lag" in warning and warning.count("\n") == 1
    assert "measured_x_m" not in (tmp_path / "out" / "poses.csv").read_text()


def test_within_the_play_of_a_drive_tubes_that_would_not_nest_stop_one_another(tmp_path: Path) -> None:
    """A plan from where the tips are even may be certified, and is replayed from there, by the same rule."""
    robot, still = with_effects(backlash={"l_2_mm": 0.4}), with_effects()
    even = robot.tubes[0].length_m - robot.tubes[1].length_m
    lines = (f"0,0,0,{even + ahead!r}" for ahead in (0.0, 1e-4, 3e-3))
    path = load_joint_path(write_path(tmp_path, HEADER, *lines), robot)
    found, free = simulate(robot, path), simulate(still, path)
    at = found.waypoints
    np.testing.assert_allclose(found.position_m[at[:2]], free.position_m[at[:1]].repeat(2, axis=0), atol=1e-7)
    assert np.linalg.norm(found.position_m[at[2]] - free.position_m[at[2]]) > 1e-4  # behind by half the play


def test_a_drive_that_pushes_tubes_through_the_plate_is_refused(tmp_path: Path) -> None:
    robot = with_effects(homing_offset={"l_1_mm": 1.0})
    path = load_joint_path(write_path(tmp_path, HEADER, *ROWS), robot)
    with pytest.raises(InputError, match=r"row 1.*effects of the drive.*behind the plate"):
        simulate(robot, path)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], ["is empty"]),
        ([HEADER], ["at least one row"]),
        (["theta_1_rad,theta_2_rad,l_1_m", "0,0,0"], ["l_2_m", "missing"]),
        (["theta_1_deg,theta_2_deg,l_1_m,l_2_m", ROWS[0]], ["theta_1_rad", "found theta_1_deg", "rad"]),
        (["theta_1_rad,theta_2_rad,l_1_mm,l_2_mm", ROWS[0]], ["l_1_m", "found l_1_mm", "rad and m"]),
        ([HEADER + ",theta_3_rad,l_3_m", ROWS[0] + ",0,0"], ["header", "joints of 3 tubes", "file has 2"]),
        ([HEADER + ",l_2_m", ROWS[0] + ",0"], ["l_2_m", "2 times"]),
        ([HEADER, "0,0,0"], ["row 1", "has 3 values"]),
        ([HEADER, *ROWS, HEADER], ["row 4", "repeats the header"]),
        ([HEADER, *ROWS[:1], "0,x,0,-0.06"], ["row 2", "theta_2_rad", "'x'", "number"]),
        ([HEADER, "0,nan,0,-0.06"], ["row 1", "finite"]),
        ([HEADER, "0,0,0,-60.4"], ["row 1", "l_2_m", "metres", "millimetres?"]),
        ([HEADER, "0,720,0,-0.06"], ["row 1", "theta_2_rad", "degrees?"]),
        ([HEADER, *ROWS, "0,0,0,-0.01"], ["row 4", "17 mm apart"]),
        ([HEADER, "0,0,0.001,-0.06"], ["row 1", "behind the plate"]),
        (["sequence," + HEADER, "1," + ROWS[0], "2," + ROWS[0], "1," + ROWS[0]], ["row 3", "sequence", "together"]),
        (["sequence," + HEADER, "1.5," + ROWS[0]], ["row 1", "sequence", "whole"]),
        (["time_s," + HEADER, "1," + ROWS[0], "0," + ROWS[0]], ["row 2", "time_s", "backwards"]),
        ([HEADER, '"0,0,0,-0.06'], ["CSV"]),
        ([HEADER.replace(",", ";"), ROWS[0].replace(",", ";")], ["separated by semicolons", "commas"]),
        ([HEADER.replace(",", "\t"), ROWS[0].replace(",", "\t")], ["separated by tabs"]),
    ],
)
def test_bad_paths_are_refused_in_one_sentence(
    lines: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_path(tmp_path, *lines)
    assert main(["simulate", PAIR, path, "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"ctrplan: {path}") and message.count("\n") == 1
    assert all(word in message for word in words), message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "words"), [("nowhere.csv", "does not exist"), (".", "is a folder"), ("bytes.csv", "UTF-8")]
)
def test_files_that_are_none(file: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    assert main(["simulate", PAIR, str(tmp_path / file), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1


@pytest.mark.parametrize("text", ["resting", "+1,-1", "2", "", "+1,", "nan"])
def test_start_states_are_checked(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_path(tmp_path, HEADER, *ROWS)
    assert main(["simulate", PAIR, path, "-o", str(tmp_path / "out"), "--start", text]) == 2
    message = capsys.readouterr().err
    assert "--start" in message and "oscillated" in message and message.count("\n") == 1
    assert start_state("+1,-0.5", 2) == (1.0, -0.5)


def test_help_has_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    text = capsys.readouterr().out
    assert "examples:" in text and "--start +1,-1" in text and "theta_1_rad" in text
