"""The folder that a command writes its results into."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ctrplan.errors import CtrplanError, InputError
from ctrplan.storage.temporary import temporary

DEFAULT = "ctrplan-output"
CHECKSUMS = "SHA256SUMS"
LONGEST_NAME = 255  # bytes, on all usual file systems


@contextmanager
def written_together(folder: Path, outputs: Sequence[str]) -> Iterator[Path]:
    """A hidden folder to write `outputs` into; they are renamed to their places together, or none is.

    The file SHA256SUMS follows last: a process killed between two renames leaves files that do not match it, so
    `sha256sum -c SHA256SUMS` tells a whole set from a mixed one. What a killed process left hidden is removed by the
    next one. Makes `folder` if need be. Raises CtrplanError where the system refuses.
    """
    from ctrplan.storage.atomic_write import write_atomically

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with temporary(folder, Path.mkdir) as made:
            yield made
            sums = "".join(f"{_sha256(made / output)}  {output}\n" for output in outputs)
            write_atomically(made / CHECKSUMS, sums)
            for output in (*outputs, CHECKSUMS):
                os.replace(made / output, folder / output)
    except OSError as error:
        raise CtrplanError(f"{folder}: could not be written: {error.strerror or error}.") from error


def write_results(folder: Path, results: Mapping[str, str | bytes]) -> None:
    """Writes contents by their file names as `written_together` does."""
    from ctrplan.storage.atomic_write import write_atomically

    with written_together(folder, tuple(results)) as made:
        for name, content in results.items():
            write_atomically(made / name, content)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def output_folder(name: str, outputs: Sequence[str]) -> Path:
    """The folder that `outputs` will be written into, checked before any time is spent on them.

    It is made when there is something to write. Raises InputError if it can't be used.
    """
    folder = Path(name)
    try:
        os.stat(name)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # longer than a name may be, a NUL in it
        raise InputError(_reason(error), key="--output", value=name) from None
    existing = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not name or not existing.is_dir():
        raise InputError("must be a folder, or a place to make one", key="--output", value=name)
    try:
        with temporary(existing, Path.touch):  # permissions alone do not say: nobody writes into /proc
            pass
    except OSError:
        raise InputError("is not writable", key="--output", value=name) from None
    if any(len(os.fsencode(part)) > LONGEST_NAME for part in folder.parts):  # below a folder that is to be made
        raise InputError(f"has a part longer than {LONGEST_NAME} bytes", key="--output", value=name)
    for output in (*outputs, CHECKSUMS):
        if (folder / output).is_dir():
            rule = f"holds a folder of the name {output}, where a file is to be written"
            raise InputError(rule, key="--output", value=name)
    return folder


def _reason(error: Exception) -> str:
    return f"can't be a folder ({getattr(error, 'strerror', None) or error})"
