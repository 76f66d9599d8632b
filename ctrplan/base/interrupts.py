"""Ctrl-C as an event, so that nothing is lost in the middle of an import, a search or a write."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

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


@contextmanager
def interrupts_noticed() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also where the import of a compiled module made another error of it."""
    pressed = False

    def press(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.default_int_handler(number, frame)

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # somebody else takes care
        yield
        return
    signal.signal(signal.SIGINT, press)
    try:
        yield
    except Exception as error:
        if pressed:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
