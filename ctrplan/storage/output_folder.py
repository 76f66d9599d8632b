"""Files and folders of results, written whole or not at all: under a temporary name first, then renamed.

Whoever writes under a name holds a lock on it (flock). The system takes the lock away when the process ends, however it
ends: a name that can be locked is nobody's any more. Where there are no such locks, on some network drives, nothing is
taken for abandoned.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ctrplan.base.arguments import refuse_other_text
from ctrplan.errors import CtrplanError, InputError

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
    abandoned = list[Path]()
    with contextlib.suppress(OSError), os.scandir(parent) as entries:
        abandoned = [parent / entry.name for entry in entries if NAME.fullmatch(entry.name)]
    for path in abandoned:
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
        shown = Path(*(part for part in Path(path).parts if not NAME.fullmatch(part)))  # as it would have been called
        raise CtrplanError(f"{shown}: could not be written, nothing was changed: {error.strerror or error}.") from error


def _write_through(path: Path, content: bytes) -> None:
    with open(path, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())  # before the rename, or a crash may leave an empty file under the final name


DEFAULT = "ctrplan-output"
CHECKSUMS = "SHA256SUMS"
LONGEST_NAME = 255  # bytes, on all usual file systems


@contextmanager
def written_together(folder: Path, outputs: Sequence[str], outdated: Sequence[str] = ()) -> Iterator[Path]:
    """A hidden folder to write `outputs` into; they are renamed to their places together, or none is.

    The file SHA256SUMS follows last: a process killed between two renames leaves files that do not match it, so
    `sha256sum -c SHA256SUMS` tells a whole set from a mixed one. It keeps the sums of other results in the folder.
    Files called `outdated`, of earlier results, are removed then. What a killed process left hidden is removed by the
    next one. Makes `folder` if need be, and leaves none without results. Raises CtrplanError where the system refuses.
    """
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with temporary(folder, Path.mkdir) as made:
            yield made
            left = {name: stated for name, stated in stated_sums(folder).items() if (folder / name).is_file()}
            sums = {name: stated for name, stated in left.items() if name not in {*outputs, *outdated}}
            sums |= {output: _sha256(made / output) for output in outputs}
            write_atomically(made / CHECKSUMS, "".join(f"{stated}  {name}\n" for name, stated in sums.items()))
            for output in (*outputs, CHECKSUMS):
                os.replace(made / output, folder / output)
        for name in outdated:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise CtrplanError(f"{folder}: could not be written: {error.strerror or error}.") from error
    finally:
        if is_new:
            with contextlib.suppress(OSError):  # it has what was written
                folder.rmdir()


def stated_sums(folder: Path) -> dict[str, str]:
    """The sums that SHA256SUMS of a folder states of files in it, by their names; none where it can't be read."""
    try:
        rows = (folder / CHECKSUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    stated = {name: digest for digest, _, name in (row.partition("  ") for row in rows)}
    return {name: digest for name, digest in stated.items() if name and name == Path(name).name}


def write_results(folder: Path, results: Mapping[str, str | bytes], outdated: Sequence[str] = ()) -> None:
    """Writes contents by their file names as `written_together` does."""
    with written_together(folder, tuple(results), outdated) as made:
        for name, content in results.items():
            write_atomically(made / name, content)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def output_folder(
    name: str, outputs: Sequence[str], later: Sequence[str] = (), *, inputs: Sequence[str | None] = ()
) -> Path:
    """The folder that `outputs` will be written into, checked before any time is spent on them.

    The first of them tells such results from others: where it is missing, files called like the rest, or like those of
    `later`, are of others and are kept, as are always the `inputs`, files that are read. The folder is made when there
    is something to write. Raises InputError if it can't be used.
    """
    folder = Path(name)
    refuse_other_text(name, "--output")
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
        require_kept(folder / output, inputs)
    foreign = [] if (folder / outputs[0]).exists() else [x for x in (*outputs[1:], *later) if (folder / x).exists()]
    if foreign:
        rule = f"holds {foreign[0]} without {outputs[0]}: other results, which would be lost; name another folder"
        raise InputError(rule, key="--output", value=name)
    return folder


def require_kept(file: Path, inputs: Sequence[str | None], key: str = "--output") -> None:
    """Raises InputError if `file`, which is to be written, is one of those that are read."""
    for each in inputs:
        if each and file.exists() and os.path.exists(each) and file.samefile(each):
            raise InputError(
                f"would write over {file.name}, which is read: name another place", key=key, value=str(file)
            )


def _reason(error: Exception) -> str:
    return f"can't be a folder ({getattr(error, 'strerror', None) or error})"
