"""Which poses a diagnosis goes by: the believed robot is stable, clocks can be compared, nothing went wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.calibration.gross_outliers import gross_outliers, too_many
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.workbench import Workbench
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import LONGEST_LAG_S, Measurements
from ctrplan.experiment.split import Split, groups, split
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

LEAST_STABILITY = 0.03  # of the believed robot: nearer to snapping no model is asked
MOST_POSES = 200  # of a continuous motion that are compared; the others stand near them and say the same
LEAST_GROUPS = 12  # configurations, or blocks of a continuous motion


def usable_poses(robot: Robot, data: Measurements) -> NDArray[np.bool_]:
    """(K,) poses that every candidate is asked about: the believed robot is stable there, clocks can be compared."""
    first = np.unique(data.configuration, return_index=True)[1]
    rows = data.rows[first]
    theta_b, l_b = robot.collars(data.theta_commanded[rows], data.l_commanded[rows])
    bounds = robot.bound_many(theta_b, nested(robot, l_b))
    sound = (bounds.status <= Status.MULTIPLE) & (bounds.stability > LEAST_STABILITY)
    usable: NDArray[np.bool_] = sound[data.configuration]
    if data.is_stream and data.time_s is not None:
        starts = {run: data.time_s[data.sequence == run][0] for run in np.unique(data.sequence).tolist()}
        begun = np.array([starts[run] for run in data.sequence[data.rows].tolist()])
        usable = usable & (data.time_s[data.rows] - begun >= LONGEST_LAG_S)
    return usable


def checked_split(data: Measurements, usable: NDArray[np.bool_]) -> Split:
    """Raises InputError where `usable` (K,) leaves too little."""
    count = len(np.unique(groups(data)[usable]))
    if count < LEAST_GROUPS:
        what = "blocks of a continuous motion" if data.is_stream else "configurations"
        rule = f"has {count} usable {what}, too few to fit a model and keep a quarter aside: at least {LEAST_GROUPS}"
        raise InputError(rule, file=data.file)
    return split(data, usable)


def bench_of(robot: Robot, data: Measurements, parts: Split, noise: Noise) -> Workbench:
    """A workbench of the poses that choose."""
    return Workbench(robot, data.subset(parts.selection), noise, groups(data)[parts.selection], parts.fold)


def without_outliers(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise
) -> tuple[NDArray[np.bool_], Split, Workbench]:
    """Poses (K,) that went wrong, and split and bench without them. Found by the calibrated model without effects."""
    wrong = np.zeros(data.count, bool)
    while True:
        parts = checked_split(data, usable & ~wrong)
        some = thinned(parts, data)
        bench = bench_of(robot, data, some, noise)
        more = gross_outliers(bench.scored([]).fit, data, usable & ~wrong)
        if not more.any() or too_many(wrong | more, usable):
            return wrong, parts, bench if some is parts else bench_of(robot, data, parts, noise)
        wrong |= more


def thinned(parts: Split, data: Measurements) -> Split:
    """Of a continuous motion so many poses for the selection that they stand apart."""
    step = thinning(len(parts.selection))
    if not data.is_stream or step == 1:
        return parts
    return Split(parts.selection[::step], parts.held_out_set, parts.fold[::step])


def thinning(count: int) -> int:
    """Every how manieth of the poses of a continuous motion is enough."""
    return max(1, -(-count // MOST_POSES))
