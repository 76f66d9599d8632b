"""Runs a benchmark by name, prints what it finds and keeps it as JSON.

    python benchmarks/run.py --list                    # every benchmark, a line each
    python benchmarks/run.py NAME [ARGUMENT ...]       # --help tells the arguments of a benchmark
    python benchmarks/run.py --write NAME ...          # tables and pictures are put into the documents, too
    python benchmarks/run.py --json FILE NAME ...      # the JSON goes to another file

The JSON is benchmarks/results/NAME.json: for each list of arguments where and when it was measured, the tables that
were printed, by their titles, and the other lines. A table goes into a document between `<!-- NAME: TITLE -->` and
`<!-- end of table -->`. Benchmarks keep distance fields and friction laws under build/, apart from what a user has
tabulated, which would change what is planned.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, TextIO

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parent
END = "<!-- end of "  # of a table, how each such mark begins


class Tee:
    """A stream that keeps what it passes on."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self.text = stream, ""

    def write(self, text: str) -> int:
        self.text += text
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def benchmarks() -> dict[str, Path]:
    """Scripts by name: those that have a function `main`, in folders by subject."""
    files = {path.stem: path for path in sorted(FOLDER.glob("*/*.py"))}
    return {name: path for name, path in files.items() if "\ndef main(" in path.read_text(encoding="utf-8")}


def listed() -> str:
    """A line for each benchmark: the first sentence of its docstring."""
    lines = []
    for name, path in benchmarks().items():
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        lines.append(f"{path.parent.name:12} {name:20} {text.splitlines()[0]}")
    return "\n".join(sorted(lines))


def without_places(arguments: list[str]) -> str:
    """The arguments as one line, paths as what they end with."""
    return " ".join(Path(text).name if "/" in text else text for text in arguments)


def origin() -> dict[str, Any]:
    """Where and when something was measured."""
    commit = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    load = round(os.getloadavg()[0], 1)
    return {"commit": commit, "date": time.strftime("%Y-%m-%d"), "processors": os.cpu_count(), "load": load}


def keep(name: str, arguments: list[str], text: str, tables: dict[str, Any], began: dict[str, Any], file: Path) -> None:
    """Adds a run to the file of a benchmark: its tables, and what it printed beside them."""
    lines = [line for line in text.splitlines() if line.strip() not in tables and line[:1] not in ("", "|")]
    runs = json.loads(file.read_text(encoding="utf-8"))["runs"] if file.exists() else {}
    runs[without_places(arguments)] = {"measured": began, "tables": tables, "lines": lines}
    write_json(file, name, runs)


def write_json(file: Path, name: str, runs: dict[str, Any]) -> None:
    """Writes the runs of a benchmark, a row of a table and a line of text on a line of its own."""

    def flat(value: Any) -> str:
        return json.dumps(value, ensure_ascii=False)

    def block(values: list[Any], space: str) -> str:
        return "[" + ",".join(f"\n{space} {flat(value)}" for value in values) + "]"

    parts = []
    for arguments, run in runs.items():
        tables = ",".join(
            f'\n   {flat(title)}: {{"columns": {flat(table["columns"])}, "rows": {block(table["rows"], "   ")}}}'
            for title, table in run["tables"].items()
        )
        head = f'  {flat(arguments)}: {{"measured": {flat(run["measured"])},\n  "tables": {{{tables}}},\n'
        parts.append(f'{head}  "lines": {block(run["lines"], "  ")}}}')
    file.parent.mkdir(parents=True, exist_ok=True)
    text = f'{{"benchmark": {flat(name)}, "runs": {{\n' + ",\n".join(parts) + "\n}}\n"
    file.write_text(text, encoding="utf-8")


def put_into_documents(name: str, tables: dict[str, Any]) -> None:
    """Replaces the tables that documents have of this benchmark."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = old = page.read_text(encoding="utf-8")
        for title, table in tables.items():
            mark = f"<!-- {name}: {title} -->\n"
            if mark in text:
                before, rest = text.split(mark)
                rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
                new = "".join(f"| {' | '.join(row)} |\n" for row in rows)
                text = before + mark + new + rest[rest.index(END) :]
        if text != old:
            page.write_text(text, encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--write", action="store_true", help="put its tables into the documents")
    parser.add_argument("--json", type=Path, metavar="FILE", help="another file than benchmarks/results/NAME.json")
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)  # a benchmark that starts itself again
    parser.add_argument("name", nargs="?", metavar="NAME")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="ARGUMENT")
    given = parser.parse_args()
    if given.list:
        print(listed())
        return 0
    known = benchmarks()
    if given.name not in known:
        parser.error(f"no benchmark {given.name}: --list shows them")
    places = [FOLDER, known[given.name].parent, *(ROOT / "tests" / place for place in ("oracles", "support"))]
    sys.path[:0] = [str(place) for place in places]
    sys.argv = [f"run.py {given.name}", *given.arguments]
    os.environ["CTRPLAN_CACHE_DIR"] = str(ROOT / "build" / "benchmark-cache")
    os.environ["MPLBACKEND"] = "Agg"
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads only fight over small matrices
    common = importlib.import_module("common")
    common.is_writing[0] = given.write
    module, began = importlib.import_module(given.name), origin()
    shown = sys.stdout = Tee(sys.stdout)  # type: ignore[assignment]
    try:
        code = int(module.main() or 0)
    except importlib.import_module("ctrplan.errors").CtrplanError as error:
        sys.exit(f"{given.name}: {error}")
    sys.stdout = shown.stream
    if given.bare:
        return code
    file = given.json or FOLDER / "results" / f"{given.name}.json"
    keep(given.name, given.arguments, shown.text, common.tables, began, file)
    if given.write:
        put_into_documents(given.name, common.tables)
    return code


if __name__ == "__main__":
    sys.exit(main())
