"""Terms of one's own in the cost of a plan: integrated along motions, heeded by every part of planning, named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError, UserFunctionError
from ctrplan.plans.plan import plan_to_json

FREE = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
TURNING = FREE.robot.drive.is_rotation


def broken(states: Array) -> Array:
    return states[:, 99]


def changing(states: Array) -> Array:
    states[:, 0] = 0.0
    return np.ones(len(states))


def late(states: Array) -> Array:
    """Broken beside the start, where a search comes by its planner's own way: through OMPL."""
    if np.any(np.abs(states - FREE.start) > 0.2):
        raise KeyError("mine")
    return np.zeros(len(states))


@pytest.mark.parametrize(
    ("function", "cause", "said"),
    [
        (
            broken,
            IndexError,
            r"term mine: IndexError: index 99 is out of bounds .* \(line \d+ of test_cost_terms\.py\)\.",
        ),
        (changing, ValueError, r"term mine: ValueError: assignment destination is read-only \(line"),
        (late, KeyError, r"term mine: KeyError: 'mine' \(line"),
        (lambda: 0.0, TypeError, r"term mine: TypeError: .*takes 0 positional arguments but 1 was given\.$"),
    ],
)
def test_what_a_function_of_ones_own_raises_is_said_with_its_name(function: Any, cause: type, said: str) -> None:
    with pytest.raises(UserFunctionError, match=said) as caught:
        ctrplan.plan(FREE, time_s=0.2, terms=[ctrplan.CostTerm("mine", 1.0, function)])
    assert isinstance(caught.value.__cause__, cause)


def test_a_term_that_changes_its_mind_is_refused() -> None:
    rng = np.random.default_rng(0)
    term = ctrplan.CostTerm("mine", 1.0, lambda states: rng.random(len(states)))
    with pytest.raises(
        InputError, match=r"term mine: must be a function of the states: of one state it says 0\.\d+, then"
    ):
        ctrplan.plan(FREE, time_s=0.2, terms=[term])


def one(states: Array) -> Array:
    return np.ones(len(states))


def test_a_term_is_the_integral_along_the_joint_length() -> None:
    """A term of 1 costs the length, whatever the stations; of a value that grows evenly it is that in the middle."""
    a, b = FREE.start, FREE.goal.joints
    assert b is not None
    terms = [
        ctrplan.CostTerm("length", 2.0, one),
        ctrplan.CostTerm("even", 1.0, lambda q: np.linalg.norm(q - a, axis=1)),
        ctrplan.CostTerm("nothing", 0.0, one),
    ]
    plain, checker = ctrplan.MotionChecker(FREE), ctrplan.MotionChecker(replace(FREE, terms=tuple(terms)))
    turned = np.where(TURNING, b, a)
    before, motion = plain.along(np.array([a, turned])), checker.along(np.array([a, turned]))
    per_rad = FREE.cost.mm_per_rad
    length, even, nothing = motion.terms_mm
    assert motion.valid and length == pytest.approx(2 * motion.length_mm / per_rad)
    assert even == pytest.approx(np.linalg.norm(turned - a) / 2 * motion.length_mm / per_rad)
    assert nothing == 0
    for at_goal in (True, False):
        extra = checker.cost_mm(motion, ends_at_goal=at_goal) - plain.cost_mm(before, ends_at_goal=at_goal)
        assert extra == pytest.approx(length + even)
    whole, first, last = (checker.along(np.array(way)).terms_mm for way in ([a, turned, b], [a, turned], [turned, b]))
    np.testing.assert_allclose(whole, np.add(first, last))  # a path costs what its motions cost
    assert checker.state(a).terms_mm == ()


MIDDLE = np.array([np.pi / 6, -1.4])  # of the rotations on the way that is the shortest


def avoided(states: Array) -> Array:
    """Dear within about 0.3 rad of it."""
    return np.exp(-((states[:, TURNING] - MIDDLE) ** 2).sum(axis=1) / 0.3**2)


@pytest.fixture(scope="module")
def plans() -> tuple[ctrplan.Plan, ctrplan.Plan]:
    """Without a term and with it, by counted seconds: the same anywhere."""
    case, dear = FREE.with_("planner.time_s=0.6"), ctrplan.CostTerm("avoided", 1000.0, avoided)
    return ctrplan.plan(case), ctrplan.plan(case, terms=[dear])


def term_mm(plan: ctrplan.Plan) -> float:
    checker = ctrplan.MotionChecker(replace(FREE, terms=(ctrplan.CostTerm("avoided", 1000.0, avoided),)))
    (cost,) = checker.along(plan.waypoints).terms_mm
    return cost


def test_the_search_heeds_a_term(plans: tuple[ctrplan.Plan, ctrplan.Plan]) -> None:
    plain, heeding = plans
    assert heeding.certificate.valid and term_mm(plain) > 200
    assert term_mm(heeding) < 0.1 * term_mm(plain)
    assert heeding.certificate.cost_mm > plain.certificate.cost_mm  # the way round is longer
    bare = ctrplan.certify(heeding.scenario.with_(terms=()), heeding.waypoints)
    assert heeding.certificate.cost_mm == pytest.approx(bare.cost_mm + term_mm(heeding))
    assert heeding.reorder.cost_after_mm <= heeding.reorder.cost_before_mm + 1e-6


def test_reports_name_the_term(plans: tuple[ctrplan.Plan, ctrplan.Plan], tmp_path: Path) -> None:
    plain, heeding = plans
    assert list(heeding.reorder.terms_after_mm) == ["avoided"] and not plain.reorder.terms_after_mm
    ways = {way.name: way.terms_mm for way in heeding.reorder.alternatives if not way.problem}
    assert ways and all(list(terms) == ["avoided"] for terms in ways.values())
    folder = heeding.save(tmp_path / "out")
    assert "Of the cost, avoided" in (folder / "report.html").read_text(encoding="utf-8")
    assert json.loads((folder / "plan.json").read_text())["reorder"]["terms_after_mm"].keys() == {"avoided"}
    assert ctrplan.open_plan(folder).reorder.terms_after_mm == pytest.approx(heeding.reorder.terms_after_mm)
    assert plan_to_json(plain)["reorder"]["terms_after_mm"] == {}


@pytest.mark.parametrize(
    ("sentence", "term"),
    [
        ("term below = .* must be .* finite numbers, one a state, zero or more", ("below", 1.0, lambda q: -one(q))),
        ("term short = .* must be .* finite numbers", ("short", 1.0, lambda q: one(q)[:1])),
        ("term none = .* finite numbers", ("none", 1.0, lambda q: np.nan * one(q))),
        ("weight of w = -1: must be from 0", ("w", -1, one)),
        ("of_states of w = 3: must be a function", ("w", 1, 3)),
    ],
)
def test_terms_below_their_bound_are_refused(sentence: str, term: tuple[str, float, object]) -> None:
    with pytest.raises(InputError, match=sentence):
        ctrplan.plan(FREE, time_s=0.5, terms=[ctrplan.CostTerm(*term)])  # type: ignore[arg-type]


def test_names_are_given_once() -> None:
    with pytest.raises(InputError, match="is the name of two terms"):
        ctrplan.plan(FREE, terms=[ctrplan.CostTerm("a", 1, one)] * 2)
