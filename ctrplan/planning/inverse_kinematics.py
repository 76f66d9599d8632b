"""`ctrplan.inverse_kinematics`: every way found to bring the tip to a point, and which of them may be used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import SEED, Number, Whole, checked, require
from ctrplan.base.arrays import LONGEST_MM, numbers
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.motion.checker import MotionChecker, path_limits
from ctrplan.planning.reach import Configuration, Reach, reach
from ctrplan.robot.magnitudes import UNITS_M
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.sizes import place_doubt
from ctrplan.scenario.tip_solver import TipTarget

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array

TOLERANCE_M = 1e-4
DIRECTION_TOLERANCE_RAD = math.radians(5.0)
MOST_STARTS = 100_000
STARTS = 400
FARTHEST_M = LONGEST_MM * 1e-3


@shown
@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """Ways to a point; positions in the robot's frame, as those of `Configuration` are."""

    scenario: Scenario  # of a robot alone, in free space
    found: Reach

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All that reach the point within the tolerances, lowest bound first; `reason` says why one is not valid."""
        return self.found.configurations

    @property
    def valid(self) -> tuple[Configuration, ...]:
        """Those that keep all limits and margins."""
        return tuple(c for c in self.configurations if c.valid)

    @property
    def nearest(self) -> Configuration:
        """The frictionless tip that came closest, whatever else it does."""
        return self.found.nearest

    @cached_property
    def branches(self) -> tuple[int, ...]:
        """Number of each configuration's branch, from 0: those of one branch lead to each other at the point."""
        return tuple(self.found.branches().tolist())

    @property
    def sentence(self) -> str:
        """What was found."""
        count, valid = len(self.configurations), len(self.valid)
        if not count:
            return self._unreached
        ways = "1 configuration reaches" if count == 1 else f"{count} configurations reach"
        if valid:
            return f"{ways} the point, {valid} of them within all limits and margins."
        return f"{ways} the point, none within all limits and margins: {self.configurations[0].reason}."

    @property
    def _unreached(self) -> str:
        nearest = self.nearest
        if nearest.tip_error_m <= self.found.tolerance_m:
            turned = math.degrees(nearest.turned_rad)
            allowed = math.degrees(self.found.direction_tolerance_rad)
            return (
                f"The point is reached, but at best {turned:.1f} deg from the direction, {allowed:g} deg are allowed."
            )
        return f"The point is out of reach, the nearest tip found is {nearest.tip_error_m * 1e3:.3g} mm away."


@checked(
    tolerance_m=Number(1e-6, 1.0, "m"),
    direction_tolerance_rad=Number(0, math.pi, "rad", above=True),
    starts=Whole(1, MOST_STARTS),
    seed=SEED,
)
def inverse_kinematics(
    robot_or_scenario: Robot | Scenario,
    tip_m: ArrayLike,
    direction: ArrayLike | None = None,
    *,
    tolerance_m: float = TOLERANCE_M,
    direction_tolerance_rad: float | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> InverseKinematics:
    """Distinct configurations whose frictionless tip is within `tolerance_m` of a point (3,) [m].

    A scenario's point, and a direction (3,) of the tip of any length, are in the anatomy's frame; a robot's in its own.
    The direction may be off by `direction_tolerance_rad`, by default 5 deg. `starts` random configurations, drawn by
    `seed`, are where solves begin. Nothing found is no error: see `InverseKinematics.sentence`. Raises InputError.
    """
    scenario = _scenario(robot_or_scenario)
    refuse_wrong_unit(scenario, tip_m, "m", "tip_m")
    target = _target(scenario, tip_m, direction, direction_tolerance_rad)
    checker = MotionChecker(scenario)
    checker.limits = path_limits(scenario)  # the scenario's own, without what a search adds, as in the live view
    return InverseKinematics(
        scenario, reach(checker, target, float(tolerance_m), np.random.default_rng(seed), int(starts))
    )


def refuse_wrong_unit(scenario: Scenario, tip: ArrayLike, unit: Literal["m", "mm"], key: str) -> None:
    """Raises InputError for a point (3,) whose numbers make sense in another unit than `unit`, and not in this one."""
    point = numbers(tip, key)
    if point.shape != (3,) or not np.isfinite(point).all():
        return  # which is refused for that
    doubt = place_doubt(scenario.robot, point * UNITS_M[unit], scenario.base_position_m, unit, scenario.anatomy)
    if doubt is not None and doubt.is_sure:
        raise InputError(doubt.rule, key=key, value=point.tolist(), unit=unit)


def _scenario(given: Robot | Scenario) -> Scenario:
    if isinstance(given, Scenario):
        return given
    if isinstance(given, Robot):
        return bare_scenario(given)
    raise InputError("must be a Robot or a Scenario", key="robot_or_scenario", value=given)


def _target(
    scenario: Scenario, tip_m: ArrayLike, direction: ArrayLike | None, tolerance_rad: float | None
) -> TipTarget:
    """The point and direction asked for, in the robot's frame."""
    tip = scenario.base_R.T @ (_vector("tip_m", tip_m, FARTHEST_M, "m") - scenario.base_position_m)
    if direction is None:
        if tolerance_rad is not None:
            raise InputError("goes with direction", key="direction_tolerance_rad", value=tolerance_rad)
        return TipTarget(tip)
    given = _vector("direction", direction, 1e12)
    largest = np.abs(given).max()
    if largest == 0:
        raise InputError("must not be zero", key="direction", value=given.tolist())
    scaled = given / largest  # so that squares do not vanish
    along = scenario.base_R.T @ (scaled / np.linalg.norm(scaled))
    return TipTarget(tip, along, DIRECTION_TOLERANCE_RAD if tolerance_rad is None else float(tolerance_rad))


def _vector(key: str, value: ArrayLike, largest: float, unit: str | None = None) -> Array:
    """Three numbers (3,), none beyond `largest`. Raises InputError."""
    vector = numbers(value, key)
    if vector.shape != (3,):
        raise InputError("must be three numbers", key=key, value=value, unit=unit)
    for component in vector.tolist():
        require(key, component, Number(-largest, largest, unit))
    return vector
