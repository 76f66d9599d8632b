"""What a certificate allows for uncertain parameters and registration, at every sample of a path."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.uncertainty.body_clearance import BodyClearance
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.tip_slopes import friction_bound_m, tip_slopes, worst_bound_m

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Registration, Scenario

ROWS = 12  # samples of a path at which bodies are solved at the ends of every interval
_USUAL: WeakKeyDictionary[Robot, dict[Registration, float]] = WeakKeyDictionary()
INTERPOLATED = 1.1  # times the larger of the two around, in between; an allowance, see docs/planning.md


def is_uncertain(scenario: Scenario) -> bool:
    """Whether parameters of the robot or its registration have intervals."""
    return bool(uncertain_parameters(scenario.robot).count) or not scenario.registration.is_exact


class ParameterAllowance(NamedTuple):
    """At K samples of a path; inf where the robot has no equilibrium within the intervals."""

    clearance_m: Array  # (K,) to take off: intervals and registration; limits require `model_error_m` on top
    bound_m: Array  # (K,) to add: parameters alone, for a base that stands elsewhere moves all shapes alike
    stability: Array  # (K,) to take off: parameters alone
    strain: Array  # (K,) to add: likewise

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """(K,)."""
        return np.asarray(np.isfinite(np.array(self)).all(axis=0))


def parameter_allowance(scenario: Scenario, joints: Array) -> ParameterAllowance:
    """At the samples of a path, joints (K, m). Zero where nothing is uncertain."""
    parameters, nothing = uncertain_parameters(scenario.robot), np.zeros(len(joints))
    if not is_uncertain(scenario):
        return ParameterAllowance(nothing, nothing, nothing, nothing)
    rows = looked_at(len(joints))
    bound = _between(rows, _bounds(parameters, joints[rows]), len(joints)) if parameters.count else nothing
    bodies = bodies_at(scenario, parameters, joints[rows])
    taken = np.array([(body.allowance_m, *body.margins_lost) for body in bodies])
    clearance, stability, strain = (_between(rows, values, len(joints)) for values in taken.T)
    return ParameterAllowance(clearance, bound, stability, strain)


def usual_allowance_m(scenario: Scenario, sample: Callable[[], Array]) -> float:
    """What nearly every state loses of its clearance [m], for searches, whose paths are certified after.

    The lower quartile over configurations (R, m) that `sample` returns; asked for once for a robot and a registration.
    """
    parameters = uncertain_parameters(scenario.robot)
    if not scenario.anatomy or not is_uncertain(scenario):
        return 0.0
    known = _USUAL.setdefault(scenario.robot, {})
    if scenario.registration not in known:
        found = [body.allowance_m for body in bodies_at(scenario, parameters, sample())]
        known[scenario.registration] = float(np.quantile(found, 0.25, method="lower"))
    return known[scenario.registration]


def looked_at(count: int) -> NDArray[np.int_]:
    """Samples of `count`, spread evenly, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, ROWS)).round().astype(int))


def bodies_at(scenario: Scenario, parameters: UncertainParameters, joints: Array) -> list[BodyClearance]:
    """At joints (R, m), on every core."""

    def look(q: Array) -> BodyClearance:
        found = BodyClearance.of(scenario, parameters, q)
        _ = found.allowance_m, found.margins_lost  # solved here, on this thread
        return found

    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(look, joints))


def _bounds(parameters: UncertainParameters, joints: Array) -> Array:
    """(R,) [m] by how much the parameters widen the bound at joints (R, m)."""
    theta, l = parameters.robot.drive.commanded(joints)  # noqa: E741 (as in the equations)
    slopes = tip_slopes(parameters, theta, l)
    worst, beyond = worst_bound_m(parameters, slopes, theta, l)
    friction = friction_bound_m(slopes)
    wider = np.maximum(worst + beyond - np.where(np.isinf(friction), np.nan, friction), 0.0)
    return np.nan_to_num(wider, nan=np.inf)


def _between(rows: NDArray[np.int_], values: Array, count: int) -> Array:
    """(count,) values at `rows`; in between INTERPOLATED times the larger neighbour."""
    right = np.searchsorted(rows, np.arange(count))
    left = np.maximum(right - 1, 0)
    found: Array = INTERPOLATED * np.maximum(values[left], values[right])
    found[rows] = values
    return found
