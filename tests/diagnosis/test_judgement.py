"""The verdict goes by the probability that something unknown acts, beside named effects and beside none."""

from __future__ import annotations

from math import log
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from measured_data import pair_robot

from ctrplan.diagnosis import CATALOGUE, verdict
from ctrplan.diagnosis.verdict import Hypothesis, Judgement, Posterior, judge
from ctrplan.diagnosis.workbench import candidates
from ctrplan.pipeline.term import Term, term


def judged(unknown: float, *names: str) -> Judgement:
    """The verdict on a set of effects that certainly act, and something unknown besides with a probability."""
    robot = pair_robot()
    terms = tuple(term(CATALOGUE[name], [p.name for p in CATALOGUE[name].parameters(robot)], robot) for name in names)
    chosen = fitted(*terms)
    acts = frozenset(names)
    return judged_by(
        Posterior((Hypothesis(acts, False, log(1 - unknown)), Hypothesis(acts, True, log(unknown)))), chosen
    )


def fitted(*terms: Term) -> Any:
    """A set of effects, as if it were fitted."""
    chain = SimpleNamespace(terms=(SimpleNamespace(name="calibration"), *terms))
    names = tuple(t.name for t in terms)
    return SimpleNamespace(terms=terms, names=names, failed=np.zeros(4, dtype=bool), fit=SimpleNamespace(chain=chain))


def judged_by(posterior: Posterior, chosen: Any) -> Judgement:
    robot = pair_robot()
    return judge(cast(Any, None), chosen, candidates(robot, cast(Any, None), {}), posterior, ())


@pytest.fixture(autouse=True)
def no_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "remains", lambda bench, chosen: None)
    monkeypatch.setattr(verdict, "_is_strained", lambda bench, chosen: False)
    monkeypatch.setattr(verdict, "_is_shared", lambda bench, chosen, t: False)


@pytest.mark.parametrize(("unknown", "said"), [(0.2, "no_missing_effect"), (0.8, "unexplained")])
def test_nothing_is_missing_where_nothing_unknown_acts(unknown: float, said: str) -> None:
    assert judged(unknown).verdict == said


@pytest.mark.parametrize(("unknown", "said"), [(0.2, "named"), (0.8, "unexplained")])
def test_an_effect_is_named_where_nothing_unknown_acts_beside(unknown: float, said: str) -> None:
    result = judged(unknown, "tip_load")
    assert result.verdict == said
    assert [finding.term.name for finding in result.findings] == (["tip_load"] if said == "named" else [])
    assert any("unknown acts beside tip_load, probability 0.8" in note for note in result.notes) == (said != "named")


def test_nothing_is_missing_only_where_that_is_more_probable_than_not() -> None:
    """The most probable set has no effect, the posterior over all sets has one, and does not know which."""
    acts = {"homing_offset": 0.23, "off_plane_precurvature": 0.37}
    sets = [Hypothesis(frozenset({name}), False, log(probability)) for name, probability in acts.items()]
    unknown = Hypothesis(frozenset(), True, log(0.4))
    result = judged_by(Posterior((unknown, *sets)), fitted())
    assert result.verdict == "unexplained" and not result.findings
    assert [name for name in acts if name in result.notes[0]] == list(acts) and "unknown" in result.notes[0]


@pytest.mark.parametrize(("nothing", "is_done"), [(0.4, True), (0.6, False)])
def test_what_is_more_probably_done_than_not_is_handed_over_without_a_name(nothing: float, is_done: bool) -> None:
    """Look-alikes share what acts, so that neither has a name; a robot with the likelier one is nearer all the same."""
    robot, effect = pair_robot(), CATALOGUE["off_plane_precurvature"]
    chosen = fitted(term(effect, [p.name for p in effect.parameters(robot)], robot))
    acts = {"off_plane_precurvature": 0.5, "gravity": 0.3, "ovality": 0.1, "tip_load": 0.1}
    sets = [Hypothesis(frozenset({name}), False, log(p * (1 - nothing))) for name, p in acts.items()]
    result = judged_by(Posterior((*sets, Hypothesis(frozenset(), True, log(nothing)))), chosen)
    names = [t.name for t in result.together]
    assert result.verdict == "unexplained" and not result.findings
    assert names == (["off_plane_precurvature"] if is_done else [])


def test_of_a_set_only_what_is_more_probably_done_than_not_is_handed_over() -> None:
    """Where one effect probably acts and another beside it does not, the robot has the first alone."""
    robot, names = pair_robot(), ("off_plane_precurvature", "gravity")
    chosen = fitted(*(term(CATALOGUE[n], [p.name for p in CATALOGUE[n].parameters(robot)], robot) for n in names))
    sets = {frozenset(names): 0.3, frozenset(names[:1]): 0.4}
    weighed = [Hypothesis(acts, False, log(probability)) for acts, probability in sets.items()]
    result = judged_by(Posterior((*weighed, Hypothesis(frozenset(), True, log(0.3)))), chosen)
    assert result.verdict == "unexplained" and [t.name for t in result.together] == [names[0]]
