"""What the friction states of `approach.py` leave out, as a correction of the tips.

At rest after a 90 degree approach the states are right, and a finer mesh gives the rest. On a continuous motion
friction is spread unevenly along the tubes, and the whole path is simulated.
"""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.experiment.friction_states import friction_state
from ctrplan.pipeline.followed_runs import followed
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.point_table import point_table

LARGEST_M = 5e-3  # corrections beyond it are a path that snapped, and are left out


def friction_correction(chain: ParametricChain, p: Array) -> tuple[Array, Array] | None:
    """What to add to positions (K, 3) [m] and tangents (K, 3) at parameters (P,); None without friction."""
    robot = chain.at(p).mechanics
    if not robot.friction.any():
        return None
    # friction that a rest or a speed has changed is as much less in the states as in the history, to first order
    collars, phi = chain.collars(p), friction_state(chain.data, chain.at(p).release_m)
    coarse = point_table(robot, chain.data, collars, phi)
    if chain.data.is_stream:
        path = followed(chain, p)
        position, tangent = path.position_m, path.tangent
    else:
        fine = point_table(robot, chain.data, collars, phi, accuracy="certificate")
        position, tangent = fine.position_m, fine.tangent
    shift, turn = position - coarse.position_m, tangent - coarse.tangent
    wild = ~(np.linalg.norm(shift, axis=1) < LARGEST_M)
    shift[wild], turn[wild] = 0.0, 0.0
    return shift, turn
