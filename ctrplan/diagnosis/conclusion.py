"""From measurements to a set of effects and a verdict, before the test set is opened.

The ordinary search comes first and names what leaves noise alone. Where nothing does, what holds beside a rest is asked
for, `partly.py`. A long log of a continuous motion, in which the ordinary search takes minutes, is asked that first.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.long_work import StageProgress
from ctrplan.calibration.fit_warnings import gross_outliers, too_many
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import ignored, remains, rescaled_noise
from ctrplan.diagnosis.built_term import Built, build
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis, diagnose_partially
from ctrplan.diagnosis.posterior import Compared, compared
from ctrplan.diagnosis.selection import SelectionStep, Selector
from ctrplan.diagnosis.smooth_evidence import remaining_error
from ctrplan.diagnosis.usable_poses import MOST_POSES, bench_of, checked_split, thinned, without_outliers
from ctrplan.diagnosis.verdict import NAMED, Finding, Judgement, judge, names_of, specific
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench
from ctrplan.measurement.measurements import Measurements, Split, groups
from ctrplan.robot.robot import Robot

HELD_OUT_SHARE = 0.95  # of the work done when the held-out set is asked


class Interrupted(Exception):
    """Ctrl-C between two fits."""


@dataclass(eq=False)
class Teller:
    """Names the steps to whoever watches, and stops between them when asked to."""

    progress: StageProgress | None
    interrupted: threading.Event | None
    share: float = 0.05

    def pause(self) -> None:
        """Where a run may stop."""
        if self.interrupted is not None and self.interrupted.is_set():
            raise Interrupted

    def __call__(self, step: str) -> None:
        """A step begins."""
        self.pause()
        self.share += 0.25 * (HELD_OUT_SHARE - self.share)  # how many steps there will be is not known
        if self.progress:
            self.progress(step, self.share)


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
    partly: PartialDiagnosis | None = None
    built: Built | None = None  # a term of what the effects leave
    otherwise: Conclusion | None = None  # what is said where the built term fails on the held-out set
    compared: Compared | None = None  # sets of effects, as probable as they are on the poses of the ordinary search


def conclude(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, known: Candidates, teller: Teller
) -> Conclusion:
    """Searches what the catalogue has; `usable` (K,) are the poses to go by. Raises InputError where they are few."""
    wrong, parts, bench = without_outliers(robot, data, usable, noise)
    is_long = (
        data.is_stream and int((usable & ~wrong).sum()) > 2 * MOST_POSES
    )  # of which every other is compared at most
    if is_long:
        few = thinned(parts, data)
        nothing = _nothing(data, few, bench_of(robot, data, few, noise), wrong)
        first = _beside_a_remainder(nothing, data, usable, noise, known, teller)
        if first.interrupted or (first.partly and not first.partly.is_noise):
            return _with_built(first, first, teller)
    result = _unless_something_remains(_ordinary(data, usable, wrong, bench, parts, known, teller))
    result = result if is_long else _unless_improbable(result, known, teller)
    explained = result.judgement.verdict != "unexplained" or result.judgement.adequacy.is_adequate
    if explained or result.interrupted or is_long:
        return result
    part = _beside_a_remainder(result, data, usable, noise, known, teller)
    if whole := _explaining_all(part, known, teller):
        return whole
    return _with_built(part, part if part.judgement.verdict == "partial" or part.interrupted else result, teller)


def _with_built(part: Conclusion, otherwise: Conclusion, teller: Teller) -> Conclusion:
    """What holds beside a rest with a term built of the rest; `otherwise` where there is none."""
    if part.partly is None or part.interrupted:
        return otherwise
    try:
        built = build(part.partly, teller)
    except Interrupted:
        return replace(otherwise, interrupted=True, notes=(*otherwise.notes, INTERRUPTED))
    if built is None:
        return otherwise
    return replace(
        part,
        chosen=built.scored,
        judgement=built.partly.judgement,
        partly=built.partly,
        built=built,
        otherwise=otherwise,
        path=(*part.path, *built.path, *built.partly.path),
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
        part = diagnose_partially(before.bench.robot, data, usable & ~before.wrong, noise, known, teller)
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
        partly=part,
    )


def _unless_something_remains(conclusion: Conclusion) -> Conclusion:
    """The answer, its names taken back where what they leave has a memory: effects are at work then, but not alone."""
    judgement = conclusion.judgement
    if judgement.verdict not in ("named", "ambiguous") or conclusion.interrupted:
        return conclusion
    remains_too = remaining_error(conclusion.bench, conclusion.chosen)
    if not remains_too:
        return conclusion
    kept = specific(conclusion.bench, conclusion.chosen, judgement.findings, judgement.adequacy)
    notes = (*judgement.notes, remains_too)
    return replace(conclusion, judgement=replace(judgement, verdict="unexplained", findings=kept, notes=notes))


def _unless_improbable(conclusion: Conclusion, known: Candidates, teller: Teller) -> Conclusion:
    """The answer, or the most probable set of effects where its names are not, or where it has none.

    The search goes by poses left out, one effect at a time, and may not come to effects that only explain together. A
    set that the posterior prefers is judged as any other.
    """
    judgement = conclusion.judgement
    if conclusion.interrupted:
        return conclusion
    bench, chosen, more = conclusion.bench, conclusion.chosen, [a.scored for a in judgement.compared]
    told = compared(bench, chosen, known, more)
    if judgement.verdict != "unexplained" and _is_probable(told, judgement):
        return replace(conclusion, compared=told)
    try:
        bench.pause = teller.pause
        teller("comparing sets of effects")
        told = compared(bench, chosen, known, more, search=True)
        best = bench.corrected(told.sets[0])
        certain = best.terms and told.is_alone and all(told.posterior.of_effect(name) >= NAMED for name in best.names)
        if certain and remains(bench, best).is_adequate and not remaining_error(bench, best):
            selector = Selector(bench, known, teller, best)
            other = judge(selector, selector.found)
            if other.verdict in ("named", "ambiguous"):
                names = tuple(q.name for t in best.terms for q in t.parameters)
                taken = SelectionStep("compare", " and ".join(best.names), names, round(told.gain, 2), 0.0, 0.0, True)
                path = (*conclusion.path, taken)
                return replace(conclusion, chosen=best, judgement=other, compared=told, path=path)
    except Interrupted:
        return replace(conclusion, interrupted=True, notes=(*conclusion.notes, INTERRUPTED))
    finally:
        bench.pause = lambda: None
    if judgement.verdict in ("named", "ambiguous") and not _is_probable(told, judgement):
        judgement = replace(judgement, verdict="unexplained", findings=())
    return replace(conclusion, judgement=judgement, compared=told)


def _is_probable(told: Compared, judgement: Judgement) -> bool:
    """Whether what is named acts more probably than not."""
    return all(told.posterior.of_effect(*names) > 1 / 2 for names in names_of(judgement))


def _explaining_all(part: Conclusion, known: Candidates, teller: Teller) -> Conclusion | None:
    """What was found beside a rest, judged as any other set: None where something remains after all.

    Effects that hide one another are found beside a rest, where each need not leave noise alone.
    """
    if part.partly is None or part.interrupted or not part.judgement.findings:
        return None
    there = part.partly.bench
    bench = Workbench(there.robot, there.data, part.noise, there.group, there.fold)
    frames = [f.term for f in part.judgement.findings if f.term.name not in part.chosen.names]
    chosen = bench.corrected(bench.scored([*part.chosen.terms, *frames], part.chosen.fit))
    if not remains(bench, chosen).is_adequate or remaining_error(bench, chosen):
        return None
    selector = Selector(bench, known, teller, chosen)
    try:
        bench.pause = teller.pause
        judgement = judge(selector, selector.found)
    except Interrupted:
        return None
    bench.pause = lambda: None
    if judgement.verdict not in ("named", "ambiguous"):
        return None
    return replace(part, bench=bench, chosen=chosen, judgement=judgement, partly=None)


def _nothing(data: Measurements, parts: Split, bench: Workbench, wrong: NDArray[np.bool_]) -> Conclusion:
    """Before any search."""
    base = bench.scored([])
    judgement = Judgement("unexplained", (), remains(bench, base), ())
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
    selector, judgement, notes, stopped = _searched(bench, known, teller)
    more = gross_outliers(selector.found.chosen.fit, data, usable & ~wrong)
    if more.any() and not too_many(wrong | more, usable) and not stopped:
        wrong = wrong | more
        parts = checked_split(data, usable & ~wrong)
        bench = bench_of(bench.robot, data, parts, bench.noise)
        selector, judgement, notes, stopped = _searched(bench, known, teller)
    selector.bench.pause = lambda: None  # what follows is short, and nothing is told without it
    noise, result = selector.bench.noise, selector.found
    base = selector.bench.scored([])
    is_rescaled = noise.position_m < bench.noise.position_m
    return Conclusion(
        selector.bench,
        tuple(result.path),
        result.chosen,
        base,
        judgement,
        parts,
        groups(data),
        noise,
        is_rescaled,
        wrong,
        tuple(notes),
        stopped,
    )


def _searched(bench: Workbench, known: Candidates, teller: Teller) -> tuple[Selector, Judgement, list[str], bool]:
    """Selection and judgement, once more with the noise that the data show if it is not the stated one."""
    selector, notes = Selector(bench, known, teller), list[str]()
    bench.pause = teller.pause
    try:
        teller("calibrating")
        selector.run()
        judgement = judge(selector, selector.found)
        scaled, note = rescaled_noise(judgement.adequacy, bench.noise, *_norms(selector.found.chosen))
        notes += [note] if note else []
        if scaled is not None:
            again = Workbench(bench.robot, bench.data, scaled, bench.group, bench.fold)
            selector = Selector(again, known, teller)
            again.pause = teller.pause
            selector.run()
            judgement = judge(selector, selector.found)
    except Interrupted:
        notes.append(INTERRUPTED)
        chosen = selector.found.chosen
        findings = tuple(Finding(t) for t in chosen.terms)
        return selector, Judgement("unexplained", findings, remains(bench, chosen), ()), notes, True
    return selector, judgement, notes, False


def _norms(scored: Scored) -> tuple[Array, Array]:
    """Norms of the residuals per pose, without outliers, and how many measured numbers each has."""
    parts, kept = scored.fit.residuals, ~ignored(scored)
    return parts.norm[kept], parts.given[kept].sum(axis=1)
