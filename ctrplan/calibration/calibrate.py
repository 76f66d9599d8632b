"""Least squares over named parameters, (48), (49): values, intervals, what the data can't tell, error on unseen
poses.

Deviation from (49): it squares the sum of the distance and the angle of each pose; here position and tangent are
squared apart, which is the likelihood of independent Gaussian errors. With weighting "paper" 1 deg weighs as much as
1 mm, as there; with "stated" both count over the noise of the robot file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import SEED, Choice, Flag, Interval, Made, Number, Table, Texts, Whole, checked
from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.calibration.estimates import Combination, Errors, Estimate, combinations, distances, estimates, summary
from ctrplan.calibration.fit_warnings import (
    excused,
    gross_outliers,
    outlier_sentences,
    symptoms,
    too_many,
    unsolved_sentence,
)
from ctrplan.calibration.least_squares import MOST_STEPS, Fit, fit
from ctrplan.calibration.parameters import chosen_terms, require_apart, spelled_out
from ctrplan.calibration.reading import told_again
from ctrplan.calibration.residuals import Noise, Weighting, weighed_by
from ctrplan.calibration.robot_content import calibrated_content, model_error_m, within_file
from ctrplan.effects.effect import Parameter
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements, groups
from ctrplan.pipeline.followed_runs import simulated
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.robot.data_rules import require_measured
from ctrplan.robot.robot import Robot


@shown
@dataclass(frozen=True, eq=False)
class Calibration:
    """A fit of named parameters. Estimates are in the units of the names."""

    fit: Fit
    estimates: Mapping[str, Estimate]
    training: Errors
    held_out: Errors | None  # None when no pose was kept aside
    nominal: Errors  # of all poses, with the file's values
    combinations: tuple[Combination, ...]  # least known first
    model_error_m: float
    notes: tuple[str, ...]
    data: Measurements
    first: Fit | None = None  # of two passes

    @cached_property
    def robot(self) -> Robot:
        """The calibrated robot, as if read from the file that `robot_content` is of: with its intervals and the error
        that is left.
        """
        import ctrplan  # files are of a package above, and stand in the public names

        return ctrplan.robot_from_dict(self.robot_content())

    def robot_content(self) -> dict[str, Any]:
        """The content of the new robot file; the parent is not touched."""
        effects = [t for t in self.fit.chain.terms if not t.effect.of_the_file]
        return calibrated_content(self.fit, effects, self.data, self.model_error_m, self.first)


def calibrated(
    passes: Sequence[Fit],
    everything: Measurements,
    everyones: NDArray[np.int_],
    apart: NDArray[np.bool_],
    wrong: NDArray[np.bool_],
) -> Calibration:
    """The calibration of all poses, their groups, those kept aside and those that went wrong, (K,) each."""
    data, group, aside = everything.subset(~wrong), everyones[~wrong], apart[~wrong]
    passes, noticed = [*passes[:-1], within_file(passes[-1])], [symptom.sentence for symptom in symptoms(passes[0])]
    first, result = passes[0], passes[-1]
    robot, terms = result.chain.robot, result.chain.terms
    trained = tested = PoseErrors.of(result.chain, result.p, group[~aside])
    if aside.any():
        chain = simulated(robot, data.subset(aside), terms, result.p)
        tested = PoseErrors.of(chain, result.p, group[aside])
    neutral = result.chain.neutral
    nominal = PoseErrors.of(simulated(robot, data, terms, neutral), neutral, group)
    least_known = tuple(combinations(first))
    unknown = [
        f"The data can't tell {' and '.join(c.parameters)} apart from the prior: "
        f"{100 * c.posterior_share:.0f} % of it is left."
        for c in least_known
        if not c.is_known
    ]
    return Calibration(
        fit=result,
        estimates={n: e for f in reversed(passes) for t in f.chain.terms for n, e in estimates(f, t).items()},
        training=trained.errors,
        held_out=tested.errors if aside.any() else None,
        nominal=nominal.errors,
        combinations=least_known,
        model_error_m=model_error_m(tested.distance_m, result.noise.position_m),
        notes=(
            *data.warnings,
            *unknown,
            *unsolved_sentence(data, nominal.failed, nominal.counted, "with the file's values"),
            *_unsolved(data, aside, trained, tested),
            *outlier_sentences(result, everything, wrong),
            *noticed,
        ),
        data=everything,
        first=passes[0] if len(passes) > 1 else None,
    )


@shown
@dataclass(frozen=True, eq=False)
class PoseErrors:
    """What a fit leaves of the poses (K,) of a chain."""

    distance_m: Array  # of those that count: not where the model has no solution, unless it has none at too many
    errors: Errors
    failed: NDArray[np.bool_]  # (K,)
    counted: NDArray[np.bool_]  # (K,)

    @classmethod
    def of(cls, chain: ParametricChain, p: Array, group: NDArray[np.int_]) -> PoseErrors:
        """Errors of a chain at parameters (P,); `group` (K,) numbers the configurations."""
        prediction = chain.predict(p, derivatives=False)
        counted = ~excused(prediction.failed)
        distance = distances(prediction, chain.data)[counted]
        return cls(distance, summary(distance, group[counted]), prediction.failed, counted)


def _unsolved(data: Measurements, aside: NDArray[np.bool_], trained: PoseErrors, tested: PoseErrors) -> list[str]:
    failed, counted = np.zeros((2, data.count), bool)
    failed[~aside], counted[~aside] = trained.failed, trained.counted
    if aside.any():
        failed[aside], counted[aside] = tested.failed, tested.counted
    return unsolved_sentence(data, failed, counted, "calibrated")


SPREAD = 0.7  # of the priors that further starts are drawn with


@checked(
    robot=Made("Robot"),
    measurements=Made("Measurements"),
    parameters=Texts(),
    second_pass=Texts(),
    weighting=Choice("stated", "paper"),
    priors=Table(Number(0, 1e6, above=True)),
    bounds=Table(Interval()),
    held_out=Number(0, 0.99),
    starts=Whole(1, 100),
    seed=SEED,
    as_read=Flag(),
)
def calibrate(
    robot: Robot,
    measurements: Measurements,
    parameters: Sequence[str] | None = None,
    *,
    second_pass: Sequence[str] = (),
    weighting: Weighting | None = None,
    priors: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    held_out: float = 0.25,
    starts: int = 1,
    seed: int = 0,
    as_read: bool = False,
) -> Calibration:
    """Fits `parameters`, then with these held `second_pass`, to measured poses.

    Names: a number of the robot such as tube.2.poisson_ratio (SI), effects.friction.mu_1 for one of an effect,
    effects.friction for all of them that the data can test, or one of the base parameters, "calibration" for all;
    None: all of those (precurvature magnitudes, stiffness ratios, Poisson's ratios).
    `priors` are standard deviations and `bounds` limits, by the names that are fitted, in their units. `held_out` is
    the share of configurations kept aside. Poses that went wrong, `gross_outliers.py`, are left out of all fits and
    errors, and a note names their rows.
    Whether the measurements mean what they say is asked first: by default nothing is fitted to those that do not, and
    MisreadError is raised; with `as_read` they are fitted as they stand, and a note says it. Raises
    InputError for what no file of measurements may say, for unknown names, for names given twice and for too few poses.
    """
    require_measured(robot, measurements)
    names = spelled_out(["calibration"] if parameters is None else parameters, robot, measurements)
    second_pass = spelled_out(second_pass, robot, measurements)
    fitted_names = [*names, *second_pass]
    require_apart(robot, fitted_names)
    if not names:
        raise InputError("must name something to fit, None is ordinary calibration", key="parameters", value=names)
    for key, table in (("priors", priors or {}), ("bounds", bounds or {})):
        for name in table.keys() - set(fitted_names):
            raise InputError(f"is not fitted: those that are, are {', '.join(fitted_names)}", key=key, value=name)
    reading = told_again(robot, measurements, as_read=as_read)
    noise = weighed_by(robot, measurements, weighting)
    group = groups(measurements)
    aside = _split_off(group, held_out, seed)
    terms = chosen_terms(robot, names, priors or {}, bounds or {})
    more = chosen_terms(robot, second_pass, priors or {}, bounds or {}) if second_pass else []

    def fitted(poses: NDArray[np.bool_]) -> list[Fit]:
        _check_count(measurements.subset(poses), group[poses], len(names) + len(second_pass))
        first = _fitted(ParametricChain(robot, measurements.subset(poses), terms), noise, starts, seed)
        return [first, _second(first, more)] if more else [first]

    passes, wrong = _without_outliers(fitted, measurements, aside)
    result = calibrated(passes, measurements, group, aside, wrong)
    return replace(result, notes=(*(each.sentence for each in reading), *result.notes))


def _without_outliers(
    fitted: Callable[[NDArray[np.bool_]], list[Fit]], data: Measurements, aside: NDArray[np.bool_]
) -> tuple[list[Fit], NDArray[np.bool_]]:
    """The passes fitted to poses that are right, and which of all (K,) went wrong: by the last fit, too."""
    wrong, every = np.zeros(data.count, bool), np.ones(data.count, bool)
    while True:
        passes = fitted(~aside & ~wrong)
        more = gross_outliers(passes[-1], data, ~wrong)
        if not more.any() or too_many(wrong | more, every):
            break
        wrong |= more
    still = wrong & gross_outliers(passes[-1], data, every)
    return (passes, wrong) if np.array_equal(still, wrong) else (fitted(~aside & ~still), still)


def _split_off(group: NDArray[np.int_], share: float, seed: int) -> NDArray[np.bool_]:
    if not 0 <= share < 1:
        raise InputError("must be from 0 to below 1", key="held_out", value=share)
    numbers = np.random.default_rng(seed).permutation(np.unique(group))
    aside: NDArray[np.bool_] = np.isin(group, numbers[: int(round(share * len(numbers)))])
    return aside


def _check_count(data: Measurements, group: NDArray[np.int_], parameters: int) -> None:
    count = len(np.unique(group))
    each = int(np.ceil(data.given.sum(axis=1).mean())) if count else data.given.shape[1]  # numbers of a pose
    if count * each < 2 * parameters:
        least = -(-2 * parameters // each)
        there = "1 configuration" if count == 1 else f"{count} configurations"
        rule = f"has {there} to fit, too few for {parameters} parameters: at least {least}"
        raise InputError(rule, file=data.file)


def _fitted(chain: ParametricChain, noise: Noise, starts: int, seed: int, first: Array | None = None) -> Fit:
    """The best of several starts; with friction again with what its states leave out, until that changes nothing."""
    group = np.arange(chain.data.count) if chain.data.is_stream else chain.data.configuration
    rng = np.random.default_rng(seed)
    begin = chain.start if first is None else first
    drawn = [begin + SPREAD * chain.prior * rng.standard_normal(len(begin)) for _ in range(starts - 1)]
    chain = simulated(chain.robot, chain.data, chain.terms, begin)
    best = min((fit(chain, noise, group, start) for start in (begin, *drawn)), key=lambda candidate: candidate.loss)
    for _ in range(MOST_STEPS):
        corrected = simulated(chain.robot, chain.data, chain.terms, best.p)
        if corrected.correction is None:
            break
        before, best = best, fit(corrected, noise, group, best.p)
        if np.array_equal(before.p, best.p):
            break
    return best


def _second(first: Fit, terms: Sequence[Term]) -> Fit:
    """The second pass: what the first found is held by priors that leave it no room."""
    fixed = tuple(
        Term(t.effect, tuple(_test_set(p, v / p.si) for p, v in zip(t.parameters, first.p[s], strict=True)))
        for t, s in zip(first.chain.terms, first.chain.slices(), strict=True)
    )
    chain = ParametricChain(first.chain.robot, first.chain.data, [*fixed, *terms])
    return _fitted(chain, first.noise, 1, 0)


def _test_set(parameter: Parameter, value: float) -> Parameter:
    tight = 1e-6 * parameter.prior
    return Parameter(
        parameter.name, tight, neutral=value, lower=parameter.lower, upper=parameter.upper, si=parameter.si
    )
