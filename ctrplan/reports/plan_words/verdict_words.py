"""The certificate in words: what was checked, what was found, and what it means at the target."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import place_time_s, sample_time_s
from ctrplan.reports.plan_words.numbers import degrees, digits, millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.planning.plan import Plan


def certificate_in_words(plan: Plan) -> list[str]:
    """Paragraphs that say what the certificate's figures say."""
    times = sample_time_s(plan)
    texts = [
        _checked(plan),
        _errors(plan, times),
        _play(plan),
        _reached(plan),
        _room(plan, times),
        _elastic(plan, times),
    ]
    return [text for text in (*texts, _insertion(plan)) if text]


def _checked(plan: Plan) -> str:
    certificate, corners = plan.certificate, 2 ** (plan.scenario.robot.n - 1)
    return (
        f"The finished motion was driven again through the full model at {len(certificate.samples.leg)} places, so "
        f"close together that no point of the robot moves more than {millimetres(certificate.spacing_m)} from one to "
        "the next. At each of them the robot was solved without friction and with friction at its limit in all "
        f"{corners} combinations of directions. Of the friction states between these as many were solved as it took to "
        "know their clearance, stability and strain."
    )


def _errors(plan: Plan, times: Array) -> str:
    certificate, bound = plan.certificate, plan.certificate.samples.bound_m
    when = times[int(np.nanargmax(bound))] if np.isfinite(bound).any() else 0.0
    return (
        f"In none of these states is the tip farther than {millimetres(certificate.worst_bound_m)} from where it would "
        f"be without friction; the worst comes {digits(when)} s after the start. At the goal it is at most "
        f"{millimetres(certificate.goal_bound_m)}, and the direction is off by at most "
        f"{degrees(certificate.goal_bound_rad)}."
    )


def _play(plan: Plan) -> str:
    certificate = plan.certificate
    if not certificate.worst_play_m:
        return ""
    return (
        f"Play of the drive may move the robot by up to {millimetres(certificate.worst_play_m)} on the way and "
        f"{millimetres(certificate.goal_play_m)} at the goal; this is taken off every clearance."
    )


def _reached(plan: Plan) -> str:
    """What adds up at each target in space."""
    sentences = []
    for number, (goal, target) in enumerate(
        zip(plan.scenario.targets, plan.certificate.targets, strict=False), start=1
    ):
        if goal.tip_m is None:
            continue
        name = f"Target {number}{f' ({goal.name})' if goal.name else ''}" if plan.scenario.via else "The target"
        total, model = target.tip_error_m + target.bound_m + target.play_m, plan.scenario.robot.model_error_m
        causes = "it and the drive's play" if target.play_m else "it"
        extra = f", the model's own error of {millimetres(model)} not counted" if model else ""
        sentence = (
            f"{name} is missed by {millimetres(target.tip_error_m)} without friction and by at most "
            f"{millimetres(total)} with {causes}{extra}."
        )
        if target.line_error_m is not None:
            sentence += f" On its line the tip without friction strays by at most {millimetres(target.line_error_m)}."
        sentences.append(sentence)
    return " ".join(sentences)


def _room(plan: Plan, times: Array) -> str:
    certificate = plan.certificate
    if math.isinf(certificate.min_clearance_m):
        return "There is no anatomy to keep clear of."
    narrowest, least = certificate.narrowest, times[int(np.argmin(certificate.samples.clearance_m))]
    when = digits(least if narrowest is None else place_time_s(plan, narrowest))
    if certificate.min_clearance_m < path_limits(plan.scenario).clearance_m:
        return (
            f"The margins to the anatomy are not kept: {millimetres(-certificate.min_clearance_m)} short at {when} s."
        )
    return (
        "In every friction state the robot keeps its margins to the anatomy, measured to its surface and not on a "
        f"grid, and {millimetres(certificate.min_clearance_m)} more; the narrowest place comes at {when} s. Half the "
        f"motion between places and allowances for all that was not solved are already taken off.{_solved(plan)}"
    )


def _solved(plan: Plan) -> str:
    closest, nominal = plan.certificate.closest, plan.certificate.nominal
    if closest is None or nominal is None:
        return ""
    return (
        f" As solved it comes within {millimetres(closest.clearance_m)} of the margins in the worst friction state, "
        f"and within {millimetres(nominal.clearance_m)} without friction."
    )


def _elastic(plan: Plan, times: Array) -> str:
    samples, certificate = plan.certificate.samples, plan.certificate
    when = digits(times[int(np.nanargmin(samples.stability))]) if np.isfinite(samples.stability).any() else "?"
    return (
        f"In whatever friction state, the robot is nearest to snapping at {when} s, with a stability of "
        f"{digits(certificate.min_stability)} (0 is the limit, {plan.scenario.margins.stability:g} the margin), "
        f"and its tubes are strained by at most {digits(100 * certificate.max_strain)} %."
    )


def _insertion(plan: Plan) -> str:
    off = plan.follow_the_leader_m
    if off is None:
        return ""
    return f"While it inserts itself, the body without friction stays within {millimetres(off)} of the tip's track."
