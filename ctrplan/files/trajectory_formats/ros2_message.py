"""A ROS 2 trajectory_msgs/JointTrajectory in YAML."""

from __future__ import annotations

import json
from collections.abc import Iterable

from ctrplan.drive.trajectory import Trajectory
from ctrplan.files.trajectory_file import register


@register("ros2", suffix=".yaml")
def trajectory_as_ros2_yaml(trajectory: Trajectory) -> str:
    """The trajectory as a ROS 2 trajectory_msgs/JointTrajectory in YAML, rad and m, times from start."""
    lines = ["header:", "  stamp: {sec: 0, nanosec: 0}", '  frame_id: ""']
    lines += [f"joint_names: {json.dumps(list(trajectory.names), ensure_ascii=False)}", "points:"]
    for k, time_s in enumerate(trajectory.time_s.tolist()):
        sec, nanosec = divmod(round(time_s * 1e9), 10**9)
        lines.append(f"- positions: {_yaml_list(trajectory.position[k].tolist())}")
        lines.append(f"  velocities: {_yaml_list(trajectory.velocity[k].tolist())}")
        lines.append(f"  accelerations: {_yaml_list(trajectory.acceleration[k].tolist())}")
        lines.append(f"  effort: []\n  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
    return "\n".join(lines) + "\n"


def _yaml_list(values: Iterable[float]) -> str:
    return f"[{', '.join(map(_yaml_float, values))}]"


def _yaml_float(value: float) -> str:
    """YAML 1.1, which ROS reads, takes 1e-05 for a string: it wants 1.0e-05."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
