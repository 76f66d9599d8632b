"""What `sha256sum -c SHA256SUMS` says of a folder."""

from __future__ import annotations

import hashlib
from pathlib import Path


def unmatched(folder: Path) -> tuple[str, ...]:
    """Names in the folder's SHA256SUMS whose files are missing or are not of the same set."""
    rows = [row.split("  ", 1) for row in (folder / "SHA256SUMS").read_text().splitlines()]
    return tuple(name for sha256, name in rows if not (folder / name).exists() or _sha256(folder / name) != sha256)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
