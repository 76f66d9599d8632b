"""A collar that slips once, or a drive that loses steps: from an instant that nobody wrote down a joint's zero is off.

Such a slip is a homing that the file does not tell of: the instant found, the rest of the diagnosis treats it as one
(`homing_shift`). It is looked for beside an ordinary calibration, and beside the most probable effects where these
leave something, linearised: of every joint that moves and every pose, what a constant change of its zero from there on
would explain. It is asked after where it leaves less than half of the error beyond the noise, as another reading of the
file does (`calibration/reading.py`), and less than anything smooth in time that the same joint could do. Whether it is
believed, the posterior says, as of any other effect, for which every instant is a variant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.reading import BETTER
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.linear_fit import Linear, solved
from ctrplan.diagnosis.workbench import Workbench
from ctrplan.effects.drive.homing_shift import HomingShift
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

LEAST_POSES = 5  # before and after a slip: fewer are outliers
SMOOTH = 4  # functions of time that a drift of a joint is made of: a line and cosines of up to so many half waves


@dataclass(frozen=True)
class Slip:
    """From the measured pose with a number on, in the order of the file, a joint's zero is another one."""

    pose: int  # from 0
    row: int  # of the file's waypoints, from 1
    joint: str  # as the parameter of homing_shift is called: "theta_2_2_deg"
    instants: int = 1  # of which it is one, each as probable a priori


def found_slip(robot: Robot, data: Measurements, noise: Noise, beside: Sequence[Term] = ()) -> Slip | None:
    """The slip that the poses show, if they show one; none where homings are given, or on a continuous motion.

    beside: effects that are fitted besides.
    """
    effect, after = HomingShift(), replace(data, homing=np.full(len(data.sequence), 2))
    if data.is_stream or data.of_collars or len(np.unique(data.homings)) > 1 or effect.untestable(robot, after):
        return None
    if data.count < 2 * LEAST_POSES:
        return None
    bench = Workbench(robot, data, noise, data.configuration)
    calibrated, shift = bench.scored(beside), term(effect, effect.variants(robot, after)[0], robot)
    panel = replace(bench, data=after).panel(calibrated, [shift])
    joints = panel.places([shift])
    rest = panel.whole.columns([k for k in range(len(panel.keys)) if k not in joints]).refitted()
    columns, instants = panel.whole.J[:, :, joints], slice(LEAST_POSES, data.count - LEAST_POSES + 1)
    gains = np.array([_gains(rest, column)[instants] for column in np.moveaxis(columns, 2, 0)])
    j, k = np.unravel_index(int(gains.argmax()), gains.shape)
    times, pose = np.linspace(-1, 1, data.count), LEAST_POSES + int(k)
    drift = np.stack([times, *(np.cos(np.pi * wave * (times + 1) / 2) for wave in range(1, SMOOTH))], axis=1)
    before, left = rest.loss, rest.loss - float(gains[j, k])
    smooth = rest.beside(columns[:, :, j, None] * drift[:, None]).refitted().loss
    excess = [np.sqrt(max(value / rest.given.sum() - 1.0, 0.0)) for value in (before, left)]
    if excess[0] < 1.0 / BETTER or excess[1] * BETTER > excess[0] or left >= smooth:
        return None
    return Slip(pose, int(data.rows[pose]) + 1, shift.parameters[j].name, gains.shape[1])


def _gains(rest: Linear, column: Array) -> Array:
    """(K,) what a constant times a column (K, 5) takes off a fit's loss, if it acts from each pose on only."""
    root = np.sqrt(rest.weight)[:, None]
    c, r, J = column * root, rest.r * root, rest.J * root[:, :, None]
    terms = np.column_stack([(c * r).sum(axis=1), (c**2).sum(axis=1), np.einsum("kc,kcp->kp", c, J)])
    along, square, shared = np.split(np.cumsum(terms[::-1], axis=0)[::-1], [1, 2], axis=1)  # of all poses from each on
    free = square[:, 0] - (shared.T * solved(rest.information, shared.T)).sum(axis=0)
    gains: Array = along[:, 0] ** 2 / np.maximum(free, np.finfo(float).tiny)
    return gains


def after_slip(data: Measurements, slip: Slip) -> Measurements:
    """The measurements with another homing from the slip on."""
    return replace(data, homing=np.where(np.arange(len(data.sequence)) >= slip.row - 1, 2, 1))
