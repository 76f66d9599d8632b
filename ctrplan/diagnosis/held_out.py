"""The poses kept aside, opened once: the gap there before and after effects were added, and what is taken back.

No verdict is greener than its figures; an effect without which tips are nearer there goes, as does a built term with
which they are no nearer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.calibration.fit_warnings import excused, symptoms
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import MODEL_POSITION_M, Noise, Residuals, residuals
from ctrplan.calibration.robot_content import within_file
from ctrplan.diagnosis.adequacy import (
    HEAVY,
    REJECTED,
    ChiSquare,
    ignored,
    left_out_probability,
    outliers,
    tail_weight,
)
from ctrplan.diagnosis.conclusion import Conclusion
from ctrplan.diagnosis.linear_fit import predicted
from ctrplan.diagnosis.partial_diagnosis import left_by_names
from ctrplan.diagnosis.remainder import Place, localise
from ctrplan.diagnosis.term_pieces import is_built
from ctrplan.diagnosis.verdict import NAMED, Judgement, Verdict, done_by, names_of
from ctrplan.diagnosis.workbench import Scored
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import simulated
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term
from ctrplan.pipeline.tip_table import FrictionCorrection

MOST_WORSE = 1.05  # rms error of poses kept aside with an effect, over that without it, for chance allows for so much


@dataclass(frozen=True, eq=False)
class Gap:
    """Before: calibrated, without the effects; after: with them. Regions are named in words."""

    nominal: Errors
    before: Errors
    after: Errors
    floor_m: float
    tails: float  # of the residuals that were fitted: variance of their squares over what it is for Gaussian noise
    spread_m: float  # rms distance that the uncertainty of the fitted parameters leaves open, with the effects
    regions: Mapping[str, tuple[Errors, Errors]]
    before_m: Array  # (V,) distances of the held-out set's poses, without those that are left out
    after_m: Array
    chi_square: ChiSquare  # of the held-out set's poses under the predictive distribution of the fit with the effects
    failed: NDArray[np.bool_]  # of all poses of the held-out set: without a solution, before or after
    outlying: NDArray[np.bool_]  # likewise: too far off for noise while few are, left out of every figure
    correction: FrictionCorrection | None  # of all its poses: what friction states leave out, with the effects


def open_test_set(before: Fit, after: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise) -> Gap:
    """Predicts the held-out set's poses with fits that have not seen them; where one has no solution, none is asked.

    Few poses too far off for noise are in no figure: what chi-squares leave out, errors leave out as well.
    """
    nominal = ParametricChain(before.chain.robot, held_out_set, before.chain.terms)
    chains = [simulated(f.chain.robot, held_out_set, f.chain.terms, f.p) for f in (before, after)]
    correction, effective_there = chains[1].correction, chains[1].predict(after.p)
    without = (nominal, before.chain.neutral), (chains[0], before.p)
    predictions = [*(chain.predict(p, derivatives=False) for chain, p in without), effective_there]
    failed = predictions[1].failed | predictions[2].failed
    kept = ~excused(failed)
    result = _residuals(effective_there.subset(kept), held_out_set.subset(kept), group[kept], noise)
    outlying, near = np.zeros(len(kept), bool), ~outliers(result.raw_norm)
    outlying[np.flatnonzero(kept)[~near]] = True
    kept &= ~outlying
    held_out_set, group = held_out_set.subset(kept), group[kept]
    errors = [distances(prediction.subset(kept), held_out_set) for prediction in predictions]
    regions = {
        name: (summary(errors[1][inside], group[inside]), summary(errors[2][inside], group[inside]))
        for name, inside in _regions(held_out_set).items()
    }
    nominal_errors, calibrated, effective = (summary(e, group) for e in errors)
    given = result.given[near]
    chi_square = ChiSquare(predicted(result.r[near][given], result.J[near][given], after.information)[0], given.sum())
    return Gap(
        nominal_errors,
        calibrated,
        effective,
        noise.floor_m,
        _tails(after.residuals),
        _spread_m(effective_there.subset(kept).position_by, after),
        regions,
        errors[1],
        errors[2],
        chi_square,
        failed,
        outlying,
        correction,
    )


def rms_there_m(fit: Fit, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise, like: Gap) -> float:
    """Rms distance of the held-out set's poses by a like fit, with friction states as a gap has them.

    Poses that either leaves without a solution, and its own outliers, are left out.
    """
    chain = ParametricChain(fit.chain.robot, held_out_set, fit.chain.terms)
    chain.correction = like.correction if chain.robot_at(fit.p).friction.any() else None
    there = chain.predict(fit.p, derivatives=False)
    kept = ~excused(like.failed | there.failed)
    result = _residuals(there.subset(kept), held_out_set.subset(kept), group[kept], noise)
    error = distances(there.subset(kept), held_out_set.subset(kept))[~outliers(result.raw_norm)]
    return float(np.sqrt(np.mean(error**2)))


def _tails(fitted: Residuals) -> float:
    near = ~outliers(fitted.raw_norm)
    weight = tail_weight(fitted.norm[near], fitted.given.sum(axis=1)[near]) if near.any() else 1.0
    return weight if weight > HEAVY else 1.0


def _spread_m(position_by: Array, after: Fit) -> float:
    """Rms distance, of positions with derivatives (V, 3, P), within the covariance of the parameters."""
    per_pose = ((position_by @ after.covariance) * position_by).sum(axis=(1, 2))
    return float(np.sqrt(per_pose.mean())) if len(per_pose) else 0.0


def _regions(held_out_set: Measurements) -> dict[str, NDArray[np.bool_]]:
    """Thirds by extension of the innermost tube, or by time where it does not slide."""
    out = held_out_set.l_commanded[held_out_set.rows, -1]
    if np.ptp(out) < 1e-3:
        out, words = held_out_set.rows.astype(float), ("first third", "second third", "last third")
    else:
        words = ("innermost tube retracted", "innermost tube half way", "innermost tube extended")
    edges = np.quantile(out, [1 / 3, 2 / 3])
    third = np.searchsorted(edges, out, side="right")
    return {word: third == k for k, word in enumerate(words) if np.any(third == k)}


def _residuals(
    prediction: SensorPrediction, held_out_set: Measurements, group: NDArray[np.int_], noise: Noise
) -> Residuals:
    whitening: Sequence[int] | NDArray[np.int_] = np.arange(len(group)) if held_out_set.is_stream else group
    return residuals(held_out_set, prediction, noise, whitening)


LARGEST_REST = 1.5  # of the noise: rms error with which a model still agrees with measurements


def times_noise(rms_m: float, floor_m: float) -> float:
    """An rms error [m] over the noise and the solver's own error."""
    return rms_m / math.hypot(floor_m, math.sqrt(3) * MODEL_POSITION_M)


def largest_remainder(tails: float) -> float:
    """The largest remainder that noise leaves, whose squares vary `tails` times as much as Gaussian ones: so much
    less certain is their mean.
    """
    return math.sqrt(1 + (LARGEST_REST**2 - 1) * math.sqrt(tails))


def contradiction(verdict: Verdict, gap: Gap, place: Place) -> str:
    """What contradicts a verdict that says that a model agrees with the measurements, as a sentence; empty if nothing.

    On the poses kept aside it is the error with the effects, beyond noise and what the fitted parameters leave open:
    few poses do not settle an effect of many parameters, and noise with heavy tails is larger here and smaller there.
    Where none is missing, no tails are allowed for, and the poses that were fitted are asked as well.
    """
    if verdict == "partial" and gap.after.rms_m >= gap.before.rms_m:
        off = f"{gap.before.rms_m * 1e3:.2f} mm off (rms) without them and {gap.after.rms_m * 1e3:.2f} mm with them"
        return f"The figures contradict the effects found: on the poses kept aside tips are {off}."
    if verdict in ("partial", "unexplained"):
        return ""
    is_complete = verdict == "no_missing_effect"
    largest = LARGEST_REST if is_complete else largest_remainder(gap.tails)
    shown = {"the poses kept aside": (gap.after.rms_m, math.hypot(gap.floor_m, gap.spread_m), largest)}
    if is_complete:
        shown["the poses that were fitted"] = place.rms_m, gap.floor_m, LARGEST_REST
    for where, (rms_m, expected_m, most) in shown.items():
        if not times_noise(rms_m, expected_m) <= most:
            left_open = f", parameters leave {gap.spread_m * 1e3:.2f} mm open"
            off = f"tips are {rms_m * 1e3:.2f} mm off (rms), the noise is {gap.floor_m * 1e3:.2f} mm{left_open}"
            return f"The figures contradict it: on {where} {off}."
    return ""


@dataclass(frozen=True, eq=False)
class Opened:
    """The verdict after the held-out set was asked, the model with its effects, and the errors of that model."""

    judgement: Judgement
    written: Scored
    gap: Gap
    place: Place
    notes: tuple[str, ...]
    answer: Conclusion  # whose verdict that is: without a built term where that failed
    named_gap: Gap | None = None  # without the built term, where there is one
    framed_gap: Gap | None = None  # with free frames alone, where something remains


def opened(answer: Conclusion, data: Measurements) -> Opened:
    """What the poses kept aside say of an answer; a built term that brings them no nearer is taken back.

    Names that hold beside it stay. An effect without which tips are nearer there is taken back.
    """
    outcome = _with_or_without_built(answer, data)
    if harmful := _harmful(outcome, data):
        names = ", ".join(t.name for t in harmful)
        note = f"Found and taken back: {names}, without which tips of the poses kept aside are nearer."
        outcome = _opened(_without(outcome.answer, harmful), data)
        outcome = replace(outcome, notes=(*outcome.notes, note))
    return replace(outcome, framed_gap=_framed(outcome.answer, data)) if outcome.answer.rest else outcome


def _harmful(outcome: Opened, data: Measurements) -> list[Term]:
    """Effects without which poses kept aside are predicted better."""
    answer, listed = outcome.answer, _handed_over(outcome.judgement)
    if answer.rest is None or answer.compared is None or answer.interrupted or not listed:
        return []
    kept, results, chosen = answer.split.held_out_set, list[Term](), answer.handed_over
    aside, group, noise = data.subset(kept), answer.group[kept], answer.noise
    for t in (t for t in chosen.terms if t.key in listed):
        others = [other for other in chosen.terms if other.key != t.key]
        without = answer.bench.scored(others, *(answer.compared.places(others) or [chosen.fit]))
        rms_m = rms_there_m(answer.bench.handed_over(without).fit, aside, group, noise, outcome.gap)
        if MOST_WORSE * rms_m < outcome.gap.after.rms_m:
            results.append(t)
    return results


def _handed_over(judgement: Judgement) -> set[str]:
    """Keys of the effects that the robot file has: those listed, and those whose work something unknown may do."""
    return {t.key for t in (*(finding.term for finding in judgement.findings), *judgement.together)}


def _without(answer: Conclusion, harmful: Sequence[Term]) -> Conclusion:
    """The answer where some of its effects do not act: others are listed that are as certain without them."""
    assert answer.compared is not None
    gone, posterior = {t.key for t in harmful}, answer.compared.posterior.without({t.name for t in harmful})
    kept = [f for f in answer.judgement.findings if f.term.key not in gone]
    findings = tuple(f for f, names in zip(kept, names_of(kept), strict=True) if posterior.of_effect(*names) >= NAMED)
    told = {f.term.key for f in findings}
    others = [t for t in (*(f.term for f in kept), *answer.judgement.together) if t.key not in told | gone]
    rest = [t for t in answer.chosen.terms if t.key not in gone]
    bench, chosen = answer.bench.corrected(answer.bench.scored(rest, answer.handed_over.fit))
    together = done_by(chosen, others, posterior, NAMED if findings else 1 / 2)
    verdict: Verdict = "partial" if findings else "unexplained"
    judgement = replace(answer.judgement, verdict=verdict, findings=findings, together=together)
    compared = replace(answer.compared, posterior=posterior)
    return replace(answer, bench=bench, chosen=chosen, judgement=judgement, compared=compared, built=None)


def _framed(answer: Conclusion, data: Measurements) -> Gap:
    """What frames alone do for the poses kept aside."""
    assert answer.compared is not None
    kept, frames = answer.split.held_out_set, answer.bench.handed_over(answer.compared.base)
    return open_test_set(answer.base.fit, frames.fit, data.subset(kept), answer.group[kept], answer.noise)


def _with_or_without_built(answer: Conclusion, data: Measurements) -> Opened:
    if answer.built is None or answer.before is None:
        return _opened(answer, data)
    result, without = _opened(answer, data), _opened(replace(answer, chosen=answer.built.named, built=None), data)
    if result.gap.after.rms_m < without.gap.after.rms_m:
        return replace(result, named_gap=without.gap)
    less = without if _handed_over(without.judgement) else _opened(answer.before.told, data)
    note = "A term was built and taken back: the poses kept aside are not nearer with it."
    return replace(less, notes=(*less.notes, note))


def _opened(answer: Conclusion, data: Measurements) -> Opened:
    """The verdict and the errors of the model that is handed over, without what these contradict."""
    kept = answer.split.held_out_set
    aside, group = data.subset(kept), answer.group[kept]

    def handed_over(judgement: Judgement) -> tuple[Judgement, Scored, Gap]:
        written = _written(answer, judgement)
        gap = open_test_set(answer.base.fit, written.fit, aside, group, answer.noise)
        return replace(judgement, adequacy=left_by_names(answer.bench, written)), written, gap

    judgement, written, gap = handed_over(answer.judgement)
    place, notes = _place(answer, gap), list[str]()
    is_part = judgement.verdict == "unexplained" and bool(_handed_over(judgement))
    verdict: Verdict = "partial" if is_part else judgement.verdict
    if doubt := contradiction(verdict, gap, place) or _unlike(answer, judgement, written, gap):
        judgement, written, gap = handed_over(replace(judgement, verdict="unexplained", findings=(), together=()))
        notes.append(doubt)
    settled, built = answer.handed_over, {t.name for t in answer.chosen.terms if is_built(t)}
    sentences = [symptom.sentence for symptom in symptoms(settled.fit) if symptom.owner not in built]
    return Opened(judgement, written, gap, place, (*notes, *sentences), answer)


def _unlike(answer: Conclusion, judgement: Judgement, written: Scored, gap: Gap) -> str:
    """That the held-out set is farther off than poses that chose, where noise alone should remain, as a sentence.

    Noise that had to be enlarged may have taken in a misfit: no allowance is made for it.
    """
    if judgement.verdict in ("partial", "unexplained"):
        return ""
    left = judgement.adequacy.total
    p = left_out_probability(gap.chi_square, left, _solved(written), estimated=answer.is_rescaled)
    says = f"The held-out set contradicts it: chi-square per degree of freedom {gap.chi_square.ratio:.2f}."
    return says if p <= REJECTED else ""


def _solved(scored: Scored) -> Residuals:
    """Residuals of the poses that chi-squares are of, outliers among them."""
    parts, kept = scored.fit.residuals, ~excused(scored.failed)
    return Residuals(parts.r[kept], parts.J[kept], parts.weight[kept], parts.raw_norm[kept], parts.given[kept])


def _written(answer: Conclusion, judgement: Judgement) -> Scored:
    """The model with the effects of the verdict alone, as large as the data say, in numbers a robot file may have."""
    bench, whole, listed = answer.bench, answer.handed_over, _handed_over(judgement)
    kept = [t for t in whole.terms if t.key in listed or (answer.built and is_built(t))]
    is_whole = len(kept) == len(whole.terms)
    if answer.rest:
        return whole if is_whole else bench.handed_over(bench.scored(kept, whole.fit))
    scored = whole if is_whole else bench.handed_over(bench.scored(kept, answer.chosen.fit))
    inside = within_file(scored.fit)
    return scored if inside is scored.fit else replace(scored, fit=inside)


def _place(answer: Conclusion, gap: Gap) -> Place:
    base = answer.base
    fit, kept = base.fit, ~ignored(base)
    error = distances(fit.chain.predict(fit.p, derivatives=False), fit.chain.data)
    data, group = answer.bench.data.subset(kept), answer.bench.group[kept]
    return localise(data, fit.residuals.r[kept], group, error[kept], gap.floor_m)
