"""The part of report.html about what is uncertain: worst cases and chances, causes ranked by bars, the intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ctrplan.reports.html_page import Markup, facts, section, table, tag
from ctrplan.reports.plan_words.numbers import degrees, digits, millimetres
from ctrplan.reports.plan_words.uncertainty_rows import stated_in_words, uncertainty_rows

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.uncertainty.contributors import Contributor, TurnContributor
    from ctrplan.planning.uncertainty.goal_miss import GoalMiss
    from ctrplan.planning.uncertainty.result import ParameterInterval

BAR = 24  # blocks of the largest share


def uncertainty_section(plan: Plan) -> Markup:
    """Nothing where nothing is stated to be uncertain."""
    found = plan.uncertainty
    if found is None:
        return Markup()
    parts = [
        facts(list(uncertainty_rows(plan).items())),
        *(part for k, miss in enumerate(found.via, start=1) for part in _target(miss, _named(miss, k))),
        *_target(found.goal, "the goal"),
    ]
    if found.closest:
        parts += [tag("h3", "Causes where the robot comes nearest to the anatomy"), _causes(found.closest.contributors)]
    if found.parameters:
        parts += [tag("h3", "Intervals"), _intervals(found.parameters)]
    return section("What is uncertain", *parts, *(tag("p", text, kind="quiet") for text in stated_in_words(found)))


def _named(miss: GoalMiss, number: int) -> str:
    return f"target {number} ({miss.name})" if miss.name else f"target {number}"


def _target(miss: GoalMiss, name: str) -> list[Markup]:
    parts = [tag("h3", f"Causes at {name}"), _causes(miss.contributors)]
    if miss.turn:
        parts += [tag("h3", f"Causes of the turn at {name}"), _turns(miss.turn.contributors)]
    return parts


def _causes(contributors: Sequence[Contributor]) -> Markup:
    return _bars([(c.name, c.share_m, c.saved_m) for c in contributors], millimetres)


def _turns(contributors: Sequence[TurnContributor]) -> Markup:
    return _bars([(c.name, c.share_rad, c.saved_rad) for c in contributors], degrees)


def _bars(causes: Sequence[tuple[str, float, float]], said: Callable[[float], str]) -> Markup:
    largest = max((abs(share) for _, share, _ in causes), default=0.0) or 1.0
    rows = (
        (name, said(share), "█" * round(BAR * max(share, 0.0) / largest), said(saved)) for name, share, saved in causes
    )
    return table(("Cause", "Share of the worst case", "", "Measuring it would take off"), rows)


def _intervals(parameters: Sequence[ParameterInterval]) -> Markup:
    rows = (
        (p.name, p.title, f"{digits(p.value)} {p.unit}", f"{digits(p.low)} to {digits(p.high)} {p.unit}")
        for p in parameters
    )
    return table(("Parameter", "What it is", "Value", "95 % interval"), rows)
