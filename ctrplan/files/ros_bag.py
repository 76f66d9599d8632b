"""Recordings of ROS as tables: rosbag2 folders, MCAP files and ROS 1 bags, read by `rosbags` (extra `ros`).

Joints come from sensor_msgs/JointState, tips from PoseStamped, TransformStamped, PointStamped or tf. Every message of
the joints is a waypoint, and every one of the tip a measured one, where joints are interpolated in time. The stamps in
the headers count; the recorder's own where a header has none.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import JOINT_ROUNDING
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import LARGEST_FILE_BYTES, CsvTable

ENDINGS = (".mcap", ".bag", ".db3")
TIP = ("x", "y", "z", "tx", "ty", "tz")
KINDS = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "PointStamped", "TFMessage", "Odometry")
NANOSECONDS = 1e-9


def is_bag(path: Path) -> bool:
    """Whether a path is that of a recording: a folder with metadata.yaml, or a file by its ending."""
    return path.suffix.lower() in ENDINGS or (path / "metadata.yaml").is_file()


class BagTable(CsvTable):
    """A recording as a table: `time` [s], joints by their names, x, y, z [m] and direction tx, ty, tz of the tip."""

    def __init__(self, path: Path, joints: str, poses: str, frame: str = "") -> None:
        """Reads the topics of joints and poses; `frame` is the child whose transforms count where these are of tf.

        Raises InputError where a topic, joint values or a common time are missing, or a clock runs backwards.
        """
        self.file = str(path)
        with _opened(path) as reader:
            topics = {connection.topic: connection.msgtype for connection in reader.connections}
            joint_rows = [*self._messages(reader, topics, joints, ("JointState",))]
            pose_rows = [*self._messages(reader, topics, poses, KINDS)]
        self.sha256 = _hash(path)
        names = self._names(joint_rows, joints)
        at, values = self._joints(joint_rows, names, joints)
        stamps, tips = self._poses(pose_rows, poses, frame)
        inside = (stamps >= at[0]) & (stamps <= at[-1])
        if not inside.any():
            spans = f"from {stamps[0]:.3f} to {stamps[-1]:.3f} s, joints from {at[0]:.3f} to {at[-1]:.3f} s"
            raise self.fault(f"has poses {spans}: their clocks are not the same", column=poses)
        stamps, tips = stamps[inside], tips[inside]
        moved = np.abs(np.diff(values, axis=0)).max(axis=1) > JOINT_ROUNDING
        kept = np.r_[True, moved] | np.r_[moved, True]
        at, values = at[kept], values[kept]
        times = np.concatenate([at, stamps])
        order = np.argsort(times, kind="stable")
        there = np.column_stack([np.interp(stamps, at, column) for column in values.T])
        blank = np.full((len(at), len(TIP)), np.nan)
        table = np.hstack([np.vstack([values, there]), np.vstack([blank, tips])])[order]
        self.header = ["time", *names, *TIP]
        columns = np.column_stack([times[order] - times.min(), table]).T
        self._columns: dict[str, Array] = dict(zip(self.header, columns, strict=True))
        self.rows = [[""]] * len(order)

    def numbers(self, name: str, *, blanks: bool = False) -> Array:
        """(K,) numbers of a column; NaN at waypoints without a pose."""
        return self._columns[name]

    def _messages(
        self, reader: Any, topics: dict[str, str], topic: str, kinds: Sequence[str]
    ) -> Iterator[tuple[float, Any]]:
        """Stamps [s] and messages of a topic, in the order recorded."""
        if topic not in topics:
            known = ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, kind in sorted(topics.items()))
            raise self.fault(f"has no topic {topic}, it has {known or 'none'}")
        if topics[topic].rsplit("/", 1)[-1] not in kinds:
            raise self.fault(f"holds {topics[topic]}, must hold one of {', '.join(kinds)}", column=topic)
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        for connection, recorded, raw in reader.messages(connections=chosen):
            yield recorded * NANOSECONDS, reader.deserialize(raw, connection.msgtype)

    def _names(self, rows: Sequence[tuple[float, Any]], topic: str) -> list[str]:
        if not rows:
            raise self.fault("has no message", column=topic)
        names = [str(name) for name in rows[0][1].name]
        if len(set(names)) < len(names) or not names or set(names) & {"time", *TIP}:
            raise self.fault(f"must name its joints, differently and not {', '.join(TIP)}", column=topic, value=names)
        return names

    def _joints(self, rows: Sequence[tuple[float, Any]], names: Sequence[str], topic: str) -> tuple[Array, Array]:
        stamps, values = [], []
        for number, (recorded, message) in enumerate(rows):
            known = dict(zip(map(str, message.name), message.position, strict=False))
            if missing := [name for name in names if name not in known]:
                raise self.fault(f"has no position of {', '.join(missing)}", number, topic)
            stamps.append(_stamp(message.header, recorded))
            values.append([float(known[name]) for name in names])
        table = np.array(values)
        if not np.isfinite(table).all():
            row = int(np.argmin(np.isfinite(table).all(axis=1)))
            raise self.fault("must have finite positions", row, topic)
        return self._rising(np.array(stamps), topic), table

    def _poses(self, rows: Sequence[tuple[float, Any]], topic: str, frame: str) -> tuple[Array, Array]:
        stamps, tips, children = [], [], set[str]()
        for recorded, message in rows:
            for part in getattr(message, "transforms", [message]):
                child = str(getattr(part, "child_frame_id", ""))
                children.add(child)
                if not frame or child == frame:
                    stamps.append(_stamp(part.header, recorded))
                    tips.append(_tip(part))
        if not tips:
            raise self.fault(f"has no transform to {frame}, it has {', '.join(sorted(children))}", column=topic)
        if not frame and len(children) > 1:
            raise self.fault(
                f"holds several frames, bag.frame must say which: {', '.join(sorted(children))}", column=topic
            )
        return self._rising(np.array(stamps), topic), np.array(tips)

    def _rising(self, stamps: Array, topic: str) -> Array:
        back = np.flatnonzero(np.diff(stamps) < 0)
        if len(back):
            k = int(back[0])
            by = stamps[k] - stamps[k + 1]
            raise self.fault(f"has a clock that runs backwards by {by:.3g} s after message {k + 1}", column=topic)
        return stamps


def _stamp(header: Any, recorded: float) -> float:
    stamp = header.stamp.sec + NANOSECONDS * header.stamp.nanosec
    return float(stamp if stamp > 0 else recorded)


def _tip(message: Any) -> list[float]:
    """Position and direction of the third axis; NaN where a message has none."""
    part: Any = message
    for name in ("pose", "transform", "pose"):  # poses with covariances hold a pose in a pose
        part = getattr(part, name, part)
    place = next(getattr(part, name) for name in ("position", "translation", "point") if hasattr(part, name))
    turn = getattr(part, "orientation", getattr(part, "rotation", None))
    axis = [np.nan] * 3
    if turn is not None and (norm := turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2) > 0:
        w, x, y, z = (float(value) / np.sqrt(norm) for value in (turn.w, turn.x, turn.y, turn.z))
        axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    return [float(place.x), float(place.y), float(place.z), *axis]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The recording's reader. Raises InputError where `rosbags` is not installed or cannot read it."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError("is a recording of ROS: pip install 'ctrplan[ros]' reads it", file=str(path)) from None
    if not path.exists():
        raise InputError("does not exist", file=str(path))
    read: Callable[..., Any] = AnyReader
    try:
        with read([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except InputError:
        raise
    except (AnyReaderError, OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is no recording of ROS that can be read ({reason})", file=str(path)) from None


def _hash(path: Path) -> str:
    """SHA-256 of the content of a file, or of all files of a folder. Raises InputError for more than can be read."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    if sum(file.stat().st_size for file in files) > LARGEST_FILE_BYTES:
        raise InputError(f"is larger than {LARGEST_FILE_BYTES // 10**6} MB, no file of measurements", file=str(path))
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()
