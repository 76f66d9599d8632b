"""What happened once, at an instant that nobody wrote down: a collar that slipped, a drive that lost steps, a tracker
that was knocked.

From there on a joint's zero is off, or the tracker has another frame, which is a homing or a set-up that the file does
not tell of: the instant found, the rest of the diagnosis treats it as one (`homing_shift`, `frame_shift`). It is looked
for beside an ordinary calibration, and beside the most probable effects where these leave something, linearised: of
every joint that moves, of the tracker, and of every pose, what a constant change from there on would explain. It is
asked after where it leaves less than half of the error beyond the noise, as another reading of the file does
(`calibration/reading.py`), and less than anything smooth in time that the same could do. Whether it is believed, the
posterior says, as of any other effect, for which every instant is a variant.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.reading import BETTER
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.linear_fit import Linear, solved
from ctrplan.diagnosis.workbench import Linearisation, Workbench
from ctrplan.effects.drive.homing_shift import HomingShift
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.effects.sensor.frame_shift import FrameShift
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

LEAST_POSES = 5  # before and after a slip: fewer are outliers
SMOOTH = 4  # functions of time that a drift is made of besides a line: cosines of up to three half waves, and 1
TRACKER = "tracker"  # in the place of a joint that slipped
REMEDIES = {
    HomingShift: "tighten that collar, home the drive and measure some of the first poses again",
    FrameShift: "fasten the tracker and the robot's base and measure some of the first poses again",
}


@dataclass(frozen=True)
class Slip:
    """From the measured pose with a number on, in the order of the file, a joint's zero or the frame is another one."""

    pose: int  # from 0
    row: int  # of the file's waypoints, from 1
    joint: str  # "theta_2", or "tracker"
    instants: int = 1  # of which it is one, each as probable a priori

    @property
    def effect(self) -> str:
        """Name of the effect that treats it so."""
        return FrameShift.name if self.joint == TRACKER else HomingShift.name


def most_probable_slip(
    robot: Robot, data: Measurements, noise: Noise, beside: Sequence[Term] = (), among: Collection[str] = CATALOGUE
) -> Slip | None:
    """The slip that the poses show, if they show one; none on a continuous motion, of a joint where homings are given,
    or of a tracker where frames are.

    beside: effects that are fitted besides; among: names of those that may stand for a slip.
    """
    number = np.full(len(data.sequence), 2)
    after = replace(data, homing=number, frame=number)
    shifts = [term(e, e.variants(robot, after)[0], robot) for e in _asked(robot, data, after) if e.name in among]
    if data.is_stream or data.count < 2 * LEAST_POSES or not shifts:
        return None
    bench = Workbench(robot, data, noise, data.configuration)
    panel = replace(bench, data=after).panel(bench.scored(beside), shifts)
    moved = panel.places(shifts)
    rest = panel.whole.columns([k for k in range(len(panel.keys)) if k not in moved]).refitted()
    instants = slice(LEAST_POSES, data.count - LEAST_POSES + 1)
    best: tuple[float, float, str, int, list[int]] | None = None
    for joint, places in _events(panel, moved):
        gains, evidence = _gains(rest, panel.whole.columns(places))
        k = int(evidence[instants].argmax()) + LEAST_POSES
        if best is None or evidence[k] > best[0]:
            best = float(evidence[k]), float(gains[k]), joint, k, places
    assert best is not None
    _, gain, joint, pose, places = best
    times = np.linspace(-1, 1, data.count)
    drift = np.stack([times, *(np.cos(np.pi * wave * (times + 1) / 2) for wave in range(SMOOTH))], axis=1)
    drifting = panel.whole.J[:, :, places, None] * drift[:, None, None]
    before, left = rest.loss, rest.loss - gain
    smooth = rest.beside(drifting.reshape(*drifting.shape[:2], -1)).refitted().loss
    excess = [np.sqrt(max(value / rest.given.sum() - 1.0, 0.0)) for value in (before, left)]
    if excess[0] < 1.0 / BETTER or excess[1] * BETTER > excess[0] or left >= smooth:
        return None
    return Slip(pose, int(data.rows[pose]) + 1, joint, instants.stop - instants.start)


def _asked(robot: Robot, data: Measurements, after: Measurements) -> Iterator[Effect]:
    """Effects that treat a slip as what the file would tell: none of a drive whose collars were measured."""
    homing, frame = HomingShift(), FrameShift()
    if not data.of_collars and len(np.unique(data.homings)) == 1 and not homing.untestable(robot, after):
        yield homing
    if len(np.unique(data.frames)) == 1:
        yield frame


def _events(panel: Linearisation, moved: Sequence[int]) -> Iterator[tuple[str, list[int]]]:
    """What may have slipped, and the places of its parameters: a joint alone, a tracker as a whole."""
    tracker = [k for k in moved if panel.keys[k][0] == FrameShift.name]
    yield from (("_".join(panel.keys[k][1].split("_")[:2]), [k]) for k in moved if k not in tracker)
    if tracker:
        yield TRACKER, tracker


def _gains(rest: Linear, more: Linear) -> tuple[Array, Array]:
    """(K,) what further parameters take off a fit's loss if they act from each pose on only, and logarithms of how much
    more probable they make the poses.
    """
    root = np.sqrt(rest.weight)[:, None, None]
    c, r, J = more.J * root, rest.r[:, :, None] * root, rest.J * root
    along, square, shared = (
        np.cumsum((np.swapaxes(c, 1, 2) @ other)[::-1], axis=0)[::-1] for other in (r, c, J)
    )  # of all poses from each on
    free = square + np.diag(more.precision)
    inverse = solved(rest.information, np.eye(len(rest.precision)))
    free -= shared @ inverse @ np.swapaxes(shared, 1, 2)
    gains: Array = (np.swapaxes(along, 1, 2) @ np.linalg.solve(free, along))[:, 0, 0]
    return gains, (gains + np.log(more.precision).sum() - np.linalg.slogdet(free)[1]) / 2


def after_slip(data: Measurements, slip: Slip) -> Measurements:
    """The measurements with another homing, or another frame, from the slip on."""
    number = np.where(np.arange(len(data.sequence)) >= slip.row - 1, 2, 1)
    return replace(data, frame=number) if slip.joint == TRACKER else replace(data, homing=number)
