"""Tips of a robot in every corner of friction, their derivatives by its uncertain parameters, and the bound with
these.

The mechanics differentiate exactly, by the numbers of the robot and by the collars. How these follow from the
parameters is arithmetic, differenced and joined by the chain rule. Where collars touch, so that one of them can't be
moved by itself, tips are differenced across the interval instead.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import Made, checked
from ctrplan.base.arrays import Array, warn_of_degrees
from ctrplan.base.package import shown
from ctrplan.effects.learned.learned import effect_of
from ctrplan.mechanics.core_arrays import joint_rows
from ctrplan.mechanics.shapes import Status, Tips
from ctrplan.pipeline.chain import Chain
from ctrplan.pipeline.tip_table import held
from ctrplan.robot.named_numbers import MAGNITUDE, value_of
from ctrplan.robot.robot import Robot
from ctrplan.uncertainty.parameters import UncertainParameters, uncertain_parameters
from ctrplan.uncertainty.worst_case import OffsetBox, farthest

STEP = 1e-4  # of half an interval


@dataclass(frozen=True, eq=False)
class TipSlopes:
    """K configurations in S friction states: released, then every corner in the order of `Bound.corners`."""

    pose: Array  # (K, S, 6) tip [m] in the robot's frame, then its tangent; NaN where there is no solution
    pose_by: Array  # (K, S, 6, P) per SI unit

    @property
    def tip_m(self) -> Array:
        """(K, S, 3)."""
        return self.pose[..., :3]

    @property
    def by(self) -> Array:
        """(K, S, 3, P) of the tip, m per SI unit."""
        return self.pose_by[..., :3, :]


def friction_states(robot: Robot) -> Array:
    """(S, n - 1) the released state, and every corner in the order of `Bound.corners`."""
    pairs = robot.n - 1
    return np.array([(0.0,) * pairs, *(itertools.product((1.0, -1.0), repeat=pairs) if pairs else ())])


def clamped_collars(parameters: UncertainParameters, robot: Robot, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741
    """(K, n) [rad], (K, n) [m] where the drive of `robot`, the parameters' at an offset, holds collars that nest.

    They are commanded to theta, l (K, n). Play that is wider than stated counts as a displacement to one side.
    """
    return held(robot, theta, l, _wider(parameters, robot))


def tips_at(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> Array:  # noqa: E741
    """(K, S, 3) tips [m] with parameters (P,) away from their values; NaN where a solve failed.

    Collars are commanded to theta, l (K, n).
    """
    return poses_at(parameters, offset, theta, l)[..., :3]


def poses_at(parameters: UncertainParameters, offset: Array, theta: Array, l: Array) -> Array:  # noqa: E741
    """(K, S, 6) as `tips_at`, with the tangents after the tips."""
    robot = parameters.robot_at(offset)
    states = friction_states(robot)
    theta_b, l_b = (np.repeat(part, len(states), axis=0) for part in clamped_collars(parameters, robot, theta, l))
    result = robot.mechanics.tips_with_friction(theta_b, l_b, np.tile(states, (len(theta), 1)))
    return _pose(result).reshape(len(theta), len(states), 6)


def tip_slopes(parameters: UncertainParameters, theta: Array, l: Array) -> TipSlopes:  # noqa: E741
    """At commanded collars theta (K, n) [rad], l (K, n) [m]."""
    robot, states = parameters.robot, friction_states(parameters.robot)
    names, numbers_by = _numbers(parameters)
    joints_by = _collars_by(parameters, theta, l)
    moved: NDArray[np.bool_] = np.any(joints_by, axis=(0, 2))
    joints = [f"{kind}.{i + 1}" for kind in ("theta_b", "l_b") for i in range(robot.n)]
    columns = [*names, *itertools.compress(joints, moved.tolist())]
    theta_b, l_b = (np.repeat(part, len(states), axis=0) for part in clamped_collars(parameters, robot, theta, l))
    phi = np.tile(states, (len(theta), 1))
    result = robot.mechanics.tips_with_friction(theta_b, l_b, phi, parameters=tuple(columns))
    shape = (len(theta), len(states), 6)
    core = np.concatenate([result.position_by, result.tangent_by], axis=1).reshape(*shape, len(columns))
    numbers = np.broadcast_to(numbers_by, (len(theta), *numbers_by.shape))
    by = _chained(core[..., : len(names)], numbers) + _chained(core[..., len(names) :], joints_by[:, moved])
    return TipSlopes(_pose(result).reshape(shape), _differenced(parameters, theta, l, by))


def _pose(tips: Tips) -> Array:
    """(K, 6)."""
    pose = np.concatenate([tips.position_m, tips.tangent], axis=1)
    return np.where((tips.status == Status.FAILED)[:, None], np.nan, pose)


def _chained(outer: Array, inner: Array) -> Array:
    """(K, S, 6, P) of (K, S, 6, N) and (K, N, P); NaN where a factor is that matters."""
    known: Array = np.einsum("kscn,knp->kscp", np.nan_to_num(outer), inner)
    lost = np.einsum("kscn,knp->kscp", np.isnan(outer).astype(float), (inner != 0).astype(float)) > 0
    return np.where(lost, np.nan, known)


def _numbers(parameters: UncertainParameters) -> tuple[list[str], Array]:
    """Names of the robot's numbers (N,) that the parameters change, and their derivatives (N, P)."""
    names = _changing(parameters)
    columns = []
    for j in range(parameters.count):
        up, down, width = _beside(parameters, j)
        columns.append([(value_of(up, name) - value_of(down, name)) / width for name in names])
    by = np.array(columns).reshape(parameters.count, len(names)).T
    used = np.flatnonzero(by.any(axis=1)).tolist()
    return [names[k] for k in used], by[used]


def _changing(parameters: UncertainParameters) -> list[str]:
    chain = Chain.of(parameters.robot)
    of_effects = (given.effect.mechanics(given.values, chain.ideal) for given in chain.of_stage("mechanics"))
    result = {name for named in of_effects for name in named}
    for name in parameters.names:
        kind, *rest = name.split(".")
        if kind == "effects":
            result |= _numbers_of_effect(parameters, rest)
        elif rest[-1] == MAGNITUDE:
            stem = name.rsplit(".", 1)[0]
            result |= {f"{stem}.curvature_x_per_m", f"{stem}.curvature_y_per_m"}
        else:
            result.add(name)
    return sorted(result)


def _numbers_of_effect(parameters: UncertainParameters, place: list[str]) -> set[str]:
    robot = parameters.robot
    effect, ideal = effect_of(place[0], robot.effects[place[0]], robot.n), Chain.of(robot).ideal
    at = parameters.value[parameters.names.index(f"effects.{place[0]}.{place[1]}")]
    return set(effect.mechanics({place[1]: float(at)}, ideal)) if effect.stage == "mechanics" else set()


def _collars_by(parameters: UncertainParameters, theta: Array, l: Array) -> Array:  # noqa: E741
    """(K, 2 n, P) derivatives of theta_b, then of l_b; play, whose side nobody knows, counts as a displacement."""
    columns = []
    for j in range(parameters.count):
        up, down, width = _beside(parameters, j)
        ends = [np.hstack(end.drive.reached(theta, l, _wider(parameters, end))) for end in (up, down)]
        columns.append((ends[0] - ends[1]) / width)
    shape = (parameters.count, len(theta), 2 * parameters.robot.n)
    result: Array = np.array(columns).reshape(shape).transpose(1, 2, 0)
    return result


def _wider(parameters: UncertainParameters, robot: Robot) -> Array:
    """(2 G n,) [rad], [m] by how much the play of a robot's collars is wider than the file's to either side."""
    return half_widths(robot) - half_widths(parameters.robot)


def half_widths(robot: Robot) -> Array:
    """(2 G n,) [rad], [m] half widths of the play of a robot's collars at G places in its drive, at least one."""
    return np.zeros(2 * robot.n) if robot.drive.play is None else robot.drive.play.ravel()


def widest_play(parameters: UncertainParameters) -> Array:
    """(2 G n,) [rad], [m] half widths of the play of collars, all parameters of the drive where they widen it most."""
    own = half_widths(parameters.robot)
    widest = own.copy()
    for k, name in enumerate(parameters.names):
        kind, *rest = name.split(".")
        if (
            kind == "effects"
            and effect_of(rest[0], parameters.robot.effects[rest[0]], parameters.robot.n).stage == "drive"
        ):
            ends = np.outer([parameters.low[k], parameters.high[k]] - parameters.value[k], np.eye(parameters.count)[k])
            widest += np.max([half_widths(parameters.robot_at(end)) - own for end in ends], axis=0).clip(0.0)
    return widest


def _beside(parameters: UncertainParameters, j: int) -> tuple[Robot, Robot, float]:
    """Robots on both sides of parameter j, and how far they are apart in it [SI]."""
    step = STEP * parameters.half_width[j]
    at = parameters.value[j]
    ends = [float(np.clip(at + side * step, parameters.least[j], parameters.most[j]) - at) for side in (1, -1)]
    unit = np.eye(parameters.count)[j]
    return parameters.robot_at(ends[0] * unit), parameters.robot_at(ends[1] * unit), ends[0] - ends[1]


def _differenced(parameters: UncertainParameters, theta: Array, l: Array, by: Array) -> Array:  # noqa: E741
    """`by` with what the core can't tell by differences across the intervals."""
    for j in np.flatnonzero(np.isnan(by).any(axis=(0, 1, 2))).tolist():
        unit = np.eye(parameters.count)[j]
        ends = [end - parameters.value[j] for end in (parameters.low[j], parameters.high[j])]
        low, high = (poses_at(parameters, end * unit, theta, l) for end in ends)
        across = (high - low) / (ends[1] - ends[0])
        by[..., j] = np.where(np.isnan(by[..., j]), across, by[..., j])
    return by


@shown
@dataclass(frozen=True, eq=False)
class UncertainBounds:
    """Largest distance of the tip from where the file's robot has it without friction, at K configurations."""

    position_m: Array  # (K,) over every corner of friction and every parameter in its interval; inf without a solution
    friction_m: Array  # (K,) over the corners alone
    beyond_first_order_m: Array  # (K,) by how much the solved extreme differs from the linear one; in position_m


@checked(robot=Made("Robot"))
def bound_with_parameters(robot: Robot, theta_commanded: ArrayLike, l_commanded: ArrayLike) -> UncertainBounds:
    """Worst-case tip deviations with the 95 % intervals of the robot's file, (n,) or (K, n) [rad] and [m] commanded.

    First order in the parameters by exact derivatives; the worst combination of each configuration is solved, and what
    it differs by is added. Without intervals the same as `robot.bound_many`.
    """
    warn_of_degrees("theta_commanded", theta_commanded)
    theta, l = joint_rows(np.atleast_2d(theta_commanded), np.atleast_2d(l_commanded), robot.n)  # noqa: E741
    parameters = uncertain_parameters(robot)
    slopes = tip_slopes(parameters, theta, l)
    friction = friction_bound_m(slopes)
    if not parameters.count:
        return UncertainBounds(friction, friction, np.zeros(len(friction)))
    worst, beyond = worst_bound_m(parameters, slopes, theta, l)
    return UncertainBounds(np.where(np.isnan(worst), np.inf, worst + beyond), friction, beyond)


def friction_bound_m(slopes: TipSlopes) -> Array:
    """(K,) over the corners; inf where one has no solution."""
    away = np.linalg.norm(slopes.tip_m - slopes.tip_m[:, :1], axis=2).max(axis=1)
    return np.where(np.isnan(away), np.inf, away)


def worst_bound_m(
    parameters: UncertainParameters,
    slopes: TipSlopes,
    theta: Array,
    l: Array,  # noqa: E741 (as in the equations)
) -> tuple[Array, Array]:
    """(K,) [m] to first order, and by how much the worst combination of parameters, solved, is off that."""
    box, (count, states) = OffsetBox.of(parameters), slopes.tip_m.shape[:2]
    away = slopes.tip_m - slopes.tip_m[:, :1]
    lost = np.isnan(away).any(axis=(1, 2)) | np.isnan(slopes.by).any(axis=(1, 2, 3))
    by = np.nan_to_num(slopes.by).reshape(-1, 3, parameters.count)
    result = farthest(np.nan_to_num(away).reshape(-1, 3), box.displaced(by))
    length = result.length_m.reshape(count, states)
    state, rows = np.argmax(length, axis=1), np.arange(count)
    beyond = np.zeros(count)
    for k in rows.tolist():
        offset = box.middle + box.axes @ result.signs.reshape(count, states, -1)[k, state[k]]
        tip = tips_at(parameters, offset, theta[k : k + 1], l[k : k + 1])[0, state[k]]
        linear = slopes.tip_m[k, state[k]] + slopes.by[k, state[k]] @ offset
        beyond[k] = np.nan_to_num(np.linalg.norm(tip - linear), nan=np.inf)
    return np.where(lost, np.nan, length[rows, state]), beyond
