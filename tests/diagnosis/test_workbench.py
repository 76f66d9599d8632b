"""Fits of sets of effects on the workbench: a set is as good as the best place to start it from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration import least_squares
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import robust_square
from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.posterior import compared
from ctrplan.diagnosis.workbench import Workbench, candidates
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term

ROBOT = pair_robot()
TRUE = {
    "tip_load": {"force_x_N": 0.15, "force_y_N": -0.12, "force_z_N": 0.0},
    "shaft_torsion": {"compliance_2_rad_per_Nm": 12.0},
}


@pytest.fixture(scope="module")
def data() -> Measurements:
    return measured(ROBOT, waypoints(ROBOT, 14), TRUE)


def bench_of(data: Measurements) -> Workbench:
    group = data.configuration
    return Workbench(ROBOT, data, noise_floor(ROBOT, data)[0], group)


def whole(name: str) -> Term:
    return term(CATALOGUE[name], [p.name for p in CATALOGUE[name].parameters(ROBOT)], ROBOT)


def test_a_set_is_fitted_again_from_a_place_that_promises_more(
    data: Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, shaft, shifted = bench_of(data), whole("shaft_torsion"), whole("base_misalignment")
    both = bench.scored([shaft, shifted])
    with monkeypatch.context() as patch:
        patch.setattr(least_squares, "MOST_STEPS", 1)
        stuck = bench.scored([shifted], both.fit)  # its shape without the compliance: robots snap there
    better = bench.improved(stuck, bench.scored([]).fit)
    assert better.fit.loss < stuck.fit.loss - 100
    assert bench.scored([shifted], both.fit) is stuck  # what was asked elsewhere changes no answer


def test_the_order_in_which_effects_came_does_not_matter(data: Measurements) -> None:
    shaft, load, shifted = whole("shaft_torsion"), whole("tip_load"), whole("base_misalignment")
    direct = bench_of(data).scored([shaft, load])
    bench = bench_of(data)
    wide = bench.scored([shaft, load, shifted], bench.scored([shifted], bench.scored([]).fit).fit, None)
    found = bench.scored([load, shaft], wide.fit, None)
    assert found.fit.loss == pytest.approx(direct.fit.loss, abs=1.0)
    assert np.sqrt(found.fit.loss / (5 * data.count)) < 1.1


def test_errors_are_numbers_where_a_model_has_no_solution(data: Measurements) -> None:
    chain = bench_of(data).scored([]).fit.chain
    tips = chain.predict(chain.neutral, derivatives=False)
    lost = tips.position_m.copy()
    lost[3] = np.nan
    error_m = distances(replace(tips, position_m=lost), data)
    assert error_m[3] == pytest.approx(np.linalg.norm(data.position_m[3]))
    np.testing.assert_allclose(error_m[4:], np.linalg.norm(tips.position_m - data.position_m, axis=1)[4:])


def test_a_variant_promises_what_it_can_do_itself(data: Measurements) -> None:
    """A field that leaves tangents unharmed is no field that turns them, whose share of the turn is free."""
    effect = CATALOGUE["sensor_distortion"]
    bent = {"x_x_mm": 1.0, "y_xz_mm": -1.5, "z_yy_mm": 1.5, "x_zz_mm": 1.5, "tangent_share": 1.0}
    turned = measured(ROBOT, waypoints(ROBOT, 14), {"sensor_distortion": bent})
    bench = bench_of(turned)
    base = bench.scored([])
    variants = [term(effect, names, ROBOT) for names in effect.variants(ROBOT, turned)]
    known = candidates(ROBOT, turned, {"sensor_distortion": effect})
    for variant, one in zip(variants, bench.screened(base, variants, known), strict=True):
        promised = float(robust_square(np.linalg.norm(one.linear.r, axis=1)).sum())
        assert bench.scored([variant], base.fit).fit.residuals.loss == pytest.approx(promised, rel=0.15), variant.key


def test_a_bench_that_is_corrected_is_another(data: Measurements) -> None:
    first = CorrelatedBench(ROBOT, data, noise_floor(ROBOT, data)[0], data.configuration)
    base, noise = first.scored([]), first.noise
    second, there = first.corrected(base)
    assert first.noise is noise and first.scored([]) is base and there is not base
    assert second.noise.discrepancy is not None and noise.discrepancy is None and first.corrected(base)[0] is not first


def test_the_same_question_has_the_same_answer_whatever_was_asked_before(data: Measurements) -> None:
    shaft, load, shifted = whole("shaft_torsion"), whole("tip_load"), whole("base_misalignment")
    questions = [([], None), ([shaft], None), ([shaft, load], "shaft"), ([shifted], "both"), ([shifted, load], None)]

    def answers(order: list[int]) -> dict[int, np.ndarray]:
        bench = bench_of(data)
        near = {"shaft": bench_of(data).scored([shaft]).fit, "both": bench_of(data).scored([shaft, shifted]).fit}
        told = {}
        for k in order:
            terms, place = questions[k]
            told[k] = bench.scored(terms, near[place] if place else None).fit.p
        return told

    first, other = answers([0, 1, 2, 3, 4, 0, 3]), answers([4, 3, 3, 2, 1, 0])
    for k in range(len(questions)):
        np.testing.assert_allclose(first[k], other[k], rtol=1e-7, atol=1e-9, err_msg=str(k))


def test_what_a_search_comes_to_does_not_depend_on_what_its_bench_was_asked_before(data: Measurements) -> None:
    few = {name: CATALOGUE[name] for name in ("shaft_torsion", "tip_load", "base_misalignment")}
    known = candidates(ROBOT, data, few)
    fresh, used = bench_of(data), bench_of(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(least_squares, "MOST_STEPS", 1)
        for t in known.terms:
            used.scored([t], used.scored([whole("base_misalignment")], None).fit)  # these end anywhere
    told = [compared(bench, bench.scored([]), known) for bench in (fresh, used)]
    for a, b in zip(*(one.posterior.hypotheses for one in told), strict=True):
        assert (a.names, a.has_unknown) == (b.names, b.has_unknown) and a.weight == pytest.approx(b.weight, abs=1e-6)
    for a, b in zip(told[0].sets, told[1].sets, strict=True):
        assert a.names == b.names and a.fit.loss == pytest.approx(b.fit.loss, abs=1e-6)
