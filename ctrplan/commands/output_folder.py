"""The folder that a command writes its results into."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ctrplan.errors import CtrplanError, InputError

DEFAULT = "ctrplan-output"


@contextmanager
def written_together(folder: Path, outputs: Sequence[str]) -> Iterator[Path]:
    """A hidden folder to write `outputs` into; they are renamed to their places together, or none is.

    Makes `folder` if need be. Raises CtrplanError where the system refuses.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".ctrplan-", dir=folder) as name:
            yield Path(name)
            for output in outputs:
                os.replace(Path(name) / output, folder / output)
    except OSError as error:
        raise CtrplanError(f"{folder}: could not be written: {error.strerror or error}.") from error


def output_folder(name: str, outputs: Sequence[str]) -> Path:
    """The folder that `outputs` will be written into, checked before any time is spent on them.

    It is made when there is something to write. Raises InputError if it can't be used.
    """
    folder = Path(name)
    existing = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not name or not existing.is_dir():
        raise InputError("must be a folder, or a place to make one", key="--output", value=name)
    if not os.access(existing, os.W_OK):
        raise InputError("is not writable", key="--output", value=name)
    for output in outputs:
        if (folder / output).is_dir():
            rule = f"holds a folder of the name {output}, where a file is to be written"
            raise InputError(rule, key="--output", value=name)
    return folder
