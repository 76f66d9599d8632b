"""The verdict on a plan, in one sentence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ctrplan.reports.plan_words.certificate_rows import certificate_rows
from ctrplan.reports.plan_words.numbers import millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan


def verdict(plan: Plan) -> str:
    """One sentence: certified or not, with the figures that matter most, or with the first problem."""
    certificate = plan.certificate
    if not certificate.valid:
        first = certificate.problems[0].rstrip(".") if certificate.problems else "a requirement is not met"
        first = first[:1].lower() + first[1:]
        others = len(certificate.problems) - 1
        return f"Not certified: {first}{f' (and {others} more)' if others > 0 else ''}."
    predicted = millimetres(certificate.goal_predicted_m)
    parts = [f"worst-case friction error at the goal {millimetres(certificate.goal_bound_m)}"]
    limit_m = plan.scenario.cost.max_error_goal_m
    if limit_m is not None:
        relation = "within" if certificate.goal_bound_m <= limit_m else "above"
        parts[0] += f" ({relation} the required {millimetres(limit_m)})"
    parts.append(f"{predicted} predicted by its history")
    parts.append(f"worst case at most {millimetres(certificate.worst_bound_m)} along the path")
    if math.isfinite(certificate.min_clearance_m):
        parts.append(f"smallest clearance {millimetres(certificate.min_clearance_m)} beyond the margins")
    opening = "Certified" if is_acceptable(plan) else "Certified, but short of a requirement"
    return f"{opening}: {', '.join(parts)}."


def is_acceptable(plan: Plan) -> bool:
    """Certified, and every requirement met."""
    return plan.certificate.valid and all(row.met is not False for row in certificate_rows(plan))
