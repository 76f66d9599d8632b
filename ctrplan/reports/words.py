"""Terms of pictures and pages with their explanations, and numbers as people read them."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Unit
    from ctrplan.plans.plan import Plan
    from ctrplan.uncertainty.result import GoalMiss, Uncertainty
    from ctrplan.uncertainty.worst_case import Chance


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
    "arrival": "How far from the target the tip may be after this very motion, whatever friction was before it: with "
    "all that the files state to be uncertain, and the drive's inexact execution.",
    "worst case at the target": "Distance of the target from the tip without friction, and the worst-case friction "
    "error and the drive's play added to it: what any motion could leave there.",
    "restart": "The place of the motion from which a run that was interrupted begins again. From there on every pair "
    "of tubes slips far enough to forget where it came from.",
    "tolerance": "How far from the target the tip may arrive. The scenario asks for it.",
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


FINEST = 1e-3  # mm or degrees, below which no solve is that good: a tolerance of what is said, not of what is computed


def millimetres(length_m: float) -> str:
    """A length for people, about three digits; one below FINEST is said to be that."""
    return f"{_no_finer(length_m * 1e3)} mm"


def degrees(angle_rad: float) -> str:
    """An angle for people, in the same way."""
    return f"{_no_finer(math.degrees(angle_rad))}°"


def _no_finer(value: float) -> str:
    return f"<{FINEST:g}" if 0 < abs(value) < FINEST else digits(value)


def digits(value: float) -> str:
    """Three digits, two of what is below 0.1, never in powers of ten where a plain number does; "?" of no number."""
    if not math.isfinite(value):
        return "?"
    if value == 0 or abs(value) >= 0.1:
        return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(abs(value) or 1))))}f}"
    return f"{value:#.2g}" if abs(value) >= LEAST else f"{value:.5f}"


VALUES: dict[Unit, Callable[[float], str]] = {
    "m": millimetres,
    "rad": degrees,
    "mm": lambda value: f"{_no_finer(value)} mm",
    "share": lambda value: f"{digits(100 * value)} %",
    "number": digits,
    "count": str,
}


Rows = dict[str, str]  # what -> how much


def uncertainty_rows(plan: Plan) -> Rows:
    """Worst cases with their causes, and chances; empty where nothing is stated to be uncertain."""
    result = plan.uncertainty
    if result is None:
        return {}
    rows = dict[str, str]()
    for number, miss in enumerate(result.via, start=1):
        name = f"target {number}"
        rows |= _target_rows(miss, (f"{name} with uncertainty", f"{name} turned at worst", f"chance to miss {name}"))
    rows |= _target_rows(result.goal, ("at worst with uncertainty", "turned at worst", "chance to miss tolerance"))
    if result.tour:
        chances = _by_friction(met, result.tour.chance_by_history, result.tour.chance_any_friction)
        rows["chance to meet all targets"] = chances
    if result.closest:
        left, without = millimetres(result.closest.worst_m), millimetres(result.closest.nominal_m)
        rows["room with uncertainty"] = (
            f"{left} beyond the margins, {without} without it; it takes {result.closest.sentence}"
        )
        margin, touch = percent(result.closest.chance_margin), percent(result.closest.chance_touch)
        rows["chance to lose room"] = f"{margin} to enter the margin, {touch} to touch"
    return rows


def _target_rows(miss: GoalMiss, labels: tuple[str, str, str]) -> Rows:
    """Rows of one target: its worst case, the turn's, and the chance of missing it."""
    worst, turned, missed = labels
    rows = {worst: f"the tip ends off by {miss.sentence}"}
    if miss.turn:
        rows[turned] = f"by {miss.turn.sentence}"
    if miss.chance_any_friction:
        rows[missed] = _by_friction(percent, miss.chance_by_history, miss.chance_any_friction)
        if miss.turn:
            alone = _by_friction(percent, miss.turn.chance_by_history, miss.turn.chance_any_friction)
            rows[missed] += f"; by the direction alone {alone}"
    return rows


def _by_friction(phrase: Callable[[Chance], str], by_history: Chance | None, any_friction: Chance) -> str:
    predicted = f"{phrase(by_history)} with friction as predicted, " if by_history else ""
    return f"{predicted}{phrase(any_friction)} in the worst friction state"


def met(chance: Chance) -> str:
    """The chance that something does not happen, or the bound on it where it happened to every draw or to none."""
    if chance.stated == 0:
        return f"above {digits(100 * (1 - chance.high))} %"
    if chance.stated == 1:
        return f"below {digits(100 * (1 - chance.low))} %"
    return _stated(chance, 1 - chance.stated)


def percent(chance: Chance) -> str:
    """A chance, or the bound on one that no draw had; that of the solves where they are worse."""
    return _stated(chance, chance.stated) if chance.stated else f"below {digits(100 * chance.high)} %"


def _stated(chance: Chance, share: float) -> str:
    return f"{digits(100 * share)} %{'' if chance.is_confirmed else ' (by solves)'}"


def stated_in_words(uncertainty: Uncertainty) -> list[str]:
    """Paragraphs: what the numbers rest on."""
    base = (
        f"the base within {millimetres(uncertainty.position_sigma_m)} and "
        f"{digits(math.degrees(uncertainty.rotation_sigma_rad))}° "
        "(standard deviations of each coordinate and each rotation)"
    )
    known = [f"{len(uncertainty.parameters)} parameters by their 95 % intervals"] if uncertainty.parameters else []
    known += [base] if uncertainty.position_sigma_m or uncertainty.rotation_sigma_rad else []
    if uncertainty.model_error_m:
        known.append(f"what calibration left unexplained, {millimetres(uncertainty.model_error_m)} in 95 % of poses")
    return [
        f"Known are {', '.join(known)}. The worst case has every one of them at the worst end of its 95 % interval at "
        "once, which hardly any robot is; what calibration left unexplained exceeds its number in one pose of twenty.",
        f"Chances are shares of {uncertainty.draws:,} draws of the linearised model; what {uncertainty.solved} solves "
        f"differ by is in all of them. {uncertainty.distribution[0].upper()}{uncertainty.distribution[1:]}.",
        *_simulated(uncertainty),
    ]


def _simulated(uncertainty: Uncertainty) -> list[str]:
    if not uncertainty.simulated:
        return []
    return [
        f"Friction as predicted: the motion was simulated on {uncertainty.simulated} of these robots, each from one "
        "of the friction states that the start may have. They are equally likely, unless they were observed.",
    ]


MEANING = (
    "Friction between the tubes makes the robot's shape depend on how it got there: the same joint values can "
    "give many shapes. At every sampled place of the path the model was solved without friction, and with "
    "friction at its Coulomb limit in every combination of directions (the corner shapes). The worst-case "
    "friction error is the largest distance of the tip in a corner shape from the tip without friction. The "
    "envelope is that distance all along the robot, with the tubes' radius and the model error added.",
    "Clearance, stability and strain are those of every friction state, not of these shapes alone: of the states "
    "between them the certificate solves as many as it takes for what lies between solved shapes to be safe.",
    "The predicted friction error follows the contacts' slip along this very path, from every friction state that the "
    "robot may start in (released, and every corner); the largest counts. Rotations load friction, translations "
    "release it, so that it is usually far below the worst case where a plan ends with a translation.",
    "The arrival is where this motion brings the tip. Each pair of tubes forgets its past by its own slip: the "
    "friction states that the robot may begin with, carried along the motion, become one where every pair slips far "
    "enough. What is left is known beforehand, and the end of the motion is corrected by it. Coefficients of friction, "
    "the drive's exactness, play, parameters and registration count as far as the files state them. It holds for the "
    "motion driven as written; a run that was interrupted begins again where the table says. It is simulated, not "
    "proved, and real contacts may keep some of what slip erases in the model.",
    "What the figures do not cover: the model is quasi-static (slow motion, no vibration), friction follows "
    "Coulomb's law with the coefficients of the robot file, and nothing touches the robot from outside, neither "
    "anatomy nor tools. They hold for the model as calibrated; what calibration could not explain is in the robot "
    "file's model error and nowhere else. That no history of motion takes the tip beyond the corner shapes is "
    "supported by trials, not proved; for bodies, friction that differs along a contact has an allowance that was "
    "measured.",
)
