"""case.json: what a case was asked for, and what each of its files was made from, so that a rerun does what changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ctrplan.cases.request import Request
from ctrplan.errors import InputError
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.file_bytes import file_bytes

FILE = "case.json"
LARGEST_FILE_BYTES = 5_000_000


@dataclass
class Made:
    """One step's result: the key of what it was made from, and the hash of each file as it was written."""

    key: str = ""
    files: dict[str, str] = field(default_factory=dict)
    sentence: str = ""
    pending: bool = False  # begun, and perhaps killed
    chosen: int = 1  # row of bases.csv


class Record:
    """The file in a case's folder."""

    def __init__(self, folder: Path) -> None:
        """Reads it where it is there. Raises InputError for a file that is none of a case."""
        self.folder, self.request, self.steps = folder, Request(), dict[str, Made]()
        self.is_new = not (folder / FILE).exists()
        if self.is_new:
            return
        text = file_bytes(str(folder / FILE), LARGEST_FILE_BYTES, "JSON", "record of a case")
        try:
            content = json.loads(text)
            self.request = Request.of(content["request"])
            self.steps = {name: Made(**made) for name, made in content["steps"].items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError("is no record of a case: remove it to begin anew", file=folder / FILE) from None

    def write(self) -> None:
        """Writes the file, whole."""
        request = {name: value for name, value in vars(self.request).items() if value is not None}
        steps = {name: vars(made) for name, made in self.steps.items()}
        write_atomically(self.folder / FILE, json.dumps({"request": request, "steps": steps}, indent=1) + "\n")

    def edited(self, name: str) -> list[str]:
        """Files of a step that are not as it wrote them."""
        made = self.steps.get(name, Made())
        if made.pending:
            return []
        return [file for file, digest in made.files.items() if digest_of(self.folder / file) != digest]

    def begin(self, name: str) -> None:
        """Notes that a step's files are about to be written: what a kill leaves is nobody's edit."""
        self.steps[name] = Made(pending=True)
        self.write()

    def end(self, name: str, key: str, files: Mapping[str, str], sentence: str, chosen: int = 1) -> None:
        """Notes that they are there."""
        self.steps[name] = Made(key, dict(files), sentence, chosen=chosen)
        self.write()


def digest_of(path: Path) -> str:
    """Hash of a file's bytes; empty where there is none."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def key_of(*parts: Any) -> str:
    """One hash of what JSON can say."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def stamp_of(path: Path) -> list[Any]:
    """What changes when a file does that is too large to be hashed each time; of folders what their files say."""
    if path.is_dir():
        return [stamp_of(each) for each in sorted(path.iterdir()) if each.is_file()]
    try:
        told = path.stat()
        return [str(path.resolve()), told.st_size, told.st_mtime_ns]
    except OSError:
        return [str(path), 0, 0]
