"""From measurements to a set of effects and a verdict, before the test set is opened.

The ordinary search comes first and names what leaves noise alone. Where nothing does, the partial diagnosis says what
holds beside a remainder. A long log of a continuous motion, in which the ordinary search takes minutes, begins there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import gross_outliers, too_many
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import ignored, remains, rescaled_noise
from ctrplan.diagnosis.built_term import Built, build
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis, diagnose_partially
from ctrplan.diagnosis.posterior import Compared, settled
from ctrplan.diagnosis.usable_poses import MOST_POSES, bench_of, checked_split, thinned, without_outliers
from ctrplan.diagnosis.verdict import Judgement, judge
from ctrplan.diagnosis.workbench import Candidates, Interrupted, Scored, SelectionStep, Teller, Workbench
from ctrplan.measurement.measurements import Measurements, Split, groups
from ctrplan.robot.robot import Robot

INTERRUPTED = "Interrupted: this is what was found until then, not a verdict."


@dataclass(frozen=True, eq=False)
class Conclusion:
    """What was found on the poses that choose; the arrays are over all poses (K,) of the data."""

    bench: Workbench
    path: tuple[SelectionStep, ...]
    chosen: Scored  # with the effects of the search
    base: Scored  # calibrated, without effects
    judgement: Judgement
    split: Split
    group: NDArray[np.int_]  # (K,) poses that count as one
    noise: Noise
    is_rescaled: bool  # whether the noise is smaller than stated
    wrong: NDArray[np.bool_]  # (K,) poses that went wrong
    notes: tuple[str, ...]
    interrupted: bool = False
    partial: PartialDiagnosis | None = None
    built: Built | None = None  # a term of what the effects leave
    otherwise: Conclusion | None = None  # what is said where the built term fails on the held-out set
    compared: Compared | None = None  # sets of effects, as probable as they are on the poses of the ordinary search


def conclude(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, known: Candidates, teller: Teller
) -> Conclusion:
    """Searches what the catalogue has; `usable` (K,) are the poses to go by. Raises InputError where they are few."""
    wrong, parts, bench = without_outliers(robot, data, usable, noise)
    is_long = data.is_stream and int((usable & ~wrong).sum()) > 2 * MOST_POSES  # every other is compared at most
    if is_long:
        begun = _calibrated(data, thinned(parts, data), bench, wrong)
        first = _beside_a_remainder(begun, data, usable, noise, known, teller)
        if first.interrupted or (first.partial and not first.partial.is_noise):
            return _with_built(first, first, teller)
    if bench.data.count < len(parts.selection):
        bench = bench_of(robot, data, parts, noise)
    result = _ordinary(data, usable, wrong, bench, parts, known, teller)
    is_explained = result.compared is None or result.compared.posterior.of_unknown < 1 / 2
    if is_explained or is_long:
        return result
    part = _beside_a_remainder(result, data, usable, noise, known, teller)
    is_told = part.interrupted or part.judgement.findings or part.judgement.together
    return _with_built(part, part if is_told else result, teller)


def _with_built(part: Conclusion, otherwise: Conclusion, teller: Teller) -> Conclusion:
    """What holds beside a rest with a term built of the rest; `otherwise` where there is none."""
    if part.partial is None or part.interrupted:
        return otherwise
    try:
        built = build(part.partial, teller)
    except Interrupted:
        return replace(otherwise, interrupted=True, notes=(*otherwise.notes, INTERRUPTED))
    if built is None:
        return otherwise
    return replace(
        part,
        bench=built.partial.bench,
        chosen=built.scored,
        judgement=built.partial.judgement,
        partial=built.partial,
        built=built,
        otherwise=otherwise,
        path=(*part.path, *built.path, *built.partial.path),
    )


def _beside_a_remainder(
    before: Conclusion,
    data: Measurements,
    usable: NDArray[np.bool_],
    stated: Noise,
    known: Candidates,
    teller: Teller,
) -> Conclusion:
    """What holds although something remains; what there was before, where it is interrupted.

    The noise may be smaller than stated. It is never enlarged, for the rest would hide in it.
    """
    noise = before.noise if before.is_rescaled else stated
    try:
        near = before.base.fit
        part = diagnose_partially(before.bench.robot, data, usable & ~before.wrong, noise, known, teller, near)
    except Interrupted:
        return replace(before, interrupted=True, notes=(*before.notes, INTERRUPTED))
    return replace(
        before,
        bench=part.bench,
        noise=noise,
        path=(*before.path, *part.path),
        chosen=part.chosen,
        base=part.base,
        judgement=part.judgement,
        split=part.split,
        group=part.block,
        partial=part,
    )


def _calibrated(data: Measurements, parts: Split, bench: Workbench, wrong: NDArray[np.bool_]) -> Conclusion:
    """Before any search."""
    base = bench.scored([])
    judgement = Judgement("unexplained", (), remains(bench, base))
    return Conclusion(bench, (), base, base, judgement, parts, groups(data), bench.noise, False, wrong, ())


def _ordinary(
    data: Measurements,
    usable: NDArray[np.bool_],
    wrong: NDArray[np.bool_],
    bench: Workbench,
    parts: Split,
    known: Candidates,
    teller: Teller,
) -> Conclusion:
    """The search for what leaves noise alone, once more without poses that something missing had hidden."""
    result = _searched(data, parts, bench, wrong, known, teller)
    more = gross_outliers(result.chosen.fit, data, usable & ~wrong)
    if more.any() and not too_many(wrong | more, usable) and not result.interrupted:
        parts = checked_split(data, usable & ~(wrong | more))
        bench = bench_of(bench.robot, data, parts, bench.noise)
        result = _searched(data, parts, bench, wrong | more, known, teller)
    return result


def _searched(
    data: Measurements,
    parts: Split,
    bench: Workbench,
    wrong: NDArray[np.bool_],
    known: Candidates,
    teller: Teller,
) -> Conclusion:
    """Search and judgement, once more with the noise that the data show if it is not the stated one."""
    notes, stated = tuple[str, ...](), bench.noise
    try:
        teller("calibrating")
        bench, compared, chosen, path, judgement = _most_probable(bench, known, teller)
        scaled, note = rescaled_noise(judgement.adequacy, stated, *_norms(chosen))
        notes = (note,) if note else ()
        if scaled is not None:
            bench = Workbench(bench.robot, bench.data, scaled, bench.group)
            bench, compared, chosen, path, judgement = _most_probable(bench, known, teller)
    except Interrupted:
        return replace(_calibrated(data, parts, bench, wrong), notes=(*notes, INTERRUPTED), interrupted=True)
    return replace(
        _calibrated(data, parts, bench, wrong),
        path=path,
        chosen=chosen,
        judgement=judgement,
        is_rescaled=bench.noise.position_m < stated.position_m,
        notes=notes,
        compared=compared,
    )


def _most_probable(
    bench: Workbench, known: Candidates, teller: Teller
) -> tuple[Workbench, Compared, Scored, tuple[SelectionStep, ...], Judgement]:
    bench, compared, chosen, path = settled(bench, bench.scored([]), known, teller)
    judgement = judge(bench, chosen, known, compared.posterior, compared.sets)
    return bench, compared, chosen, path, judgement


def _norms(scored: Scored) -> tuple[Array, Array]:
    """Norms of the residuals per pose, without outliers, and how many measured numbers each has."""
    parts, kept = scored.fit.residuals, ~ignored(scored)
    return parts.norm[kept], parts.given[kept].sum(axis=1)
