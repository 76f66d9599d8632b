"""Which poses a diagnosis goes by, which of them are kept aside, and which stand for the others.

Two configurations are kin if they are the same but for full turns, a common rotation, or a reflection: whatever belongs
to one belongs to the other. Kin stand in one block, and blocks are kept aside as a whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import LONGEST_LAG_S, SEED, VAULT_SHARE, Measurements
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

LEAST_STABILITY = 0.03  # of the believed robot: nearer to snapping no model is asked
BLOCKS = 16  # of a continuous motion, of which four are kept aside
KIN_RAD, KIN_M = np.radians(2.0), 0.5e-3  # joints nearer than this are the same configuration
KIN_SHARE = 0.5  # of the poses of a block of a continuous motion that have kin in another, which makes the blocks one
MOST_POSES = 240  # that are compared: time grows with the cube, and more stand near others and say the same
LEAST_POSES = 6  # with fewer a rigid frame alone explains nearly all
LEAST_BLOCKS = 12  # of which a quarter is three configurations: with fewer none is kept aside


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


def split(data: Measurements, usable: NDArray[np.bool_]) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
    """Poses that choose, poses kept aside, and (K,) the block of each; a quarter of the blocks is kept aside.

    Nothing is kept aside where there are few blocks. Raises InputError where `usable` (K,) leaves too little.
    """
    block = blocks(data)
    if usable.sum() < LEAST_POSES:
        rule = (
            f"has {usable.sum()} usable poses: with fewer than {LEAST_POSES} a misread file can be told, and "
            "`ctrplan calibrate` can fit a parameter or two, but no effect can be told from another"
        )
        raise InputError(rule, file=data.file)
    numbers = np.random.default_rng(SEED).permutation(np.unique(block[usable]))
    aside = int(round(VAULT_SHARE * len(numbers))) if len(numbers) >= LEAST_BLOCKS else 0
    held_out = np.isin(block, numbers[:aside]) & usable
    return np.flatnonzero(usable & ~held_out), np.flatnonzero(held_out), block


def thinned(data: Measurements, chosen: NDArray[np.int_]) -> NDArray[np.int_]:
    """So many of the chosen poses that they can be compared: of a motion evenly, else whole configurations."""
    if len(chosen) <= MOST_POSES:
        return chosen
    if data.is_stream:
        return chosen[:: -(-len(chosen) // MOST_POSES)]
    configuration = data.configuration[chosen]
    numbers = np.unique(configuration)
    kept = numbers[np.linspace(0, len(numbers) - 1, int(len(numbers) * MOST_POSES / len(chosen))).round().astype(int)]
    return chosen[np.isin(configuration, kept)]


def blocks(data: Measurements) -> NDArray[np.int_]:
    """(K,) number of each pose's block: configurations with their kin, or parts of a continuous motion."""
    if not data.is_stream:
        return _joined(data.configuration, _kin_pairs(data), share=0.0)
    time, run = clock(data), data.sequence[data.rows]
    lasts = sum(float(np.ptp(time[run == number])) for number in np.unique(run))
    number, count = np.zeros(data.count, dtype=np.int_), 0
    for one in np.unique(run).tolist():
        inside = run == one
        since = time[inside] - time[inside].min()
        pieces = max(1, round(float(since.max()) / max(lasts, 1e-9) * BLOCKS))
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
