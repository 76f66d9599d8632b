"""The certificate of a plan in rows and sentences, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ctrplan.certificate.certificate import FIGURES
from ctrplan.motion.limits import path_limits
from ctrplan.plans.planned_motion import place_time_s, restarts, sample_time_s, settling_duration_s
from ctrplan.reports import looks
from ctrplan.reports.words import VALUES, degrees, digits, millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.certificate.arrival import Arrival
    from ctrplan.certificate.certificate import Closest, Figure
    from ctrplan.plans.plan import Plan
    from ctrplan.scenario.scenario import StartFriction


BEFORE = {
    "unknown": "from any friction state before it",
    "oscillated": "from the state that an oscillation leaves, as the scenario says",
    "observed": "from the friction states that an observer found",
    "released": "from a start without friction, as the scenario says",
}


@dataclass(frozen=True)
class TargetArrival:
    """How near the motion brings the tip to a target in space, everything stated counted."""

    target: str  # "the target", or which of several
    arrival: Arrival | None  # None where a history found no equilibrium
    tolerance_m: float
    direction_tolerance_rad: float | None
    bound_m: float  # how far friction may push the tip once the robot moves on from there
    start: StartFriction
    by_model: bool  # nothing is stated of what real contacts keep after slip
    corrected_from_m: float | None = None  # the arrival before the end of the motion was corrected

    @property
    def error_m(self) -> float:
        """Worst distance from the target; inf where nothing is known."""
        return self.arrival.error_m if self.arrival else math.inf

    @property
    def error_rad(self) -> float:
        """Worst angle from the target's direction; inf where nothing is known."""
        return self.arrival.error_rad if self.arrival else math.inf

    @property
    def is_turned(self) -> bool:
        """Whether the tip's direction may be off by more than its tolerance."""
        most = self.direction_tolerance_rad
        return most is not None and not (self.arrival is not None and self.arrival.error_rad <= most)

    @property
    def exceeds(self) -> bool:
        """Whether the target may be missed; also where the distance is not a number."""
        return not self.error_m <= self.tolerance_m or self.is_turned

    @property
    def beyond(self) -> float:
        """How far beyond the tolerances, as a share of them; inf where that is not a number."""
        shares = [self.error_m / self.tolerance_m]
        if self.arrival and self.direction_tolerance_rad:
            shares.append(self.arrival.error_rad / self.direction_tolerance_rad)
        return math.inf if any(map(math.isnan, shares)) else max(shares)

    @property
    def sentence(self) -> str:
        """The distance and what it holds for; where it is too large, by what."""
        distance, tolerance = millimetres(self.error_m), f"tolerance {millimetres(self.tolerance_m)}"
        before = BEFORE[self.start] + (" (by the model)" if self.by_model and self._forgets else "")
        if not self.error_m <= self.tolerance_m:
            return f"may end {distance} from {self.target} {before}, {tolerance}{self._causes}"
        if self.is_turned and self.arrival and self.direction_tolerance_rad:
            turned, most = degrees(self.arrival.error_rad), degrees(self.direction_tolerance_rad)
            return f"may be turned by {turned} at {self.target} {before}, tolerance {most}"
        return f"arrives within {distance} of {self.target} {before}, {tolerance}"

    @property
    def afterwards(self) -> str:
        """What friction may do once the robot moves on."""
        return f"moved on from there, friction can push it by up to {millimetres(self.bound_m)}"

    @property
    def _causes(self) -> str:
        causes = self.arrival.by_cause.main if self.arrival else []
        return f": {', '.join(f'{millimetres(share)} by {words}' for words, share in causes)}" if causes else ""

    @property
    def _forgets(self) -> bool:
        return self.arrival is not None and self.start == "unknown" and self.arrival.spread_m < self.tolerance_m


def target_arrivals(plan: Plan) -> tuple[TargetArrival, ...]:
    """Arrivals at every target in space, in the order reached, the goal last; none for goals in joint values."""
    certificate, scenario, results = plan.certificate, plan.scenario, []
    targets = scenario.targets[-len(certificate.targets) :]
    for number, (goal, at) in enumerate(zip(targets, certificate.targets, strict=True), start=1):
        if goal.tip_m is None:
            continue
        is_last = goal is scenario.goal
        name = "the target" if is_last else f"target {number}{f' ({goal.name})' if goal.name else ''}"
        corrected = plan.compensation if is_last and plan.compensation and plan.compensation.correction.any() else None
        results.append(
            TargetArrival(
                target=name,
                arrival=certificate.arrival if is_last else at.arrival,
                tolerance_m=goal.tolerance_m,
                direction_tolerance_rad=goal.direction_tolerance_rad,
                bound_m=certificate.goal_bound_m if is_last else at.bound_m,
                start=certificate.start_friction,
                by_model=not scenario.robot.friction_memory,
                corrected_from_m=corrected.error_without_m if corrected else None,
            )
        )
    return tuple(results)


def worst_arrival(plan: Plan) -> TargetArrival | None:
    """The one farthest beyond its tolerance, else that of the goal; None where there is none."""
    arrivals = target_arrivals(plan)
    beyond = [arrival for arrival in arrivals if arrival.exceeds]
    return max(beyond, key=lambda arrival: arrival.beyond) if beyond else arrivals[-1] if arrivals else None


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
    "unknown": "unknown, so that the certificate holds whatever friction was before",
    "oscillated": "let go of by an oscillation, as the scenario says; the certificate covers no other start",
    "observed": "as an observer found it, for predictions; the certificate holds whatever friction was before",
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
    """Arrivals at targets in space with their causes, where an interrupted run begins again, settling."""
    scenario, compensation, certificate = plan.scenario, plan.compensation, plan.certificate
    rows = []
    if scenario.goal.tip_m is not None and not (compensation and compensation.correction.any()):
        rows.append(_row(plan, "goal_tip_error_m"))
    for arrival in target_arrivals(plan):
        tolerance = f"tolerance {millimetres(arrival.tolerance_m)}"
        met = None if arrival.exceeds else True
        quantity = f"Farthest arrival from {arrival.target}"
        rows.append(CertificateRow(quantity, millimetres(arrival.error_m), tolerance, met, caution=arrival.exceeds))
    if certificate.arrival:
        rows += [CertificateRow(f"  by {words}", millimetres(m)) for words, m in certificate.arrival.by_cause.main]
        rows.append(CertificateRow("Friction before the motion is forgotten", _forgotten(certificate.arrival)))
        rows.append(CertificateRow("An interrupted run begins again", restart_words(plan)))
    return rows + _settling(plan)


def _forgotten(arrival: Arrival) -> str:
    """By which legs each pair of tubes forgets."""
    parts = []
    for pair, erased in enumerate(arrival.erased, start=1):
        tubes = f"tubes {pair} and {pair + 1}"
        if erased.leg is not None:
            moved = f"{degrees(erased.turned_rad)} and {millimetres(erased.slid_m)} between their bases"
            parts.append(f"{tubes} on leg {erased.leg + 1} after {moved}")
        elif erased.kept:
            parts.append(f"{tubes} keep {100 * erased.kept:.0f} %")
        else:
            parts.append(f"{tubes} know none")
    return "; ".join(parts) or "there is none"


def restart_words(plan: Plan) -> str:
    """From where, in words; for every target of a tour where these differ."""
    stated, found = "from a start in the friction state that the scenario states", restarts(plan.certificate)
    each = [stated if k is None else f"from the end of leg {k}" if k else "from the start" for k in found]
    if len(set(each)) == 1:
        return each[0]
    return ", ".join(f"{words} for target {k}" for k, words in enumerate(each, start=1))


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
    row, place = _row(plan, "min_clearance_m"), plan.certificate.narrowest
    if plan.scenario.robot.model_error_m:
        row = replace(row, requirement=f"{row.requirement} (model error)")
    taken = sorted(place.taken_m.items(), key=lambda pair: -pair[1]) if place else []
    shown = [(cause, millimetres(m)) for cause, m in taken if millimetres(m) != millimetres(0.0)]
    return [row, *(CertificateRow(f"  taken by {cause}", length) for cause, length in shown)]


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
        first, *others = certificate.problems or ("a requirement is not met",)
        more = f" (and {len(others)} more)" if others else ""
        return f"Not certified: {first[:1].lower()}{first[1:].rstrip('.')}{more}."
    parts = [*_at_the_goal(plan), f"worst case at most {millimetres(certificate.worst_bound_m)} along the path"]
    if math.isfinite(certificate.min_clearance_m):
        parts.append(f"smallest clearance {millimetres(certificate.min_clearance_m)} beyond the margins")
    return f"{OPENINGS[standing(plan)]}: {', '.join(parts)}."


def _at_the_goal(plan: Plan) -> Iterator[str]:
    """The arrival where the goal is a point, else the worst case there; and what is required of that."""
    bound_m, limit_m, arrival = plan.certificate.goal_bound_m, plan.scenario.cost.max_error_goal_m, worst_arrival(plan)
    if arrival:
        yield f"{arrival.sentence}; {arrival.afterwards}"
    if limit_m is not None:
        relation = "within" if bound_m <= limit_m else "above"
        required = f" ({relation} the required {millimetres(limit_m)})"
        yield f"worst-case friction error at the goal {millimetres(bound_m)}{required}"
    elif not arrival:
        yield f"worst-case friction error at the goal {millimetres(bound_m)}"


def standing(plan: Plan) -> Standing:
    """What a plan's colour says: red where something required is not met, amber where a target may be missed."""
    if not is_acceptable(plan):
        return "bad"
    return "good" if plan.arrives else "caution"


def is_acceptable(plan: Plan) -> bool:
    """Certified, and every requirement met."""
    return plan.certificate.valid and all(row.met is not False for row in certificate_rows(plan))


def certificate_in_words(plan: Plan) -> list[str]:
    """Paragraphs that say what the certificate's figures say."""
    times = sample_time_s(plan)
    texts = [_checked(plan), _error_sentences(plan, times), _play(plan), _reached(plan), _room(plan, times)]
    return [text for text in (*texts, _elastic(plan, times), _insertion(plan)) if text]


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
        f"{millimetres(certificate.goal_play_m)} at the goal; clearances hold anywhere within it."
    )


def _reached(plan: Plan) -> str:
    """What the motion leaves at each target in space."""
    sentences = []
    for arrival in target_arrivals(plan):
        corrected = arrival.corrected_from_m
        before = f", {millimetres(corrected)} before its end was corrected" if corrected is not None else ""
        name = arrival.target[:1].upper() + arrival.target[1:]
        sentences.append(f"{name}: driven as written the tip {arrival.sentence}{before}; {arrival.afterwards}.")
    for target in plan.certificate.targets:
        if target.line_error_m is not None:
            strays = millimetres(target.line_error_m)
            sentences.append(f"On its line the tip without friction strays by at most {strays}.")
    return " ".join(sentences)


def _room(plan: Plan, times: Array) -> str:
    certificate = plan.certificate
    if math.isinf(certificate.min_clearance_m):
        return "There is no anatomy to keep clear of."
    narrowest, least = certificate.narrowest, times[int(np.argmin(certificate.samples.clearance_m))]
    when = digits(least if narrowest is None else place_time_s(plan, narrowest))
    if certificate.min_clearance_m < path_limits(plan.scenario).clearance_m:
        short = millimetres(-certificate.min_clearance_m)
        return f"The margins to the anatomy are not kept: {short} short at {when} s."
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
