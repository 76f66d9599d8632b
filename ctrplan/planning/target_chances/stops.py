"""The targets of a motion, and the samples of its path at which the tip is judged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.drive.legs import distance_from_polyline
from ctrplan.planning.play import play_turn
from ctrplan.planning.target_chances.aim import Stop

if TYPE_CHECKING:
    from ctrplan.planning.planned_motion import PlannedMotion
    from ctrplan.planning.scenario import Goal

ON_LINE = 8  # samples along a line, evenly; and the one where the frictionless tip is farthest from it


def plan_stops(plan: PlannedMotion) -> tuple[Stop, ...]:
    """Of a plan, in the order reached."""
    scenario, samples, reached = plan.scenario, plan.certificate.samples, plan.certificate.targets
    found: list[Stop] = []
    begin, first = 0, 0
    targets = scenario.targets[-len(reached) :]  # a certificate of one path knows of its end alone
    for goal, target in zip(targets, reached, strict=True):
        is_last = goal is scenario.goal
        end = len(samples.leg) - 1 if is_last else int(np.flatnonzero(samples.leg <= target.leg)[-1])
        rows = np.array([end]) if goal.line_m is None else _on_line(plan, goal, begin, end)
        turn = 0.0
        if goal.direction is not None:
            turn = play_turn(scenario.robot, *scenario.robot.drive.collars(samples.joints[end]))
        found.append(Stop(goal, rows, first + np.arange(len(rows)), target.play_m, turn))
        begin, first = end, first + len(rows)
    return tuple(found)


def _on_line(plan: PlannedMotion, goal: Goal, begin: int, end: int) -> NDArray[np.int_]:
    """Samples from one to another, both among them."""
    assert goal.line_m is not None
    scenario, tips = plan.scenario, plan.certificate.samples.tip_m[begin : end + 1]
    located = scenario.located(tips)
    farthest = begin + int(np.argmax(distance_from_polyline(located, goal.line_m)))
    evenly = np.linspace(begin, end, min(end - begin + 1, ON_LINE)).round().astype(int)
    return np.union1d(evenly, farthest)
