"""The colours of all pictures: Okabe and Ito's, which colour-blind readers tell apart, with paler ones for surfaces."""

from __future__ import annotations

from ctrplan.drive.drive import Drive

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
ANATOMY = {"avoid": "#D98880", "inside": "#9FB4C4"}
LEG_KINDS = {"rotation": "#E4EDF7", "translation": "#FBF0DC", "simultaneous": "#EDE6F6"}


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
