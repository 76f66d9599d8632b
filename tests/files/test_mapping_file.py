"""Mapping files: a laboratory's own tables, whatever their order, units and number, read as ctrplan's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from measured_data import chain_of, measured, pair_robot, waypoints, write_csv
from places import ROBOTS
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.calibration.reading import read_again
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements
from ctrplan.studies.simulate import simulate

ROBOT = pair_robot()
Content = dict[str, Any]


@pytest.fixture(scope="module")
def data() -> Measurements:
    return measured(ROBOT, waypoints(ROBOT, 6))


def table(data: Measurements, position: Array | None = None) -> Array:
    """Time [ms], sequence, l [mm], theta [deg], innermost first, then position [mm] and tangent at every waypoint."""
    pose = np.full((len(data.sequence), 6), np.nan)
    pose[data.rows] = np.hstack([1e3 * (data.position_m if position is None else position), data.tangent])
    l, theta = 1e3 * data.l_commanded[:, ::-1], np.degrees(data.theta_commanded[:, ::-1])  # noqa: E741
    assert data.time_s is not None
    return np.column_stack([1e3 * data.time_s, data.sequence, l, theta, pose])


def written(path: Path, rows: Array, separator: str = " ") -> None:
    path.write_text("\n".join(separator.join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows))


def mapping(**changes: object) -> Content:
    columns = {"time": 1, "sequence": 2, "l": [3, 4], "theta": [5, 6], "position": [7, 8, 9], "tangent": [10, 11, 12]}
    units = {"time": "ms", "l": "mm", "theta": "deg", "position": "mm"}
    content: Content = {"header": False, "separator": ";", "tubes": "innermost first", "columns": columns}
    return content | {"units": units, "run": [{"file": "log.txt"}]} | changes


def load(folder: Path, content: Content, robot: object = ROBOT) -> Measurements:
    (folder / "map.toml").write_text(tomli_w.dumps(content))
    return load_measurements(folder / "map.toml", robot)  # type: ignore[arg-type]


def assert_same(read: Measurements, data: Measurements) -> None:
    for name in ("theta_commanded", "l_commanded", "position_m", "tangent"):
        np.testing.assert_allclose(getattr(read, name), getattr(data, name), atol=1e-12)
    np.testing.assert_array_equal(read.sequence, data.sequence)
    np.testing.assert_array_equal(read.rows, data.rows)


NAMES = ("clock", "run", "d2", "d1", "q2", "q1", "px", "py", "pz", "ux", "uy", "uz")  # of the columns of `table`
JOINTS = {"rotate 1": "q1", "rotate 2": "q2", "translate 1": "d1", "translate 2": "d2"}


@pytest.mark.parametrize(
    "said", [{}, {"zero": {"theta_deg": [0, 1e-9], "l_mm": [1e-9, 0]}}, {"of": "drive"}, {"frame": {}}], ids=str
)
def test_columns_are_named_as_the_laboratory_does(said: dict[str, Any], data: Measurements, tmp_path: Path) -> None:
    """Also where numbers are computed from a column, and in what a misread file seems to mean."""
    rows = table(data)[:, [0, 1, 2, 3, 4, 5, 7, 6, 8, 9, 10, 11]]  # x and y exchanged
    written(tmp_path / "log.csv", rows, ",")
    (tmp_path / "log.csv").write_text(",".join(NAMES) + "\n" + (tmp_path / "log.csv").read_text())
    columns: Content = {"time": "clock", "sequence": "run", "l": ["d2", "d1"], "theta": ["q2", "q1"]}
    if "of" in said:
        columns = {"time": "clock", "sequence": "run", "joints": JOINTS}
    columns |= {"position": ["px", "py", "pz"]}
    run = {"file": "log.csv"} | {key: value for key, value in said.items() if key == "frame"}
    zero = {key: value for key, value in said.items() if key == "zero"}
    content = mapping(header=True, separator=",", columns=columns, run=[run], **zero)
    read = load(tmp_path, content)
    assert [read.columns[name] for name in ("theta_1_rad", "l_2_m", "x_m")] == ["q1", "d2", "px"]
    (told,) = read_again(ROBOT, read)
    assert told.columns == ("px", "py", "pz") and "(px, py, pz): read so" in told.sentence
    radians = load(tmp_path, content | {"units": mapping()["units"] | {"theta": "rad"}})
    turned = replace(radians, position_m=data.position_m)
    sentence = read_again(ROBOT, turned)[0].sentence
    assert sentence.startswith("Rotations are in degrees") and "(q1, q2)" in sentence


def test_a_robot_in_the_place_of_measurements_is_called_one() -> None:
    with pytest.raises(InputError, match="a CSV table or its mapping file, not a robot or scenario"):
        load_measurements(ROBOTS / "three_tube.toml", pair_robot())


def test_other_units_orders_and_separators_say_the_same(tmp_path: Path, data: Measurements) -> None:
    written(tmp_path / "log.txt", table(data), ";")
    read = load(tmp_path, mapping())
    assert_same(read, data)
    np.testing.assert_allclose(read.time_s, data.time_s)
    named = [f"c{k}" for k in range(12)]
    text = (tmp_path / "log.txt").read_text().replace(";", ",")
    (tmp_path / "named.csv").write_text(",".join(named) + "\n" + text)
    columns = {key: [f"c{k - 1}" for k in value] if isinstance(value, list) else f"c{value - 1}"
               for key, value in mapping()["columns"].items()}  # fmt: skip
    assert_same(load(tmp_path, mapping(header=True, separator=",", columns=columns, run=[{"file": "named.csv"}])), data)


def test_joints_and_poses_in_two_files_without_tangents(tmp_path: Path, data: Measurements) -> None:
    whole = table(data)
    written(tmp_path / "joints.dat", whole[:, :6], ",")
    text = "\n".join(",".join("" if np.isnan(x) else repr(float(x)) for x in row) + "," for row in whole[:, 6:9])
    (tmp_path / "poses.dat").write_text(text)  # with a comma at the end of every row
    columns = mapping()["columns"] | {"position": [1, 2, 3]}
    del columns["tangent"]
    paired = mapping(separator=",", columns=columns, run=[{"joints": "joints.dat", "poses": "poses.dat"}])
    (tmp_path / "poses.dat").write_text(text.replace(",,,", ",,"))  # rows without pose are of blanks alone: refused
    with pytest.raises(InputError, match="poses.dat"):
        load(tmp_path, paired)
    written(tmp_path / "joints.dat", whole[data.rows, :6], ",")
    (tmp_path / "poses.dat").write_text("\n".join(text.splitlines()[k] for k in data.rows))
    read = load(tmp_path, paired)
    np.testing.assert_allclose(read.position_m, data.position_m, atol=1e-12)
    assert not read.has_tangents and read.count == len(read.sequence)


def test_actuators_are_read_through_the_drive(tmp_path: Path, data: Measurements) -> None:
    """A drive that carries the inner tube along with the outer one."""
    joints = [
        {"name": "outer", "moves": {"theta": [1, 1]}},
        {"name": "inner", "moves": {"theta": [0, 1]}},
        {"name": "slide outer", "moves": {"l": [1, 1]}, "min_mm": -60, "max_mm": 0},
        {"name": "slide inner", "moves": {"l": [0, 1]}, "min_mm": -60, "max_mm": 0},
    ]
    robot = robot_from_dict({**ROBOT.content, "joint": joints})
    rows = table(data)
    rows[:, [2, 4]] -= rows[:, [3, 5]]  # relative to the outer tube
    written(tmp_path / "log.txt", rows, ";")
    columns = mapping()["columns"] | {"joints": {"slide inner": 3, "slide outer": 4, "inner": 5, "outer": 6}}
    del columns["theta"], columns["l"]
    read = load(tmp_path, mapping(columns=columns), robot)
    home = robot.drive.home_theta_rad, robot.drive.home_l_m
    np.testing.assert_allclose(read.theta_commanded, data.theta_commanded + home[0], atol=1e-12)
    np.testing.assert_allclose(read.l_commanded, data.l_commanded + home[1], atol=1e-12)


def test_signs_and_zeros(tmp_path: Path, data: Measurements) -> None:
    rows = table(data)
    rows[:, 2:4] = -rows[:, 2:4] + [5.0, 0.0]  # of the inner tube, counted the other way from another zero
    written(tmp_path / "log.txt", rows, ";")
    columns = mapping()["columns"] | {"l": ["-3", "-4"]}
    assert_same(load(tmp_path, mapping(columns=columns, zero={"l_mm": [5.0, 0.0]})), data)


def test_a_tracker_s_frame_is_taken_out_or_found(tmp_path: Path, data: Measurements) -> None:
    turn, shift = Rotation.from_rotvec([0.3, -0.8, 1.1]), np.array([0.4, -0.2, 1.5])
    rows = table(data, turn.apply(data.position_m) + shift)
    rows[data.rows, 9:] = turn.apply(data.tangent)
    written(tmp_path / "log.txt", rows, ";")
    x, y, z, w = turn.as_quat().tolist()
    frame = {"position_mm": (1e3 * shift).tolist(), "quaternion_wxyz": [w, x, y, z]}
    assert_same(load(tmp_path, mapping(run=[{"file": "log.txt", "frame": frame}])), data)
    found = load(tmp_path, mapping(run=[{"file": "log.txt", "frame": "unknown"}]))
    assert np.linalg.norm(found.position_m - data.position_m, axis=1).max() < 1e-3
    assert any("is not known" in warning and "(rms)" in warning for warning in found.warnings)
    with pytest.raises(InputError, match="beyond the reach"):
        load(tmp_path, mapping())


def test_an_unknown_frame_is_found_by_the_tips_that_the_robot_file_has_loads_included(tmp_path: Path) -> None:
    """By tips without its load the frame would be millimetres off, and the load would look like a misalignment."""
    robot = pair_robot(effects={"tip_load": {"force_x_N": 0.4, "force_y_N": -0.2}})
    plan = waypoints(ROBOT, 8)
    shapes = [robot.solve(plan.theta_commanded[k], plan.l_commanded[k]) for k in plan.rows.tolist()]
    data = replace(plan, position_m=np.array([shape.tip_m for shape in shapes]), tangent=plan.tangent)
    turn = Rotation.from_rotvec([0.3, -0.8, 1.1])
    rows = table(data, turn.apply(data.position_m) + [0.4, -0.2, 1.5])
    written(tmp_path / "log.txt", rows[:, :9], ";")
    columns = {name: at for name, at in mapping()["columns"].items() if name != "tangent"}
    content = mapping(run=[{"file": "log.txt", "frame": "unknown"}], columns=columns)
    read = load(tmp_path, content, robot)
    assert any("0.00 mm off (rms)" in warning for warning in read.warnings)
    np.testing.assert_allclose(read.position_m, data.position_m, atol=1e-6)


def test_runs_in_several_files_have_a_frame_each_that_a_fit_finds(tmp_path: Path) -> None:
    plan = waypoints(ROBOT, 16)
    data = measured(ROBOT, plan)
    runs = np.unique(data.sequence)
    shift = np.array([2e-3, -1e-3, 0.5e-3])
    for name, chosen in (("a.txt", runs[: len(runs) // 2]), ("b.txt", runs[len(runs) // 2 :])):
        moved = table(data, data.position_m + (shift if name == "b.txt" else 0.0))
        written(tmp_path / name, moved[np.isin(data.sequence, chosen)], ";")
    both = [{"file": "a.txt", "tracker": "first"}, {"file": "b.txt", "tracker": "second"}]
    read = load(tmp_path, mapping(run=both))
    assert read.count == data.count and sorted(set(read.frames.tolist())) == [1, 2]
    assert len(np.unique(read.sequence)) == len(runs)
    assert read.file is not None and read.file.endswith("a.txt and 1 other file")
    found = calibrate(ROBOT, read, ["calibration", "effects.frame_shift"])
    for axis, true in zip("xyz", shift, strict=True):
        low, high = found.estimates[f"shift_{axis}_2_mm"].ci95
        assert low - 0.1 < 1e3 * true < high + 0.1
    together = load(tmp_path, mapping(run=[{"file": "a.txt"}, {"file": "b.txt"}]))
    assert together.frame is None
    with pytest.raises(InputError, match="one frame of the tracker"):
        calibrate(ROBOT, together, ["effects.frame_shift"])


def test_runs_of_a_robot_that_was_homed_anew_have_zeros_that_a_fit_finds(tmp_path: Path) -> None:
    plan = waypoints(ROBOT, 16)
    later = plan.sequence > np.median(plan.sequence)
    homed = replace(plan, homing=1 + later)
    zeros = {"theta_2_2_deg": 5.0, "l_2_2_mm": -1.0}
    data = measured(ROBOT, homed, {"homing_shift": zeros})
    for name, rows in (("a.txt", ~later), ("b.txt", later)):
        written(tmp_path / name, table(data)[rows], ";")
    both = [{"file": "a.txt", "homing": "first"}, {"file": "b.txt", "homing": "second"}]
    read = load(tmp_path, mapping(run=both))
    assert np.array_equal(read.homings, homed.homings) and read.frame is None
    found = calibrate(ROBOT, read, ["calibration", "effects.homing_shift"])
    for name, true in zeros.items():
        low, high = found.estimates[name].ci95
        assert low - 0.5 * (high - low) < true < high + 0.5 * (high - low)
    together = load(tmp_path, mapping(run=[{"file": "a.txt"}, {"file": "b.txt"}]))
    assert together.homing is None
    with pytest.raises(InputError, match="one homing of the robot"):
        calibrate(ROBOT, together, ["effects.homing_shift"])


def test_values_of_collars_have_the_drive_s_effects_in_them(tmp_path: Path, data: Measurements) -> None:
    written(tmp_path / "log.txt", table(data), ";")
    turned = pair_robot(effects={"homing_offset": {"theta_2_deg": 20.0}})
    plain, driven = (chain_of(robot, load(tmp_path, mapping(values="collars"), robot), {}) for robot in (ROBOT, turned))
    np.testing.assert_allclose(
        plain.predict(plain.neutral).position_m, driven.predict(driven.neutral).position_m, atol=1e-12
    )
    with pytest.raises(InputError, match="the drive's effects are in them"):
        calibrate(ROBOT, plain.data, ["effects.homing_offset.theta_2_deg"])


def test_a_mapped_log_is_simulated_like_a_plain_one(tmp_path: Path, data: Measurements) -> None:
    first = data.sequence <= data.sequence[0]
    written(tmp_path / "log.txt", table(data)[first], ";")
    write_csv(tmp_path / "plain.csv", data)
    (tmp_path / "map.toml").write_text(tomli_w.dumps(mapping()))
    lines = (tmp_path / "plain.csv").read_text().splitlines()
    (tmp_path / "plain.csv").write_text("\n".join(lines[: 1 + int(first.sum())]))
    one, other = (simulate(ROBOT, load_joint_path(tmp_path / name, ROBOT)) for name in ("map.toml", "plain.csv"))
    np.testing.assert_allclose(one.position_m, other.position_m, atol=1e-9)


def _with(*path: str, value: object) -> Callable[[Content], None]:
    def change(content: Content) -> None:
        place: Any = content
        for step in path[:-1]:
            place = place[int(step)] if step.isdecimal() else place[step]
        place[path[-1]] = value

    return change


FAULTS: dict[str, tuple[Callable[[Content], None], str]] = {
    "unknown key": (_with("colums", value={}), "colums: unknown key"),
    "no such column": (_with("columns", "time", value=13), "columns.time = 13: is no column of"),
    "no such name": (_with("columns", "theta", value=[5, "q"]), "columns.theta.2 = 'q': is no column of"),
    "tubes": (_with("columns", "theta", value=[5]), "columns.theta = [5]: has 1 columns, must have one for each of 2"),
    "no joints": (_with("columns", "l", value=None), "columns.l: is missing"),
    "both": (_with("columns", "joints", value={"a": 1}), "columns.joints: and theta or l exclude each other"),
    "no file": (_with("run", "0", "file", value="none.txt"), "run.1.file = 'none.txt': is not a file that exists"),
    "elsewhere": (_with("run", "0", "file", value="../x.txt"), "must lie in the folder of this file or below"),
    "neither": (_with("run", "0", "file", value=None), "run.1: must have file, or joints and poses"),
    "frame": (
        _with("run", "0", "frame", value={"quaternion_wxyz": [1.0, 1.0, 0.0, 0.0]}),
        "run.1.frame.quaternion_wxyz",
    ),
    "unit": (_with("units", "l", value="cm"), "units.l = 'cm'"),
    "zero": (_with("zero", value={"l_mm": [1.0]}), "zero.l_mm"),
    "separator": (_with("separator", value=","), "is no column of"),
    "one column twice": (_with("columns", "position", value=[7, "-7", 9]), ": has 7 for two axes"),
    "one file twice": (
        _with("run", value=[{"file": "log.txt"}] * 2),
        "run.2: has what run 1 has: every pose would count",
    ),
    "one frame": (
        _with("run", value=[{"file": "log.txt"}, {"file": "log.txt", "frame": "unknown"}]),
        "run.2.frame = 'unknown': differs from that of another run of the tracker 'tracker'",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_a_mapping_file_are_one_sentence(name: str, tmp_path: Path, data: Measurements) -> None:
    written(tmp_path / "log.txt", table(data), ";")
    content = mapping()
    content["columns"], content["units"] = dict(content["columns"]), dict(content["units"])
    content["run"] = [dict(content["run"][0])]
    change, sentence = FAULTS[name]
    change(content)
    for part in (content["columns"], content["run"][0]):
        for key in [key for key, value in part.items() if value is None]:
            del part[key]
    with pytest.raises(InputError) as error:
        load(tmp_path, content)
    assert sentence in str(error.value) and "\n" not in str(error.value), str(error.value)


def test_a_bad_cell_is_named_by_its_own_file_and_column(tmp_path: Path, data: Measurements) -> None:
    written(tmp_path / "log.txt", table(data), ";")
    lines = (tmp_path / "log.txt").read_text().splitlines()
    cells = lines[2].split(";")
    lines[2] = ";".join([*cells[:5], "left", *cells[6:]])
    (tmp_path / "log.txt").write_text("\n".join(lines))
    with pytest.raises(InputError, match="log.txt: row 3, 6.* = 'left': must be a number"):
        load(tmp_path, mapping())
