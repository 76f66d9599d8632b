"""Terms of pictures and pages with their explanations, and numbers as people read them."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Unit


class Markup(str):
    """HTML that is finished; templates escape every other text."""

    __slots__ = ()

    def __html__(self) -> str:
        """For templates, which escape all else."""
        return self


def explained(text: str, meaning: str) -> Markup:
    """Text with what it means in a tooltip."""
    return Markup(f'<abbr title="{html.escape(meaning)}">{html.escape(text)}</abbr>')


TERMS = {
    "worst-case friction error": "Farthest that friction between the tubes can take the tip from where it would be "
    "without friction, whatever way it came there.",
    "predicted friction error": "The same distance for this very motion: the slip of every contact is followed along "
    "the path. It is no promise; the worst case is.",
    "worst case at the target": "Distance of the target from the tip without friction, and the worst-case friction "
    "error and the drive's play added to it.",
    "tolerance": "How far from the target the tip may be without friction. The scenario asks for it.",
    "envelope of friction": "Space in which the robot is, whatever friction does: the tubes, thickened by the "
    "worst-case error at each place along them.",
    "corner shapes": "The robot with friction at its limit, one shape for each combination of directions.",
    "clearance": "Smallest distance from the anatomy of every shape that friction allows, less the margin that the "
    "scenario asks for.",
    "clearance without friction": "That of the shape that the robot has without friction, as solved.",
    "clearance in the worst friction state": "That of the friction state which brings the robot closest, as solved. "
    "This is the number to compare plans by: it does not depend on how closely the certificate looked.",
    "certified clearance": "What is left once everything that was not solved is taken off: motion between the samples, "
    "the model's discretisation, friction that differs along a contact, play of the drive, uncertain parameters.",
    "friction state": "Share of its Coulomb limit that friction between two tubes has, from -1 to 1; a number for each "
    "pair of neighbours, the outermost first.",
    "stability": "How far the robot is from snapping into another shape, the least of every friction state; at 0 it "
    "snaps.",
    "strain": "Largest stretch of a tube's material in any friction state; beyond the limit it stays bent.",
    "play": "What the drive may move a tube without being asked to, backlash for example.",
    "noise": "How much a measurement of one and the same tip scatters.",
    "rms": "Root of the mean square: the usual size of an error, large ones counting more.",
    "held-out poses": "Measured poses that no fit has seen, so that the error on them is an honest one.",
    "95 % interval": "Where the true value is expected, 19 times of 20, if the model is right.",
    "branch": "Configurations that can be turned into each other while the tip stays at the point.",
    "Coulomb friction": "Friction in proportion to the force between two surfaces, against the direction of slip.",
}


def term(name: str, text: str = "") -> Markup:
    """`text`, or the term itself, with what the term means in its tooltip."""
    return explained(text or name, TERMS[name])


LEAST = 1e-4  # of which Python would write a power of ten


def millimetres(length_m: float) -> str:
    """A length for people, about three digits."""
    return f"{digits(length_m * 1e3)} mm"


def degrees(angle_rad: float) -> str:
    """An angle for people."""
    return f"{digits(math.degrees(angle_rad))}°"


def digits(value: float) -> str:
    """Three digits or so, never in powers of ten where a plain number does; a question mark for what is not finite."""
    if not math.isfinite(value):
        return "?"
    if value == 0 or abs(value) >= 0.1:
        return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(abs(value) or 1))))}f}"
    return f"{value:.2g}" if abs(value) >= LEAST else f"{value:.5f}"


VALUES: dict[Unit, Callable[[float], str]] = {
    "m": millimetres,
    "rad": degrees,
    "mm": lambda value: f"{digits(value)} mm",
    "share": lambda value: f"{digits(100 * value)} %",
    "number": digits,
    "count": str,
}
