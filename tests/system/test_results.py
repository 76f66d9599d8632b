"""The tables of docs/results.md, and those between marks of other pages, are what benchmarks wrote to their JSON."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

RESULTS = ROOT / "docs" / "results.md"
KEPT = {path.stem: json.loads(path.read_text("utf-8")) for path in (ROOT / "benchmarks" / "results").glob("*.json")}
Command = tuple[str, str]  # name of a benchmark or of a goal of make, and its arguments
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def marked_tables() -> Iterator[tuple[str, str, str]]:
    """Page, name and title, text of each table between marks."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        for mark, table in re.findall(r"<!-- (\w+: [\w ]+) -->\n(.*?)<!-- end of table -->", text, re.DOTALL):
            yield page.name, mark, table


def quoted_rows() -> Iterator[tuple[str, list[Command], str]]:
    """Rows of docs/results.md outside of marks that name a command, or mean the one before: row, commands, text."""
    text = re.sub(r"<!-- [\w]+: .*?<!-- end of table -->", "", RESULTS.read_text(encoding="utf-8"), flags=re.DOTALL)
    commands: list[Command] = []
    for line in text.splitlines():
        if not line.startswith("| "):
            continue
        named = re.findall(r"`(?:benchmarks/run\.py |make )([\w\-]+) ?([^`]*)`", line)
        if named or re.search(r"\| same \||\| the same \|", line):
            commands = named or commands
            cells = cells_of(line)
            said = cells[1] if len(cells) == 3 else cells[-1]
            yield cells[0], commands, re.sub(r"`[^`]*`|\[[^\]]*\]\([^)]*\)", "", said)


def numbers(command: Command) -> set[float]:
    """All that the JSON of a benchmark has for these arguments, or for any where it has none; without units."""
    runs = KEPT[command[0].replace("-", "_")]["runs"]
    chosen = [runs[command[1]]] if command[1] in runs else list(runs.values())
    texts = [line for run in chosen for line in run["lines"]]
    for table in (table for run in chosen for table in run["tables"].values()):
        texts += [cell for row in (table["columns"], *table["rows"]) for cell in row]
    return {float(found.replace(",", "")) for text in texts for found in NUMBER.findall(text)}


ONLY_ON_ITS_PAGE = "table: violations"
LENGTH = re.compile(r"[\d.]+ mm")


def is_among(shown: str, known: set[float]) -> bool:
    """Whether a number is one of these, rounded to the digits that are shown."""
    half = 0.5000001 * 10.0 ** -len(shown.partition(".")[2])
    return any(abs(float(shown.replace(",", "")) - value) <= half for value in known)


def written_tables(mark: str) -> list[dict[str, Any]]:
    """What benchmarks wrote for the table of a mark, in each of their runs that has it."""
    name, _, title = mark.partition(": ")
    runs = KEPT.get(name, {"runs": {}})["runs"].values()
    return [run["tables"][title] for run in runs if title in run["tables"]]


def test_every_marked_table_has_its_json() -> None:
    """The table of histories beyond their bound is exempt: it takes hours and is on its page alone."""
    assert {mark for _, mark, _ in marked_tables() if not written_tables(mark)} == {ONLY_ON_ITS_PAGE}


TABLES = [pytest.param(mark, text, id=mark) for _, mark, text in marked_tables() if mark != ONLY_ON_ITS_PAGE]


@pytest.mark.parametrize(("mark", "text"), TABLES)
def test_marked_tables_are_those_that_benchmarks_wrote(mark: str, text: str) -> None:
    tables = written_tables(mark)
    head, _, *rows = map(cells_of, text.strip().splitlines())
    assert head == tables[0]["columns"]
    assert sorted(rows) == sorted(row for table in tables for row in table["rows"])


@pytest.mark.parametrize(("row", "commands", "said"), [pytest.param(*row, id=row[0][:60]) for row in quoted_rows()])
def test_numbers_of_the_results_are_in_the_json_of_their_script(row: str, commands: list[Command], said: str) -> None:
    known = set().union(*map(numbers, commands))
    assert NUMBER.search(said)
    assert not [number for number in NUMBER.findall(said) if not is_among(number, known)]


def lengths_below_the_table(page: str) -> tuple[set[str], set[str]]:
    """Lengths in the remarks on the scenarios, and those in the cells of their table."""
    text = page.split("<!-- scenarios: plans -->\n")[1].split("\n## ")[0]
    table, _, remarks = text.partition("<!-- end of table -->")
    assert remarks.count("\n- *") >= 4
    return set(LENGTH.findall(remarks)), {cell for row in table.strip().splitlines()[2:] for cell in cells_of(row)}


def test_prose_below_the_table_of_scenarios_has_its_numbers() -> None:
    page = RESULTS.read_text(encoding="utf-8")
    said, known = lengths_below_the_table(page)
    assert said <= known
    written = next(cell for cell in sorted(known) if LENGTH.fullmatch(cell))
    told, known = lengths_below_the_table(page.replace("\n- *Joint ", f"\n- *1840 mm instead of {written}. Joint ", 1))
    assert told - known == {"1840 mm"}  # so that the law above can fail


def test_number_of_the_readme_past_the_ribs_is_that_of_the_table() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"is ([\d.]+) mm with it and ([\d.]+) mm without", text)
    plans = [run["tables"]["plans"]["rows"] for run in KEPT["scenarios"]["runs"].values() if "plans" in run["tables"]]
    goals = {row[1]: row[6] for rows in plans for row in rows if row[0] == "past the ribs"}
    assert shown == tuple(f"{float(goals[label].split()[0]):.1f}" for label in ("yes", "no"))


def test_documents_name_benchmarks_that_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    known: dict[str, Any] = importlib.import_module("run").benchmarks()
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        named = re.findall(r"benchmarks/run\.py (?:--write )?(\w+)", page.read_text(encoding="utf-8"))
        assert set(named) <= set(known), page.name


def test_every_benchmark_says_in_a_line_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    run = importlib.import_module("run")
    lines = run.listed().splitlines()
    assert len(lines) == len(run.benchmarks()) and all(re.fullmatch(r"\w+ +\w+ +\S.{20,}[.?]", line) for line in lines)
    python = [path for path in Path(ROOT / "benchmarks").rglob("*.py") if "__pycache__" not in path.parts]
    assert len(python) <= 35
