"""Colours of pictures and pages, what the parts of a scene are called, and how much of it pictures show."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.drive import Drive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ctrplan.scenario.scenario import Scenario

SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
ENVELOPE = "#7A5CC0"
CORNER = "#4B3A78"
START = "#8D979F"
GOAL = "#C2255C"
PLATE = "#B8C0C6"
BOUND = "#B5400A"
CLEARANCE = "#0B7285"
STABILITY = "#5C3D99"
STRAIN = "#8A6D00"
HEAT = "viridis"  # of matplotlib: even steps of lightness, also for colour-blind readers
UNSTABLE = "#DDE1E5"
FAILED = "#9AA2AA"
MET = "#2B7A3D"
CAUTION = "#9A5B00"
LIMIT = "#C92A2A"
CLEARANCES = (LIMIT, "#E69F00", CLEARANCE)  # from none to much
INK = "#1F2933"
MUTED = "#5F6B76"
GRID = "#E3E7EB"
ANATOMY = {"avoid": "#D98880", "inside": "#CFA08F"}
ANATOMY_OPACITY = {"avoid": 0.6, "inside": 0.3}
LEG_KINDS = {"rotation": "#E4EDF7", "translation": "#FBF0DC", "simultaneous": "#EDE6F6"}


DPI = 120  # of pictures
LEVEL = 4  # of zlib, for pictures and pages: plotly.js is 4 % larger than by its usual 6, in half the time


def png(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure of matplotlib as the content of a PNG file."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi, pil_kwargs={"compress_level": LEVEL})
    return content.getvalue()


def tube_colour(tube: int) -> str:
    """Colour of a tube, 0 the outermost."""
    return SERIES[tube % len(SERIES)]


def joint_colours(drive: Drive) -> list[str]:
    """(m,) a colour per joint, no two alike among rotations or translations while there are enough.

    A joint that is the first to move a tube has that tube's colour.
    """
    taken: dict[str, set[str]] = {"rotation": set(), "translation": set()}
    colours = []
    for joint in drive.joints:
        wanted = [tube_colour(tube) for tube in joint.moves.nonzero()[0].tolist()] + list(SERIES)
        colour = next((colour for colour in wanted if colour not in taken[joint.kind]), SERIES[0])
        taken[joint.kind].add(colour)
        colours.append(colour)
    return colours


@dataclass(frozen=True)
class Look:
    """Name in the legend, and colour."""

    name: str
    colour: str


ENVELOPE_LOOK = Look("envelope of friction", ENVELOPE)
CORNERS = Look("corner shapes", CORNER)
START_LOOK = Look("robot at the start", START)
AT_GOAL = Look("robot at the goal", START)
PLATE_LOOK = Look("front plate", PLATE)
TIP_PATH = Look("path of the tip", BOUND)
GOAL_LOOK = Look("goal", GOAL)
NARROWEST = Look("closest to the anatomy", LIMIT)
NARROW_BODY = Look("closest pose by clearance", CLEARANCE)
ANATOMY_LOOK = {
    "avoid": Look("anatomy to avoid", ANATOMY["avoid"]),
    "inside": Look("lumen to stay inside", ANATOMY["inside"]),
}


def tube_look(tube: int) -> Look:
    """The look of a tube, 0 the outermost."""
    return Look(f"tube {tube + 1}", tube_colour(tube))


def anatomy_looks(scenario: Scenario) -> list[Look]:
    """Looks of the kinds of anatomy that the scenario has."""
    roles = {part.role for part in scenario.anatomy}
    return [look for role, look in ANATOMY_LOOK.items() if role in roles]


THINNEST_BOX = 0.35  # of its longest side, or the scene is hard to turn


def view_box(points_m: Array, anatomy_m: Array) -> tuple[Array, Array]:
    """Corners (3,), (3,) [m] of what to show: the robot's points (K, 3) and the anatomy (K, 3) around them."""
    lower, upper = points_m.min(axis=0), points_m.max(axis=0)
    around = 0.35 * float(np.linalg.norm(upper - lower)) + 5e-3
    if len(anatomy_m):
        lower = np.minimum(lower, np.maximum(anatomy_m.min(axis=0), lower - around))
        upper = np.maximum(upper, np.minimum(anatomy_m.max(axis=0), upper + around))
    extent = upper - lower
    rim = 0.03 * extent.max() + 1e-3 + np.maximum(THINNEST_BOX * extent.max() - extent, 0) / 2
    return lower - rim, upper + rim


def most_ticks(sides: Array) -> list[int]:
    """How many ticks axes (3,) of such lengths have at most: few where one is short, for labels meet at corners."""
    return [3 if side < sides.max() else 6 for side in sides]


def side_azimuth_rad(points_m: Array) -> float:
    """From where points (K, 3) spread widest to left and right; not along an axis, where a scene looks flat."""
    spread = np.cov((points_m - points_m.mean(axis=0))[:, :2].T)
    x, y = np.linalg.eigh(spread)[1][:, 0]
    quarter, rest = divmod(float(np.arctan2(y, x)), np.pi / 2)
    return float(np.pi / 2 * quarter + np.clip(rest, np.radians(25), np.radians(65)))
