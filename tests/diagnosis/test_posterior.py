"""Laws of the posterior: probabilities sum to one, more data sharpen them, equals share, units say nothing."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from ctrplan.base.arrays import Array
from ctrplan.calibration import least_squares
from ctrplan.calibration.discrepancy import SIZES, Linearised
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, partial_diagnosis, posterior
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.linear_fit import Linear, widths_of
from ctrplan.diagnosis.posterior import Compared, compared
from ctrplan.diagnosis.unknown_errors import UnknownErrors, without_error
from ctrplan.diagnosis.verdict import Hypothesis, Posterior, normalised, shown
from ctrplan.diagnosis.workbench import Teller, Workbench, candidates
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term

NONE: frozenset[str] = frozenset()
A, B, BOTH = frozenset({"a"}), frozenset({"b"}), frozenset({"a", "b"})


def test_probabilities_sum_to_one_and_effects_are_sums_over_sets() -> None:
    rng = np.random.default_rng(2)
    told = normalised({names: tuple(rng.normal(0, 3, 2).tolist()) for names in (NONE, A, B, BOTH)})
    assert told.probabilities.sum() == pytest.approx(1, abs=1e-12)
    p = {(one.names, one.has_unknown): q for one, q in zip(told.hypotheses, told.probabilities, strict=True)}
    assert told.of_effect("a") == pytest.approx(sum(q for (names, _), q in p.items() if "a" in names))
    assert told.of_effect("a", "b") + p[NONE, False] + p[NONE, True] == pytest.approx(1)
    named = told.of_verdict("named", [{"a"}, {"b"}])
    assert named == pytest.approx(p[BOTH, False]) and named <= told.of_verdict("partial", [{"a"}, {"b"}])
    assert told.of_verdict("ambiguous", [{"a", "b"}]) == pytest.approx(p[A, False] + p[B, False])
    assert told.of_verdict("no_missing_effect", []) == pytest.approx(p[NONE, False])
    assert told.of_verdict("unexplained", []) == pytest.approx(told.of_unknown)


def test_equals_share_and_what_says_nothing_keeps_its_prior() -> None:
    told = normalised({NONE: (0.0, 0.0), A: (9.0, -np.inf), B: (9.0, -np.inf)})
    assert told.of_effect("a") == pytest.approx(told.of_effect("b")) and 0.4 < told.of_effect("a") < 0.5
    silent = normalised({names: (0.0, 0.0) for names in (NONE, A, B, BOTH)})
    assert silent.of_effect("a") == pytest.approx(0.03) and silent.of_unknown == pytest.approx(0.1)


ALIKE = dict.fromkeys([*"abcd", *list(CATALOGUE)[4:]], "joints")  # as many effects as there are


@pytest.mark.parametrize(("acting", "is_told"), [("a", True), ("ab", True), ("abc", False)])
def test_what_many_effects_do_together_a_single_unknown_cause_may_do(acting: str, is_told: bool) -> None:
    """Sets beside a rest, of which nothing less explains the poses: three at once are a coincidence."""
    told = normalised({NONE: (-90.0, -60.0), frozenset(acting): (-40.0, 0.0)}, inputs=ALIKE)
    assert told.probabilities.sum() == pytest.approx(1, abs=1e-12)
    assert (told.of_effect("a") > 0.99) is is_told and told.of_work("a", acting) > 0.99
    assert normalised({frozenset(acting): (0.0, -2.0)}).of_effect("a") == pytest.approx(1)  # of no catalogue


def test_what_an_effect_that_does_not_act_was_needed_for_has_no_name() -> None:
    """Three effects explain the poses together; where figures refute one, the others explain nothing by themselves."""
    evidence = {NONE: (-90.0, -60.0), frozenset("abc"): (0.0, -2.0)}
    told = normalised(evidence, inputs=ALIKE)
    assert told.of_effect("a") > 0.99 and told.without("b").of_effect("a") < 0.99
    assert not any("b" in one.names for one in told.without("b").hypotheses)
    assert told.without("b").probabilities.sum() == pytest.approx(1, abs=1e-12)


def test_effects_of_unlike_inputs_are_no_single_cause() -> None:
    unlike = ALIKE | {"c": "history", "d": "time"}
    told = normalised({NONE: (-90.0, -40.0), frozenset("abcd"): (0.0, -2.0)}, inputs=unlike)
    assert min(told.of_effect(name) for name in "abcd") > 0.99


def test_a_catalogue_whose_poses_say_nothing_keeps_the_priors() -> None:
    sets = [frozenset(some) for count in range(4) for some in combinations("abc", count)]
    silent = normalised(dict.fromkeys(sets, (0.0, 0.0)), inputs=dict.fromkeys("abc", "joints"))
    assert silent.of_unknown == pytest.approx(0.1, rel=0.01) and silent.of_effect("a") == pytest.approx(0.03, rel=0.01)


def test_certainty_is_never_said() -> None:
    assert shown(1.0) == "probability above 0.99" and shown(0.0) == "probability below 0.01"
    assert shown(0.973) == "probability 0.97"
    assert Posterior((Hypothesis(A, False, 0.0), Hypothesis(A, True, 1.0))).of_effect("a") == 1.0


def system(poses: int, size: float, seed: int = 1) -> tuple[Linearised, Linearised]:
    """Without an effect and with it, which acts with `size` over the noise in a linear world of so many poses."""
    rng = np.random.default_rng(seed)
    J, precision = rng.standard_normal((poses, 5, 4)), np.ones(4)
    r = J @ np.array([0.3, -0.5, 0.8, size]) + rng.standard_normal((poses, 5))
    return Linearised(r, J[:, :, :3], precision[:3]), Linearised(r, J, precision)


def of_a(pair: tuple[Linearised, Linearised]) -> float:
    """Probability of the effect."""
    less, more = (without_error(fit) for fit in pair)
    return normalised({NONE: (less, -np.inf), A: (more, -np.inf)}).of_effect("a")


def test_evidence_is_the_density_of_the_poses() -> None:
    less, more = system(4, 1.0)
    values = []
    for fit in (less, more):
        J = fit.J.reshape(20, -1)
        covariance = np.eye(20) + (J / fit.precision) @ J.T
        values.append(multivariate_normal(np.zeros(20), covariance).logpdf(fit.r.ravel()))
    assert without_error(more) - without_error(less) == pytest.approx(values[1] - values[0], abs=1e-9)


def test_more_poses_sharpen() -> None:
    acting, idle = ([of_a(system(poses, size)) for poses in (4, 20, 100)] for size in (0.4, 0.0))
    assert acting[0] < acting[1] < acting[2] and acting[2] > 0.99
    assert idle[2] < idle[0] < 0.05


def test_nulls_give_most_to_nothing() -> None:
    told = np.array([of_a(system(12, 0.0, seed)) for seed in range(200)])
    assert told.mean() < 0.03 and (told > 0.5).mean() <= 0.01


@pytest.mark.parametrize("factor", [1e-3, 57.3, 1e6])
def test_units_and_order_of_parameters_say_nothing(factor: float) -> None:
    less, more = system(20, 0.4)
    order, scale = np.array([2, 0, 3, 1]), np.array([1.0, factor, 1.0, 1 / factor])
    again = Linearised(more.r, (more.J * scale)[:, :, order], (more.precision * scale**2)[order])
    assert of_a((less, again)) == pytest.approx(of_a((less, more)), rel=1e-6)


ROBOT = pair_robot()
QUICK = {name: CATALOGUE[name] for name in ("sensor_offset", "joint_scale", "tip_load", "base_misalignment")}


def bench_of(hidden: str, seed: int = 4) -> tuple[Workbench, Measurements]:
    """A workbench on 16 configurations of a pair."""
    offset = {"sensor_offset": {"offset_x_mm": 2.0, "offset_y_mm": -1.5}}
    values = {"sensor_offset": offset, "pair": offset | {"joint_scale": {"theta_2": 0.05}}, "": {}}[hidden]
    data = measured(ROBOT, waypoints(ROBOT, 16, seed=seed), values)
    group = data.configuration
    return Workbench(ROBOT, data, Noise(SIGMA_M, SIGMA_RAD), group), data


def test_acting_effect_has_nearly_all_and_nothing_else_any() -> None:
    bench, data = bench_of("sensor_offset")
    known = candidates(ROBOT, data, QUICK)
    best = max((bench.scored([t]) for t in known.terms if t.name == "sensor_offset"), key=lambda one: -one.fit.loss)
    told = compared(bench, best, known).posterior
    assert told.probabilities.sum() == pytest.approx(1)
    assert told.of_effect("sensor_offset") > 0.99 and told.of_verdict("named", [{"sensor_offset"}]) > 0.8
    assert told.of_unknown < 0.2 and told.of_effect("joint_scale", "tip_load") < 0.2


@cache
def of_pair() -> Compared:
    """What the search comes to from nothing where two effects act."""
    bench, data = bench_of("pair")
    return compared(bench, bench.scored([]), candidates(ROBOT, data, QUICK))


def test_search_comes_to_the_true_pair_that_something_unknown_stood_for() -> None:
    bench, data = bench_of("pair")
    base = bench.scored([])
    before = compared(bench, base, candidates(ROBOT, data, {}))
    assert before.posterior.of_unknown > 0.99 and before.sets == (base,)
    told = of_pair()
    assert set(told.sets[0].names) == {"sensor_offset", "joint_scale"}
    assert told.posterior.of_effect("sensor_offset") > 0.99 and told.posterior.of_effect("joint_scale") > 0.99
    assert told.posterior.of_unknown < 0.2 and told.posterior.probabilities.sum() == pytest.approx(1)


BEGUN = [("tip_load",), ("sensor_offset",), ("tip_load", "sensor_offset")]


@pytest.mark.parametrize("begun", BEGUN if FUZZ else BEGUN[:1])
def test_search_ends_with_the_same_set_wherever_it_begins(begun: tuple[str, ...]) -> None:
    bench, data = bench_of("pair")
    known = candidates(ROBOT, data, QUICK)
    terms = [next(t for t in known.terms if t.name == name) for name in begun]
    told = compared(bench, bench.scored(terms), known)
    assert set(told.sets[0].names) == {"sensor_offset", "joint_scale"}


def test_sets_that_are_hopeless_are_as_hopeless_beside_everything_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    told = [of_pair().posterior]
    monkeypatch.setattr(posterior, "WINDOW", np.inf)
    told.append(of_pair.__wrapped__().posterior)
    for names in (*((name,) for name in QUICK), tuple(QUICK)):
        assert told[0].of_effect(*names) == pytest.approx(told[1].of_effect(*names), abs=1e-3)
    assert told[0].of_unknown == pytest.approx(told[1].of_unknown, abs=1e-3)


def test_rivals_are_compared_anew_beside_another_noise() -> None:
    bench, data = bench_of("pair")
    nothing, (scale, *_) = (
        candidates(ROBOT, data, {}),
        candidates(ROBOT, data, {"joint_scale": CATALOGUE["joint_scale"]}).terms,
    )
    there = replace(bench, noise=bench.noise.scaled(1.1))
    for rivals in ([], [bench.scored([scale])]):
        comparison = posterior._searched(there, there.scored([]), nothing, Teller(), rivals=rivals)
        assert [scored.fit.noise is there.noise for scored in comparison.known_sets if scored.terms] == [True] * len(
            rivals
        )


def test_fewer_parameters_in_the_place_of_many_are_promised_what_these_cost() -> None:
    """Where noise is taken for smaller, a field of 60 coefficients fits more of it than an effect in vain may lose."""
    bench, data = bench_of("")
    bench = replace(bench, noise=bench.noise.scaled(0.2))
    known = candidates(ROBOT, data, {name: CATALOGUE[name] for name in ("sensor_offset", "sensor_distortion")})
    field = next(t for t in known.terms if t.name == "sensor_distortion" and len(t.parameters) == 60)
    many, base = bench.scored([field]), bench.scored([])
    comparison = posterior._Comparison(bench, known, base, many, [base], [])
    promised = {terms[0].name: weight for weight, terms in comparison._replaced(many, field) if len(terms) == 1}
    few = bench.scored([t for t in known.terms if t.name == "sensor_offset"][:1])
    assert few.fit.residuals.loss > many.fit.residuals.loss - 2 * posterior.VAIN
    assert promised["sensor_offset"] > comparison.known_sets[many].weight


def test_search_in_a_null_ends_with_nothing() -> None:
    bench, data = bench_of("", 7)
    told = compared(bench, bench.scored([]), candidates(ROBOT, data, QUICK))
    assert told.sets[0].names == ()
    assert told.posterior.of_verdict("no_missing_effect", []) > 0.8


def test_fit_that_has_used_up_its_steps_goes_on_from_there(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, _ = bench_of("sensor_offset")
    whole = bench.scored([])
    monkeypatch.setattr(least_squares, "MOST_STEPS", 4)
    other, _ = bench_of("sensor_offset")
    short = other.scored([])
    further = other.continued(short)
    assert not short.fit.converged and further.fit.loss < short.fit.loss
    assert further.fit.loss == pytest.approx(whole.fit.loss, abs=2)
    assert bench.continued(whole) is whole


def test_effect_that_nobody_knows_is_something_unknown() -> None:
    bench, data = bench_of("sensor_offset")
    few = {name: effect for name, effect in QUICK.items() if name != "sensor_offset"}
    told = compared(bench, bench.scored([]), candidates(ROBOT, data, few)).posterior
    assert told.of_verdict("no_missing_effect", []) < 0.01


def errors_of_noise() -> tuple[Linearised, UnknownErrors]:
    """The fit of data without an effect, and what may be unknown in them."""
    bench, data = bench_of("")
    base = bench.scored([])
    parts = base.fit.residuals
    fit = Linearised(parts.r, parts.J, base.fit.precision)
    return fit, UnknownErrors(bench, base, base, [fit, fit], np.ones(data.count))


def test_processes_have_the_size_of_the_noise_and_rows_in_any_order_say_the_same() -> None:
    fit, errors = errors_of_noise()
    assert all(np.mean((modes**2).sum(axis=1)) == pytest.approx(1) for modes in errors.processes)
    order = np.random.default_rng(1).permutation(fit.r.size)
    again = copy(errors)
    again._modes, again._known = errors._modes[order], {}
    r, J = fit.r.ravel(), fit.J.reshape(fit.r.size, -1)
    mixed = replace(fit, r=r[order].reshape(fit.r.shape), J=J[order].reshape(fit.J.shape))
    np.testing.assert_allclose(again._gains(mixed), errors._gains(fit), atol=1e-6)


def test_gains_of_processes_are_ratios_of_gaussian_densities() -> None:
    fit, errors = errors_of_noise()
    _, peak = errors.evidence(fit)
    peak = replace(peak, position=0.7, tangent=0.4, process=None)
    r, J = fit.r.ravel(), fit.J.reshape(fit.r.size, -1)
    for beside in (None, peak):
        alone = np.eye(r.size) if beside is None else np.linalg.inv(beside.over_covariance(np.eye(r.size)))
        alone = alone + (J / fit.precision) @ J.T
        gains = errors._gains(fit, beside)
        for k in (0, len(errors.processes) // 2):
            for s in (0, 8, 20):
                wider = alone + SIZES[s] ** 2 * errors.processes[k] @ errors.processes[k].T
                expected = _log_density(r, wider) - _log_density(r, alone)
                assert gains[k, s] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def _log_density(r: Array, covariance: Array) -> float:
    """Logarithm of the density of a Gaussian, up to a constant."""
    return -float(r @ np.linalg.solve(covariance, r) + np.linalg.slogdet(covariance)[1]) / 2


def test_process_that_acts_gains_and_noise_gains_nothing() -> None:
    fit, errors = errors_of_noise()
    modes = errors.processes[0]
    acting = 3 * modes @ np.random.default_rng(3).standard_normal(modes.shape[1])
    weighed = replace(fit, r=fit.r + acting.reshape(fit.r.shape))
    idle, told = (errors._gains(of_data).mean(axis=1).max() for of_data in (fit, weighed))
    assert idle < 0 < 10 < told
    assert errors.evidence(weighed)[0] > without_error(weighed) + 10


def homed_anew(hidden: str, size: float = 1.0) -> Measurements:
    """What a pair measures that was homed in the middle, which changed nothing but where that is hidden."""
    plan = waypoints(ROBOT, 16, seed=4)
    values = {
        "load": {"tip_load": {"force_x_N": 0.1 * size, "force_y_N": -0.05 * size}},
        "homing": {"homing_shift": {"theta_2_2_deg": 3.0 * size}},
    }[hidden]
    middle = plan.sequence.max() // 2
    homing = np.where(plan.sequence > middle, 2, 1)
    return replace(measured(ROBOT, replace(plan, homing=homing), values), homing=homing)


HOMED = {name: CATALOGUE[name] for name in ("tip_load", "homing_shift", "base_misalignment")}


def posterior_of(data: Measurements, bench_is: type[Workbench], more: dict[str, int] | None = None) -> Posterior:
    """What the most probable sets say, on a bench of this kind."""
    bench = bench_is(ROBOT, data, Noise(SIGMA_M, SIGMA_RAD), data.configuration)
    known = candidates(ROBOT, data, HOMED, more)
    if isinstance(bench, CorrelatedBench):
        bench, _ = bench.corrected(bench.scored([]))
        known = partial_diagnosis.testable_beside(known, bench)
    return compared(bench, bench.scored([]), known).posterior


@pytest.mark.parametrize("hidden", ["load", "homing"])
def test_frames_that_are_free_in_every_fit_act_as_probably_as_where_they_are_not(hidden: str) -> None:
    data = homed_anew(hidden)
    alone, beside = (posterior_of(data, kind) for kind in (Workbench, CorrelatedBench))
    for name in HOMED:
        assert beside.of_effect(name) == pytest.approx(alone.of_effect(name), abs=0.05), name
    assert beside.of_effect("homing_shift") > 0.99 or hidden == "load"


@pytest.mark.parametrize("kind", [Workbench, CorrelatedBench])
def test_an_instant_that_the_data_chose_shares_its_prior_with_all_others(kind: type[Workbench]) -> None:
    data = homed_anew("homing", 0.05)
    given, chosen = (posterior_of(data, kind, {"homing_shift": count}).of_effect("homing_shift") for count in (1, 50))
    assert 0 < chosen < given < 0.999
    assert given / (1 - given) == pytest.approx(50 * chosen / (1 - chosen), rel=0.1)


def test_an_effect_far_below_its_prior_pays_for_that_once_and_not_for_each_parameter() -> None:
    """A base that is displaced a little beside loads, whose priors have units that do not compare."""
    data = measured(ROBOT, waypoints(ROBOT, 16, seed=4), {"base_misalignment": {"shift_x_mm": 0.1, "shift_y_mm": 0.05}})
    few = {name: CATALOGUE[name] for name in ("base_misalignment", "sensor_offset", "tip_load")}
    odds = []
    for factor in (1.0, 0.25):
        bench = Workbench(ROBOT, data, Noise(SIGMA_M, SIGMA_RAD), data.configuration)
        known, base = candidates(ROBOT, data, few), CATALOGUE["base_misalignment"]
        wide = [
            Term(base, tuple(replace(q, prior=factor * q.prior) for q in t.parameters)) if t.effect is base else t
            for t in known.terms
        ]
        told = compared(bench, bench.scored([]), replace(known, terms=tuple(wide))).posterior
        odds.append(np.log(told.of_effect("base_misalignment") / told.of_effect("sensor_offset", "tip_load")))
    assert 0 < odds[1] - odds[0] < np.log(4)  # 3 log 4 = 4.2 where widths are as stated


@pytest.mark.parametrize(("size", "count", "least"), [(1.0, 1, -0.35), (1.0, 6, -0.1), (0.05, 6, -0.3), (0.0, 3, -0.8)])
def test_the_evidence_of_an_unknown_width_is_its_integral_over_the_half_cauchy_prior(
    size: float, count: int, least: float
) -> None:
    """By quadrature over the logarithm of the width; what is not there is held for less probable, never for more."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        J = 20 * rng.standard_normal((8, 5, count))
        r = J @ (size * rng.standard_normal(count)) + rng.standard_normal((8, 5))
        ones = np.ones(count)
        fit = Linear(r, J, np.ones(8), ones, np.zeros(count), np.ones((8, 5), bool))
        width = widths_of(fit, ("a",) * count, {"a"})["a"]
        ours = without_error(Linearised(r, J, ones / width.over_stated**2)) - width.cost
        grid = np.linspace(-12, 8, 2001)  # of the logarithm
        prior = np.log(2 / np.pi) + grid - np.log1p(np.exp(2 * grid))
        values = [without_error(Linearised(r, J, ones / np.exp(2 * t))) for t in grid.tolist()] + prior
        exact = logsumexp(values) + np.log(grid[1] - grid[0])
        assert least < ours - exact < 0.1
