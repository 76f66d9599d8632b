"""The verdict on a plan, in one sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from ctrplan.reports import palette
from ctrplan.reports.plan_words.certificate_rows import certificate_rows
from ctrplan.reports.plan_words.numbers import millimetres
from ctrplan.reports.plan_words.worst_miss import worst_miss, worst_misses

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan


Standing = Literal["good", "caution", "bad"]
OPENINGS: dict[Standing, str] = {
    "good": "Certified",
    "caution": "Certified, but the target may be missed",
    "bad": "Certified, but short of a requirement",
}
COLOURS: dict[Standing, str] = {"good": palette.MET, "caution": palette.CAUTION, "bad": palette.LIMIT}


def verdict(plan: Plan) -> str:
    """One sentence: certified or not, with the figures that matter most, or with the first problem."""
    certificate = plan.certificate
    if not certificate.valid:
        first = certificate.problems[0].rstrip(".") if certificate.problems else "a requirement is not met"
        first = first[:1].lower() + first[1:]
        others = len(certificate.problems) - 1
        return f"Not certified: {first}{f' (and {others} more)' if others > 0 else ''}."
    parts = [*_at_the_goal(plan), f"{millimetres(certificate.goal_predicted_m)} predicted by its history"]
    parts.append(f"worst case at most {millimetres(certificate.worst_bound_m)} along the path")
    if math.isfinite(certificate.min_clearance_m):
        parts.append(f"smallest clearance {millimetres(certificate.min_clearance_m)} beyond the margins")
    return f"{OPENINGS[standing(plan)]}: {', '.join(parts)}."


def _at_the_goal(plan: Plan) -> Iterator[str]:
    """The worst case there, of which the friction error is a part where the goal is a point."""
    bound_m, limit_m, miss = plan.certificate.goal_bound_m, plan.scenario.cost.max_error_goal_m, worst_miss(plan)
    if miss:
        yield miss.sentence
    if limit_m is not None:
        relation = "within" if bound_m <= limit_m else "above"
        required = f" ({relation} the required {millimetres(limit_m)})"
        yield f"worst-case friction error at the goal {millimetres(bound_m)}{required}"
    elif not miss:
        yield f"worst-case friction error at the goal {millimetres(bound_m)}"


def standing(plan: Plan) -> Standing:
    """What a plan's colour says: red where something required is not met, amber where a target may be missed."""
    if not is_acceptable(plan):
        return "bad"
    return "caution" if any(miss.exceeds for miss in worst_misses(plan)) else "good"


def is_acceptable(plan: Plan) -> bool:
    """Certified, and every requirement met."""
    return plan.certificate.valid and all(row.met is not False for row in certificate_rows(plan))
