"""Runs the notebooks of examples/ without Jupyter and keeps what their cells show: `python tools/notebooks.py`.

A cell's last expression is shown as Jupyter would: its table or page, or else its picture, and its text.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[1] / "examples"
LONGEST_HTML = 20_000  # letters of a table that is kept; pages and scenes are made again by whoever runs the cell
DPI = 80


def run(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The notebook with the outputs of its code cells, run one after the other in `folder`."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = []
    with contextlib.chdir(folder):
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                cell = {**cell, "outputs": outputs("".join(cell["source"]), names), "execution_count": None}
            cells.append(cell)
    return {**notebook, "cells": cells}


def outputs(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """What a cell prints and shows."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    result: list[dict[str, Any]] = []
    if printed.getvalue():
        result.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)})
    if value is not None:
        result.append({"output_type": "execute_result", "data": shown(value), "metadata": {}, "execution_count": None})
    return result


def shown(value: Any) -> dict[str, Any]:
    """A value by the kinds of content in which a notebook keeps it."""
    if hasattr(value, "savefig"):
        stream = io.BytesIO()
        value.savefig(stream, format="png", dpi=DPI)
        return {"image/png": base64.b64encode(stream.getvalue()).decode(), "text/plain": ["a figure"]}
    if type(value).__module__.startswith("plotly"):
        return {"text/plain": ["a scene that turns: run the cell to see it"]}
    data: dict[str, Any] = {"text/plain": repr(value).splitlines(keepends=True)}
    page = value._repr_html_() if hasattr(value, "_repr_html_") else ""
    if page and len(page) <= LONGEST_HTML:
        data["text/html"] = page.splitlines(keepends=True)
    return data


def main() -> None:
    """Runs all of them where they stand."""
    for path in sorted(EXAMPLES.glob("*.ipynb")):
        made = run(json.loads(path.read_text(encoding="utf-8")), path.parent)
        path.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        sys.stdout.write(f"{path.name}\n")


if __name__ == "__main__":
    main()
