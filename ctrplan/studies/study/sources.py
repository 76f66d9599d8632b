"""The files that tasks read, as content that travels with them: a worker needs no file system of ours."""

from __future__ import annotations

import atexit
import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property, lru_cache
from glob import glob
from operator import attrgetter
from pathlib import Path
from typing import Any

from ctrplan.anatomy.image import ImageRefusal, data_files
from ctrplan.errors import InputError
from ctrplan.storage.csv_table import LARGEST_FILE_BYTES, file_bytes
from ctrplan.storage.output_folder import temporary
from ctrplan.storage.toml_document import Document, read_document

ROBOT_PREFIX = "robot."  # of keys that a scenario hands on
VARIED = "0"  # stands for what a study varies, where content is hashed


@dataclass(frozen=True)
class Sources:
    """Files by their names relative to a folder, which is where they lie on the machine that began the study."""

    folder: str
    content: Mapping[str, bytes]

    @classmethod
    def of(cls, files: Sequence[Path], folder: Path) -> Sources:
        """The files, and those that TOML files among them name. Raises InputError for one that can't be read.

        folder: where relative names begin, which is this one or above it.
        """
        results: dict[str, bytes] = {}
        for file in files:
            _gather(os.path.abspath(file), results)
        top = os.path.commonpath([os.path.abspath(folder), *(os.path.dirname(name) for name in results)])
        return cls(top, {os.path.relpath(name, top): data for name, data in results.items()})

    def name(self, file: str | os.PathLike[str]) -> str:
        """What a file of this machine is called here."""
        return os.path.relpath(os.path.abspath(file), self.folder)

    def has(self, name: Path) -> bool:
        """Whether a file, named as here, is among them."""
        return os.path.normpath(name) in self.content

    def digest(self, name: str, varied: Sequence[str] = ()) -> str:
        """Hash of what a file and those it names say, but for the keys that are `varied`.

        Layout and comments of TOML files make no difference. Keys that begin with "robot." are those of the robot that
        a scenario names.
        """
        original = os.path.join(self.folder, name)
        if not name.endswith(".toml"):
            files = (original, *_beside(original))
            return hashlib.sha256(b"".join(self.content[self.name(file)] for file in files)).hexdigest()
        own = [key for key in varied if not key.startswith(ROBOT_PREFIX)]
        inner = [key.removeprefix(ROBOT_PREFIX) for key in varied if key.startswith(ROBOT_PREFIX)]
        document = read_document(original).with_overrides([f"{key}={VARIED}" for key in own])
        parts = [document.sha256]
        for named in _named_files(document, os.path.dirname(original)):
            parts.append(self.digest(self.name(named), inner if named.endswith(".toml") else ()))
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    @cached_property
    def key(self) -> str:
        """Hash of all content."""
        parts = [f"{name}:{hashlib.sha256(data).hexdigest()}" for name, data in sorted(self.content.items())]
        return hashlib.sha256("\n".join([self.folder, *parts]).encode()).hexdigest()

    @property
    def here(self) -> Path:
        """A folder of this process with the files in it, until the process ends."""
        return _unpacked(_Keyed(self))

    def with_original_paths(self, sentence: str) -> str:
        """A sentence about files in that folder as one about the originals."""
        return sentence.replace(f"{self.here}{os.sep}", f"{self.folder}{os.sep}")

    def named(self, data: bytes) -> bytes:
        """Content of a file that a task wrote, likewise."""
        return data.replace(f"{self.here}{os.sep}".encode(), f"{self.folder}{os.sep}".encode())


class _Keyed:
    """Sources that are equal where their content is."""

    def __init__(self, sources: Sources) -> None:
        self.sources = sources

    def __hash__(self) -> int:
        return hash(self.sources.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Keyed) and self.sources.key == other.sources.key


_folders = ExitStack()  # what a killed process leaves, the next one removes: see `storage/output_folder.py`
atexit.register(_folders.close)


@lru_cache(maxsize=8)
def _unpacked(keyed: _Keyed) -> Path:
    folder = _folders.enter_context(temporary(Path(tempfile.gettempdir()), Path.mkdir))
    for name, data in keyed.sources.content.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    return folder


def _gather(file: str, results: dict[str, bytes]) -> None:
    if file in results:
        return
    results[file] = file_bytes(os.path.relpath(file), LARGEST_FILE_BYTES, "", "file of a study")
    for other in _beside(file):
        _gather(other, results)
    if file.endswith(".toml"):
        for named in _named_files(read_document(file), os.path.dirname(file)):
            _gather(named, results)


def _beside(file: str) -> list[str]:
    """Absolute names of files that a header has its voxels in."""
    try:
        return [os.path.abspath(other) for other in data_files(Path(file))]
    except ImageRefusal:  # which whoever reads the image says
        return []


def _named_files(document: Document, folder: str) -> Iterator[str]:
    """Absolute names of the files that stand in a document, each once, in its order; of a DICOM folder all in it."""
    for key, text in dict.fromkeys(_texts(document.content)):
        name = os.path.normpath(os.path.join(folder, text))
        try:
            if os.path.isfile(name):
                yield name
            elif key in FILE_KEYS and os.path.isdir(name):
                yield from (entry.path for entry in sorted(os.scandir(name), key=by_name) if entry.is_file())
        except ValueError:  # a NUL
            continue


FILE_KEYS = ("file", "files")
by_name = attrgetter("name")


def _texts(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Texts of a document, each with its key."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _texts(item, name)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item, key)


def matching_files(patterns: Sequence[str], folder: str, key: str, file: str | None) -> list[Path]:
    """Files that patterns relative to a folder name, sorted, each once. Raises InputError for a pattern without any."""
    results: dict[Path, None] = {}
    for pattern in patterns:
        named = [] if "\0" in pattern else glob(pattern, root_dir=folder, recursive=True)
        here = sorted(path for path in (Path(folder) / name for name in named) if path.is_file())
        if not here:
            raise InputError("names no file that exists", file=file, key=key, value=pattern)
        results |= dict.fromkeys(here)
    return list(results)
