"""A mesh that is refused because of a place in it, with what a picture of that place needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ctrplan.anatomy.mesh_repair import Indices, odd_edges
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError


@dataclass(frozen=True, eq=False)
class MeshDefect:
    """In the file's frame, m."""

    file: Path
    surface: Surface
    place_m: Array  # (3,)

    @property
    def edges(self) -> Indices:
        """Edges (E, 2) at which the surface ends, or one branches off."""
        return odd_edges(self.surface.faces)


class MeshDefectError(InputError):
    """The refusal of a mesh that has a place."""

    def __init__(self, refusal: InputError, defect: MeshDefect) -> None:
        """Says what `refusal` says."""
        super().__init__(refusal.rule, file=refusal.file, key=refusal.key, value=refusal.value, unit=refusal.unit)
        self.defect = defect
