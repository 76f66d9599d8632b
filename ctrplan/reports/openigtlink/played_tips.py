"""A simulated path sent over OpenIGTLink row by row, as it would be driven."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.reports.openigtlink.broadcast import Broadcast
from ctrplan.reports.openigtlink.messages import pyigtl, tip_messages
from ctrplan.studies.simulate import Simulation

ROW_S = 0.1  # where a path says no time
LOOK_S = 0.05  # for a listener


def play_tips(
    result: Simulation, port: int, interrupted: threading.Event, on_listening: Callable[[int], object]
) -> None:
    """Waits for a listener, then sends each sample's tip at its time; ends early when `interrupted` is set.

    `on_listening` is told the port. Raises InputError where that can't be had, and without pyigtl.
    """
    pyigtl()
    found = np.flatnonzero(np.isfinite(result.position_m).all(axis=1))
    with Broadcast(port) as broadcast:
        on_listening(broadcast.port)
        while not broadcast.is_heard:
            if interrupted.wait(LOOK_S):
                return
        for k, wait_s in zip(found.tolist(), np.diff(_times(result)[found], append=np.nan).tolist(), strict=True):
            broadcast.send(tip_messages(result.position_m[k], result.tangent[k]))
            if interrupted.wait(wait_s if wait_s > 0 else 0.0):
                return


def _times(result: Simulation) -> Array:
    """(S,) [s] of the samples."""
    rows = np.arange(len(result.path.theta_commanded))
    given = result.path.time_s
    return np.interp(result.place, rows, ROW_S * rows if given is None else given)
