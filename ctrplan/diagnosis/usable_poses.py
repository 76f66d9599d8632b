"""Which poses a diagnosis goes by, and which of them are independent evidence.

Two configurations are kin if they are the same but for full turns, a common rotation, or a reflection: whatever belongs
to one belongs to the other. Kin stand in one block, and blocks are left out and kept aside as a whole.

A solution that is found afresh is one of them, the robot stays in the one that it comes from, and models that are alike
elsewhere are centimetres apart. Such a pose says which equilibrium a model has chosen, not which effects act.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import gross_outliers, too_many
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.workbench import Scored, Workbench
from ctrplan.errors import InputError
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import LONGEST_LAG_S, Measurements, Split, groups, split
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.followed_runs import followed
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.tip_table import FrictionCorrection, nested
from ctrplan.robot.robot import Robot

MEMORIES_IN_BLOCK = 2.0  # correlation times that a block of a continuous motion lasts at least
LEAST_BLOCKS = 16  # of a continuous motion, shorter ones where it does not last long enough
KIN_RAD, KIN_M = np.radians(2.0), 0.5e-3  # joints nearer than this are the same configuration
KIN_SHARE = 0.5  # of the poses of a block of a continuous motion that have kin in another, which makes the blocks one


def blocks(data: Measurements, memory: float) -> NDArray[np.int_]:
    """(K,) number of each pose's block; the memory is in s, of a log without times in rows."""
    if not data.is_stream:
        return _joined(data.configuration, _kin_pairs(data), share=0.0)
    time, run = clock(data), data.sequence[data.rows]
    lasts = sum(float(np.ptp(time[run == number])) for number in np.unique(run))
    length = min(MEMORIES_IN_BLOCK * memory, lasts / LEAST_BLOCKS)
    number, count = np.zeros(data.count, dtype=np.int_), 0
    for this_run in np.unique(run).tolist():
        inside = run == this_run
        since = time[inside] - time[inside].min()
        pieces = max(1, int(since.max() // length))
        number[inside] = count + np.minimum((since / max(since.max(), 1e-9) * pieces).astype(np.int_), pieces - 1)
        count += pieces
    return _joined(number, _kin_pairs(data), share=KIN_SHARE)


def _kin_pairs(data: Measurements) -> NDArray[np.int_]:
    """(N, 2) poses whose configurations are kin."""
    turns = np.diff(data.theta_commanded[data.rows], axis=1) / KIN_RAD
    slides = data.l_commanded[data.rows] / KIN_M
    pairs = [_near(turns, turns, slides), _near(turns, -turns, slides)]
    return np.concatenate(pairs)


def _near(turns: Array, others: Array, slides: Array) -> NDArray[np.int_]:
    """(N, 2) rows of the first that are within 1 of rows of the second in every column; rotations are modulo a turn."""
    turn = 2 * np.pi / KIN_RAD
    length = 4 * (np.ptp(slides, axis=0) + 1)  # of a box that translations never go round
    box = np.concatenate([np.full(turns.shape[1], turn), length])
    first, second = (np.mod(np.hstack([a, slides - slides.min(axis=0)]), box) for a in (turns, others))
    result = cKDTree(first, boxsize=box).query_ball_tree(cKDTree(second, boxsize=box), 1.0, p=np.inf)
    return np.array([(i, j) for i, near in enumerate(result) for j in near if i != j], dtype=np.int_).reshape(-1, 2)


def _joined(number: NDArray[np.int_], pairs: NDArray[np.int_], share: float) -> NDArray[np.int_]:
    """Blocks of which more than a `share` of the poses have kin in another become one with it."""
    block = np.unique(number, return_inverse=True)[1].ravel()
    count = int(block.max()) + 1
    between = np.unique(np.column_stack([pairs[:, 0], block[pairs[:, 1]]]), axis=0)  # pose, block where it has kin
    links = np.zeros((count, count))
    np.add.at(links, (block[between[:, 0]], between[:, 1]), 1.0)
    kin = links / np.bincount(block)[:, None] > share
    joined: NDArray[np.int_] = connected_components(coo_matrix(kin), directed=False)[1][block]
    return joined


APART_M = 5e-3  # of a simulated history and a solution found afresh, in the same friction state


def on_one_branch(bench: CorrelatedBench, chosen: Scored) -> NDArray[np.bool_]:
    """(K,) poses where simulated histories and solutions found afresh agree, with usual friction and without any."""
    if not bench.data.is_stream or bench.robot.n < 2:
        return np.ones(bench.data.count, bool)
    apart = _apart_m(*bench.rubbing(chosen)) > APART_M
    if not chosen.fit.chain.robot_at(chosen.fit.p).friction.any():
        apart |= _apart_m(chosen.fit.chain, chosen.fit.p) > APART_M
    return np.ones(len(apart), bool) if too_many(apart, np.ones(len(apart), bool)) else ~apart


def _apart_m(chain: ParametricChain, p: Array) -> Array:
    """(K,) [m] of the tips; 0 where either is missing."""
    path, alone = followed(chain, p), ParametricChain(chain.robot, chain.data, chain.terms)
    alone.correction = FrictionCorrection(np.clip(np.nan_to_num(path.phi), -1.0, 1.0))
    afresh, sound = alone.before_sensor(p)
    distance: Array = np.where(sound, np.linalg.norm(path.position_m - afresh, axis=1), 0.0)
    return np.nan_to_num(distance)


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


def require_unread(read: Measurements, data: Measurements, key: str) -> None:
    """Raises InputError where some of the new poses are among those that a diagnosis has read."""
    if (known := data.are_of(read)).any():
        rule = (
            f"must be runs that the diagnosis has not read: those poses count already (row {data.rows_in_words(known)})"
        )
        raise InputError(rule, file=data.file, key=key)


def checked_split(data: Measurements, usable: NDArray[np.bool_]) -> Split:
    """Raises InputError where `usable` (K,) leaves too little."""
    count = len(np.unique(groups(data)[usable]))
    if count < LEAST_GROUPS:
        what = "blocks of a continuous motion" if data.is_stream else "configurations"
        rule = f"has {count} usable {what}, too few to fit a model and keep a quarter aside: at least {LEAST_GROUPS}"
        raise InputError(rule, file=data.file)
    return split(usable, groups(data))


def bench_of(robot: Robot, data: Measurements, parts: Split, noise: Noise) -> Workbench:
    """A workbench of the poses that choose."""
    return Workbench(robot, data.subset(parts.selection), noise, groups(data)[parts.selection])


def without_outliers(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise
) -> tuple[NDArray[np.bool_], Split, Workbench]:
    """Poses (K,) that went wrong, and split and bench without them, of a continuous motion with poses that stand apart.

    Found by the calibrated model without effects.
    """
    wrong = np.zeros(data.count, bool)
    while True:
        parts = checked_split(data, usable & ~wrong)
        bench = bench_of(robot, data, thinned(parts, data), noise)
        more = gross_outliers(bench.scored([]).fit, data, usable & ~wrong)
        if not more.any() or too_many(wrong | more, usable):
            return wrong, parts, bench
        wrong |= more


def thinned(parts: Split, data: Measurements) -> Split:
    """So many poses of a continuous motion for the selection that they stand apart."""
    step = thinning(len(parts.selection))
    if not data.is_stream or step == 1:
        return parts
    return Split(parts.selection[::step], parts.held_out_set)


def thinning(count: int) -> int:
    """Every how manieth of the poses of a continuous motion is enough."""
    return max(1, -(-count // MOST_POSES))
