"""What effects leave is asked for a memory: chi-squares have none, and take a jump of the tracker for a drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.diagnosis import CATALOGUE, diagnose
from ctrplan.diagnosis.adequacy import remains
from ctrplan.diagnosis.posterior import compared
from ctrplan.diagnosis.verdict import Posterior
from ctrplan.diagnosis.workbench import Scored, Workbench, candidates
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.reports.diagnosis_words import effect_lines, verdict_sentence

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 18)
FEW = {name: CATALOGUE[name] for name in ("drift", "tip_load")}
SHIFTS = [f"shift_{axis}_mm_per_h" for axis in "xyz"]


def jumped(step_mm: float, seed: int = 1) -> Measurements:
    """The tracker was pushed half way."""
    data = measured(ROBOT, PLAN, seed=seed)
    late = np.arange(data.count) >= data.count // 2
    return replace(data, position_m=data.position_m + np.outer(late, [1e-3, -1e-3, 0.5e-3]) * step_mm)


def beside(data: Measurements, *terms: Term) -> tuple[Workbench, Scored]:
    bench = Workbench(ROBOT, data, noise_floor(ROBOT, data)[0], data.configuration)
    return bench, bench.scored(terms)


def besides(bench: Workbench, explained: Scored) -> Posterior:
    return compared(bench, explained, candidates(ROBOT, bench.data, {})).posterior


@pytest.mark.parametrize("seed", [1, 2, 3] if FUZZ else [1])
def test_what_a_drift_leaves_of_a_jump_goes_along_with_the_time(seed: int) -> None:
    drift = term(CATALOGUE["drift"], SHIFTS, ROBOT)
    bench, explained = beside(jumped(0.35, seed), drift)
    assert remains(bench, explained).total.p > 1e-3  # to chi-squares
    told = besides(bench, explained)
    assert told.of_unknown > 0.5 and told.along["time"] > 0.5
    assert besides(*beside(jumped(0.0, seed), drift)).of_unknown < 0.5


@pytest.mark.usefixtures("without_building")
@pytest.mark.parametrize("step_mm", [0.4, 2.0, 8.0] if FUZZ else [0.4, 8.0])
def test_a_jump_is_something_unknown_that_goes_along_with_time_and_no_drift(step_mm: float) -> None:
    found = diagnose(ROBOT, jumped(step_mm, seed=2), catalogue=FEW)
    assert found.verdict == "unexplained" and not found.listed and found.posterior is not None
    assert found.posterior.of_unknown > 0.9 and found.posterior.along["time"] > 0.9


@pytest.mark.usefixtures("without_building")
def test_without_a_clock_nothing_goes_along_with_the_time_but_with_the_order_of_the_rows() -> None:
    found = diagnose(ROBOT, replace(jumped(8.0, seed=2), time_s=None), catalogue={"tip_load": CATALOGUE["tip_load"]})
    assert found.posterior is not None and found.verdict == "unexplained"
    assert "time" not in found.posterior.along and found.posterior.along["order"] > 0.9
    told = verdict_sentence(found) + " ".join(effect_lines(found))
    assert "What is unknown goes along with the order of the rows, probability" in told and "the time" not in told


def test_a_drift_of_any_size_is_named() -> None:
    for hour in (5.0, 1500.0):  # the latter far larger than its prior, which draws a part of it in
        true = {"drift": {"shift_x_mm_per_h": hour, "shift_y_mm_per_h": -hour}}
        assert diagnose(ROBOT, measured(ROBOT, PLAN, true), catalogue=FEW).verdict == "named"


@pytest.mark.parametrize("name", ["tip_load", "backlash", "clearance", "shaft_torsion"])
def test_what_is_true_leaves_noise_alone(name: str) -> None:
    values = {
        "tip_load": {"force_x_N": 2.5},
        "backlash": {"theta_2_deg": 20.0},
        "clearance": {"delta_1_mm": 0.4},
        "shaft_torsion": {"compliance_2_rad_per_Nm": 25.0},
    }[name]
    whole = term(CATALOGUE[name], list(values), ROBOT)
    for seed in range(3 if FUZZ else 1):
        assert besides(*beside(measured(ROBOT, PLAN, {name: values}, seed=seed), whole)).of_unknown < 0.5
