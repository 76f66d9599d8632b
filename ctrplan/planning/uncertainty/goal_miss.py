"""How far from its goal the tip may end, with every friction state and everything uncertain: worst case and chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.planning.uncertainty.chance import SOLVED, Chance, Draws, chance
from ctrplan.planning.uncertainty.contributors import (
    FRICTION,
    OFF,
    PLAY,
    REGISTRATION,
    SECOND_ORDER,
    UNEXPLAINED,
    Contributor,
    ranked,
    sentence,
    shares,
)
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.tip_slopes import TipSlopes, friction_states, tip_slopes, tips_at
from ctrplan.uncertain.worst_case import BaseBall, OffsetBox, farthest

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


@dataclass(frozen=True)
class PredictedTip:
    """Where simulated histories leave the tip of the file's robot, and how far a start state may take it from there."""

    tip_m: Array  # (3,) robot frame
    spread_m: float


@dataclass(frozen=True, eq=False)
class GoalMiss:
    """Distances of the tip from the goal's; for a goal in joint values, from where the frictionless tip shall be."""

    worst_m: float  # every friction state, parameters anywhere in their box, base and unexplained error in 95 % balls
    contributors: tuple[Contributor, ...]  # largest first; their shares add up to `worst_m`
    friction_state: tuple[float, ...]  # phi of the worst case
    beyond_first_order_m: float  # by how much the solved worst case differs from the linear one; in `worst_m`
    tolerance_m: float | None
    chance_any_friction: Chance | None  # of missing the tolerance in the worst of all friction states
    chance_by_history: Chance | None  # and with friction as simulated from the plan's start
    quantile_any_friction_m: float  # 95 % of robots miss by less, in the worst friction state
    quantile_by_history_m: float | None
    sentence: str


def goal_miss(
    scenario: Scenario,
    parameters: UncertainParameters,
    joints: Array,
    play_m: float = 0.0,
    predicted: PredictedTip | None = None,
) -> GoalMiss:
    """At joints (m,), the plan's last ones."""
    theta, l = scenario.robot.drive.commanded(joints[None])  # noqa: E741 (as in the equations)
    slopes = tip_slopes(parameters, theta, l)
    goal = scenario.goal
    tolerance = None if goal.tip_m is None else goal.tolerance_m
    target = slopes.tip_m[0, 0]
    if goal.tip_m is not None:
        target = scenario.base_R.T @ (goal.tip_m - scenario.base_position_m)
    case = _GoalCase(scenario, parameters, theta, l, slopes, target)
    worst, contributors, state, beyond = case.worst(play_m)
    any_friction, by_history = case.misses(play_m, predicted)
    return GoalMiss(
        worst_m=worst,
        contributors=contributors,
        friction_state=state,
        beyond_first_order_m=beyond,
        tolerance_m=tolerance,
        chance_any_friction=_chance(any_friction, tolerance),
        chance_by_history=None if by_history is None else _chance(by_history, tolerance),
        quantile_any_friction_m=float(np.quantile(any_friction[0], 0.95)),
        quantile_by_history_m=None if by_history is None else float(np.quantile(by_history[0], 0.95)),
        sentence=sentence(worst, contributors),
    )


Misses = tuple[Array, Array]  # (M,) by the linearised model, (R,) of the first of them, solved


def _chance(misses: Misses, tolerance_m: float | None) -> Chance | None:
    if tolerance_m is None:
        return None
    return chance(~(misses[0] <= tolerance_m), ~(misses[1] <= tolerance_m))


@dataclass(frozen=True, eq=False)
class _GoalCase:
    """One configuration and the tip that it shall have."""

    scenario: Scenario
    parameters: UncertainParameters
    theta: Array  # (1, n)
    l: Array  # (1, n)  # noqa: E741 (as in the equations)
    slopes: TipSlopes  # of one configuration
    target: Array  # (3,) robot frame

    @property
    def base(self) -> BaseBall:
        registration = self.scenario.registration
        return BaseBall.of(registration.position_sigma_m, registration.rotation_sigma_rad)

    def worst(self, play_m: float) -> tuple[float, tuple[Contributor, ...], tuple[float, ...], float]:
        """The worst case [m], its contributors, its friction state, and the second order in it [m]."""
        unexplained, tip = self.scenario.robot.model_error_m, self.slopes.tip_m[0]
        box = OffsetBox.of(self.parameters)
        found = farthest(tip - self.target, box.displaced(self.slopes.by[0]), self.base, tip)
        state = int(np.argmax(found.length_m))
        u, offset = found.direction[state], box.middle + box.axes @ found.signs[state]
        beyond = self._beyond(state, offset)
        given = shares(self.parameters, u, self.slopes.by[0, state], offset, self.base, tip[state], unexplained)
        given[FRICTION] = given.get(FRICTION, 0.0) + float(u @ (tip[state] - tip[0]))
        given |= {OFF: float(u @ (tip[0] - self.target)), PLAY: play_m, SECOND_ORDER: beyond}
        total = float(found.length_m[state]) + unexplained + play_m + beyond
        saved = self._saved(float(found.length_m.max()))
        kept = {name: share for name, share in given.items() if share or name == FRICTION}
        phi = tuple(friction_states(self.scenario.robot)[state].tolist())
        return total, ranked(kept, saved | {UNEXPLAINED: unexplained}), phi, beyond

    def _beyond(self, state: int, offset: Array) -> float:
        if not self.parameters.count:
            return 0.0
        solved = tips_at(self.parameters, offset, self.theta, self.l)[0, state]
        linear = self.slopes.tip_m[0, state] + self.slopes.by[0, state] @ offset
        return float(np.nan_to_num(np.linalg.norm(solved - linear), nan=np.inf))

    def _saved(self, whole_m: float) -> dict[str, float]:
        """By how much the worst case shrinks where the parameters of one title, or the base, are known exactly."""
        titles, tip = np.array(self.parameters.title), self.slopes.tip_m[0]
        found = {}
        for title in dict.fromkeys(titles.tolist()):
            known = titles == title
            box = OffsetBox.of(self.parameters.measured(known))
            left = farthest(tip - self.target, box.displaced(self.slopes.by[0][:, :, ~known]), self.base, tip)
            found[title] = whole_m - float(left.length_m.max())
        if not self.scenario.registration.is_exact:
            left = farthest(tip - self.target, OffsetBox.of(self.parameters).displaced(self.slopes.by[0]))
            found[REGISTRATION] = whole_m - float(left.length_m.max())
        return found

    def misses(self, play_m: float, predicted: PredictedTip | None) -> tuple[Misses, Misses | None]:
        """Distances in the worst friction state, and with friction as simulated; drawn, and solved for the first."""
        robot = self.scenario.robot
        draws = Draws.of(self.parameters, self.scenario.registration, robot.model_error_m)
        tip, by = self.slopes.tip_m[0], self.slopes.by[0]
        moved = np.einsum("scp,mp->msc", by, draws.offset)
        rigid = np.stack([draws.rigid(point) for point in tip], axis=1)  # (M, S, 3)
        solved = np.stack(
            [tips_at(self.parameters, offset, self.theta, self.l)[0] - tip for offset in draws.offset[:SOLVED]]
        )
        off = tip - self.target

        def distances(displaced: Array) -> Array:
            found: Array = np.linalg.norm(off + displaced + rigid[: len(displaced)], axis=2).max(axis=1) + play_m
            return found

        any_friction = distances(moved), distances(solved)
        if predicted is None:
            return any_friction, None
        # histories move with the mean of the corners, whose derivative by friction nearly vanishes
        base = draws.rigid(predicted.tip_m)
        apart = predicted.tip_m - self.target

        def about(displaced: Array) -> Array:
            away = np.linalg.norm(apart + displaced.mean(axis=1) + base[: len(displaced)], axis=1)
            found: Array = away + predicted.spread_m + play_m
            return found

        return any_friction, (about(moved), about(solved))
