"""What is uncertain about a plan's robot and base, in words: at the goal, before the anatomy, and by which causes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ctrplan.reports.plan_words.numbers import digits, millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.uncertainty.chance import Chance
    from ctrplan.planning.uncertainty.result import Uncertainty

Rows = dict[str, str]  # what -> how much


def uncertainty_rows(plan: Plan) -> Rows:
    """Worst cases with their causes, and chances; empty where nothing is stated to be uncertain."""
    found = plan.uncertainty
    if found is None:
        return {}
    rows = {"at worst with uncertainty": f"the tip ends off by {found.goal.sentence}"}
    if found.goal.chance_any_friction:
        chances = [f"{percent(found.goal.chance_any_friction)} in the worst friction state"]
        if found.goal.chance_by_history:
            chances.insert(0, f"{percent(found.goal.chance_by_history)} with friction as predicted")
        rows["chance to miss tolerance"] = ", ".join(chances)
    if found.closest:
        left, without = millimetres(found.closest.worst_m), millimetres(found.closest.nominal_m)
        rows["room with uncertainty"] = (
            f"{left} beyond the margins, {without} without it; it takes {found.closest.sentence}"
        )
        margin, touch = percent(found.closest.chance_margin), percent(found.closest.chance_touch)
        rows["chance to lose room"] = f"{margin} to enter the margin, {touch} to touch"
    return rows


def percent(found: Chance) -> str:
    """A chance, or the bound on one that no draw had; that of the solves where they are worse."""
    share = found.stated
    if share == 0:
        return f"below {digits(100 * found.high)} %"
    return f"{digits(100 * share)} %" if found.is_confirmed else f"{digits(100 * share)} % (by solves)"


def stated_in_words(found: Uncertainty) -> list[str]:
    """Paragraphs: what the numbers rest on."""
    base = (
        f"the base within {millimetres(found.position_sigma_m)} and {digits(math.degrees(found.rotation_sigma_rad))}° "
        "(standard deviations of each coordinate and each rotation)"
    )
    known = [f"{len(found.parameters)} parameters by their 95 % intervals"] if found.parameters else []
    known += [base] if found.position_sigma_m or found.rotation_sigma_rad else []
    if found.model_error_m:
        known.append(f"what calibration left unexplained, {millimetres(found.model_error_m)} in 95 % of poses")
    return [
        f"Known are {', '.join(known)}. The worst case has every one of them at the worst end of its 95 % interval at "
        "once, which hardly any robot is; what calibration left unexplained exceeds its number in one pose of twenty.",
        f"Chances are shares of {found.draws:,} draws of the linearised model, {found.solved} of them solved to check: "
        f"{found.distribution}.",
    ]
