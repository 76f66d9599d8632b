"""What acts beside a built term and a smooth error has a probability of its own, and a smooth error has no name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import (
    POSITION,
    SIZES,
    TANGENT,
    Discrepancy,
    Linearised,
    Spectrum,
    block_of,
    shared,
)
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, partial_diagnosis, unknown_errors
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.posterior import Compared, compared
from ctrplan.diagnosis.remainder import input_distances
from ctrplan.diagnosis.term_pieces import built_term
from ctrplan.diagnosis.unknown_errors import Peak, SmoothError
from ctrplan.diagnosis.usable_poses import blocks
from ctrplan.diagnosis.verdict import Posterior, normalised, standing_for
from ctrplan.diagnosis.workbench import Workbench, candidates
from ctrplan.effects.learned.inputs import InputRange, Target
from ctrplan.measurement.measurements import Measurements, split

ROBOT = pair_robot()
PLANS = {count: waypoints(ROBOT, count, seed=4) for count in (24, 48)}
QUICK = {name: CATALOGUE[name] for name in ("sensor_offset", "joint_scale", "tip_load", "base_misalignment")}
OFFSET = {"sensor_offset": {"offset_x_mm": 2.0, "offset_y_mm": -1.5}}
FRAME = {"base_misalignment": {"shift_x_mm": 4.0, "rotation_y_deg": -3.0}}
RIPPLE = built_term(
    Target("theta", 2), ["sin_3_theta_2_deg", "cos_3_theta_2_deg"], {"theta_2": InputRange(-180.0, 180.0)}, ROBOT.n
)


def rippled(values: dict[str, dict[str, float]], smooth_mm: float, count: int = 24) -> Measurements:
    """Gears turn tube 2 further three times a turn; and an error that goes along with the joints."""
    plan = PLANS[count]
    theta = plan.theta_commanded.copy()
    theta[:, 1] += np.radians(7.0) * np.sin(3 * theta[:, 1] + 0.5)
    data = replace(measured(ROBOT, replace(plan, theta_commanded=theta), values), theta_commanded=plan.theta_commanded)
    return replace(data, position_m=data.position_m + smooth_mm * smooth_field(plan))


def smooth_field(plan: Measurements) -> Array:
    """(K, 3) an error of 1 mm that goes along with the joints."""
    rng = np.random.default_rng(3)
    turn = np.diff(plan.theta_commanded, axis=1)[plan.rows]
    joints = np.hstack([np.sin(turn), np.cos(turn), plan.l_commanded[plan.rows] / 0.06])
    waves, phases = rng.standard_normal((40, joints.shape[1])), rng.uniform(-np.pi, np.pi, 40)
    return 1e-3 * np.cos(joints @ waves.T + phases) @ rng.standard_normal((40, 3)) * np.sqrt(2 / 40 / 3)


def told_of(data: Measurements, *beside: object) -> Compared:
    """The most probable sets from a ripple's term on, or from nothing."""
    block = blocks(data, 0.0)
    parts = split(np.ones(data.count, bool), block)
    chosen = parts.selection
    bench = CorrelatedBench(ROBOT, data.subset(chosen), Noise(SIGMA_M, SIGMA_RAD), block[chosen])
    known = partial_diagnosis.testable_beside(candidates(ROBOT, data, QUICK), bench)
    return compared(*bench.corrected(bench.scored(beside)), known)  # type: ignore[arg-type]


def test_what_acts_beside_a_term_and_a_smooth_error_is_named() -> None:
    told = told_of(rippled(OFFSET, 0.3), RIPPLE).posterior
    assert told.of_effect("sensor_offset") > 0.99 and told.of_unknown > 0.99
    assert told.of_effect("joint_scale", "tip_load") < 0.5


@pytest.mark.parametrize("smooth_mm", [0.3, 1.5])
def test_a_smooth_error_beside_a_term_has_no_name(smooth_mm: float) -> None:
    told = told_of(rippled({}, smooth_mm), RIPPLE).posterior
    assert not [name for name in QUICK if told.of_effect(name) > 0.5]


def test_a_frame_that_is_displaced_is_more_probable_than_a_smooth_error_in_its_place() -> None:
    """A smooth error of its size may stand for it, with ever less probability the more configurations there are."""
    few, many = (odds(told_of(rippled(FRAME, 0.3, count), RIPPLE).posterior, "base_misalignment") for count in PLANS)
    assert 0 < few < many
    assert many > np.log(0.95 / 0.05)


def odds(told: Posterior, name: str) -> float:
    """Logarithm of those that an effect acts, where probabilities are rounded to 1."""
    weights = {acts: [h.weight for h in told.hypotheses if (name in h.names) is acts] for acts in (True, False)}
    return float(logsumexp(weights[True]) - logsumexp(weights[False]))


def test_look_alikes_are_told_together_and_what_anything_stands_for_is_not() -> None:
    a, b, c = (frozenset({name}) for name in "abc")
    told = normalised({a: (0.0, -99.0), b: (-0.5, -99.0), c: (-9.0, -99.0), frozenset(): (-99.0, -99.0)})
    assert standing_for(told, "a") == ["b"] and standing_for(told, "c") is None
    certain = normalised({a: (0.0, -99.0), frozenset(): (-99.0, -99.0)})
    assert standing_for(certain, "a") == []
    pair = normalised({a | c: (0.5, -np.inf), b | c: (0.0, -np.inf)})
    assert standing_for(pair, "a", ("a", "c")) == ["b"]  # what acts beside it with certainty stands for nothing
    three = normalised({a: (0.0, -99.0), b: (-0.1, -99.0), c: (-0.2, -99.0)})  # none more probable than not
    assert standing_for(three, "a") == ["b", "c"] and standing_for(three, "b") is None
    many: Posterior = normalised({frozenset({name}): (0.01 * (name == "a"), -99.0) for name in "abcdefgh"})
    assert standing_for(many, "a") is None


def test_a_process_in_the_covariance_is_the_same_as_one_among_the_parameters() -> None:
    rng = np.random.default_rng(1)
    r, J, precision, whole = small()
    modes = rng.standard_normal((r.size, 4))
    numbers, none = np.arange(r.size).reshape(r.shape), block_of(np.arange(6), np.zeros((6, 6)))
    error = SmoothError("configuration", ((numbers[:, POSITION], none),), ((numbers[:, TANGENT], none),))
    plain = Peak(error, 0.0, 0.0, modes).evidence(whole) - Peak(error, 0.0, 0.0).evidence(whole)
    flat = J.reshape(-1, J.shape[2])
    covariance = np.eye(r.size) + flat @ np.diag(1 / precision) @ flat.T
    densities = [multivariate_normal.logpdf(r.ravel(), cov=C) for C in (covariance + modes @ modes.T, covariance)]
    assert plain == pytest.approx(densities[0] - densities[1], abs=1e-9)


def test_what_sets_have_in_common_is_integrated_out_once() -> None:
    """Some parameters of a wide fit beside a process and an error, with priors of their own, are a fit of their own."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        r, J, scale = rng.standard_normal((8, 5)), rng.standard_normal((8, 5, 6)), 10.0 ** rng.uniform(-4, 4, 6)
        whole = Linearised(100 * r, J * scale, scale**2)
        modes = 10.0 ** rng.uniform(-2, 2) * rng.standard_normal((r.size, 5))
        numbers, block = np.arange(r.size).reshape(r.shape), block_of(np.arange(8), shared(8, 0.8))
        error = SmoothError("configuration", ((numbers[:, POSITION], block),), ((numbers[:, TANGENT], block),))
        peak, some = Peak(error, 0.0, 0.0, modes), [4, 0, 3]
        moved = np.array([0.0, 0.3, 0.0, 0.0, 0.0, -0.2]) / scale
        precision = whole.precision[some] * 10.0 ** rng.uniform(-2, 2, 3)
        alone = Peak(error, 0.0, 0.0).beside(
            Linearised(
                whole.r + whole.J @ moved,
                np.concatenate([whole.J[:, :, some], modes.reshape(8, 5, 5)], axis=2),
                np.append(precision, np.ones(5)),
            )
        )
        together = peak.beside(whole).of(some, precision, moved)
        assert together.highest() == pytest.approx(alone.highest(), rel=1e-9)
        pair = (slice(None, None, 5), 7)
        np.testing.assert_allclose(together.evidences(*pair), alone.evidences(*pair), rtol=1e-8)


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


NAMES = (*QUICK, "gravity", "kink", "sensor_distortion", "homing_offset", "eccentricity", "shaft_torsion")
LIKE = {  # what acts all the same in every pose where it has a name, and the seed of the poses
    "a load": (4, {"tip_load": {"force_x_N": 0.1, "force_y_N": -0.05}}),
    "a weight": (5, {"gravity": {"g_x_m_s2": 200.0, "g_z_m_s2": 100.0}}),
    "a sensor's mount": (4, OFFSET),
    "a base": (5, {"base_misalignment": {"rotation_x_deg": 1.0, "shift_y_mm": 1.0}}),
}


def by_travel(seed: int, values: dict[str, dict[str, float]]) -> Measurements:
    """What effects do, from once one way to once the other way as tube 2 travels."""
    plan = waypoints(ROBOT, 16, seed=seed)
    travel = plan.l_commanded[plan.rows, 1]
    share = (2 * (travel - travel.mean()) / np.ptp(travel))[:, None]
    none, whole = (measured(ROBOT, plan, some) for some in ({}, values))
    tangent = none.tangent + share * (whole.tangent - none.tangent)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return replace(none, position_m=none.position_m + share * (whole.position_m - none.position_m), tangent=tangent)


def screwed() -> Measurements:
    """Travel turns tube 2 by a degree, which nothing in the catalogue does."""
    plan = waypoints(ROBOT, 16, seed=4)
    theta, travel = plan.theta_commanded.copy(), plan.l_commanded[:, 1]
    theta[:, 1] += 0.02 * (travel - travel.mean()) / np.ptp(travel)
    return replace(measured(ROBOT, replace(plan, theta_commanded=theta)), theta_commanded=plan.theta_commanded)


@pytest.mark.parametrize("cause", [*LIKE, "a screw"])
def test_what_goes_along_with_a_travel_at_any_stage_has_no_name(cause: str) -> None:
    """Three names, each with 0.998, stood for what varied where the catalogue has it constant."""
    data = screwed() if cause == "a screw" else by_travel(*LIKE[cause])
    bench = Workbench(ROBOT, data, Noise(SIGMA_M, SIGMA_RAD), data.configuration)
    known = candidates(ROBOT, data, {name: CATALOGUE[name] for name in NAMES})
    told = compared(bench, bench.scored([]), known).posterior
    assert told.of_unknown > 0.8
    assert not [name for name in NAMES if told.of_effect(name) > 0.1]


def test_angles_between_tubes_are_inputs_where_both_turn() -> None:
    """A robot that turns as a whole, each time otherwise, leaves them as they are."""
    plan = PLANS[24]
    turned = replace(plan, theta_commanded=plan.theta_commanded + np.arange(len(plan.sequence))[:, None])
    still, moved = (dict(input_distances(data)) for data in (plan, turned))
    assert "turn_2" not in still  # tube 1 never turns
    np.testing.assert_allclose(moved["turn_2"], still["theta_2"], atol=1e-9)


def small() -> tuple[Array, Array, Array, Linearised]:
    rng = np.random.default_rng(5)
    r, J, precision = rng.standard_normal((6, 5)), rng.standard_normal((6, 5, 3)), np.array([1.0, 0.2, 4.0])
    return r, J, precision, Linearised(r, J, precision)


def log_density(r: Array, J: Array, precision: Array, position: float, tangent: float) -> float:
    """Log density of residuals (K, 5) that parameters and an error of one block leave."""
    correlation, flat = shared(6, 0.8), J.reshape(-1, J.shape[2])
    covariance = np.eye(r.size) + flat @ np.diag(1 / precision) @ flat.T
    for k in range(5):
        rows = np.arange(6) * 5 + k
        covariance[np.ix_(rows, rows)] += (position if k < 3 else tangent) ** 2 * correlation
    return float(multivariate_normal.logpdf(r.ravel(), cov=covariance))


def test_a_set_that_leaves_no_error_says_nothing_of_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its shares of approaches all have one evidence, and rounding chose which errors were compared."""
    none, there = Discrepancy(0.0, 0.0, 0.9, ()), Discrepancy(2.0, 1.0, 0.5, ())
    said, shares = {"none": none, "there": there}, list[float]()
    monkeypatch.setattr(unknown_errors, "of_configurations", lambda fit, _: said[fit])
    monkeypatch.setattr(unknown_errors, "at_rest", lambda _, share, __: shares.append(share) or [])
    for sets, wanted in ((["none", "there"], [0.5]), (["none", "none"], [0.9])):
        shares.clear()
        unknown_errors._smooth(rippled({}, 0.0), np.zeros((24, 2, 3)), sets)  # type: ignore[arg-type]
        assert shares == wanted
