"""Files that are written whole or not at all: under a temporary name first, then renamed."""

from __future__ import annotations

import os
from pathlib import Path

from ctrplan.errors import CtrplanError
from ctrplan.storage.temporary import temporary


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write content (text as UTF-8) to path; a reader sees the old file or the new one, never a part.

    Raises CtrplanError where the system refuses (no such folder, no permission, disk full); the old file stays.
    """
    target = Path(os.path.realpath(path))  # a link is written through, not replaced
    try:
        with temporary(target.parent, Path.touch) as made:
            _write_through(made, content.encode() if isinstance(content, str) else content)
            os.replace(made, target)
    except OSError as error:
        raise CtrplanError(f"{path}: could not be written, nothing was changed: {error.strerror or error}.") from error


def _write_through(path: Path, content: bytes) -> None:
    with open(path, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())  # before the rename, or a crash may leave an empty file under the final name
