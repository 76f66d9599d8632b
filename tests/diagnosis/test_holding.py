"""What may speak against an effect that was found beside a rest, and what is told as another name for it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.diagnosis import CATALOGUE, block_evidence, partial_search, workbench
from ctrplan.diagnosis.block_evidence import (
    AT_REST,
    OF_MOTION,
    Evidence,
    Sides,
    Telling,
    evidence,
    in_its_place,
    telling_odds,
)
from ctrplan.diagnosis.block_evidence import _shift as shift
from ctrplan.diagnosis.cross_validation import Linear
from ctrplan.diagnosis.term_search import built_term
from ctrplan.effects.learned.inputs import InputRange, Target
from ctrplan.effects.learned.learned import named


@dataclass(frozen=True)
class Effect:
    needs: str = ""


@dataclass(frozen=True)
class Term:
    name: str
    variant: str = ""
    effect: Effect = field(default_factory=Effect)
    parameters: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Panel:
    """Sets are what they explain of every block."""

    explained: dict[frozenset[str], float]
    terms: tuple[Term, ...]

    def without(self, t: Term) -> Panel:
        return self

    def of(self, terms: list[Term]) -> frozenset[str]:
        return frozenset(t.name + t.variant for t in terms)

    def others(self, among: list[Term]) -> list[Term]:
        return [t for t in self.terms if t not in among]


LAG = Term("lag")
TWIN, FAR_TWIN = Term("drive_lag", "_theta"), Term("drive_lag", "_l")
REFINED = Term("creep", effect=Effect(needs="lag"))
FRAME, SOFT = Term("base_misalignment"), Term("sensor_distortion", parameters=(None,) * 61)
BETTER = Term("frame_shift")
OTHER = Term("backlash")
EXPLAINED = {
    frozenset[str](): 0.0,
    frozenset({"lag"}): 10.0,
    frozenset({"drive_lag_theta"}): 9.9,
    frozenset({"drive_lag_l"}): 0.5,
    frozenset({"creep"}): 0.0,
    frozenset({"base_misalignment"}): 10.0,
    frozenset({"sensor_distortion"}): 9.9,
    frozenset({"frame_shift"}): 30.0,
    frozenset({"backlash"}): 4.0,
    frozenset({"lag", "drive_lag_theta"}): 10.0,
    frozenset({"lag", "drive_lag_l"}): 10.0,
    frozenset({"lag", "creep"}): 10.1,
    frozenset({"lag", "backlash"}): 10.2,
}


@pytest.fixture(autouse=True)
def by_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def gains(bench: object, with_it: frozenset[str], without_it: frozenset[str]) -> Array:
        return (EXPLAINED[with_it] - EXPLAINED[without_it]) * np.array([0.9, 1.0, 1.1, 1.0])

    monkeypatch.setattr(block_evidence, "_gains", gains)
    monkeypatch.setattr(
        block_evidence, "_shift", lambda panel, among, t, other: 40.0 if other.name == "drive_lag" else 0.5
    )


def asked(*others: Term) -> Any:
    return evidence(None, sides(LAG, *others), LAG, 1.0)  # type: ignore[arg-type]


def sides(t: Term, *others: Term) -> Sides:
    panel: Any = Panel(EXPLAINED, (t, *others))
    return Sides(panel, [t], panel, [])  # type: ignore[list-item]


def test_what_does_as_well_in_its_place_does_not_speak_against_an_effect() -> None:
    found = asked(TWIN, OTHER)
    assert found.holds and found.weakest == "backlash" and found.shift < 1


def test_what_only_refines_an_effect_does_not_compete_with_it() -> None:
    assert asked(REFINED).weakest == "" and asked(REFINED).holds


def test_a_competitor_that_takes_its_parameters_away_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_evidence, "_shift", lambda *_: 40.0)
    assert asked(OTHER).doubts == ["beside backlash its parameters leave their intervals"]


def test_effects_in_its_place_come_best_first_each_in_its_best_variant() -> None:
    found = in_its_place(None, sides(LAG, FAR_TWIN, OTHER, REFINED, TWIN), LAG)  # type: ignore[arg-type]
    assert [(other.name, other.variant) for other, _, _ in found] == [("drive_lag", "_theta"), ("backlash", "")]  # type: ignore[attr-defined]


@pytest.mark.parametrize(("moves_far", "stands_out"), [(True, False), (True, True), (False, True)])
def test_a_frame_whose_place_something_takes_is_told_with_it_if_it_stands_out_beside_a_smooth_error(
    moves_far: bool, stands_out: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(partial_search, "_stands_out", lambda *_: stands_out)
    monkeypatch.setattr(partial_search, "_moves_far", lambda *_: moves_far)
    selector: Any = SimpleNamespace(bench=None, partial_bench=None)
    chosen: Any = None
    for others, is_name in (([], True), ([SOFT], stands_out), ([BETTER], False)):
        asked_of: Any = SimpleNamespace(term=FRAME, imitators=())
        assert partial_search._is_name(selector, chosen, sides(FRAME, *others), asked_of) == (is_name and moves_far)


@pytest.mark.parametrize(
    ("kind", "tube", "is_arbitrary"), [("sensor", 0, True), ("plate", 0, True), ("theta", 2, False)]
)
def test_a_frame_is_compared_with_the_constant_of_a_built_term_whose_zero_is_arbitrary(
    kind: str, tube: int, is_arbitrary: bool
) -> None:
    on, bench = Target(kind, tube), SimpleNamespace(robot=SimpleNamespace(n=2))
    slope = named(on, "slope_l_2")
    term = built_term(on, slope, {"l_2": InputRange(-0.1, 0.0)}, 2)
    names = [parameter.name for parameter in partial_search.with_zero(bench, term).parameters]  # type: ignore[arg-type]
    assert names == slope + (named(on, "constant") if is_arbitrary else [])
    twice = partial_search.with_zero(bench, partial_search.with_zero(bench, term))  # type: ignore[arg-type]
    assert [parameter.name for parameter in twice.parameters] == names


def test_an_effect_that_a_competitor_leaves_little_of_is_one_of_several(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXPLAINED, frozenset({"backlash"}), 8.9)
    monkeypatch.setitem(EXPLAINED, frozenset({"lag", "backlash"}), 8.8)
    found = asked(OTHER)
    assert found.imitators == (OTHER,) and found.is_one_of_several and not found.holds
    assert found.doubts == ["beside backlash little of its gain is left"]
    monkeypatch.setattr(block_evidence, "_shift", lambda *_: 40.0)
    assert not asked(OTHER).is_one_of_several  # more speaks against it than that


@dataclass(frozen=True)
class Named:
    name: str


def shift_beside(likeness: float, size: float, count: int) -> Array:
    """(D,) shifts of an effect that is there by one like it of that size, in draws of the noise."""
    rng, found = np.random.default_rng(6), []
    one, other = Term("one", parameters=(Named("x"),)), Term("other", parameters=(Named("x"),))
    mine, its = np.linalg.qr(rng.standard_normal((100, 2)))[0].T * 10
    its = likeness * mine + np.sqrt(1 - likeness**2) * its
    for _ in range(count):
        r = (5 * mine + size * its + rng.standard_normal(100)).reshape(20, 5)
        J = np.stack([mine, its], axis=1).reshape(20, 5, 2)
        whole = Linear(r, J, np.ones(20), np.full(2, 1e-6), np.zeros(2), np.ones((20, 5), bool))
        panel = workbench.Linearisation((("one", "x"), ("other", "x")), whole, ())
        found.append(shift(panel, [one], one, other))  # type: ignore[arg-type, list-item]
    return np.array(found)


@pytest.mark.parametrize("likeness", [0.0, 0.7, 0.99])
def test_chance_moves_parameters_within_their_intervals_however_alike_a_competitor_is(likeness: float) -> None:
    assert np.mean(shift_beside(likeness, 0.0, 100) > 2) < 0.08


def test_a_competitor_that_is_there_moves_them_further() -> None:
    assert shift_beside(0.9, 5.0, 10).min() > 3


def told(odds: float, z: float, telling: Telling | None, winning: float = 0.8) -> Evidence:
    """By blocks that say too little."""
    t: Any = LAG
    return Evidence(t, 40.0, 15.0, z, 10.0, winning, np.inf, "", (), 0.0, "", odds, telling)


@pytest.mark.parametrize(
    ("odds", "z", "telling", "holds"),
    [
        (12.5, 3.1, AT_REST, True),
        (11.5, 3.1, AT_REST, False),
        (12.5, 2.9, AT_REST, False),
        (30.5, 2.1, OF_MOTION, True),
        (29.0, 3.1, OF_MOTION, False),
        (500.0, 3.1, None, False),
    ],
)
def test_odds_tell_an_effect_although_blocks_say_little(
    odds: float, z: float, telling: Telling | None, holds: bool
) -> None:
    found = told(odds, z, telling)
    assert found.holds == found.is_told_by_odds == holds


def test_what_blocks_tell_needs_odds_as_well() -> None:
    by_blocks = [replace(told(odds, 6.0, AT_REST, winning=1.0), gain=400.0) for odds in (8.0, 6.0)]
    assert [one.holds for one in by_blocks] == [True, False]
    assert "odds of exp(6)" in by_blocks[1].doubts[0] and not by_blocks[0].is_told_by_odds


def test_odds_tell_all_but_frames_at_rest_and_on_a_motion_what_acts_by_it() -> None:
    at_rest = {
        name: telling_odds(of_catalogue(name), is_stream=False) for name in ("lag", "drift", "base_misalignment")
    }
    assert at_rest == {"lag": AT_REST, "drift": AT_REST, "base_misalignment": None}
    moving = {name: telling_odds(of_catalogue(name), is_stream=True) for name in ("lag", "friction", "drift")}
    assert moving == {"lag": OF_MOTION, "friction": OF_MOTION, "drift": None}


def of_catalogue(name: str) -> Any:
    return SimpleNamespace(name=name, effect=CATALOGUE[name])
