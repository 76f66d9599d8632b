"""Files are whole or not there, and numbers come back bit for bit."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from csv_columns import csv_columns

from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import CtrplanError, InputError
from ctrplan.files.trajectory_file import left_over, trajectory_formats, write_trajectory
from ctrplan.files.trajectory_formats.ros2_message import trajectory_as_ros2_yaml
from ctrplan.storage.output_folder import write_atomically


def example() -> Trajectory:
    rng = np.random.default_rng(0)
    time_s = np.arange(8) / 30
    position, velocity, acceleration, jerk = rng.normal(size=(4, 8, 2)) * 10.0 ** rng.integers(-12, 6, (4, 8, 2))
    names, is_rotation = ("rotate inner", "insert inner"), np.array([True, False])
    return Trajectory(names, time_s, position, velocity, acceleration, jerk, time_s[-1:], 7 / 30, 0, is_rotation)


def test_csv_round_trip(tmp_path: Path) -> None:
    trajectory = example()
    write_trajectory(tmp_path, trajectory, trajectory_formats(["csv"]))
    columns = csv_columns(tmp_path / "trajectory.csv")
    expected = {"time_s": trajectory.time_s}
    for j, (joint, unit) in enumerate((("rotate_inner", "rad"), ("insert_inner", "m"))):
        expected[f"{joint}_position_{unit}"] = trajectory.position[:, j]
        expected[f"{joint}_velocity_{unit}_s"] = trajectory.velocity[:, j]
        expected[f"{joint}_acceleration_{unit}_s2"] = trajectory.acceleration[:, j]
    assert list(columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[name], values)


def test_formats_are_written_once_each_and_unknown_ones_are_refused(tmp_path: Path) -> None:
    write_trajectory(tmp_path, example(), trajectory_formats(["ros2", "csv", "ros2"]))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["trajectory.csv", "trajectory.yaml"]
    assert left_over(tmp_path, trajectory_formats(["csv"])) == ["trajectory.yaml"]
    with pytest.raises(InputError, match=r"--formats = 'xlsx': must be of csv, ros2\."):
        trajectory_formats(["csv", "xlsx"])


def test_names_that_coincide_are_refused(tmp_path: Path) -> None:
    trajectory = replace(example(), names=("a b", "a_b"), is_rotation=np.array([True, True]))
    with pytest.raises(InputError, match="same name"):
        write_trajectory(tmp_path, trajectory, trajectory_formats(["csv"]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", ["Länge\n", b"\x00\xff", ""])
def test_written_is_what_was_given(tmp_path: Path, content: str | bytes) -> None:
    path = tmp_path / "out"
    path.write_text("old")
    write_atomically(path, content)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failing_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, fault: BaseException
) -> None:
    path = tmp_path / "plan.json"
    path.write_text("old")

    def fail(*_: object) -> None:
        raise fault

    monkeypatch.setattr(os, step, fail)
    expected = CtrplanError if isinstance(fault, OSError) else KeyboardInterrupt
    with pytest.raises(expected) as caught:
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
    if expected is CtrplanError:
        assert re.search(r"plan\.json: could not be written, .*No space left on device\.$", str(caught.value))


def test_impossible_places_are_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    for place in (tmp_path / "no" / "such" / "folder", tmp_path / "file" / "below", tmp_path):
        with pytest.raises(CtrplanError, match=re.escape(f"{place}: could not be written")):
            write_atomically(place, "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_links_are_written_through_and_permissions_follow_the_umask(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "data" / "target")
    mask = os.umask(0o027)
    try:
        write_atomically(tmp_path / "link", "new")
    finally:
        os.umask(mask)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "data" / "target").read_text() == "new"
    assert (tmp_path / "data" / "target").stat().st_mode & 0o777 == 0o640


def test_ros2_yaml_says_what_the_trajectory_says() -> None:
    trajectory = example()
    text = trajectory_as_ros2_yaml(trajectory)
    joint_names = re.search(r"^joint_names: (.*)$", text, re.MULTILINE)
    assert joint_names is not None and json.loads(joint_names[1]) == list(trajectory.names)
    for key, values in (
        ("positions", trajectory.position),
        ("velocities", trajectory.velocity),
        ("accelerations", trajectory.acceleration),
    ):
        lists = re.findall(rf"^(?:- |  ){key}: (\[.*\])$", text, re.MULTILINE)
        np.testing.assert_array_equal([json.loads(line) for line in lists], values)
    times = re.findall(r"time_from_start: {sec: (\d+), nanosec: (\d+)}", text)
    np.testing.assert_allclose([int(s) + int(ns) / 1e9 for s, ns in times], trajectory.time_s, rtol=0, atol=5.1e-10)


def test_ros2_yaml_is_read_as_the_message_it_stands_for() -> None:
    """Fields and types of trajectory_msgs/JointTrajectory, as PyYAML, which ROS uses, reads them."""
    trajectory = replace(example(), position=example().position * 1e-7)
    message = yaml.safe_load(trajectory_as_ros2_yaml(trajectory))
    assert set(message) == {"header", "joint_names", "points"}
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert message["joint_names"] == list(trajectory.names)
    assert all(
        set(p) == {"positions", "velocities", "accelerations", "effort", "time_from_start"} for p in message["points"]
    )
    columns = (("positions", "position"), ("velocities", "velocity"), ("accelerations", "acceleration"))
    for field, attribute in columns:
        values = [point[field] for point in message["points"]]
        assert all(isinstance(value, float) for row in values for value in row)
        np.testing.assert_array_equal(values, getattr(trajectory, attribute))
    stamps = [point["time_from_start"] for point in message["points"]]
    assert all(isinstance(s["sec"], int) and 0 <= s["nanosec"] < 10**9 for s in stamps)
    times = [(s["sec"], s["nanosec"]) for s in stamps]
    assert times == sorted(set(times))  # strictly later each, as controllers demand


def test_ros2_yaml_numbers_are_floats_to_yaml_1_1() -> None:
    """PyYAML's resolver, which ROS uses, wants a point and a signed exponent."""
    trajectory = replace(example(), position=np.full((8, 2), 1e-5), velocity=np.full((8, 2), -2e22))
    points = trajectory_as_ros2_yaml(trajectory).split("points:")[1]
    numbers = re.findall(r"(?<=[\[ ])-?[0-9][^,\] }]*(?=[,\]])", points)
    resolver = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9_]*([eE][-+][0-9]+)?")
    floats = [number for number in numbers if "e" in number]
    assert len(floats) >= 32 and all(resolver.fullmatch(number) for number in floats)
