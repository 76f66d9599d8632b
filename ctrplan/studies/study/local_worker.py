"""What a worker of a cluster of this machine does when it begins; dask calls it by the name of this module."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leaves Ctrl-C, which a terminal sends to all, to the process of the study: it ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
