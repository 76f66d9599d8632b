"""Robots at the ends of the intervals in a robot file: friction's lower end, and the 95 % of fitted effects."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from ctrplan.errors import CtrplanError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.robot.robot import Robot


def robots_at_ends(robot: Robot) -> Iterator[tuple[str, Robot]]:
    """What was changed, in words, and the robot; ends that make none are left out."""
    for name, content in _contents(robot):
        try:
            yield name, robot_from_dict(content, file=robot.path)
        except CtrplanError:
            continue


def _contents(robot: Robot) -> Iterator[tuple[str, dict[str, Any]]]:
    for k, (low, high) in enumerate(robot.friction.tolist()):
        if low < high:
            content = copy.deepcopy(dict(robot.content))
            content["contact"][k]["friction_coefficient"] = low
            yield f"contact.{k + 1}.friction_coefficient = {low:.4g}", content
    for effect, table in robot.effects.items():
        for key, ends in table.get("ci95", {}).items():
            for end in ends:
                content = copy.deepcopy(dict(robot.content))
                content["effects"][effect][key] = end
                yield f"effects.{effect}.{key} = {end:.4g}", content
