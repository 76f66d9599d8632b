"""Structures that move: files of their phases, and the margin for places between them where nobody says one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.phases import Phases
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError

STEP_MM = 0.1  # to which a margin is rounded up


def later_phases(phases: Sequence[Sequence[str]]) -> dict[Path, tuple[Path, ...]]:
    """Files of further phases by that of the first. Raises InputError for a single one, a folder, one said twice."""
    files = [Path(name).resolve() for group in phases for name in group]
    for group in phases:
        if len(group) < 2:
            raise InputError("must be two files at least, one of each phase", key="--phases", value=" ".join(group))
    if folders := [file for file in files if file.is_dir()]:
        raise InputError("is a folder: name the files of the phases", key="--phases", value=folders[0].name)
    if twice := [file for file in files if files.count(file) > 1]:
        raise InputError("is said twice", key="--phases", value=twice[0].name)
    return {Path(group[0]).resolve(): tuple(map(Path, group[1:])) for group in phases}


def between_phases_mm(part: AnatomyPart) -> float | None:
    """Half the way from one phase to the next, rounded up: the farthest that a straight way leads from both.

    None for a structure that does not move.
    """
    if not isinstance(part.shape, Phases):
        return None
    return round(math.ceil(part.shape.apart_m() / 2 * MM_PER_M / STEP_MM) * STEP_MM, 6)


def with_margin(part: AnatomyPart, motion_margin_mm: float) -> AnatomyPart:
    """The part with that margin for places between its phases."""
    if not isinstance(part.shape, Phases):
        return part
    shape = replace(part.shape, motion_margin_m=motion_margin_mm / MM_PER_M)
    more_m = shape.surface_error_m - part.shape.surface_error_m
    return AnatomyPart(shape, part.role, part.margin_m + more_m)
