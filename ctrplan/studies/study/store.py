"""The folder of a study: rows are appended as they come, so that a kill at any moment loses none that was finished.

tasks.keys: the keys of all tasks in their order. rows.jsonl: a line for each row; of several with one key the last
holds. A line that a kill cut off is taken away when the file is opened again.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ctrplan.errors import CtrplanError, InputError
from ctrplan.storage.output_folder import output_folder, write_atomically
from ctrplan.studies.study.task import KEY_BYTES, KEY_DIGITS, TaskRow

COLUMNS = tuple(field.name for field in fields(TaskRow) if field.name != "files")
BEGIN, DONE = b'{"key": "', b'"status": "done"'
_written = json.JSONEncoder(ensure_ascii=False).encode


@dataclass(frozen=True)
class Lines:
    """Lines of some tasks, each with its end, and the files that are kept beside them."""

    text: bytes
    files: Mapping[int, Mapping[str, bytes]] = field(default_factory=dict)  # content by name, by place in the table

    @classmethod
    def of(cls, rows: Sequence[TaskRow]) -> Lines:
        """The lines of rows, in their order."""
        lines = [_written({name: getattr(row, name) for name in COLUMNS}) + "\n" for row in rows]
        return cls("".join(lines).encode(), {row.index: row.files for row in rows if row.files})

    def __len__(self) -> int:
        """Number of rows."""
        return self.text.count(b"\n")

    def __iter__(self) -> Iterator[bytes]:
        """Line by line."""
        return iter(self.text.splitlines(keepends=True))


def key_of(line: bytes) -> bytes | None:
    """The key of a whole line; None for what is none."""
    if not (line.endswith(b"\n") and line.startswith(BEGIN)):
        return None
    try:
        return bytes.fromhex(line[len(BEGIN) : len(BEGIN) + KEY_DIGITS].decode())
    except ValueError:
        return None


STUDY, KEYS, ROWS, LOCK, PLANS = "study.json", "tasks.keys", "rows.jsonl", ".lock", "plans"
PARQUET, CSV, REPORT = "results.parquet", "results.csv", "report.html"


class Store:
    """A study's folder; with `open_for_work` nobody else may write into it."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        """Touches nothing."""
        self.folder = Path(folder)
        self.rows_file: int | None = None
        self.lock: int | None = None
        self.offsets: dict[bytes, int] = {}  # where the last row of each key begins
        self.failed: dict[bytes, str] = {}  # status of the tasks that are not done
        self.elapsed_s: dict[bytes, float] = {}  # of those that timed out
        self.end = 0

    def open_for_work(self) -> None:
        """Makes the folder, locks it and finds the rows that it has. Raises InputError, CtrplanError."""
        output_folder(os.fspath(self.folder), [ROWS, STUDY, KEYS], [REPORT, PARQUET, CSV])  # ROWS is made first
        with self.writing(""):
            self.folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            self.rows_file = os.open(self.folder / ROWS, os.O_RDWR | os.O_CREAT, 0o644)
            self.find_rows()
            os.ftruncate(self.rows_file, self.end)

    def close(self) -> None:
        """Lets others write."""
        if self.rows_file is not None:
            os.close(self.rows_file)
            self.rows_file = None
        if self.lock is not None:
            os.close(self.lock)
            self.lock = None

    def definition(self) -> dict[str, Any] | None:
        """What study.json says; None where there is none. Raises InputError."""
        place = self.folder / STUDY
        if not place.exists():
            return None
        try:
            content: dict[str, Any] = json.loads(place.read_text(encoding="utf-8"))
            if not isinstance(content, dict) or "parts" not in content:
                raise ValueError("it says nothing of parts")
        except (OSError, ValueError) as error:
            raise InputError(f"is no study that could be read ({error})", file=str(place)) from None
        return content

    def write_definition(self, content: Mapping[str, Any]) -> None:
        """Writes study.json."""
        write_atomically(self.folder / STUDY, json.dumps(content, indent=1, ensure_ascii=False) + "\n")

    def write_keys(self, keys: Iterable[str]) -> int:
        """Writes the keys of all tasks in their order; returns how many there are."""
        count, place = 0, self.folder / KEYS
        with self.writing(KEYS), open(f"{place}.tmp", "wb") as file:
            for key in keys:
                file.write(bytes.fromhex(key))
                count += 1
            file.flush()
            os.replace(f"{place}.tmp", place)
        return count

    def keys(self) -> Iterator[bytes]:
        """The keys of all tasks in their order."""
        with open(self.folder / KEYS, "rb") as file:
            while key := file.read(KEY_BYTES):
                yield key

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows that there are, each as its line has it, in the order of their tasks."""
        with open(self.folder / ROWS, "rb") as file:
            for index, key in enumerate(self.keys()):
                offset = self.offsets.get(key)
                if offset is not None:
                    file.seek(offset)
                    yield {**json.loads(file.readline()), "index": index}

    def row(self, key: bytes) -> dict[str, Any]:
        """The row of a task that has one."""
        with open(self.folder / ROWS, "rb") as file:
            file.seek(self.offsets[key])
            row: dict[str, Any] = json.loads(file.readline())
            return row

    def add(self, lines: Lines) -> None:
        """Appends rows, and writes the files that belong to them. Raises CtrplanError where the system refuses."""
        for index, files in lines.files.items():
            for name, data in files.items():
                self.write_plan(index, name, data)
        with self.writing(ROWS):
            self._append(lines.text)
        for line in lines:
            key = key_of(line)
            assert key is not None
            self._note(key, line)

    def write_plan(self, index: int, name: str, data: bytes) -> None:
        """Writes a file of the plan of a task."""
        with self.writing(PLANS):
            self.plan_folder(index).mkdir(parents=True, exist_ok=True)
        write_atomically(self.plan_folder(index) / name, data)

    def plan_folder(self, index: int) -> Path:
        """Where the plan of a task is kept."""
        return self.folder / PLANS / f"{index:06d}"

    def _take_lock(self) -> None:
        self.lock = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise InputError("another process works on this folder", key="--output", value=str(self.folder)) from None
        except OSError:  # no locks here, for anybody
            pass

    def find_rows(self) -> None:
        """Reads where rows begin, as far as there are whole lines: a kill may have cut off the last one."""
        self.end = 0
        with open(self.folder / ROWS, "rb") as file:
            for line in file:
                key = key_of(line)
                if key is None:
                    break
                self._note(key, line)

    def _note(self, key: bytes, line: bytes) -> None:
        """Where a row begins, and what became of its task."""
        self.offsets[key] = self.end
        self.end += len(line)
        self.failed.pop(key, None)
        if DONE not in line:
            row = json.loads(line)
            self.failed[key] = row["status"]
            if row["status"] == "timed out":
                self.elapsed_s[key] = row["elapsed_s"]

    def _append(self, data: bytes) -> None:
        """All of it, or none where the disk is full."""
        assert self.rows_file is not None
        written = 0
        try:
            while written < len(data):
                written += os.pwrite(self.rows_file, data[written:], self.end + written)
        except OSError:
            os.ftruncate(self.rows_file, self.end)
            raise

    @contextmanager
    def writing(self, name: str) -> Iterator[None]:
        """Errors of the system about a file of the folder, or about it with no name, as one sentence (CtrplanError)."""
        try:
            yield
        except OSError as error:
            rule = f"could not be written: {error.strerror or error}; what is in it stays, the study can be run again"
            raise CtrplanError(f"{self.folder / name if name else self.folder}: {rule}.") from error
