"""Fits of sets of effects on the workbench: a set is as good as the best place to start it from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints

from ctrplan.calibration import least_squares
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.residuals import robust_square
from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.adequacy import noise_floor
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
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
    better = bench.scored([shifted], both.fit, None)
    assert better.fit.loss < stuck.fit.loss - 100
    assert bench.scored([shifted], both.fit) is better  # and it stays known


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
    for variant, one in zip(variants, bench.screened(base, variants, known.completed), strict=True):
        promised = float(robust_square(np.linalg.norm(one.linear.r, axis=1)).sum())
        assert bench.scored([variant], base.fit).fit.residuals.loss == pytest.approx(promised, rel=0.15), variant.key


def test_a_bench_that_is_corrected_is_another_and_goes_on_from_where_the_first_was(data: Measurements) -> None:
    first = CorrelatedBench(ROBOT, data, noise_floor(ROBOT, data)[0], data.configuration)
    base, shaft = first.scored([]), first.scored([whole("shaft_torsion")])
    noise, visited = first.noise, first.visited
    second, there = first.corrected(base)
    assert first.noise is noise and first.visited == visited and first.scored([]) is base
    assert second.visited == (there,) and second.noise.discrepancy is not None and noise.discrepancy is None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(least_squares, "MOST_STEPS", 0)
        begun = second.scored([whole("shaft_torsion")], base.fit)
    assert np.array_equal(begun.fit.p, shaft.fit.p)
