"""What joints and poses may be where the robot is known: the same rules for tables and for measurements made in code.

Tables name the row and column that break one, `InCode` the entry of the array.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array, warn_of_degrees
from ctrplan.errors import InputError
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import (
    LARGEST_RUN,
    POSITION,
    TANGENT,
    WHOLE_NUMBER,
    Measurements,
    joint_columns,
)
from ctrplan.mechanics.tube import farthest_m
from ctrplan.robot.magnitudes import in_words, likely_units
from ctrplan.robot.robot import Robot, nesting_violation
from ctrplan.storage.toml_document import LARGEST_NUMBER

MOST_TURNS = 50  # of a tube; more are most likely degrees
MOST_LENGTHS = 10  # of the longest tube; more are most likely millimetres
TANGENT_TOLERANCE = 0.01  # of its length: files are rounded


class DataPlaces(Protocol):
    """Where numbers stand."""

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: object = ...) -> InputError:
        """The error that a cell, row (from 0) or column breaks `rule`."""


class InCode:
    """Arrays of measurements by the columns that tables have."""

    def __init__(self, robot: Robot) -> None:
        """robot: whose tubes and markers have columns."""
        rotations, translations = joint_columns(robot.n)
        arrays = [("theta_commanded", rotations), ("l_commanded", translations), ("tangent", TANGENT)]
        positions = [("position_m", names) for names in (POSITION, *(marker.columns for marker in robot.markers))]
        self._places = {name: (array, k) for array, names in (*arrays, *positions) for k, name in enumerate(names)}

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: object = ...) -> InputError:
        """The error that an entry, row (from 0) or array breaks `rule`."""
        array, *axis = self._places.get(column or "", (column or "l_commanded",))
        return InputError(rule, key=array if row is None else f"{array}{[row, *axis]}", value=value)


_PASSED: WeakKeyDictionary[Measurements, Robot] = WeakKeyDictionary()  # with whom they passed


def passed(robot: Robot, data: Measurements) -> Measurements:
    """The measurements, which were read from tables that keep the rules."""
    _PASSED[data] = robot
    return data


def require_measured(robot: Robot, data: Measurements) -> None:
    """Refuses what no table may say of the robot, and asks about degrees, once for each robot and measurements.

    Raises InputError.
    """
    if _PASSED.get(data) is robot:
        return
    cells = require_path(robot, data)
    if data.seen_marker.min(initial=0) < 0 or data.seen_marker.max(initial=0) > len(robot.markers):
        raise InputError(f"must be from 0, the tip, to {len(robot.markers)}, the robot's markers", key="marker")
    for k in np.flatnonzero(np.isfinite(data.position_m).sum(axis=1) < np.where(data.seen_marker == 0, 3, 2)).tolist():
        raise cells.fault("must have all coordinates, of a marker two at least: leave such poses out", k, POSITION[0])
    for number, names in enumerate([POSITION, *(marker.columns for marker in robot.markers)]):
        poses = np.flatnonzero(data.seen_marker == number)
        check_positions(cells, data.position_m[poses], poses, names, robot)
    seen = np.isfinite(data.tangent)
    for axes in ([0, 1, 2], [0, 1], [0, 2], [1, 2]):
        poses = np.flatnonzero(seen[:, axes].all(axis=1) & (seen.sum(axis=1) == len(axes)))
        unit_tangents(cells, data.tangent[poses][:, axes], poses, [TANGENT[axis] for axis in axes])
    passed(robot, data)


def require_path(robot: Robot, path: JointPath | Measurements) -> InCode:
    """Refuses joints that no table may command the robot, and asks about degrees. Raises InputError."""
    cells, theta, l = InCode(robot), path.theta_commanded, path.l_commanded  # noqa: E741 (as in the equations)
    if np.shape(theta)[1:] != (robot.n,):
        raise InputError(f"must have a column for each of {robot.n} tubes", key="theta_commanded")
    check_order(cells, path.sequence, path.time_s)
    check_joints(cells, theta, l, robot, of_collars=path.of_collars)
    warn_of_degrees("theta_commanded", theta)
    return cells


def check_order(table: DataPlaces, sequence: Array | NDArray[np.int_], time_s: Array | None) -> None:
    """Rows of a run stand together, and time does not run backwards."""
    for row in np.flatnonzero((sequence != np.round(sequence)) | (np.abs(sequence) > LARGEST_RUN)).tolist():
        raise table.fault(WHOLE_NUMBER, row, "sequence", float(sequence[row]))
    if (resumed := _resumed_run(sequence)) is not None:
        rule = "this run was over, its rows must stand together"
        raise table.fault(rule, resumed, "sequence", int(sequence[resumed]))
    if time_s is not None:
        for row in np.flatnonzero(np.abs(time_s) > LARGEST_NUMBER).tolist():  # stamps in ns
            rule = f"must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g} s"
            raise table.fault(rule, row, "time_s", float(time_s[row]))
        for row in (np.flatnonzero(np.diff(time_s) < 0) + 1).tolist():
            rule = f"time runs backwards, the row before has {time_s[row - 1]:g} s"
            raise table.fault(rule, row, "time_s", float(time_s[row]))


def check_joints(table: DataPlaces, theta: Array, l: Array, robot: Robot, *, of_collars: bool) -> None:  # noqa: E741
    """Commanded values; tubes nest as commanded or where the drive puts them."""
    rotations, translations = joint_columns(robot.n)
    longest_m = max(tube.length_m for tube in robot.tubes)
    for row, i in np.argwhere(np.abs(theta) > MOST_TURNS * 2 * np.pi).tolist():
        rule = f"is more than {MOST_TURNS} turns in rad, are these degrees?"
        raise table.fault(rule, row, rotations[i], float(theta[row, i]))
    for row, i in np.argwhere(np.abs(l) > MOST_LENGTHS * longest_m).tolist():
        rule = f"must be in metres and is beyond {MOST_LENGTHS} lengths of the robot, are these millimetres?"
        raise table.fault(rule, row, translations[i], float(l[row, i]))
    driven = (theta, l) if of_collars else robot.collars(theta, l)
    if refused := robot.mechanics.first_refused(theta, l) and robot.mechanics.first_refused(*driven):
        row, rule = refused
        sentence = nesting_violation(robot, driven[0][row], driven[1][row]) or rule.rstrip(".")
        hint = " (a tube that may be drawn back has retractable = true)" if "tips in order" in sentence else ""
        if not robot.mechanics.first_refused(theta[:, ::-1], l[:, ::-1]):
            hint = ": are the tubes innermost first? List the outermost first"
        if (beyond := np.abs(l[row]) > longest_m).any():
            hint = f": is {translations[int(np.argmax(beyond))]} in millimetres?"
        raise table.fault(sentence + hint, row)


def _resumed_run(sequence: Array | NDArray[np.int_]) -> int | None:
    """The first row (from 0) that goes back to a run which was over, None if there is none."""
    starts = np.flatnonzero(np.diff(sequence, prepend=np.nan) != 0)
    first = np.unique(sequence[starts], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(starts)), first)
    return int(starts[again[0]]) if again.size else None


def unit_tangents(table: DataPlaces, tangent: Array, rows: NDArray[np.int_], names: Sequence[str]) -> Array:
    """The vectors at unit length; two components are a direction in their plane, whatever their length."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
    whole, given = len(names) == len(TANGENT), np.isfinite(tangent).all(axis=1)
    wrong = np.abs(length - 1) > TANGENT_TOLERANCE if whole else ~((length > 1e-6) & (length < 1 + TANGENT_TOLERANCE))
    for k in np.flatnonzero(wrong[:, 0] & given).tolist():
        rule = "must be a unit vector" if whole else "seen in a plane it must be above 0 and at most 1"
        shown = f"tangent has length {length[k, 0]:.4g}, {rule}"
        raise table.fault(shown, int(rows[k]), names[0], tangent[k, 0])
    unit: Array = tangent / length
    return unit


def require_seen(table: DataPlaces, position: Array, rows: NDArray[np.int_], columns: Sequence[str]) -> None:
    """Raises InputError for positions (K, 3) that a tracker has filled in."""
    what = "tip" if columns[0] == POSITION[0] else "marker"
    for k in np.flatnonzero((position == 0).all(axis=1)).tolist():
        rule = f"{what} is 0 in all coordinates, as trackers write what they do not see: leave such poses out"
        raise table.fault(rule, int(rows[k]), columns[0], position[k, 0])


def check_positions(
    table: DataPlaces,
    position: Array,
    rows: NDArray[np.int_],
    columns: Sequence[str],
    robot: Robot,
    *,
    anywhere: bool = False,
) -> None:
    """Within reach of the base; `anywhere`: of their own middle, where nobody knows the base."""
    if not len(position):
        return
    what = "tip" if columns[0] == POSITION[0] else "marker"
    require_seen(table, position, rows, columns)
    seen, position = ~np.isnan(position), np.nan_to_num(position)
    with np.errstate(over="ignore"):  # what is beyond all numbers is too far
        middle = np.median(position, axis=0) if anywhere else np.zeros(3)
        far = np.linalg.norm(position - middle, axis=1)
    limit = farthest_m(robot.tubes)
    for k in np.flatnonzero(far > limit).tolist():
        wide = np.abs(position[k] - middle) > limit  # of some axes alone, whose place the others say
        is_some = bool(wide.any() and not wide[seen[k]].all())
        size = np.linalg.norm((position - middle)[:, wide], axis=1) if is_some else far
        likely = likely_units(float(np.median(size)), "m", (0.01 if is_some else 0.1) * limit, limit)
        first = int(np.argmax(wide))
        unit = f", are these {in_words(likely)}?" if likely else ""
        if not np.linalg.norm(position - np.median(position, axis=0), axis=1).max() > limit:  # about another origin
            unit = ': is that the tracker\'s frame? A mapping file has frame = "unknown", or where the robot is in it'
        rule = f"{what} is {far[k]:g} m from the base, beyond the reach of {limit:.3g} m{unit}"
        raise table.fault(rule, int(rows[k]), columns[first], position[k, first])
    if np.median(far) < limit / 2000 and not anywhere:
        raise table.fault(f"{what}s are {np.median(far):.2g} m from the base, are these metres?", column=columns[0])
