"""The certificate of a plan in rows and sentences, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ctrplan.certificate.certificate import FIGURES
from ctrplan.motion.checker import path_limits
from ctrplan.plans.planned_motion import place_time_s, sample_time_s, settling_duration_s
from ctrplan.reports import looks
from ctrplan.reports.words import VALUES, degrees, digits, millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.certificate.certificate import Closest, Figure, TargetReached
    from ctrplan.plans.plan import Plan
    from ctrplan.scenario.scenario import Goal


@dataclass(frozen=True)
class WorstMiss:
    """How far the tip may end from a target in space at worst."""

    target: str  # "the target", or which of several
    without_friction_m: float
    friction_m: float  # the worst-case friction error
    play_m: float
    tolerance_m: float  # that the scenario asks of the tip without friction
    parameters_m: float = 0.0  # what parameters within their stated intervals add

    @property
    def total_m(self) -> float:
        """The robot model's own error is not in it, nor how well the base is registered."""
        return self.without_friction_m + self.friction_m + self.parameters_m + self.play_m

    @property
    def exceeds(self) -> bool:
        """Whether the tip may end farther away than the tolerance; also where the distance is not a number."""
        return not self.total_m <= self.tolerance_m

    @property
    def beyond_m(self) -> float:
        """How far beyond the tolerance, inf where the distance is not a number."""
        return math.inf if math.isnan(self.total_m) else self.total_m - self.tolerance_m

    @property
    def sentence(self) -> str:
        """Total beside tolerance, and what it is made of."""
        relation = "above" if self.exceeds else "within"
        parts = [f"{millimetres(self.without_friction_m)} without friction", f"{millimetres(self.friction_m)} by it"]
        parts += [f"{millimetres(self.parameters_m)} by uncertain parameters"] if self.parameters_m else []
        parts += [f"{millimetres(self.play_m)} by play"] if self.play_m else []
        return (
            f"at worst the tip ends {millimetres(self.total_m)} from {self.target}, {relation} the tolerance of "
            f"{millimetres(self.tolerance_m)} ({', '.join(parts)})"
        )


def worst_misses(plan: Plan) -> tuple[WorstMiss, ...]:
    """Worst misses of every target in space, in the order reached, the goal last; none for a goal in joint values."""
    certificate, scenario, result = plan.certificate, plan.scenario, []
    for number, (goal, at) in enumerate(zip(scenario.via, certificate.targets, strict=False), start=1):
        if goal.tip_m is not None:
            name = f"target {number}{f' ({goal.name})' if goal.name else ''}"
            result.append(_miss(plan, name, goal, at))
    if scenario.goal.tip_m is not None:
        off, friction, play = certificate.goal_tip_error_m, certificate.goal_bound_m, certificate.goal_play_m
        parameters = float(certificate.samples.parameter_bound_m[-1])
        tolerance = scenario.goal.tolerance_m
        result.append(WorstMiss("the target", off, friction - parameters, play, tolerance, parameters))
    return tuple(result)


def _miss(plan: Plan, name: str, goal: Goal, at: TargetReached) -> WorstMiss:
    samples = plan.certificate.samples
    parameters = float(samples.parameter_bound_m[samples.leg <= at.leg][-1])
    return WorstMiss(name, at.tip_error_m, at.bound_m - parameters, at.play_m, goal.tolerance_m, parameters)


def worst_miss(plan: Plan) -> WorstMiss | None:
    """The one farthest beyond its tolerance, else that of the goal; None where there is none."""
    misses = worst_misses(plan)
    beyond = [miss for miss in misses if miss.exceeds]
    return max(beyond, key=lambda miss: miss.beyond_m) if beyond else misses[-1] if misses else None


Kind = Literal["nominal", "closest", "narrowest"]  # as the certificate calls them
LABELS: dict[Kind, str] = {
    "nominal": "clearance without friction",
    "closest": "clearance, worst friction",
    "narrowest": "clearance, certified",
}
ENDINGS: dict[Kind, str] = {
    "nominal": " beyond the margins",
    "closest": "",
    "narrowest": ", all allowances taken off",
}
START_FRICTION = {
    "unknown": "unknown, so that the certificate holds whatever the robot did before",
    "oscillated": "let go of by an oscillation, as the scenario says; the certificate covers no other start",
    "observed": "as an observer found it, for predictions; the certificate holds whatever the robot did before",
    "released": "none, as the scenario says; the certificate covers no other start",
}


@dataclass(frozen=True)
class ClearanceRow:
    """A clearance beyond the margins, and where it is left."""

    kind: Kind
    clearance_m: float  # of "narrowest" less all allowances, else that of the place
    place: Closest
    time_s: float

    @property
    def where(self) -> str:
        """Tube, part and point: "tube 3 to anatomy.1 (tube) at [1.2, 3.4, 5.6] mm"."""
        return f"tube {self.place.tube} to {self.place.part} at {point_words(self.place.point_m)}"

    @property
    def when(self) -> str:
        """Leg and time."""
        return f"leg {self.place.leg + 1}, {self.time_s:.1f} s"

    @property
    def friction(self) -> str:
        """The friction state: shares of the Coulomb limit, from the outermost pair of tubes on."""
        phi = self.place.phi
        return f"({', '.join(f'{share:+.2g}' for share in phi)})" if phi.any() else "none"

    @property
    def sentence(self) -> str:
        """All of it, without a full stop."""
        state = "" if self.kind == "nominal" else f", friction {self.friction}"
        return f"{millimetres(self.clearance_m)}{ENDINGS[self.kind]}: {self.where}, {self.when}{state}"


def clearance_rows(plan: Plan) -> tuple[ClearanceRow, ...]:
    """From the widest to the narrowest; none in free space."""
    certificate, rows = plan.certificate, []
    for kind in LABELS:
        place: Closest | None = getattr(certificate, kind)
        if place is not None:
            left_m = certificate.min_clearance_m if kind == "narrowest" else place.clearance_m
            rows.append(ClearanceRow(kind, left_m, place, plan.time_of(place)))
    return tuple(rows)


def point_words(point_m: Array) -> str:
    """A point (3,) in the anatomy's frame, in mm."""
    return f"[{', '.join(f'{x:.1f}' for x in point_m * 1e3)}] mm"


@dataclass(frozen=True)
class CertificateRow:
    """A quantity of the certificate, ready to be read."""

    quantity: str
    value: str
    requirement: str = ""  # empty where there is none
    met: bool | None = None  # None where there is nothing to meet
    caution: bool = False  # allowed, but to be known


def certificate_rows(plan: Plan) -> tuple[CertificateRow, ...]:
    """The certificate line by line, in the order of its figures."""
    others = {"goal_tip_error_m": _at_targets, "min_clearance_m": _clearance}
    names = [name for name, figure in FIGURES.items() if figure.title]
    rows = [row for name in names for row in (others[name](plan) if name in others else [_row(plan, name)])]
    return (*rows, CertificateRow("Duration", f"{digits(plan.trajectory.duration_s)} s"))


def _row(plan: Plan, name: str) -> CertificateRow:
    """A figure, and what the scenario requires of it."""
    figure, value = FIGURES[name], getattr(plan.certificate, name)
    text = VALUES[figure.unit](value)
    limit = figure.limit(plan.scenario) if figure.limit else None
    if limit is None:
        return CertificateRow(figure.title, text)
    required = f"at {'least' if figure.is_minimum else 'most'} {_limit_words(figure, limit)}"
    return CertificateRow(figure.title, text, required, figure.meets(value, limit))


def _limit_words(figure: Figure, limit: float) -> str:
    """A limit with the digits that the file has, largest lengths as they are shown."""
    if figure.unit == "m" and figure.is_minimum:
        return f"{limit * 1e3:g} mm"
    plain = {"number": f"{limit:g}", "share": f"{100 * limit:g} %"}
    return plain.get(figure.unit) or VALUES[figure.unit](limit)


def _at_targets(plan: Plan) -> list[CertificateRow]:
    """Distances from targets in space without friction and at worst, with compensation and settling."""
    scenario, compensation = plan.scenario, plan.compensation
    rows = []
    if scenario.goal.tip_m is not None and (compensation is None or compensation.note):
        rows.append(_row(plan, "goal_tip_error_m"))
    rows += [
        CertificateRow(
            f"Distance from {miss.target} at worst, with friction{' and play' if miss.play_m else ''}",
            millimetres(miss.total_m),
            f"tolerance {millimetres(miss.tolerance_m)}",
            caution=miss.exceeds,
        )
        for miss in worst_misses(plan)
    ]
    if compensation:
        without = f"Predicted distance from the goal (without compensation {millimetres(compensation.error_without_m)})"
        left_m, most_m = compensation.error_with_m, scenario.goal.tolerance_m
        rows.append(
            CertificateRow(without, millimetres(left_m), f"at most {millimetres(most_m)}", bool(left_m <= most_m))
        )
    return rows + _settling(plan)


def _settling(plan: Plan) -> list[CertificateRow]:
    settling = plan.certificate.settling
    if settling is None:
        return []
    first_turn = f"{degrees(settling.amplitude_rad)}, {digits(settling_duration_s(plan))} s"
    before, after = millimetres(settling.goal_predicted_before_m), millimetres(settling.goal_predicted_after_m)
    clearance = "free space" if math.isinf(settling.min_clearance_m) else millimetres(settling.min_clearance_m)
    return [
        CertificateRow("Settling oscillation, first turn and duration", first_turn),
        CertificateRow("Predicted friction error before and after settling", f"{before}, {after}"),
        CertificateRow("Smallest clearance while settling, beyond the margins", clearance),
    ]


def _clearance(plan: Plan) -> list[CertificateRow]:
    if math.isinf(plan.certificate.min_clearance_m):
        return [CertificateRow("Clearance to the anatomy", "free space")]
    row = _row(plan, "min_clearance_m")
    return [replace(row, requirement=f"{row.requirement} (model error)") if plan.scenario.robot.model_error_m else row]


Standing = Literal["good", "caution", "bad"]
OPENINGS: dict[Standing, str] = {
    "good": "Certified",
    "caution": "Certified, but the target may be missed",
    "bad": "Certified, but short of a requirement",
}
COLOURS: dict[Standing, str] = {"good": looks.MET, "caution": looks.CAUTION, "bad": looks.LIMIT}


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


def certificate_in_words(plan: Plan) -> list[str]:
    """Paragraphs that say what the certificate's figures say."""
    times = sample_time_s(plan)
    texts = [
        _checked(plan),
        _error_sentences(plan, times),
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


def _error_sentences(plan: Plan, times: Array) -> str:
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
    "What the figures do not cover: the model is quasi-static (slow motion, no vibration), friction follows "
    "Coulomb's law with the coefficients of the robot file, and nothing touches the robot from outside, neither "
    "anatomy nor tools. They hold for the model as calibrated; what calibration could not explain is in the robot "
    "file's model error and nowhere else. That no history of motion takes the tip beyond the corner shapes is "
    "supported by trials, not proved; for bodies, friction that differs along a contact has an allowance that was "
    "measured.",
)
