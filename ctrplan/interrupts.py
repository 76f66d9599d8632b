"""Ctrl-C as an event, so that nothing is lost in the middle of an import, a search or a write."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

INTERRUPTED = 130  # exit code


@contextmanager
def interrupt_event(given: threading.Event | None = None) -> Iterator[threading.Event]:
    """An event that Ctrl-C sets instead of raising; `given`, if somebody else already takes care of it.

    Outside the main thread, where signals cannot be handled, the event is simply never set.
    """
    event = given or threading.Event()
    if given is not None or threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)
