"""A CSV file of numbers as others would read it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ctrplan.base.arrays import Array


def csv_columns(path: Path) -> dict[str, Array]:
    """Columns by their header, each (T,)."""
    header, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
    return dict(zip(header, np.array(rows, dtype=np.float64).T, strict=True))
