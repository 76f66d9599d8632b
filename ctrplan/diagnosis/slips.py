"""A collar that slips once, or a drive that loses steps: from an instant that nobody wrote down a joint's zero is off.

Such a slip is a homing that the file does not tell of: the instant found, the rest of the diagnosis treats it as one
(`homing_shift`). It is looked for beside an ordinary calibration, and beside the most probable effects where these
leave something, linearised: of every joint that moves and every pose, what a constant change of its zero from there on
would explain. It is asked after where it leaves less than half of the error beyond the noise, as another reading of the
file does (`reading.py`), and less than anything smooth in time that the same joint could do. Whether it is believed,
the posterior says, as of any other effect, for which every instant is a variant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import fit
from ctrplan.calibration.parameters import BaseParameters
from ctrplan.calibration.residuals import Noise, residuals
from ctrplan.diagnosis.reading import BETTER
from ctrplan.effects.drive.homing_shift import HomingShift
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
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
    effect = HomingShift()
    after = replace(data, homing=np.where(np.arange(len(data.sequence)) < 0, 1, 2))
    if data.is_stream or data.of_collars or len(np.unique(data.homings)) > 1 or effect.untestable(robot, after):
        return None
    if data.count < 2 * LEAST_POSES:
        return None
    base = BaseParameters()
    group = data.configuration
    own = [term(base, [q.name for q in base.parameters(robot)], robot), *beside]
    calibrated = fit(ParametricChain(robot, data, own), noise, group)
    names = list(effect.variants(robot, after)[0])
    chain = ParametricChain(robot, after, [*own, term(effect, names, robot)])
    there = np.concatenate([calibrated.p, np.zeros(len(names))])
    parts = residuals(after, chain.predict(there), noise, group)
    weight = np.sqrt(calibrated.residuals.weight)[:, None]
    r, J = parts.r * weight, parts.J * weight[..., None]
    given = int(parts.given.sum())
    free = _Free(J[..., : len(calibrated.p)], 1 / calibrated.chain.prior)
    before = free.left(r)
    best: tuple[float, int, int] = (np.inf, 0, 0)
    instants = range(LEAST_POSES, data.count - LEAST_POSES + 1)
    for j in range(len(names)):
        column = J[..., len(calibrated.p) + j]
        for pose in instants:
            left = free.left(r, _masked(column, pose)[..., None])
            best = min(best, (left, j, pose))
    left, j, pose = best
    times = np.linspace(-1, 1, data.count)
    drift = np.stack([times, *(np.cos(np.pi * k * (times + 1) / 2) for k in range(1, SMOOTH))])
    smooth = free.left(r, J[..., len(calibrated.p) + j][..., None] * drift.T[:, None, :])
    excess = [np.sqrt(max(value / given - 1.0, 0.0)) for value in (before, left, smooth)]
    if excess[0] < 1.0 / BETTER or excess[1] * BETTER > excess[0] or left >= smooth:
        return None
    return Slip(pose, int(data.rows[pose]) + 1, names[j], len(instants))


def after_slip(data: Measurements, slip: Slip) -> Measurements:
    """The measurements with another homing from the slip on."""
    return replace(data, homing=np.where(np.arange(len(data.sequence)) >= slip.row - 1, 2, 1))


def _masked(column: Array, pose: int) -> Array:
    """A column (K, 5) that does nothing before a pose."""
    return np.where(np.arange(len(column))[:, None] >= pose, column, 0.0)


class _Free:
    """Columns (K, 5, P) of parameters with priors, whose part of anything else is taken out."""

    def __init__(self, J: Array, root_precision: Array) -> None:
        rows = np.vstack([J.reshape(-1, J.shape[2]), np.diag(root_precision)])
        self._q = np.linalg.qr(rows)[0]

    def _rest(self, columns: Array) -> Array:
        whole = np.vstack([columns, np.zeros((len(self._q) - len(columns), columns.shape[1]))])
        rest: Array = whole - self._q @ (self._q.T @ whole)
        return rest

    def left(self, r: Array, beside: Array | None = None) -> float:
        """Sum of squares of residuals (K, 5) that is left, with columns (K, 5, D) fitted besides."""
        rest = self._rest(r.reshape(-1, 1))
        if beside is not None:
            columns = self._rest(beside.reshape(-1, beside.shape[2]))
            rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
        return float((rest**2).sum())
