"""Whether there is room where a case wants to be, and where the nearest room is."""

from __future__ import annotations

import numpy as np

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.anatomy.patient_frame import TURNED
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.errors import InputError
from ctrplan.planning.goals.clearances import blocked
from ctrplan.planning.scenario import Scenario

DIRECTIONS, SHELLS = 400, 60
FARTHEST_M = 30e-3  # at which room is looked for
SLACK_M = 1e-4
LEAST_WAY_M = 2e-3  # between an entry and a target


def refuse_targets_without_room(scenario: Scenario) -> None:
    """Raises InputError for a target in tissue or too near to it, with how far, and the nearest place with room."""
    needed = scenario.robot.tubes[-1].outer_diameter_m / 2 + scenario.robot.model_error_m
    for goal in scenario.targets:
        if goal.tip_m is not None and (why := blocked(scenario, goal.tip_m, needed, goal.tolerance_m)):
            raise _refusal(scenario, f"target {_shown(goal.tip_m)}", goal.tip_m, needed, why)


def refuse_entry_without_room(scenario: Scenario, entry_m: Array, radius_m: float) -> None:
    """Raises InputError for a plate's place (3,) that lies at a target, or where tubes have no room within a radius.

    Base poses are looked for within that radius, so the entry itself need not have room.
    """
    away = min(float(np.linalg.norm(goal.tip_m - entry_m)) for goal in scenario.targets if goal.tip_m is not None)
    if away < LEAST_WAY_M:
        rule = f"is {away * MM_PER_M:.3g} mm from a target: are its numbers in metres, not in millimetres?"
        raise InputError(rule, key=f"entry {_shown(entry_m)}")
    needed = scenario.robot.tubes[0].outer_diameter_m / 2
    if why := blocked(scenario, entry_m, needed, 0.0):
        near = nearest_room(scenario, entry_m, needed)
        if near is not None and np.linalg.norm(near - entry_m) <= radius_m:
            return
        raise _refusal(scenario, f"entry {_shown(entry_m)}", entry_m, needed, why)


def _refusal(scenario: Scenario, place: str, point_m: Array, needed_m: float, why: str) -> InputError:
    near = nearest_room(scenario, point_m, needed_m)
    if near is not None:
        apart = np.linalg.norm(near - point_m) * MM_PER_M
        return InputError(f"{why}; the nearest place with room is {_shown(near)}, {apart:.3g} mm away", key=place)
    others = {
        "with x and y turned round there is room: is it in the other frame": TURNED * point_m,
        "taken for metres there is room: are its numbers in metres": point_m * MM_PER_M,
    }
    for hint, other in others.items():
        if nearest_room(scenario, other, needed_m) is not None:
            return InputError(f"{why}; {hint}?", key=place)
    return InputError(f"{why}; within {FARTHEST_M * MM_PER_M:g} mm there is no room either", key=place)


def nearest_room(scenario: Scenario, point_m: Array, needed_m: float) -> Array | None:
    """(3,) [m] near a point (3,) where a ball of that radius keeps all margins; None where there is none near."""
    k = np.arange(DIRECTIONS) + 0.5
    height, turn = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - height**2)
    directions = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    away = np.linspace(0, FARTHEST_M, SHELLS)
    tried = (point_m + away[:, None, None] * directions).reshape(-1, 3)
    fits = exact_clearance(scenario.anatomy, tried) >= needed_m + SLACK_M
    if not fits.any():
        return None
    return np.asarray(np.round(tried[int(np.argmax(fits))] * MM_PER_M, 1) / MM_PER_M)


def _shown(point_m: Array) -> str:
    return "[" + ", ".join(f"{x + 0.0:g}" for x in np.round(point_m * MM_PER_M, 3)) + "] mm"
