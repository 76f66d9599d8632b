"""The certificate line by line: quantities, what is required of them, and whether it is met."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import settling_duration_s
from ctrplan.reports.plan_words.numbers import degrees, digits, millimetres
from ctrplan.reports.plan_words.worst_miss import worst_misses

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan


@dataclass(frozen=True)
class CertificateRow:
    """A quantity of the certificate, ready to be read."""

    quantity: str
    value: str
    requirement: str  # empty where there is none
    met: bool | None  # None where there is nothing to meet
    caution: bool = False  # allowed, but to be known


def certificate_rows(plan: Plan) -> tuple[CertificateRow, ...]:
    """The certificate line by line, what is required first."""
    return (*_errors(plan), *_margins(plan), *_figures(plan))


def _errors(plan: Plan) -> list[CertificateRow]:
    certificate, scenario = plan.certificate, plan.scenario
    rows = [
        _at_most(
            "Worst-case friction error at the goal, position",
            certificate.goal_bound_m,
            scenario.cost.max_error_goal_m,
        ),
        _figure("Worst-case friction error at the goal, direction", degrees(certificate.goal_bound_rad)),
        _figure("Worst-case friction error along the path", millimetres(certificate.worst_bound_m)),
        _figure("Predicted friction error at the goal", millimetres(certificate.goal_predicted_m)),
        _figure("Predicted friction error along the path", millimetres(certificate.worst_predicted_m)),
    ]
    compensation, tolerance = plan.compensation, scenario.goal.tolerance_m
    if scenario.goal.tip_m is not None and (compensation is None or compensation.note):
        rows.append(_at_most("Distance from the goal without friction", certificate.goal_tip_error_m, tolerance))
    rows += [
        CertificateRow(
            f"Distance from {miss.target} at worst, with friction{' and play' if miss.play_m else ''}",
            millimetres(miss.total_m),
            f"tolerance {millimetres(miss.tolerance_m)}",
            None,
            miss.exceeds,
        )
        for miss in worst_misses(plan)
    ]
    if compensation:
        without = f"Predicted distance from the goal (without compensation {millimetres(compensation.error_without_m)})"
        rows.append(_at_most(without, compensation.error_with_m, tolerance))
    return rows + _settling(plan)


def _settling(plan: Plan) -> list[CertificateRow]:
    settling = plan.certificate.settling
    if settling is None:
        return []
    first_turn = f"{degrees(settling.amplitude_rad)}, {digits(settling_duration_s(plan))} s"
    before, after = millimetres(settling.goal_predicted_before_m), millimetres(settling.goal_predicted_after_m)
    clearance = "free space" if math.isinf(settling.min_clearance_m) else millimetres(settling.min_clearance_m)
    return [
        CertificateRow("Settling oscillation, first turn and duration", first_turn, "", None),
        CertificateRow("Predicted friction error before and after settling", f"{before}, {after}", "", None),
        CertificateRow("Smallest clearance while settling, beyond the margins", clearance, "", None),
    ]


def _margins(plan: Plan) -> list[CertificateRow]:
    certificate, limits = plan.certificate, path_limits(plan.scenario)
    clearance_m, stable, strain = certificate.min_clearance_m, certificate.min_stability, certificate.max_strain
    clearance = CertificateRow("Clearance to the anatomy", "free space", "", None)
    if not math.isinf(clearance_m):
        quantity = "Clearance to the anatomy in every friction state, beyond its margins"
        least = f"at least {limits.clearance_m * 1e3:g} mm{' (model error)' if limits.clearance_m else ''}"
        clearance = CertificateRow(quantity, millimetres(clearance_m), least, bool(clearance_m >= limits.clearance_m))
    stability = CertificateRow(
        "Smallest stability in every friction state",
        digits(stable),
        f"at least {limits.stability:g}",
        bool(stable >= limits.stability),
    )
    most = f"at most {100 * limits.max_strain:g} %"
    return [
        clearance,
        stability,
        CertificateRow(
            "Largest strain in every friction state",
            f"{digits(100 * strain)} %",
            most,
            bool(strain <= limits.max_strain),
        ),
    ]


def _figures(plan: Plan) -> list[CertificateRow]:
    certificate = plan.certificate
    figures = [
        ("Joint path length", f"{digits(certificate.length_mm)} mm"),
        ("Error summed over the path", f"{digits(certificate.error_integral_mm)} mm"),
        ("Largest motion of the body between samples", millimetres(certificate.spacing_m)),
        ("Cost", f"{digits(certificate.cost_mm)} mm"),
        ("Stops on the way", str(certificate.stops)),
        ("Duration", f"{digits(plan.trajectory.duration_s)} s"),
    ]
    return [CertificateRow(quantity, value, "", None) for quantity, value in figures]


def _figure(quantity: str, value: str) -> CertificateRow:
    """What nothing is required of."""
    return CertificateRow(quantity, value, "", None)


def _at_most(quantity: str, value_m: float, limit_m: float | None) -> CertificateRow:
    if limit_m is None:
        return CertificateRow(quantity, millimetres(value_m), "", None)
    return CertificateRow(quantity, millimetres(value_m), f"at most {millimetres(limit_m)}", bool(value_m <= limit_m))
