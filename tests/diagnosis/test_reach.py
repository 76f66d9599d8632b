"""What is not tried for good: pieces that could not close enough of a rest, effects far below what is needed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from measured_data import SIGMA_M, measured, pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.partial_search import PartialSelector
from ctrplan.diagnosis.term_dictionary import TermPiece, pieces
from ctrplan.diagnosis.term_search import WideLinearisation, grown, reach, wide_linearisation
from ctrplan.diagnosis.workbench import Scored, candidates
from ctrplan.effects.effect import CATALOGUE

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 12)


DATA = measured(ROBOT, PLAN)
NOISE = Noise(SIGMA_M, 1e-3)


def bench_with(error_m: Array) -> CorrelatedBench:
    """Residuals of poses that are read with an error (K, 3) besides."""
    data = replace(DATA, position_m=DATA.position_m + error_m)
    return CorrelatedBench(ROBOT, data, NOISE, PLAN.configuration, PLAN.configuration % 6)


def traded_m() -> Array:
    """(K, 3) an error that every configuration has of its own, so that nothing explains it."""
    own: Array = np.random.default_rng(4).standard_normal((int(PLAN.configuration.max()) + 1, 3)) * 2e-3
    return own[PLAN.configuration]


@cache
def by_place() -> tuple[CorrelatedBench, Scored, WideLinearisation, tuple[TermPiece, ...]]:
    """An error in proportion to how far the tip is to the side, which pieces of the sensor have the form of."""
    bench = bench_with(0.1 * DATA.position_m[:, :1] * np.array([[0.0, 0.0, 1.0]]))
    here = bench.begun()
    known = tuple(pieces(ROBOT, bench.data))
    return bench, here, wide_linearisation(bench, here, known), known


def test_more_pieces_never_reach_less_and_none_nothing() -> None:
    bench, _, table, known = by_place()
    found = [reach(bench, table, known, most) for most in (0, 1, 2, 3)]
    assert found[0] == 0 and found == sorted(found) and found[1] > 0.8


def test_chance_is_out_of_reach_and_what_pieces_have_the_form_of_is_not() -> None:
    bench, _, table, known = by_place()
    traded = bench_with(traded_m())
    here = traded.begun()
    others = pieces(ROBOT, traded.data)
    assert reach(traded, wide_linearisation(traded, here, others), others, 4) < 0.5 < reach(bench, table, known, 4)


def test_a_search_out_of_reach_fits_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, here, _, known = by_place()
    monkeypatch.setattr(CorrelatedBench, "scored", lambda *_: pytest.fail("it was fitted"))
    found, rounds = grown(bench, here, known, lambda _: None, lambda one: one, least=1.1)
    assert found is here and not rounds


def test_effects_far_below_what_is_needed_are_told_and_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = bench_with(traded_m())
    few = {name: CATALOGUE[name] for name in ("backlash", "tip_load", "joint_scale")}
    selector = PartialSelector(bench, candidates(ROBOT, bench.data, few), lambda _: None)
    monkeypatch.setattr(CorrelatedBench, "scored", lambda *_: pytest.fail("it was fitted"))
    found = selector.run()
    (step,) = found.path
    assert not found.chosen.terms and not step.taken and step.gain < step.threshold
