"""Hidden names that results have until they are whole and renamed, and what killed processes left under such names.

Whoever writes under a name holds a lock on it (flock). The system takes the lock away when the process ends, however it
ends: a name that can be locked is nobody's any more. Where there are no such locks, on some network drives, nothing is
taken for abandoned.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

NAME = re.compile(r"\.ctrplan-[0-9a-f]{16}\.tmp")
TO_LOCK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK  # nor wait for the other end of a pipe that has such a name


@contextlib.contextmanager
def temporary(parent: Path, make: Callable[[Path], object]) -> Iterator[Path]:
    """A hidden name in `parent` for what `make` makes, Path.mkdir or Path.touch; removed at the end unless renamed.

    What processes that are gone left in `parent` is removed first. Raises OSError where the system refuses.
    """
    remove_abandoned(parent)
    path, lock = _made(parent, make)
    try:
        yield path
    finally:
        _remove(path)
        os.close(lock)


def remove_abandoned(parent: Path) -> None:
    """Remove every temporary name in `parent` that nobody holds; being refused is no error."""
    for path in parent.glob(".ctrplan-*"):
        if NAME.fullmatch(path.name):
            with contextlib.suppress(OSError):
                lock = os.open(path, TO_LOCK)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(path)
                finally:
                    os.close(lock)


def _made(parent: Path, make: Callable[[Path], object]) -> tuple[Path, int]:
    """Path and open lock; made again if another process took it for abandoned in the moment before it was locked."""
    while True:
        path = parent / f".ctrplan-{secrets.token_hex(8)}.tmp"
        make(path)
        try:
            lock = os.open(path, TO_LOCK)
        except FileNotFoundError:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        except OSError:  # no locks here, for anybody
            return path, lock
        if path.exists():
            return path, lock
        os.close(lock)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):  # renamed, most often
            path.unlink()
