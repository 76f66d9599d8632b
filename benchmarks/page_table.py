"""A table that a benchmark puts into a page of the documents, between two markers."""

from __future__ import annotations

from pathlib import Path


def put_into_page(page: Path, begin: str, text: str, end: str) -> None:
    """Replaces what stands between the marker `begin` and the next `end`."""
    before, rest = page.read_text(encoding="utf-8").split(begin)
    page.write_text(before + begin + text + end + rest.split(end, 1)[1], encoding="utf-8")
