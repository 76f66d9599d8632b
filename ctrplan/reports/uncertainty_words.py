"""What is uncertain about a plan's robot and base, in words: at the goal, before the anatomy, and by which causes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from ctrplan.reports.words import digits, millimetres

if TYPE_CHECKING:
    from ctrplan.plans.plan import Plan
    from ctrplan.uncertainty.result import GoalMiss, Uncertainty
    from ctrplan.uncertainty.worst_case import Chance

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


def _by_friction(said: Callable[[Chance], str], by_history: Chance | None, any_friction: Chance) -> str:
    predicted = f"{said(by_history)} with friction as predicted, " if by_history else ""
    return f"{predicted}{said(any_friction)} in the worst friction state"


def met(chance: Chance) -> str:
    """The chance that something does not happen, or the bound on it where it happened to every draw or to none."""
    share = 1 - chance.stated
    if chance.stated == 0:
        return f"above {digits(100 * (1 - chance.high))} %"
    if share == 0:
        return f"below {digits(100 * (1 - chance.low))} %"
    return f"{digits(100 * share)} %" if chance.is_confirmed else f"{digits(100 * share)} % (by solves)"


def percent(chance: Chance) -> str:
    """A chance, or the bound on one that no draw had; that of the solves where they are worse."""
    share = chance.stated
    if share == 0:
        return f"below {digits(100 * chance.high)} %"
    return f"{digits(100 * share)} %" if chance.is_confirmed else f"{digits(100 * share)} % (by solves)"


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
