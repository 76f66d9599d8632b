"""Poses of a continuous motion at which the robot may be in either of two equilibria.

A solution that is found afresh is one of them, the robot stays in the one that it comes from, and models that are alike
elsewhere are centimetres apart. Such a pose says which equilibrium a model has chosen, not which effects act.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.workbench import Scored
from ctrplan.pipeline.followed_runs import followed
from ctrplan.pipeline.parametric_chain import ParametricChain

APART_M = 5e-3  # of a simulated history and a solution found afresh, in the same friction state
MOST = 0.1  # of the poses: where there are more, the model is not this robot


def on_one_branch(bench: CorrelatedBench, chosen: Scored) -> NDArray[np.bool_]:
    """(K,) poses where simulated histories and solutions found afresh agree, with usual friction and without any."""
    if not bench.data.is_stream or bench.robot.n < 2:
        return np.ones(bench.data.count, bool)
    apart = _apart_m(*bench.rubbing(chosen)) > APART_M
    if not chosen.fit.chain.robot_at(chosen.fit.p).friction.any():
        apart |= _apart_m(chosen.fit.chain, chosen.fit.p) > APART_M
    return ~apart if apart.mean() <= MOST else np.ones(bench.data.count, bool)


def _apart_m(chain: ParametricChain, p: Array) -> Array:
    """(K,) [m] of the tips; 0 where either is missing."""
    path, alone = followed(chain, p), ParametricChain(chain.robot, chain.data, chain.terms)
    alone.followed_phi = np.clip(np.nan_to_num(path.phi), -1.0, 1.0)
    afresh, sound = alone.before_sensor(p)
    distance: Array = np.where(sound, np.linalg.norm(path.position_m - afresh, axis=1), 0.0)
    return np.nan_to_num(distance)
