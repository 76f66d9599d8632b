"""Poses over OpenIGTLink, which 3D Slicer and other programs of the operating room listen to."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from types import ModuleType, TracebackType

import numpy as np

from ctrplan.anatomy.patient_frame import Frame, signs
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import frames_along
from ctrplan.reports.robot_surface import RobotPose
from ctrplan.studies.simulate import Simulation

ROBOT_FRAME: Frame = "LPS"  # what the robot's own frame is taken for, as in the files of `ctrplan export`
ACROSS = np.eye(3)


def pyigtl() -> ModuleType:
    """The library that packs messages. Raises InputError without it."""
    try:
        import pyigtl as library
    except ImportError:
        raise InputError("needs pyigtl: pip install ctrplan[live]", key="--igtl") from None
    module: ModuleType = library
    return module


def pose_messages(pose: RobotPose, frame: Frame) -> list[bytes]:
    """TRANSFORM tip, tube_1, ... of the tubes' ends, third axis along them; POINT centreline_1, ... and tip_point."""
    packed = []
    for number, (rod, R) in enumerate(zip(pose.tubes, pose.ends_R, strict=True), start=1):
        packed.append(_transform(f"tube_{number}", rod.centreline_m[-1], R, frame))
        packed.append(_points(f"centreline_{number}", rod.centreline_m, frame))
    tip = _transform("tip", pose.tip_m, pose.ends_R[-1], frame)
    return [tip, _points("tip_point", pose.tip_m[None], frame), *packed]


def tip_messages(position_m: Array, tangent: Array) -> list[bytes]:
    """TRANSFORM tip and POINT tip_point of a place (3,) [m] and a direction (3,); its turn about that says nothing."""
    across = ACROSS[int(np.argmin(np.abs(tangent)))]
    R = frames_along(tangent[None], across[None])[0]
    return [_transform("tip", position_m, R, ROBOT_FRAME), _points("tip_point", position_m[None], ROBOT_FRAME)]


def to_ras(frame: Frame) -> Array:
    """(3, 3) maps vectors of the anatomy's frame to RAS."""
    return np.diag(signs(frame, "RAS"))


def _transform(name: str, position_m: Array, R: Array, frame: Frame) -> bytes:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = to_ras(frame) @ R, to_ras(frame) @ position_m * MM_PER_M
    content: bytes = pyigtl().TransformMessage(matrix, device_name=name).pack()
    return content


def _points(name: str, points_m: Array, frame: Frame) -> bytes:
    positions = points_m @ to_ras(frame) * MM_PER_M
    names = [f"{name}_{k}" for k in range(len(positions))]
    content: bytes = pyigtl().PointMessage(positions, names=names, device_name=name).pack()
    return content


ADDRESS = "127.0.0.1"
SLOWEST_S = 1.0  # that a listener may take before it is let go
LOOK_S = 0.05  # for a listener


class Listener:
    """Somebody at the other end of a connection, sent to by a thread of its own: who is slow holds up nobody else."""

    def __init__(self, connection: socket.socket) -> None:
        """Begins to send what is put."""
        connection.settimeout(SLOWEST_S)
        self._connection, self._waiting = connection, SimpleQueue[bytes]()
        self._sending = threading.Thread(target=self._send, name="OpenIGTLink listener", daemon=True)
        self._sending.start()

    @property
    def is_there(self) -> bool:
        """False once it has gone, or was let go because it took nothing for SLOWEST_S."""
        return self._sending.is_alive()

    def put(self, content: bytes) -> None:
        """Sends after all that was put before."""
        self._waiting.put(content)

    def let_go(self) -> None:
        """Sends what is left and closes the connection."""
        self._waiting.put(b"")
        self._sending.join()

    def _send(self) -> None:
        with self._connection, contextlib.suppress(OSError):
            while content := self._waiting.get():
                self._connection.sendall(content)


class Broadcast:
    """Sends messages to all listeners of a port; 0 takes a free one. Calls may come from several threads."""

    def __init__(self, port: int) -> None:
        """Raises InputError where the port can't be had."""
        try:
            self.socket = socket.create_server((ADDRESS, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"can't be listened on ({reason})", key="--igtl", value=port) from None
        self.port: int = self.socket.getsockname()[1]
        self._listeners: list[Listener] = []
        self._last, self._is_open = b"", True
        self._lock = threading.Lock()
        self._accepting = threading.Thread(target=self._accept, name="OpenIGTLink", daemon=True)

    def __enter__(self) -> Broadcast:
        """Begins to listen."""
        self._accepting.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Lets everybody go."""
        self._is_open = False
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)  # closing alone would not wake who accepts
        self.socket.close()
        self._accepting.join()
        with self._lock:
            for listener in self._listeners:
                listener.let_go()
            self._listeners.clear()

    @property
    def is_heard(self) -> bool:
        """Whether anybody listens."""
        with self._lock:
            return any(listener.is_there for listener in self._listeners)

    def send(self, messages: list[bytes]) -> None:
        """To all listeners; who has gone, or is too slow, is let go."""
        with self._lock:
            self._last = b"".join(messages)
            self._listeners = [listener for listener in self._listeners if listener.is_there]
            for listener in self._listeners:
                listener.put(self._last)

    def _accept(self) -> None:
        while self._is_open:
            try:
                connection, _ = self.socket.accept()
            except OSError:  # closed; or one that was given up, or no more files: the next may be had
                time.sleep(LOOK_S)
                continue
            listener = Listener(connection)
            with self._lock:
                if self._last:
                    listener.put(self._last)
                self._listeners.append(listener)


ROW_S = 0.1  # where a path says no time


def play_tips(
    result: Simulation, port: int, interrupted: threading.Event, on_listening: Callable[[int], object]
) -> None:
    """Waits for a listener, then sends each sample's tip at its time; ends early when `interrupted` is set.

    `on_listening` is told the port. Raises InputError where that can't be had, and without pyigtl.
    """
    pyigtl()
    outcome = np.flatnonzero(np.isfinite(result.position_m).all(axis=1))
    with Broadcast(port) as broadcast:
        on_listening(broadcast.port)
        while not broadcast.is_heard:
            if interrupted.wait(LOOK_S):
                return
        for k, wait_s in zip(outcome.tolist(), np.diff(_times(result)[outcome], append=np.nan).tolist(), strict=True):
            broadcast.send(tip_messages(result.position_m[k], result.tangent[k]))
            if interrupted.wait(wait_s if wait_s > 0 else 0.0):
                return


def _times(result: Simulation) -> Array:
    """(S,) [s] of the samples."""
    rows = np.arange(len(result.path.theta_commanded))
    given = result.path.time_s
    return np.interp(result.place, rows, ROW_S * rows if given is None else given)
