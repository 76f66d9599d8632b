"""What a certificate says, in words: one sentence, and a table of requirements with their status."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import settling_duration_s

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan


@dataclass(frozen=True)
class Finding:
    """A quantity of the certificate, ready to be read."""

    quantity: str
    value: str
    requirement: str  # empty where there is none
    met: bool | None  # None where there is nothing to meet


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


def findings(plan: Plan) -> tuple[Finding, ...]:
    """The certificate line by line, what is required first."""
    return (*_errors(plan), *_margins(plan), *_figures(plan))


def is_acceptable(plan: Plan) -> bool:
    """Certified, and every requirement met."""
    return plan.certificate.valid and all(finding.met is not False for finding in findings(plan))


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
    return f"{value:.2g}"


def _errors(plan: Plan) -> list[Finding]:
    certificate, scenario = plan.certificate, plan.scenario
    rows = [
        _at_most(
            "Worst-case friction error at the goal, position",
            certificate.goal_bound_m,
            scenario.cost.max_error_goal_m,
        ),
        Finding("Worst-case friction error at the goal, direction", degrees(certificate.goal_bound_rad), "", None),
        Finding("Worst-case friction error along the path", millimetres(certificate.worst_bound_m), "", None),
    ]
    rows += [
        Finding("Predicted friction error at the goal", millimetres(certificate.goal_predicted_m), "", None),
        Finding("Predicted friction error along the path", millimetres(certificate.worst_predicted_m), "", None),
    ]
    compensation, tolerance = plan.compensation, scenario.goal.tolerance_m
    if scenario.goal.tip_m is not None and (compensation is None or compensation.note):
        rows.append(_at_most("Distance from the goal without friction", certificate.goal_tip_error_m, tolerance))
    if compensation:
        without = f"Predicted distance from the goal (without compensation {millimetres(compensation.error_without_m)})"
        rows.append(_at_most(without, compensation.error_with_m, tolerance))
    return rows + _settling(plan)


def _settling(plan: Plan) -> list[Finding]:
    settling = plan.certificate.settling
    if settling is None:
        return []
    first_turn = f"{degrees(settling.amplitude_rad)}, {digits(settling_duration_s(plan))} s"
    before, after = millimetres(settling.goal_predicted_before_m), millimetres(settling.goal_predicted_after_m)
    clearance = "free space" if math.isinf(settling.min_clearance_m) else millimetres(settling.min_clearance_m)
    return [
        Finding("Settling oscillation, first turn and duration", first_turn, "", None),
        Finding("Predicted friction error before and after settling", f"{before}, {after}", "", None),
        Finding("Smallest clearance while settling, beyond the margins", clearance, "", None),
    ]


def _margins(plan: Plan) -> list[Finding]:
    certificate, limits = plan.certificate, path_limits(plan.scenario)
    clearance_m, stable, strain = certificate.min_clearance_m, certificate.min_stability, certificate.max_strain
    clearance = Finding("Clearance to the anatomy", "free space", "", None)
    if not math.isinf(clearance_m):
        quantity = "Smallest clearance to the anatomy, beyond its margins"
        least = f"at least {limits.clearance_m * 1e3:g} mm{' (model error)' if limits.clearance_m else ''}"
        clearance = Finding(quantity, millimetres(clearance_m), least, bool(clearance_m >= limits.clearance_m))
    stability = Finding(
        "Smallest stability", digits(stable), f"at least {limits.stability:g}", bool(stable >= limits.stability)
    )
    most = f"at most {100 * limits.max_strain:g} %"
    return [
        clearance,
        stability,
        Finding("Largest strain", f"{digits(100 * strain)} %", most, bool(strain <= limits.max_strain)),
    ]


def _figures(plan: Plan) -> list[Finding]:
    certificate = plan.certificate
    figures = [
        ("Joint path length", f"{digits(certificate.length_mm)} mm"),
        ("Error summed over the path", f"{digits(certificate.error_integral_mm)} mm"),
        ("Largest motion of the body between samples", millimetres(certificate.spacing_m)),
        ("Cost", f"{digits(certificate.cost_mm)} mm"),
        ("Stops on the way", str(certificate.stops)),
        ("Duration", f"{digits(plan.trajectory.duration_s)} s"),
    ]
    return [Finding(quantity, value, "", None) for quantity, value in figures]


def _at_most(quantity: str, value_m: float, limit_m: float | None) -> Finding:
    if limit_m is None:
        return Finding(quantity, millimetres(value_m), "", None)
    return Finding(quantity, millimetres(value_m), f"at most {millimetres(limit_m)}", bool(value_m <= limit_m))
