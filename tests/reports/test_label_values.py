"""Numbers of one name are equal: every label of a page, whatever element shows it, has one value."""

from __future__ import annotations

import re
from collections import defaultdict
from html.parser import HTMLParser
from pathlib import Path

import pytest
from made_up_input import FUZZ
from places import SCENARIOS
from small_scenarios import pair_past_a_sphere

import ctrplan
from ctrplan.reports.plan_page import plan_report_html
from ctrplan.reports.plan_scene import PlanScene, plan_scene

FILES = sorted(SCENARIOS.glob("*.toml"))
SAMPLE = ("pair_free",)  # of the suite, besides a pair past a sphere; all of them take three minutes
SPLIT = ", position"  # ends the name of a bound that has a direction beside it
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


class Labels(HTMLParser):
    """Values by label: of tiles, and of cells by the names of their row and, where there are several, their column."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.values: defaultdict[str, set[str]] = defaultdict(set)
        self._stack: list[str] = []
        self._text, self._tile, self._cells = "", [""] * 2, list[str]()
        self._header: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        kind = dict(attrs).get("class") or ""
        if tag in ("script", "style", "th", "td") or (tag, kind) == ("div", "tile"):
            self._text, self._stack = "", [*self._stack, tag if tag != "div" else "tile"]
        elif tag == "thead":
            self._header = []
        elif tag == "tr":
            self._cells = []

    def handle_data(self, data: str) -> None:
        self._text += data

    def handle_endtag(self, tag: str) -> None:
        text = " ".join(self._text.split())
        if self._stack and self._stack[-1] == "tile":
            if tag == "b":
                self._tile, self._text = [text, ""], ""
            elif tag == "div":
                self._stack.pop()
                self._note(text, self._tile[0])
        elif self._stack and self._stack[-1] == tag:
            self._stack.pop()
            if tag == "th":
                self._header.append(text)
            elif tag == "td":
                self._cells.append(text)
        elif tag == "tr" and len(self._cells) > 1:
            name, *values = self._cells
            columns = self._header[1:] if len(self._header) == len(self._cells) else [""] * len(values)
            for column, value in zip(columns, values, strict=True):
                self._note(name if column in ("", "Value") else f"{name}: {column}", value)
        elif tag == "table":
            self._header = []

    def _note(self, label: str, value: str) -> None:
        if NUMBER.search(value):
            self.values[label.removesuffix(SPLIT).casefold()].add(value)


def different(page: str) -> dict[str, set[str]]:
    """Labels that stand beside more than one value."""
    return {label: values for label, values in Labels(page).values.items() if len(values) > 1}


def test_a_label_with_two_values_is_seen() -> None:
    page = (
        '<div class="tile"><b>1.4 mm</b><span>Error</span></div><table><thead><tr><th>What</th><th>Value</th></tr>'
        "</thead><tbody><tr><td>error, position</td><td>1.5 mm</td></tr></tbody></table>"
    )
    assert different(page) == {"error": {"1.4 mm", "1.5 mm"}}


def judged(scene: PlanScene) -> None:
    page = plan_report_html(scene)
    labels = Labels(page).values
    assert len(labels) > 20 and not different(page)
    for value in {value for values in labels.values() for value in values}:
        for number in re.findall(r"(\d+\.\d+) mm", value):
            assert float(number) >= 0.001 or not float(number), value


@pytest.mark.parametrize("file", [f for f in FILES if FUZZ or f.stem in SAMPLE], ids=lambda file: file.stem)
def test_numbers_of_one_name_are_equal_on_shipped_plans(file: Path) -> None:
    """Also where targets are on the way, and where nothing is near."""
    brief = None if file.stem == "deploy" else "planner.time_s=0.2"
    judged(plan_scene(ctrplan.plan(ctrplan.load_scenario(file, [brief] if brief else []), seed=0), 4))


def test_numbers_of_one_name_are_equal_past_an_obstacle_to_a_target_of_the_tip() -> None:
    judged(plan_scene(ctrplan.plan(pair_past_a_sphere(time_s=0.2), seed=0), 4))


def test_numbers_of_one_name_are_equal_on_the_plan_made_by_hand(scene: PlanScene) -> None:
    judged(scene)
