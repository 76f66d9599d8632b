"""Rows as the lines of a study's folder: written once, where the task was done, and kept as they are."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields

from ctrplan.studies.study.task import KEY_DIGITS, Row

COLUMNS = tuple(field.name for field in fields(Row) if field.name != "files")
BEGIN, DONE = b'{"key": "', b'"status": "done"'
_written = json.JSONEncoder(ensure_ascii=False).encode


@dataclass(frozen=True)
class Lines:
    """Lines of some tasks, each with its end, and the files that are kept beside them."""

    text: bytes
    files: Mapping[int, Mapping[str, bytes]] = field(default_factory=dict)  # content by name, by place in the table

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Lines:
        """Of rows, in their order."""
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
