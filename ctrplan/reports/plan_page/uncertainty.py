"""The part of report.html about what is uncertain: worst cases and chances, causes ranked by bars, the intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ctrplan.reports.html_page import Markup, facts, section, table, tag
from ctrplan.reports.plan_words.numbers import digits, millimetres
from ctrplan.reports.plan_words.uncertainty_rows import stated_in_words, uncertainty_rows

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.uncertainty.contributors import Contributor
    from ctrplan.planning.uncertainty.result import ParameterInterval

BAR = 24  # blocks of the largest share


def uncertainty_section(plan: Plan) -> Markup:
    """Nothing where nothing is stated to be uncertain."""
    found = plan.uncertainty
    if found is None:
        return Markup()
    parts = [
        facts(list(uncertainty_rows(plan).items())),
        tag("h3", "Causes at the goal"),
        _causes(found.goal.contributors),
    ]
    if found.closest:
        parts += [tag("h3", "Causes where the robot comes nearest to the anatomy"), _causes(found.closest.contributors)]
    if found.parameters:
        parts += [tag("h3", "Intervals"), _intervals(found.parameters)]
    return section("What is uncertain", *parts, *(tag("p", text, kind="quiet") for text in stated_in_words(found)))


def _causes(contributors: Sequence[Contributor]) -> Markup:
    largest = max((abs(c.share_m) for c in contributors), default=0.0) or 1.0
    rows = (
        (c.name, millimetres(c.share_m), "█" * round(BAR * max(c.share_m, 0.0) / largest), millimetres(c.saved_m))
        for c in contributors
    )
    return table(("Cause", "Share of the worst case", "", "Measuring it would take off"), rows)


def _intervals(parameters: Sequence[ParameterInterval]) -> Markup:
    rows = (
        (p.name, p.title, f"{digits(p.value)} {p.unit}", f"{digits(p.low)} to {digits(p.high)} {p.unit}")
        for p in parameters
    )
    return table(("Parameter", "What it is", "Value", "95 % interval"), rows)
