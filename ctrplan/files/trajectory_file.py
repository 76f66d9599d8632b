"""A trajectory -> files, in the formats that the catalogue has.

A format is one file below files/trajectory_formats/: a function Trajectory -> text with a name and a suffix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ctrplan.base.catalogue import Catalogue, file_of_ones_own, guarded_function
from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError
from ctrplan.storage.output_folder import write_atomically

AsText = Callable[[Trajectory], str]


@dataclass(frozen=True)
class TrajectoryFormat:
    """A way to write a trajectory down."""

    name: str
    suffix: str
    text: AsText

    @property
    def file_name(self) -> str:
        """Name of the file beside plan.json."""
        return f"trajectory{self.suffix}"


CATALOGUE: Catalogue[TrajectoryFormat] = Catalogue("trajectory format", "ctrplan.files.trajectory_formats")


def register(name: str, *, suffix: str) -> Callable[[AsText], AsText]:
    """Adds a format to the catalogue: the decorator of the function that makes the text.

    Raises InputError for a name or suffix that another format has, and for a suffix that is none.
    """
    if not suffix.startswith(".") or not suffix[1:].replace(".", "").isalnum():
        raise InputError("must be a dot and letters or digits, such as .csv", key="suffix", value=suffix)

    def registered(text: AsText) -> AsText:
        same = [other.name for other in CATALOGUE.registered.values() if other.suffix == suffix and other.name != name]
        if same:
            raise InputError(f"is the suffix of format {same[0]} already", key="suffix", value=suffix)
        file = file_of_ones_own(text)
        write = text if file is None else guarded_function(text, f"trajectory format {name}", file)
        CATALOGUE.add(name, TrajectoryFormat(name, suffix, write), text.__module__)
        return text

    return registered


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
        text = chosen.text(trajectory)
        if not isinstance(text, str) or text.encode(errors="replace").decode() != text:
            rule = f"must return text that can be written, not {type(text).__name__}"
            raise InputError(rule, key=f"trajectory format {chosen.name}")
        write_atomically(folder / chosen.file_name, text)
