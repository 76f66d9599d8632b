"""Recordings of ROS are read as the tables that they hold; what is wrong with one is a sentence."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements

STORE = get_typestore(Stores.ROS2_HUMBLE)
ROBOT = pair_robot()
JOINTS = ["roll_1", "roll_2", "slide_1", "slide_2"]
MAPPING = '[[run]]\nfile = "log"\n[columns]\ntheta = ["roll_1", "roll_2"]\nl = ["slide_1", "slide_2"]\n{more}'
BAG = '[bag]\nposes = "/tracker/tip"\n'
DATA = measured(ROBOT, waypoints(ROBOT, 4))


def message(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(time_s: float) -> Any:
    stamp = message("builtin_interfaces/msg/Time", sec=int(time_s), nanosec=int(round(time_s % 1 * 1e9)))
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="tracker")


def joint_state(time_s: float, values: Sequence[float], names: Sequence[str] = JOINTS) -> Any:
    empty = np.zeros(0)
    return message(
        "sensor_msgs/msg/JointState",
        header=header(time_s), name=list(names), position=np.array(values), velocity=empty, effort=empty,
    )  # fmt: skip


def quaternion(axis: Array) -> Any:
    """One that turns the third axis into a direction."""
    turn = np.array([-axis[1], axis[0], 0.0, 1 + axis[2]])
    x, y, z, w = turn / np.linalg.norm(turn)
    return message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def pose(time_s: float, place: Array, axis: Array, kind: str) -> Any:
    x, y, z = map(float, place)
    if kind == "PointStamped":
        point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
        return message("geometry_msgs/msg/PointStamped", header=header(time_s), point=point)
    if kind == "PoseStamped":
        point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
        inner = message("geometry_msgs/msg/Pose", position=point, orientation=quaternion(axis))
        return message("geometry_msgs/msg/PoseStamped", header=header(time_s), pose=inner)
    vector = message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    moved = message("geometry_msgs/msg/Transform", translation=vector, rotation=quaternion(axis))
    transform = message(
        "geometry_msgs/msg/TransformStamped", header=header(time_s), child_frame_id="tip", transform=moved
    )
    return transform if kind == "TransformStamped" else message("tf2_msgs/msg/TFMessage", transforms=[transform])


def written(
    folder: Path, kind: str = "PoseStamped", plugin: StoragePlugin = StoragePlugin.SQLITE3, **wrong: Any
) -> Path:
    """A mapping file beside the recording `log` of DATA: 2 s a waypoint, poses measured when they are reached."""
    package = "tf2_msgs" if kind == "TFMessage" else "geometry_msgs"
    rows = np.hstack([DATA.theta_commanded, DATA.l_commanded])
    times = 100.0 + 2.0 * np.arange(len(rows))
    times[wrong.get("back", len(rows)) :] -= 30.0
    with Writer(folder / "log", version=9, storage_plugin=plugin) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        tips = writer.add_connection("/tracker/tip", f"{package}/msg/{kind}", typestore=STORE)
        for k, (at, values) in enumerate(zip(times, rows, strict=True)):
            state = joint_state(at, values, wrong.get("names", JOINTS))
            writer.write(joints, 10**9 * (k + 1), STORE.serialize_cdr(state, "sensor_msgs/msg/JointState"))
        for k, row in enumerate(DATA.rows):
            at = times[row] + wrong.get("apart", 0.0)
            tip = pose(at, DATA.position_m[k], DATA.tangent[k], kind)
            writer.write(tips, 10**9 * (int(row) + 1), STORE.serialize_cdr(tip, f"{package}/msg/{kind}"))
    mapping = folder / "mapping.toml"
    mapping.write_text(MAPPING.format(more=wrong.get("more", "") + wrong.get("bag", BAG)), encoding="utf-8")
    return mapping


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "PointStamped", "TFMessage"])
def test_a_recording_is_what_was_recorded(tmp_path: Path, kind: str) -> None:
    tangent = "" if kind == "PointStamped" else 'tangent = ["tx", "ty", "tz"]\n'
    data = load_measurements(written(tmp_path, kind, more=tangent), ROBOT)
    np.testing.assert_allclose(data.position_m, DATA.position_m, atol=1e-12)
    np.testing.assert_allclose(data.theta_commanded[data.rows], DATA.theta_commanded[DATA.rows], atol=1e-9)
    np.testing.assert_allclose(data.l_commanded[data.rows], DATA.l_commanded[DATA.rows], atol=1e-12)
    if tangent:
        np.testing.assert_allclose(data.tangent, DATA.tangent, atol=1e-9)
    assert data.time_s is not None and data.time_s[0] == 0 and np.all(np.diff(data.time_s) >= 0)


def test_mcap_says_the_same_as_a_database(tmp_path: Path) -> None:
    for name, plugin in (("a", StoragePlugin.SQLITE3), ("b", StoragePlugin.MCAP)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, plugin=plugin)
    a, b = (load_measurements(tmp_path / name / "mapping.toml", ROBOT) for name in "ab")
    np.testing.assert_array_equal(a.position_m, b.position_m)
    np.testing.assert_array_equal(a.theta_commanded, b.theta_commanded)


def test_joints_between_two_messages_are_interpolated(tmp_path: Path) -> None:
    data = load_measurements(written(tmp_path, apart=-1.0), ROBOT)
    before = DATA.rows[DATA.rows > 0]
    middle = (DATA.theta_commanded[before] + DATA.theta_commanded[before - 1]) / 2
    np.testing.assert_allclose(data.theta_commanded[data.rows][-len(before) :], middle, atol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            {"bag": '[bag]\nposes = "/tip"\n'},
            "has no topic /tip, it has /joint_states (JointState), /tracker/tip",
        ),
        ({"bag": '[bag]\nposes = "/joint_states"\n'}, "holds sensor_msgs/msg/JointState, must hold one of PoseStamped"),
        ({"back": 9}, "has a clock that runs backwards by 28 s after message 9"),
        ({"apart": 1e6}, "their clocks are not the same"),
        ({"names": ["roll_1", "roll_2", "slide_1", "slide_1"]}, "must name its joints, differently"),
        ({"names": ["a", "b", "c", "d"]}, "is no column of"),
        ({"kind": "TFMessage", "bag": BAG + 'frame = "needle"\n'}, "has no transform to needle, it has tip"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said(tmp_path: Path, wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        load_measurements(written(tmp_path, **wrong), ROBOT)
    assert words in str(refused.value) and "log" in str(refused.value)


def test_a_damaged_recording_is_said(tmp_path: Path) -> None:
    mapping = written(tmp_path)
    (file,) = (tmp_path / "log").glob("*.db3")
    file.write_bytes(b"no database")
    with pytest.raises(InputError, match="is no recording of ROS that can be read"):
        load_measurements(mapping, ROBOT)
    shutil.rmtree(tmp_path / "log")
    with pytest.raises(InputError, match="is not a file that exists"):
        load_measurements(mapping, ROBOT)
