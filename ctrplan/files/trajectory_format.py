"""What an output format says about itself, and the catalogue of formats.

A format is one file below files/trajectory_formats/: a function Trajectory -> text with a name and a suffix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ctrplan.base.catalogue import Catalogue
from ctrplan.drive.trajectory import Trajectory
from ctrplan.errors import InputError

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
        CATALOGUE.add(name, TrajectoryFormat(name, suffix, text), text.__module__)
        return text

    return registered
