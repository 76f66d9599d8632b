"""A refusal for lack of clearance says how much of it is anatomy, how much friction and how much allowances."""

from __future__ import annotations

import re
from typing import Any

import pytest
from places import SCENARIOS

from ctrplan.errors import NoAnswerError
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.planning.planner import plan

NAMES = ("rotate outer", "rotate middle", "rotate inner", "translate inner")
CLEAR, NEAR = (0, 60, 110, -20), (0, 60, 110, -30)  # of the sphere
SHARES = re.compile(
    r"comes (\d+\.\d+) mm too close to the anatomy \(the frictionless one is (-?\d+\.\d+) mm beyond the margins, "
    r"friction takes (\d+\.\d+), allowances (\d+\.\d+)\)\.$"
)


def refusal(start: tuple[float, ...], goal: dict[str, Any]) -> str:
    content = {
        "name": "past a sphere",
        "robot": "robots/three_tube.toml",
        "start": joints(start),
        "goal": goal,
        "anatomy": [{"kind": "sphere", "center_mm": [60, 32, 165], "radius_mm": 18.6, "margin_mm": 0.5}],
    }
    with pytest.raises(NoAnswerError) as caught:
        plan(scenario_from_dict(content, file=str(SCENARIOS / "example.toml")))
    return str(caught.value)


def joints(values: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(NAMES, values, strict=True))


@pytest.mark.parametrize(
    ("start", "goal", "where"),
    [(NEAR, {"joints": joints(CLEAR)}, "start: "), (CLEAR, {"joints": joints(NEAR)}, "goal.joints: ")],
)
def test_shares_add_up_to_what_is_missing(start: tuple[float, ...], goal: dict[str, Any], where: str) -> None:
    sentence = refusal(start, goal)
    assert where in sentence and "\n" not in sentence
    found = SHARES.search(sentence)
    assert found, sentence
    short, nominal, friction, allowed = map(float, found.groups())
    assert nominal - friction - allowed == pytest.approx(-short, abs=0.02)
    assert nominal > 0 and friction > 0
