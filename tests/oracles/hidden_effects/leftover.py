"""How large an effect is: what it leaves after recalibration of the ordinary parameters, over the noise."""

from __future__ import annotations

import numpy as np

from hidden_effects.chain import Poses
from hidden_effects.equilibrium import State, System
from hidden_effects.experiment import Experiment
from hidden_effects.mesh import Fineness
from hidden_effects.noise import POSITION_SIGMA_M, TANGENT_SIGMA_RAD
from hidden_effects.poses import Solver
from hidden_effects.tube import Array
from hidden_effects.world import Ordinary, World

STEP = 1e-4
CONTINUOUS_STRIDE = 8  # rows of a continuous motion that are looked at: every 0.8 s


def leftover_over_noise(plain: World, experiment: Experiment, found: Poses, fineness: Fineness | None = None) -> float:
    """Rms over poses of the 3-D tip error that a linear recalibration of `plain` leaves, over sigma sqrt(3).

    `plain` is the true robot without its effects; `found` are the poses with them, of the
    same fineness.
    """
    rows = np.flatnonzero(experiment.measured)
    picked = np.arange(0, len(rows), CONTINUOUS_STRIDE if experiment.continuous else 1)
    residuals, sensitivities = [], []
    solver = Solver(plain, fineness or Fineness())
    known: tuple[bytes, tuple[Array, Array]] | None = None
    for k in picked.tolist():
        theta, l_b = experiment.motion.theta[rows[k]], experiment.motion.l[rows[k]]
        key = np.concatenate([theta, l_b]).tobytes()
        if known is None or known[0] != key:
            solver.pose(theta, l_b, np.zeros(plain.n - 1))
            known = key, _with_derivatives(plain, *solver.solved)
        pose, derivatives = known[1]
        residuals.append((np.concatenate([found.p[k], found.tangent[k]]) - pose) / WEIGHT)
        sensitivities.append(derivatives / WEIGHT[:, None])
    r, J = np.concatenate(residuals), np.concatenate(sensitivities)
    left = (r - J @ np.linalg.lstsq(J, r, rcond=None)[0]).reshape(-1, 6)[:, :3]
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1)) / 3))


WEIGHT = np.repeat([POSITION_SIGMA_M, TANGENT_SIGMA_RAD], 3)


def _with_derivatives(plain: World, system: System, state: State) -> tuple[Array, Array]:
    """Tip and tangent (6,) of a frictionless state, and their derivatives (6, 3 n - 1) by the ordinary parameters."""
    _, H = system.residual(state, _released)
    free = np.ix_(system.free, system.free)
    base = system.elastic_gradient(state.x)
    neutral = Ordinary((1.0,) * plain.n, (1.0,) * plain.n, tuple(tube.poisson_ratio for tube in plain.tubes))
    loads = []
    for i, value in enumerate(neutral.vector()):
        values = neutral.vector()
        values[i] = value + STEP
        changed = system.with_tubes(Ordinary.from_vector(values).of(plain).tubes)
        loads.append((changed.elastic_gradient(state.x) - base)[system.free] / STEP)
    steps = np.zeros((len(state.x), len(loads)))
    steps[system.free] = -np.linalg.solve(H[free], np.column_stack(loads))
    curve, last = state.curves[system.foremost], system.foremost
    own = steps[system.start[last] : system.start[last] + system.rods[last].n_bend]
    tangent = curve.Q[-1, :, 2]
    turned = np.cross((curve.turned[-1] @ own).T, tangent).T
    return np.concatenate([curve.p[-1], tangent]), np.vstack([curve.moved[-1] @ own, turned])


def _released(system: System, state: State, k: int) -> tuple[Array, None]:
    return np.zeros(len(system.contacts[k].s)), None
