"""What remains beside the effects that hold: how large it is, how long it lasts, where, and what it is fixed to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.experiment.friction_states import friction_state, last_directions
from ctrplan.experiment.measurements import Measurements
from ctrplan.experiment.motion import clock

SCALES = (0.5, 1.0, 2.0)  # of a kernel, in rad of relative rotation or what counts as much
RIDGES = (0.1, 0.5, 2.0)  # noise of a kernel fit, over what it explains
ROOM_M, STATE = 0.05, 1.0  # of translation, and of friction states and directions, that count as much as a radian
QUARTERS = 4.0  # of the experiment that count as much as a radian each


@dataclass(frozen=True)
class Rest:
    """What nothing in the catalogue explains. Shares are of its variance, the noise's taken out."""

    rms_m: float  # of the distance, noise taken out
    memory: float | None  # [s] after which it has forgotten itself; None for poses at rest
    of_configuration: float  # share that a configuration has whenever it comes back
    of_history: float  # share that depends on how it was reached besides
    of_time: float  # share that changes with the time of the experiment besides
    place: str  # where it is, as a sentence
    memory_in_rows: bool = False  # of a log without times

    @property
    def sentence(self) -> str:
        """Size, memory and shares."""
        unit = "rows" if self.memory_in_rows else "s"
        lasting = "" if self.memory is None else f", which last {self.memory:.2g} {unit}"
        shares = [
            f"{100 * share:.0f} % {what}"
            for share, what in (
                (self.of_configuration, "belong to the configuration"),
                (self.of_history, "to how it was reached"),
                (self.of_time, "to the time"),
            )
            if share > 0.005
        ]
        fixed = f"Of their variance {', '.join(shares)}." if shares else "They go with nothing that comes back."
        return f"{self.rms_m * 1e3:.2f} mm remain (rms, noise taken out){lasting}. {fixed}"


def shares_of_motion(
    error_m: Array, data: Measurements, block: NDArray[np.int_], floor_m: float
) -> tuple[float, float, float]:
    """Of configuration, history and time in errors (K, 3), by what each adds when blocks (K,) are left out."""
    wanted = max(float((error_m**2).sum()) - len(error_m) * floor_m**2, 1e-12)
    features, explained = list[Array](), [0.0]
    for more in (_configuration(data), _history(data), _time(data)):
        features.append(more)
        explained.append(max(explained[-1], _explained(error_m, np.hstack(features), block)))
    configuration, history, time = (float(min(1.0, step / wanted)) for step in np.diff(explained))
    return configuration, history, time


def share_of_time(error_m: Array, data: Measurements, block: NDArray[np.int_], floor_m: float) -> float:
    """Of errors (K, 3) of poses at rest."""
    wanted = max(float((error_m**2).sum()) - len(error_m) * floor_m**2, 1e-12)
    return float(min(1.0, max(0.0, _explained(error_m, _time(data), block)) / wanted))


def _configuration(data: Measurements) -> Array:
    turns = np.diff(data.theta_commanded[data.rows], axis=1)
    return np.hstack([np.sin(turns), np.cos(turns), data.l_commanded[data.rows] / ROOM_M])


def _history(data: Measurements) -> Array:
    states: Array = np.hstack([friction_state(data), last_directions(data)]) / STATE
    return states


def _time(data: Measurements) -> Array:
    time = clock(data)
    since: Array = (time - time.min())[:, None] / max(float(np.ptp(time)), 1e-9) * QUARTERS
    return since


def _explained(error: Array, features: Array, block: NDArray[np.int_]) -> float:
    """Sum of squares that a smooth function of the features predicts of blocks it has not seen, the best of a few."""
    total = float((error**2).sum())
    square = ((features[:, None] - features[None]) ** 2).sum(axis=2)
    best: float = 0.0
    for scale in SCALES:
        kernel = np.exp(-square / (2 * scale**2 * features.shape[1]))
        for ridge in RIDGES:
            best = max(best, total - float(((error - _left_out(kernel, ridge, error, block)) ** 2).sum()))
    return best


def _left_out(kernel: Array, ridge: float, error: Array, block: NDArray[np.int_]) -> Array:
    """(K, 3) predictions of each block from the others: one inversion, (I - H_bb)^-1 per block."""
    smoother = kernel @ np.linalg.inv(kernel + ridge * np.eye(len(kernel)))
    predicted = smoother @ error
    for number in np.unique(block):
        rows = np.flatnonzero(block == number)
        own = np.eye(len(rows)) - smoother[np.ix_(rows, rows)]
        predicted[rows] = error[rows] - np.linalg.solve(own, error[rows] - predicted[rows])
    left: Array = predicted
    return left
