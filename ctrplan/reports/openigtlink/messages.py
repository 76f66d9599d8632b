"""Poses of the robot -> messages of OpenIGTLink: TRANSFORM and POINT, in RAS and mm as Slicer takes them."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from ctrplan.anatomy.patient_frame import Frame, signs
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError
from ctrplan.reports.pose import Pose
from ctrplan.sensor.poses import frames_along

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


def pose_messages(pose: Pose, frame: Frame) -> list[bytes]:
    """TRANSFORM tip, tube_1, ... of the tubes' ends, third axis along them; POINT centreline_1, ... and tip_point."""
    packed = []
    for number, (rod, R) in enumerate(zip(pose.tubes, pose.ends_R, strict=True), start=1):
        packed.append(_transform(f"tube_{number}", rod.centreline_m[-1], R, frame))
        packed.append(_points(f"centreline_{number}", rod.centreline_m, frame))
    tip = _transform("tip", pose.tip_m, pose.ends_R[-1], frame)
    return [tip, _points("tip_point", pose.tip_m[None], frame), *packed]


def tip_messages(position_m: Array, tangent: Array, frame: Frame = ROBOT_FRAME) -> list[bytes]:
    """TRANSFORM tip and POINT tip_point of a place (3,) [m] and a direction (3,); its turn about that says nothing."""
    across = ACROSS[int(np.argmin(np.abs(tangent)))]
    R = frames_along(tangent[None], across[None])[0]
    return [_transform("tip", position_m, R, frame), _points("tip_point", position_m[None], frame)]


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
