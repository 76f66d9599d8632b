"""Poses that are no independent evidence: stretches of a motion longer than its memory, configurations and their kin.

Two configurations are kin if they are the same but for full turns, a common rotation, or a reflection: whatever belongs
to one belongs to the other. Kin stand in one block, and blocks are left out and kept aside as a whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ctrplan.base.arrays import Array
from ctrplan.experiment.measurements import Measurements
from ctrplan.experiment.motion import clock
from ctrplan.experiment.split import FOLDS, SEED, VAULT_SHARE, Split

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
    for one in np.unique(run).tolist():
        inside = run == one
        since = time[inside] - time[inside].min()
        pieces = max(1, int(since.max() // length))
        number[inside] = count + np.minimum((since / max(since.max(), 1e-9) * pieces).astype(np.int_), pieces - 1)
        count += pieces
    return _joined(number, _kin_pairs(data), share=KIN_SHARE)


def block_split(data: Measurements, usable: NDArray[np.bool_], block: NDArray[np.int_]) -> Split:
    """A quarter of the blocks, (K,) by number, is kept aside; every other one is a fold, or part of one of six."""
    numbers = np.random.default_rng(SEED).permutation(np.unique(block[usable]))
    aside = int(round(VAULT_SHARE * len(numbers)))
    held_out = np.isin(block, numbers[:aside]) & usable
    selection = np.flatnonzero(usable & ~held_out)
    order = {number: k % FOLDS for k, number in enumerate(numbers[aside:].tolist())}
    return Split(selection, np.flatnonzero(held_out), np.array([order[n] for n in block[selection].tolist()]))


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
    found = cKDTree(first, boxsize=box).query_ball_tree(cKDTree(second, boxsize=box), 1.0, p=np.inf)
    return np.array([(i, j) for i, near in enumerate(found) for j in near if i != j], dtype=np.int_).reshape(-1, 2)


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
