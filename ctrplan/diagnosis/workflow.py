"""The workflow, from measurements to a verdict: docs/diagnosis.md has the steps and their reasons.

The ordinary search comes first and names what leaves noise alone. Where nothing does, the partial diagnosis says what
holds beside a rest. A long log of a continuous motion, in which the ordinary search takes minutes, begins there. The
held-out set is opened, once: what a verdict is worth on poses that nothing has read, and what is handed over.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, PROGRESS, Flag, Made, Texts, checked
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import StageProgress
from ctrplan.calibration.fit_warnings import excused, gross_outliers, outlier_sentences, too_many, unsolved_sentence
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.reading import told_again
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import ignored, remains, rescaled_noise
from ctrplan.diagnosis.conclusion import Conclusion
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.held_out import Opened, opened
from ctrplan.diagnosis.next_experiment import decision, next_experiment
from ctrplan.diagnosis.partial_diagnosis import build, diagnose_partially
from ctrplan.diagnosis.posterior import settled
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.slips import REMEDIES, Slip, after_slip, most_probable_slip
from ctrplan.diagnosis.usable_poses import (
    MOST_POSES,
    bench_of,
    checked_split,
    require_unread,
    thinned,
    usable_poses,
    without_outliers,
)
from ctrplan.diagnosis.verdict import Judgement, judge, names_of
from ctrplan.diagnosis.workbench import (
    HELD_OUT_SHARE,
    Candidates,
    Interrupted,
    Scored,
    Teller,
    Workbench,
    candidates,
    reduced,
)
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements, Split, groups
from ctrplan.robot.data_rules import require_measured
from ctrplan.robot.robot import Robot

INTERRUPTED = "Interrupted: this is what was found until then, not a verdict."


@dataclass(frozen=True, eq=False)
class Concluded:
    """What was found in measurements as they are, or with another homing or frame from a slip on."""

    data: Measurements
    slip: Slip | None
    known: Candidates
    result: Conclusion

    @property
    def has_slip(self) -> bool:
        """Whether zeros that changed then are among what is told: the instant was only a place to look."""
        names = names_of(self.result.judgement.findings)
        return self.result.interrupted or self.slip is None or any(self.slip.effect in group for group in names)


@checked(
    robot=Made("Robot"),
    data=Made("Measurements"),
    progress=PROGRESS,
    without=Texts(),
    interrupted=EVENT,
    as_read=Flag(),
)
def diagnose(
    robot: Robot,
    data: Measurements,
    progress: StageProgress | None = None,
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    without: Sequence[str] = (),
    interrupted: threading.Event | None = None,
    as_read: bool = False,
) -> Diagnosis:
    """Compares the whole chain with measurements and says which stage lacks what, if anything.

    `progress` is told the step and the share done. When `interrupted` is set, what was found so far is returned.
    `without` names effects to be left out of the catalogue. Whether the measurements mean what they say is asked first:
    by default nothing is fitted to those that do not, and MisreadError is raised; with `as_read` they are compared as
    they stand, and `reading` says it. Raises InputError for what no file of measurements may say, where `without` names
    another effect, where the data are too few, or neither the robot file states the noise nor the data have repeats.
    """
    began = time.monotonic()
    allowed = reduced(catalogue, without)
    require_measured(robot, data)
    reading = told_again(robot, data, as_read=as_read)
    teller = Teller(progress, interrupted)
    noise, about_noise = noise_floor(robot, data)
    usable = usable_poses(robot, data)
    checked_split(data, usable)  # before anything is asked

    def conclude_from(data: Measurements, slip: Slip | None = None) -> Concluded:
        known = candidates(robot, data, allowed, {slip.effect: slip.instants} if slip else {})
        return Concluded(data, slip, known, conclude(robot, data, usable, noise, known, teller))

    def after(slip: Slip | None) -> Concluded | None:
        concluded = conclude_from(after_slip(data, slip), slip) if slip else None
        if concluded is None or concluded.has_slip:
            return concluded
        needs_none = concluded.result.rest is None  # it was asked as any effect, and acts in no fit that is told
        return Concluded(data, None, candidates(robot, data, allowed), concluded.result) if needs_none else None

    concluded = after(most_probable_slip(robot, data, noise, among=allowed)) or conclude_from(data)
    found = concluded.result
    searched = found.ordinary.compared
    if concluded.slip is None and found.judgement.verdict in ("partial", "unexplained") and searched:
        concluded = after(most_probable_slip(robot, data, noise, searched.sets[0].terms, allowed)) or concluded
    data, slip, known, result = concluded.data, concluded.slip, concluded.known, concluded.result

    def tell(step: str) -> None:
        if progress:
            progress(step, HELD_OUT_SHARE)

    tell("asking the held-out set")
    outcome = opened(result, data)
    result = outcome.answer
    written, judgement = outcome.written, outcome.judgement
    poses = _marked(result, outcome, data)
    sentence, proposed = next_experiment(
        result.chosen, judgement, result.bench.data, result.noise, list(known.not_testable)
    )
    if slip:
        for effect, remedy in REMEDIES.items():
            sentence = sentence.replace(effect.experiment, remedy)
    return Diagnosis(
        judgement=judgement,
        base=result.base,
        chosen=written,
        gap=outcome.gap,
        place=outcome.place,
        next_experiment=sentence,
        proposals=proposed,
        path=result.path,
        not_testable=known.not_testable,
        without=tuple(without),
        notes=(
            *data.warnings,
            *_left_out(without),
            *([about_noise] if about_noise else []),
            *result.notes,
            *judgement.notes,
            *outcome.notes,
            *_coverage(usable),
            *outlier_sentences(written.fit, data, poses.outlying),
            *unsolved_sentence(data, poses.unsolved, ~poses.left_out, "calibrated or with the effects"),
        ),
        robot=robot,
        data=data,
        noise=result.noise,
        coverage=float((usable & ~poses.left_out & ~result.wrong).mean()),
        outlier_rows=tuple((data.rows[poses.outlying] + 1).tolist()),
        interrupted=result.interrupted,
        time_s=time.monotonic() - began,
        partial=result if result.rest and judgement.verdict == "partial" else None,
        built=result.built,
        named_gap=outcome.named_gap,
        framed_gap=outcome.framed_gap,
        reading=reading,
        posterior=None if result.interrupted or result.compared is None else result.compared.posterior,
        slip=slip,
    )


def decide(
    diagnosis: Diagnosis,
    data: Measurements,
    progress: StageProgress | None = None,
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    interrupted: threading.Event | None = None,
) -> Diagnosis:
    """The diagnosis with what new poses decide between a finding and its alternatives, best those that it proposed.

    Where they decide, the others are taken out of the catalogue and the diagnosis is made again. Poses that were not
    proposed decide as well as they can. Raises InputError where nothing is ambiguous.
    """
    require_measured(diagnosis.robot, data)
    require_unread(diagnosis.data, data, "decide")
    finding = next((f for f in diagnosis.judgement.findings if f.alternatives), None)
    if finding is None:
        raise InputError("has nothing to decide: the verdict is not ambiguous", file=data.file, key="decide")
    taken = decision(diagnosis.chosen, finding, data, diagnosis.noise, diagnosis.posterior)
    decisions = (*diagnosis.decisions, taken)
    if not taken.is_decided:
        return replace(diagnosis, decisions=decisions)
    others = taken.explanations[1:]
    again = diagnose(
        diagnosis.robot,
        diagnosis.data,
        progress,
        catalogue=catalogue,
        without=(*diagnosis.without, *others),
        interrupted=interrupted,
        as_read=True,  # what was misread has been said
    )
    sentences = _left_out(again.without)
    notes = [*_left_out(diagnosis.without), f"Left out, as new poses decided against it: {', '.join(others)}."]
    return replace(again, decisions=decisions, notes=(*(n for n in again.notes if n not in sentences), *notes))


@dataclass(frozen=True, eq=False)
class _Marked:
    """Poses (K,) of all data that some figure leaves out."""

    outlying: NDArray[np.bool_]
    unsolved: NDArray[np.bool_]
    left_out: NDArray[np.bool_]


def _marked(conclusion: Conclusion, outcome: Opened, data: Measurements) -> _Marked:
    parts, base, written = conclusion.split, conclusion.base, outcome.written
    outlying, (unsolved, left_out) = conclusion.wrong.copy(), np.zeros((2, data.count), bool)
    outlying[parts.selection] = ignored(written) & ~excused(written.failed)
    outlying[parts.held_out_set] = outcome.gap.outlying
    unsolved[parts.selection], unsolved[parts.held_out_set] = base.failed | written.failed, outcome.gap.failed
    left_out[parts.selection] = excused(base.failed) | excused(written.failed)
    left_out[parts.held_out_set] = excused(outcome.gap.failed)
    return _Marked(outlying, unsolved, left_out)


def _left_out(without: Sequence[str]) -> list[str]:
    return [f"Taken out of the catalogue, as asked: {', '.join(without)}."] if without else []


def _coverage(usable: NDArray[np.bool_]) -> list[str]:
    masked = int((~usable).sum())
    if not masked:
        return []
    return [f"{masked} of {len(usable)} poses were left out for all candidates alike: near snapping, or a run's start."]


def conclude(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, known: Candidates, tell: Teller
) -> Conclusion:
    """What holds before the held-out set is opened; `usable` (K,) are the poses to go by.

    Raises InputError where they are few.
    """
    wrong, parts, bench = without_outliers(robot, data, usable, noise)
    is_long = data.is_stream and int((usable & ~wrong).sum()) > 2 * MOST_POSES  # every other is compared at most
    if is_long:
        first = _beside_a_rest(_calibrated(bench, known, thinned(parts, data), data, wrong), data, usable, noise, tell)
        if first.interrupted or not (isinstance(first.bench, CorrelatedBench) and first.bench.is_noise_alone):
            return _with_built(first, tell)
    if bench.data.count < len(parts.selection):
        bench = bench_of(robot, data, parts, noise)
    result = _ordinary(_calibrated(bench, known, parts, data, wrong), data, usable, tell)
    is_explained = result.compared is None or result.compared.posterior.of_unknown < 1 / 2
    if is_explained or is_long:
        return result
    return _with_built(_beside_a_rest(result, data, usable, noise, tell), tell).told


def _with_built(part: Conclusion, tell: Teller) -> Conclusion:
    """What holds beside a rest, with a term built of the rest if there is one."""
    try:
        return part if part.interrupted else build(part, tell) or part
    except Interrupted:
        return _interrupted(part.told)


def _interrupted(begun: Conclusion) -> Conclusion:
    return replace(begun, interrupted=True, notes=(*begun.notes, INTERRUPTED))


def _beside_a_rest(
    before: Conclusion, data: Measurements, usable: NDArray[np.bool_], stated: Noise, tell: Teller
) -> Conclusion:
    """What holds although something remains; what there was before, where it is interrupted.

    The noise may be smaller than stated. It is never enlarged, for the rest would hide in it.
    """
    noise, known = before.noise if before.is_rescaled else stated, before.known
    try:
        near = before.base.fit
        part = diagnose_partially(before.bench.robot, data, usable & ~before.wrong, noise, known, tell, near)
    except Interrupted:
        return _interrupted(before)
    return replace(
        part,
        path=(*before.path, *part.path),
        wrong=before.wrong,
        notes=before.notes,
        is_rescaled=before.is_rescaled,
        before=before if before.compared else None,
    )


def _calibrated(
    bench: Workbench, known: Candidates, parts: Split, data: Measurements, wrong: NDArray[np.bool_]
) -> Conclusion:
    """Before any search."""
    base = bench.scored([])
    nothing = Judgement("unexplained", (), remains(bench, base))
    return Conclusion(bench, known, parts, groups(data), wrong, bench.noise, base, base, nothing)


def _ordinary(begun: Conclusion, data: Measurements, usable: NDArray[np.bool_], tell: Teller) -> Conclusion:
    """The search for what leaves noise alone, once more with the poses that went wrong by what it found."""
    result = _searched(begun, data, tell)
    wrong = gross_outliers(result.chosen.fit, data, usable)
    if (wrong != begun.wrong).any() and not too_many(wrong, usable) and not result.interrupted:
        parts = checked_split(data, usable & ~wrong)
        bench = bench_of(begun.bench.robot, data, parts, begun.noise)
        result = _searched(_calibrated(bench, begun.known, parts, data, wrong), data, tell)
    return result


def _searched(begun: Conclusion, data: Measurements, tell: Teller) -> Conclusion:
    """Search and judgement, once more with the noise that the data show if it is not the stated one."""
    stated, bench = begun.noise, begun.bench
    try:
        tell("calibrating")
        begun = _most_probable(begun, bench, data, tell)
        scaled, note = rescaled_noise(begun.judgement.adequacy, stated, *_norms(begun.chosen))
        begun = replace(begun, notes=(note,) if note else ())
        if scaled is not None:
            anew = Workbench(bench.robot, bench.data, scaled, bench.group)
            begun = replace(_most_probable(begun, anew, data, tell), notes=begun.notes)
    except Interrupted:
        calibrated = _calibrated(begun.bench, begun.known, begun.split, data, begun.wrong)
        return _interrupted(replace(calibrated, notes=begun.notes))
    return replace(begun, is_rescaled=begun.noise.position_m < stated.position_m)


def _most_probable(begun: Conclusion, bench: Workbench, data: Measurements, tell: Teller) -> Conclusion:
    bench, compared, chosen, path = settled(bench, bench.scored([]), begun.known, tell)
    judgement = judge(bench, chosen, begun.known, compared.posterior, compared.sets)
    calibrated = _calibrated(bench, begun.known, begun.split, data, begun.wrong)
    return replace(calibrated, path=path, chosen=chosen, judgement=judgement, compared=compared)


def _norms(scored: Scored) -> tuple[Array, Array]:
    """Norms of the residuals per pose, without outliers, and how many measured numbers each has."""
    parts, kept = scored.fit.residuals, ~ignored(scored)
    return parts.norm[kept], parts.given[kept].sum(axis=1)
