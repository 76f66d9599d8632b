"""What other ways to the same goal would leave: what the plan gains over one that does not look at friction."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ctrplan.reports.glossary import term
from ctrplan.reports.html_page import Markup, table, tag
from ctrplan.reports.plan_words.numbers import digits, millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.planned_motion import ComparedWay

NAMES = {
    "as given": "as the search found it",
    "as driven": "this plan",
    "straight line": "all joints at once, as without a look at friction",
    "translations first": "translations before rotations",
}
LIMITATION = (
    "All end at the joint values of this plan, so that the worst case at the goal is the same. A planner that knows no "
    "friction might choose others; that is not compared."
)


def other_ways(plan: Plan) -> Markup:
    """Ways to the goal by their predicted error there, this plan first; nothing where none was compared."""
    ways = sorted(plan.reorder.alternatives, key=lambda way: way.name != "as driven")
    if not ways:
        return Markup()
    head = ("Same goal, driven", term("predicted friction error", "Predicted error there"))
    rows = ((_name(way), _left(way)) for way in ways)
    return tag("div", table(head, rows), tag("p", LIMITATION, kind="quiet small"), kind="ways")


def ways_table(plan: Plan) -> Markup:
    """The same with lengths and what stands against each."""
    rows = (
        (_name(way), _left(way), f"{digits(way.length_mm)} mm", way.problem or "valid")
        for way in plan.reorder.alternatives
    )
    return table(("Way to the goal", "Predicted friction error there", "Joint length", "Validity"), rows)


def _name(way: ComparedWay) -> Markup | str:
    name = NAMES.get(way.name, way.name)
    return tag("b", name) if way.name == "as driven" else name


def _left(way: ComparedWay) -> Markup | str:
    left = millimetres(way.goal_predicted_m) if math.isfinite(way.goal_predicted_m) else "no way"
    return tag("span", f"{left}, not valid", kind="bad") if way.problem else left
