"""What the parts of a scene are called and coloured, in pictures and on pages alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ctrplan.reports import palette

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


@dataclass(frozen=True)
class Look:
    """Name in the legend, and colour."""

    name: str
    colour: str


ENVELOPE = Look("envelope of friction", palette.ENVELOPE)
CORNERS = Look("corner shapes", palette.CORNER)
START = Look("robot at the start", palette.START)
AT_GOAL = Look("robot at the goal", palette.START)
PLATE = Look("front plate", palette.PLATE)
TIP_PATH = Look("path of the tip", palette.BOUND)
GOAL = Look("goal", palette.GOAL)
NARROWEST = Look("closest to the anatomy", palette.LIMIT)
NARROW_BODY = Look("closest pose by clearance", palette.CLEARANCE)
ANATOMY = {
    "avoid": Look("anatomy to avoid", palette.ANATOMY["avoid"]),
    "inside": Look("lumen to stay inside", palette.ANATOMY["inside"]),
}


def tube_look(tube: int) -> Look:
    """Of a tube, 0 the outermost."""
    return Look(f"tube {tube + 1}", palette.tube_colour(tube))


def anatomy_looks(scenario: Scenario) -> list[Look]:
    """Of the kinds of anatomy that the scenario has."""
    roles = {part.role for part in scenario.anatomy}
    return [look for role, look in ANATOMY.items() if role in roles]
