"""A scenario file with its robot standing elsewhere, in a folder of its own or beside the file that it comes from."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import MM_PER_M
from ctrplan.planning.base_pose import DIGITS, MM_DIGITS, BaseFrame, BasePose
from ctrplan.storage.toml_document import Document, toml_text

TURNS = ("quaternion_wxyz", "direction", "look_at", "roll_deg")


def placed_scenario(document: Document, pose: BasePose, file: Path) -> str:
    """The content of `document`, a scenario's, as a file at `file`; read back, it has exactly the pose."""
    content = copy.deepcopy(document.content) if pose.is_own else content_at(document.content, pose)
    here = Path(document.file or ".").parent
    if here.resolve() != file.parent.resolve():
        _name_files_from(content, here, file.parent)
    direction = ", ".join(f"{x:.4f}" for x in pose.direction)
    return f"# Base pose proposed by `ctrplan place`; it looks along [{direction}].\n{toml_text(content)}"


def content_at(content: dict[str, Any], pose: BasePose | BaseFrame) -> dict[str, Any]:
    """A scenario's content with its robot at a pose, and with what was said of how well the base is known."""
    base = {**_pose(pose), **_without_turns(content.get("base", {}))}
    return {**copy.deepcopy(content), "base": base}


def names_files_outside(document: Document, file: Path) -> bool:
    """Whether the file at `file` would name some that lie outside of its folder."""
    inside, here = file.parent.resolve(), Path(document.file or ".").parent
    return any(not (here / table[key]).resolve().is_relative_to(inside) for table, key in _files(document.content))


def _pose(pose: BasePose | BaseFrame) -> dict[str, Any]:
    quaternion = BaseFrame(pose.position_m, pose.R).quaternion_wxyz
    position_mm = np.round(pose.position_m * MM_PER_M, MM_DIGITS) + 0.0  # no -0
    return {"position_mm": position_mm.tolist(), "quaternion_wxyz": (np.round(quaternion, DIGITS) + 0.0).tolist()}


def _without_turns(base: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in base.items() if key not in (*TURNS, "position_mm")}


def _name_files_from(content: dict[str, Any], old: Path, new: Path) -> None:
    for table, key in _files(content):
        if not os.path.isabs(table[key]):
            table[key] = Path(os.path.relpath(old / table[key], new)).as_posix()


def _files(content: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Tables and keys that name a file."""
    parts = [*content.get("anatomy", []), *content.get("fixture", [])]
    return [(content, "robot"), *((part, "file") for part in parts if "file" in part)]
