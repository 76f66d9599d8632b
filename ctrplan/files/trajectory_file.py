"""A trajectory -> files in the formats there are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError
from ctrplan.files.trajectory_format import CATALOGUE, TrajectoryFormat
from ctrplan.storage.atomic_write import write_atomically


def trajectory_formats(names: Sequence[str]) -> list[TrajectoryFormat]:
    """The formats of these names, each once. Raises InputError for one that there is not."""
    for name in names:
        if name not in CATALOGUE:
            raise InputError(f"must be of {CATALOGUE.names}", key="--formats", value=name)
    return [CATALOGUE[name] for name in dict.fromkeys(names)]


def left_over(folder: Path, formats: Sequence[TrajectoryFormat]) -> list[str]:
    """Names of trajectories in a folder that are in none of these formats: an earlier plan left them there."""
    others = [other.file_name for other in CATALOGUE.values() if other not in formats]
    return [name for name in others if (folder / name).exists()]


def write_trajectory(folder: Path, trajectory: Trajectory, formats: Sequence[TrajectoryFormat]) -> None:
    """Writes a file per format into a folder. Raises InputError for joints that a format can't tell apart."""
    for chosen in formats:
        write_atomically(folder / chosen.file_name, chosen.text(trajectory))
