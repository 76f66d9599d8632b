"""Where joints and poses are read from: a CSV file with ctrplan's columns, or a mapping file with those of others.

Everything that reads joints or poses, `joint_path_file.py` and `measurement_file.py`, asks here.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from ctrplan.files.mapped_table import MappedTable
from ctrplan.files.mapping_entries import MappingEntry
from ctrplan.robot.robot import Robot
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.file_bytes import file_name
from ctrplan.storage.toml_document import read_document


@dataclass(frozen=True)
class Source:
    """A table and what a mapping file says of it besides its columns."""

    table: CsvTable
    is_mapped: bool = False
    tracker: str = ""  # sources with the same one share its frame
    homing: str = ""  # sources with the same one share the zeros of the joints
    is_registered: bool = True  # whether the robot's place in that frame is known
    of_collars: bool = False  # whether joints are those of the tubes' collars rather than what was commanded
    wrapped: bool | None = None  # whether rotations are kept within one turn; None: as the values look


def sources(path: str | os.PathLike[str], robot: Robot, what: str) -> list[Source]:
    """The tables of a CSV file, one, or of a mapping file (TOML), one for each run. Raises InputError."""
    name = file_name(path, "a CSV file, or of a mapping file (TOML)")
    if not name.lower().endswith(".toml"):
        return [Source(CsvTable(name, what))]
    document = read_document(name)
    entry = document.to(MappingEntry)
    wrapped = None if entry.rotations is None else entry.rotations == "wrapped"
    return [
        Source(
            table=MappedTable(entry, k, robot, document),
            is_mapped=True,
            tracker=run.tracker,
            homing=run.homing,
            is_registered=run.frame != "unknown",
            of_collars=entry.values == "collars",
            wrapped=wrapped,
        )
        for k, run in enumerate(entry.run)
    ]
