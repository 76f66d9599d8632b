"""What is plausible of a fit: it does not depend on priors' widths, and what a prior draws in strains nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration.fit_warnings import is_strained, strained, symptoms
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import robust_square
from ctrplan.diagnosis import CATALOGUE, diagnose, held_out
from ctrplan.diagnosis.held_out import LARGEST_REST, contradiction, largest_remainder
from ctrplan.diagnosis.posterior import settled
from ctrplan.diagnosis.verdict import judge
from ctrplan.diagnosis.workbench import Teller, Workbench, candidates
from ctrplan.pipeline.term import Term, term
from ctrplan.reports.diagnosis_words import effect_lines, verdict_sentence

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 18)
BASE = {"calibration": {"precurvature_factor_1_1": 1.05, "stiffness_factor_2": 0.93, "poisson_ratio_1": 0.36}}
FEW = {name: CATALOGUE[name] for name in ("backlash", "tip_load", "shaft_torsion")}
LARGE = [("shaft_torsion", {"compliance_2_rad_per_Nm": 60.0}), ("tip_load", {"force_x_N": -2.5})]


def bench_of(values: Mapping[str, Mapping[str, float]]) -> Workbench:
    data = measured(ROBOT, PLAN, BASE | values)
    return Workbench(ROBOT, data, noise_floor(ROBOT, data)[0], data.configuration)


def whole(name: str) -> Term:
    return term(CATALOGUE[name], [p.name for p in CATALOGUE[name].parameters(ROBOT)], ROBOT)


@pytest.mark.parametrize(("name", "values"), LARGE)
def test_an_effect_that_its_prior_draws_in_strains_no_calibration(name: str, values: dict[str, float]) -> None:
    bench = bench_of({name: values})
    drawn_in = bench.scored([whole(name)])
    freed = bench.sized(drawn_in)
    assert is_strained(drawn_in.fit) and not is_strained(freed.fit)
    assert strained(freed.fit, [name]) == [name]  # and it is told, however wide its prior became


def test_a_load_larger_than_is_plausible_is_named_and_its_size_is_told() -> None:
    name, values = LARGE[1]
    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE | {name: values}), catalogue=FEW)
    assert found.verdict == "named" and found.chosen.names == (name,)
    assert found.gap.after.rms_m < 1.3 * found.gap.floor_m
    told = [note for note in found.notes if "times what is plausible" in note]
    assert told and all(note.startswith(name) for note in told)


def test_symptoms_are_those_of_the_numbers_and_not_of_the_priors() -> None:
    bench = bench_of({"shaft_torsion": {"compliance_2_rad_per_Nm": 60.0}})
    fit = bench.sized(bench.scored([whole("shaft_torsion")])).fit
    for factor in (0.1, 10.0):
        terms = [
            Term(t.effect, tuple(replace(q, prior=factor * q.prior) for q in t.parameters)) for t in fit.chain.terms
        ]
        assert symptoms(replace(fit, chain=fit.chain.with_terms(terms))) == symptoms(fit) != []


@pytest.mark.parametrize("room_mm", [0.05, 0.2, 0.5])
def test_room_between_tubes_is_seen_by_the_screening(room_mm: float) -> None:
    bench = bench_of({"clearance": {"delta_1_mm": room_mm}})
    here, known = bench.scored([]), candidates(ROBOT, bench.data)
    (alone,) = bench.screened(here, [t for t in known.terms if t.name == "clearance"], known)
    fitted = bench.scored([alone.term], here.fit)
    assert fitted.fit.p[-1] == pytest.approx(room_mm * 1e-3, rel=0.2)
    left = [float(robust_square(np.linalg.norm(alone.linear.r, axis=1)).sum()), fitted.fit.residuals.loss]
    promised, kept = (here.fit.residuals.loss - one for one in left)
    assert promised > 0.8 * kept > 0  # less from where there is no room


@pytest.mark.parametrize(("play_deg", "verdict"), [(8.0, "named"), (24.0, "unexplained")])
def test_beside_enlarged_noise_no_effect_is_larger_than_is_plausible(play_deg: float, verdict: str) -> None:
    data = measured(ROBOT, PLAN, BASE | {"backlash": {"theta_2_deg": play_deg}})
    noise, few = noise_floor(ROBOT, data)[0], candidates(ROBOT, data, FEW)
    half = {
        "position_sigma_mm": noise.position_m * 1e3 / 2,
        "tangent_sigma_deg": float(np.degrees(noise.tangent_rad)) / 2,
    }
    for robot, told in ((ROBOT, "named"), (pair_robot(measurement=half), verdict)):
        bench = Workbench(robot, data, noise, data.configuration)
        _, found, chosen, _ = settled(bench, bench.scored([]), few, Teller())
        assert judge(bench, chosen, few, found.posterior, found.sets).verdict == told


def test_what_parameters_leave_open_is_no_contradiction_and_is_told() -> None:
    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE | {"backlash": {"theta_2_deg": 8.0}}), catalogue=FEW)
    assert 0 < found.gap.spread_m < found.gap.floor_m  # one number, from 54 poses
    assert "uncertain by" not in verdict_sentence(found) and " This verdict has probability " in verdict_sentence(found)
    assert effect_lines(found)[0].startswith("backlash acts with probability above 0.99 (drive): theta_2_deg = ")
    off = 2.0 * found.gap.floor_m
    far = replace(found.gap, after=replace(found.gap.after, rms_m=off))
    open_ = replace(far, spread_m=1.5 * found.gap.floor_m)
    assert off > LARGEST_REST * found.gap.floor_m
    assert "contradict" in contradiction("named", far, found.place)
    assert contradiction("named", open_, found.place) == ""
    assert "uncertain by" in verdict_sentence(replace(found, gap=open_))
    tailed = replace(far, tails=12.0)
    assert contradiction("named", tailed, found.place) == ""
    assert "heavy tails" in verdict_sentence(replace(found, gap=tailed))
    assert contradiction("no_missing_effect", tailed, found.place) != ""
    assert largest_remainder(1.0) == pytest.approx(LARGEST_REST) and largest_remainder(4.0) == pytest.approx(
        np.sqrt(3.5)
    )
    nothing = contradiction("no_missing_effect", open_, replace(found.place, rms_m=off))
    assert "poses that were fitted" in nothing  # nothing is left open there


def test_what_the_robot_file_s_numbers_contradict_lists_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot that would be written does not agree with the poses kept aside."""
    monkeypatch.setattr(held_out, "contradiction", lambda verdict, *_: "The figures contradict it.")
    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE | {"backlash": {"theta_2_deg": 8.0}}), catalogue=FEW)
    assert found.verdict == "unexplained" and "The figures contradict it." in found.notes
    assert not found.listed and found.chosen.names == ()
    assert found.gap.after.rms_m > 3 * found.gap.floor_m  # of a robot without the effect
