"""Grids kept on disk between runs by the hash of all that determines them; a lost or damaged one is rebuilt.

A file holds the hash of its key and content, 32 bytes, and the content: float32 in the machine's byte order. Whoever
asks knows its shape.
"""

import contextlib
import hashlib
import logging
import os
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrplan.storage.output_folder import temporary

MAX_TOTAL_BYTES = 1_000_000_000
SUFFIX, FORMER_SUFFIX = ".grid", ".npz"  # the latter are not read any more
DIGEST_BYTES = hashlib.sha256().digest_size

logger = logging.getLogger(__name__)


def cache_directory() -> Path | None:
    """$CTRPLAN_CACHE_DIR, else where the system keeps caches of a user; None where there is no such place.

    That is $XDG_CACHE_HOME/ctrplan or ~/.cache/ctrplan on Linux, ~/Library/Caches/ctrplan on macOS.
    """
    if named := os.environ.get("CTRPLAN_CACHE_DIR"):
        return Path(named)
    from platformdirs import user_cache_path

    place = user_cache_path("ctrplan", appauthor=False)
    return place if place.is_absolute() else None


def _path(key: str) -> Path | None:
    directory = cache_directory()
    return None if directory is None else directory / "fields" / f"{key}{SUFFIX}"


def _digest(key: str, content: bytes | memoryview) -> bytes:
    result = hashlib.sha256(key.encode())
    result.update(content)
    return result.digest()


def trouble() -> str:
    """Why nothing can be kept, as a sentence; empty where it can."""
    path = _path("any")
    if path is None:
        return "there is no place for a cache, neither CTRPLAN_CACHE_DIR nor a home folder is known"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary(path.parent, Path.touch):
            return ""
    except OSError as error:
        return f"{path.parent} can't be written into ({error.strerror or error})"


def load(key: str, shape: tuple[int, ...], otherwise: str = "will be rebuilt") -> NDArray[np.float32] | None:
    """The values stored under `key`, float32 of `shape`, read-only, or None when there are none that can be trusted.

    otherwise: what becomes of a damaged one, for the log.
    """
    path = _path(key)
    if path is None:
        return None
    try:
        stored = path.read_bytes()
        digest, content = stored[:DIGEST_BYTES], memoryview(stored)[DIGEST_BYTES:]
        if digest != _digest(key, content):
            raise ValueError("content does not match its hash")
        values = np.frombuffer(content, dtype=np.float32).reshape(shape)
    except OSError as error:
        if not isinstance(error, FileNotFoundError):
            logger.info("field cache can't be read: %s", error)
        return None
    except ValueError as error:
        logger.warning("cached field %s is damaged and %s (%s)", path, otherwise, error)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # recently used ones are pruned last
    return values


def store_all(grids: Mapping[str, NDArray[np.float32]]) -> str:
    """Keeps grids by their keys, each written to a temporary name and renamed.

    Not being able to is no error: returns why, empty where they are kept.
    """
    paths = {key: _path(key) for key in grids}
    written = {key: path for key, path in paths.items() if path is not None}
    if not written:
        return trouble() if grids else ""
    path = folder = next(iter(written.values())).parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with temporary(folder, Path.mkdir) as made:  # which looks through the folder: once for all grids
            for key, path in written.items():
                _write(made / path.name, key, np.ascontiguousarray(grids[key], dtype=np.float32))
                os.replace(made / path.name, path)
    except OSError as error:
        logger.info("field not cached: %s", error)
        return f"{path} could not be written ({error.strerror or error})"
    with contextlib.suppress(OSError):  # what is kept is kept
        _prune(folder, {path.name for path in written.values()})
    return ""


def _write(path: Path, key: str, values: NDArray[np.float32]) -> None:
    content = values.reshape(-1).view(np.uint8).data
    with open(path, "wb") as file:
        file.write(_digest(key, content))
        file.write(content)


def _prune(folder: Path, newest: Collection[str]) -> None:
    """Remove the least recently used grids beyond MAX_TOTAL_BYTES, never the `newest`."""
    with os.scandir(folder) as entries:
        kept = [(entry.stat(), entry.name) for entry in entries if entry.name.endswith((SUFFIX, FORMER_SUFFIX))]
    total = sum(stat.st_size for stat, name in kept if name in newest)
    for stat, name in sorted(kept, key=lambda row: row[0].st_mtime, reverse=True):
        if name not in newest:
            total += stat.st_size
            if total > MAX_TOTAL_BYTES:
                (folder / name).unlink(missing_ok=True)
