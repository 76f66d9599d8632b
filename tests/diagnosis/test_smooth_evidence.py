"""Evidence beside a smooth error: the density of all poses, whatever is integrated out how; and names that have it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints
from scipy.stats import multivariate_normal

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import SIZES, Linearised, Spectrum, block_of, shared
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, smooth_evidence
from ctrplan.diagnosis import partial_diagnosis as rules
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.partial_search import PartialSelector
from ctrplan.diagnosis.smooth_evidence import Gain, SmoothEvidence
from ctrplan.diagnosis.term_search import built_term
from ctrplan.diagnosis.usable_poses import block_split, blocks
from ctrplan.diagnosis.verdict import Finding
from ctrplan.diagnosis.workbench import candidates
from ctrplan.effects.learned.inputs import InputRange, Target
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 24, seed=4)
QUICK = {name: CATALOGUE[name] for name in ("sensor_offset", "joint_scale", "tip_load", "base_misalignment")}
OFFSET = {"sensor_offset": {"offset_x_mm": 2.0, "offset_y_mm": -1.5}}
FRAME = {"base_misalignment": {"shift_x_mm": 4.0, "rotation_y_deg": -3.0}}
RIPPLE = built_term(
    Target("theta", 2), ["sin_3_theta_2_deg", "cos_3_theta_2_deg"], {"theta_2": InputRange(-180.0, 180.0)}, ROBOT.n
)


def rippled(values: dict[str, dict[str, float]], smooth_mm: float) -> Measurements:
    """Gears turn tube 2 further three times a turn; and an error that goes along with the joints."""
    theta = PLAN.theta_commanded.copy()
    theta[:, 1] += np.radians(7.0) * np.sin(3 * theta[:, 1] + 0.5)
    data = replace(measured(ROBOT, replace(PLAN, theta_commanded=theta), values), theta_commanded=PLAN.theta_commanded)
    return replace(data, position_m=data.position_m + smooth_mm * FIELD_M)


def smooth_field() -> Array:
    """(K, 3) an error of 1 mm that goes along with the joints."""
    rng = np.random.default_rng(3)
    turn = np.diff(PLAN.theta_commanded, axis=1)[PLAN.rows]
    joints = np.hstack([np.sin(turn), np.cos(turn), PLAN.l_commanded[PLAN.rows] / 0.06])
    waves, phases = rng.standard_normal((40, joints.shape[1])), rng.uniform(-np.pi, np.pi, 40)
    return 1e-3 * np.cos(joints @ waves.T + phases) @ rng.standard_normal((40, 3)) * np.sqrt(2 / 40 / 3)


FIELD_M = smooth_field()


@cache
def told(which: str, smooth_mm: float = 0.3) -> tuple[Finding, ...]:
    """Named beside the ripple's term."""
    return named_in(rippled({"offset": OFFSET, "frame": FRAME, "nothing": {}}[which], smooth_mm))


def named_in(data: Measurements) -> tuple[Finding, ...]:
    selector = selector_of(data)
    return rules.effects_beside_built_term(selector, selector.bench.scored([RIPPLE])).findings


def selector_of(data: Measurements) -> PartialSelector:
    block = blocks(data, 0.0)
    parts = block_split(data, np.ones(data.count, bool), block)
    chosen = parts.selection
    bench = CorrelatedBench(ROBOT, data.subset(chosen), Noise(SIGMA_M, SIGMA_RAD), block[chosen], parts.fold)
    return PartialSelector(bench, candidates(ROBOT, data, QUICK), lambda _: None)


def test_what_acts_beside_a_term_and_a_smooth_error_is_named() -> None:
    (one,) = told("offset")
    assert one.term.name == "sensor_offset" and len(one.alternatives) <= 3


def test_a_smooth_error_beside_a_term_has_no_name() -> None:
    assert not told("nothing") and not told("nothing", 1.5)


def test_a_frame_is_named_where_it_moves_more_than_all_that_is_left() -> None:
    assert [one.term.name for one in told("frame", 0.3)] == ["base_misalignment"]


@pytest.mark.parametrize(("own", "rival", "named"), [(40.0, 20.0, True), (40.0, 38.0, True), (20.0, 40.0, False)])
def test_a_frame_gains_what_the_set_without_it_lacks(
    own: float, rival: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compared with the set that has it a frame would gain nothing, and every rival would do better."""
    selector = selector_of(rippled(FRAME, 0.3))
    settled = selector.bench.scored([RIPPLE])
    (offset,) = (t for t in selector.candidates.terms if t.name == "tip_load")
    monkeypatch.setattr(SmoothEvidence, "highest", lambda self, without="": 100.0 - own * (without == rules.FRAME))
    monkeypatch.setattr(SmoothEvidence, "moved", lambda self, name: 1.0)
    monkeypatch.setattr(SmoothEvidence, "gains", lambda self, variants, without="": [Gain(offset, rival)])
    found = rules._frame(selector, settled, 100.0)
    assert bool(found) == named
    if named:
        ((_, rivals),) = found.values()
        assert bool(rivals) == (rival > own - smooth_evidence.EQUAL)


def test_what_was_listed_as_or_is_not_listed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smooth_evidence, "EQUAL", 1e9)
    (one,) = named_in(rippled({**OFFSET, "joint_scale": {"theta_2": 0.1}}, 0.3))
    assert {one.term.name, *(a.term.name for a in one.alternatives)} >= {"sensor_offset", "joint_scale"}


@pytest.mark.parametrize(("which", "smooth_mm", "name"), [("offset", 0.3, "sensor_offset"), ("nothing", 1.5, None)])
def test_an_effect_may_be_likely_beside_a_smooth_error_alone(which: str, smooth_mm: float, name: str | None) -> None:
    """A smooth error has none; gears that ripple are no smooth error, and an effect may be likely by mistake."""
    values = {"offset": OFFSET, "nothing": {}}[which]
    plain = replace(measured(ROBOT, PLAN, values), theta_commanded=PLAN.theta_commanded)
    data = replace(plain, position_m=plain.position_m + smooth_mm * FIELD_M)
    likely = rules.most_probable_alone(selector_of(data))
    assert (likely and likely.names) == (name and (name,))


def test_evidence_is_the_density_of_the_measurements() -> None:
    """Over parameters and error at once, by the covariance of both."""
    r, J, precision, whole = small()
    block = (block_of(np.arange(6), shared(6, 0.8)),)
    some = [0, 2]
    spectrum = Spectrum.at(whole, block).of(some)
    dense = [
        [log_density(r, J[:, :, some], precision[some], a, b) for b in SIZES[::8].tolist()] for a in SIZES[::8].tolist()
    ]
    ours = np.stack([spectrum.evidences(slice(None, None, 8), k) for k in range(0, len(SIZES), 8)], axis=1) / 2
    np.testing.assert_allclose(ours - ours[0, 0], np.array(dense) - dense[0][0], rtol=1e-9, atol=1e-9)
    value, position, tangent = spectrum.highest()
    assert value / 2 >= ours.max() and {position, tangent} <= set(SIZES.tolist())
    assert spectrum.without_error / 2 == pytest.approx(ours[0, 0])


def test_some_parameters_of_a_spectrum_are_a_spectrum_of_their_own() -> None:
    _, J, precision, whole = small()
    block = (block_of(np.arange(6), shared(6, 0.8)),)
    alone = Spectrum.at(Linearised(whole.r, J[:, :, [1]], precision[[1]]), block)
    assert Spectrum.at(whole, block).of([1]).highest() == pytest.approx(alone.highest(), rel=1e-12)


def test_gains_are_differences_of_evidence_whatever_is_asked_with_them() -> None:
    data = rippled(OFFSET, 0.7)
    bench = CorrelatedBench(ROBOT, data, Noise(SIGMA_M, SIGMA_RAD), data.configuration, data.configuration % 6)
    here, known = bench.corrected(bench.scored([RIPPLE])), candidates(ROBOT, data, QUICK).terms
    known = tuple(t for t in known if t.name != "base_misalignment")
    gains = {one.term.key: one.gain for one in SmoothEvidence(bench, here, known).gains(known)}
    best = max(gains, key=lambda key: gains[key])
    (alone,) = [t for t in known if t.key == best]
    (again,) = SmoothEvidence(bench, here, [alone]).gains([alone])
    assert alone.name == "sensor_offset" and gains[best] == pytest.approx(again.gain, rel=1e-3)
    plain = SmoothEvidence(bench, here).highest()
    refitted = SmoothEvidence(bench, bench.corrected(bench.scored([RIPPLE, alone], here.fit))).highest() - plain
    assert 0.9 * again.gain < refitted < 2 * again.gain  # a fit of its own finds no less than the first order promises


def small() -> tuple[Array, Array, Array, Linearised]:
    rng = np.random.default_rng(5)
    r, J, precision = rng.standard_normal((6, 5)), rng.standard_normal((6, 5, 3)), np.array([1.0, 0.2, 4.0])
    return r, J, precision, Linearised(r, J, precision)


def log_density(r: Array, J: Array, precision: Array, position: float, tangent: float) -> float:
    """Of residuals (K, 5) that parameters and an error of one block leave."""
    correlation, flat = shared(6, 0.8), J.reshape(-1, J.shape[2])
    covariance = np.eye(r.size) + flat @ np.diag(1 / precision) @ flat.T
    for k in range(5):
        rows = np.arange(6) * 5 + k
        covariance[np.ix_(rows, rows)] += (position if k < 3 else tangent) ** 2 * correlation
    return float(multivariate_normal.logpdf(r.ravel(), cov=covariance))
