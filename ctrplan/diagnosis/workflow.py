"""The workflow, from measurements to a verdict: docs/diagnosis.md has the steps and their reasons.

The held-out set is opened, once: what a verdict is worth on poses that nothing has read, and what is handed over.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, PROGRESS, Flag, Made, Texts, checked
from ctrplan.base.long_work import StageProgress
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.fit_warnings import excused, outlier_sentences, symptoms, unsolved_sentence
from ctrplan.calibration.residuals import Residuals
from ctrplan.calibration.robot_content import within_file
from ctrplan.diagnosis.adequacy import Adequacy, ignored, left_out_probability, noise_floor, remains
from ctrplan.diagnosis.conclusion import Conclusion, conclude
from ctrplan.diagnosis.gap import Gap, contradiction, open_test_set, rms_there_m
from ctrplan.diagnosis.next_experiment import decision, next_experiment
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis, left_by_names
from ctrplan.diagnosis.reading import MisreadError, read_again
from ctrplan.diagnosis.remainder import Place, localise
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.slips import Slip, after_slip, found_slip
from ctrplan.diagnosis.term_pieces import is_built
from ctrplan.diagnosis.usable_poses import checked_split, usable_poses
from ctrplan.diagnosis.verdict import Judgement, Verdict, names_of
from ctrplan.diagnosis.workbench import HELD_OUT_SHARE, Candidates, Scored, Teller, candidates, reduced
from ctrplan.effects.drive.homing_shift import HomingShift
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

MOST_WORSE = 1.05  # rms error of poses kept aside with an effect, over that without it, for chance allows for so much
HELD_OUT_REJECTED = 1e-4  # probability of the held-out set's residuals that takes a name back


@dataclass(frozen=True, eq=False)
class Opened:
    """The verdict after the held-out set was asked, the model with its effects, and the errors of that model."""

    judgement: Judgement
    written: Scored
    gap: Gap
    place: Place
    notes: tuple[str, ...]
    answer: Conclusion  # that it is of: without a built term where that failed
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
    return replace(outcome, framed_gap=_framed(outcome.answer, data)) if outcome.answer.partial else outcome


def _harmful(outcome: Opened, data: Measurements) -> list[Term]:
    """Effects without which poses kept aside are predicted better."""
    part = outcome.answer.partial
    if part is None or outcome.answer.interrupted or outcome.judgement.verdict != "partial":
        return []
    listed = {finding.term.key for finding in outcome.judgement.findings}
    kept, results, chosen = outcome.answer.split.held_out_set, list[Term](), outcome.answer.chosen
    aside, group, noise = data.subset(kept), outcome.answer.group[kept], outcome.answer.noise
    for t in (t for t in chosen.terms if t.key in listed):
        rest = part.bench.scored([other for other in chosen.terms if other.key != t.key], chosen.fit, None)
        rms_m = rms_there_m(_beside_a_remainder(part, rest).fit, aside, group, noise, outcome.gap)
        if MOST_WORSE * rms_m < outcome.gap.after.rms_m:
            results.append(t)
    return results


def _without(answer: Conclusion, harmful: Sequence[Term]) -> Conclusion:
    """The answer without some of its effects."""
    assert answer.partial is not None
    gone = {t.key for t in harmful}
    findings = tuple(f for f in answer.judgement.findings if f.term.key not in gone)
    rest = [t for t in answer.chosen.terms if t.key not in gone]
    bench, chosen = answer.partial.bench.corrected(answer.partial.bench.scored(rest, answer.chosen.fit))
    verdict: Verdict = "partial" if findings else "unexplained"
    judgement = replace(answer.judgement, verdict=verdict, findings=findings)
    partial = replace(answer.partial, bench=bench, chosen=chosen, judgement=judgement)
    return replace(answer, bench=bench, partial=partial, chosen=chosen, judgement=judgement, built=None)


def _framed(answer: Conclusion, data: Measurements) -> Gap:
    """What frames alone do for the poses kept aside."""
    assert answer.partial is not None
    kept = answer.split.held_out_set
    frames = answer.partial.bench.handed_over(answer.partial.compared.base)
    return open_test_set(answer.base.fit, frames.fit, data.subset(kept), answer.group[kept], answer.noise)


def _with_or_without_built(answer: Conclusion, data: Measurements) -> Opened:
    if answer.built is None or answer.otherwise is None:
        return _opened(answer, data)
    result, without = _opened(answer, data), _opened(replace(answer, chosen=answer.built.named, built=None), data)
    if result.gap.after.rms_m < without.gap.after.rms_m:
        return replace(result, named_gap=without.gap)
    less = without if without.judgement.findings else _opened(answer.otherwise, data)
    note = "A term was built and taken back: the poses kept aside are not nearer with it."
    return replace(less, notes=(*less.notes, note))


def _opened(answer: Conclusion, data: Measurements) -> Opened:
    kept = answer.split.held_out_set
    if answer.partial:
        answer = replace(answer, chosen=_beside_a_remainder(answer.partial, answer.chosen))
    aside, group = data.subset(kept), answer.group[kept]
    gap = open_test_set(answer.base.fit, answer.chosen.fit, aside, group, answer.noise)
    place = _place(answer, gap)
    judgement, notes = _after_test_set(answer, gap, place)
    written = _written(answer, judgement)
    if written is not answer.chosen:  # errors are of the model that is handed over
        judgement = replace(judgement, adequacy=_left(answer, written))
        gap = open_test_set(answer.base.fit, written.fit, aside, group, answer.noise)
        if doubt := contradiction(judgement.verdict, gap, place):
            judgement, notes = replace(judgement, verdict="unexplained", findings=()), [*notes, doubt]
            written = _written(answer, judgement)
            gap = open_test_set(answer.base.fit, written.fit, aside, group, answer.noise)
    settled = answer.chosen if answer.partial else answer.bench.sized(answer.chosen)
    built = {t.name for t in settled.terms if is_built(t)}
    sentences = [symptom.sentence for symptom in symptoms(settled.fit) if symptom.owner not in built]
    return Opened(judgement, written, gap, place, (*notes, *sentences), answer)


def _after_test_set(answer: Conclusion, gap: Gap, place: Place) -> tuple[Judgement, list[str]]:
    """A verdict that the held-out set or any figure contradicts is taken back.

    Noise that had to be enlarged may have taken in a misfit: no allowance is made for it.
    """
    judgement, doubt = answer.judgement, contradiction(answer.judgement.verdict, gap, place)
    if judgement.verdict == "partial" and doubt:
        return replace(judgement, verdict="unexplained", findings=()), [doubt]
    if judgement.verdict in ("partial", "unexplained"):
        return judgement, []
    left = judgement.adequacy.total
    p = left_out_probability(gap.chi_square, left, _solved(answer.chosen), estimated=answer.is_rescaled)
    if p > HELD_OUT_REJECTED and not doubt:
        return judgement, []
    note = f"The held-out set contradicts it: chi-square per degree of freedom {gap.chi_square.ratio:.2f}."
    return replace(judgement, verdict="unexplained", findings=()), [doubt or note]


def _solved(scored: Scored) -> Residuals:
    """Residuals of the poses that chi-squares are of, outliers among them."""
    parts, kept = scored.fit.residuals, ~excused(scored.failed)
    return Residuals(parts.r[kept], parts.J[kept], parts.weight[kept], parts.raw_norm[kept], parts.given[kept])


def _written(answer: Conclusion, judgement: Judgement) -> Scored:
    """The model with the effects of the verdict alone, as large as the data say, in numbers a robot file may have."""
    bench, chosen = answer.bench, answer.chosen
    built = answer.built.terms if answer.built else ()
    listed = {finding.term.key for finding in judgement.findings} | {t.key for t in built}
    kept = [t for t in chosen.terms if t.key in listed]
    if answer.partial and len(kept) == len(chosen.terms):
        return chosen
    if answer.partial:
        return _beside_a_remainder(answer.partial, answer.partial.bench.scored(kept, chosen.fit))
    scored = bench.sized(chosen if len(kept) == len(chosen.terms) else bench.scored(kept, chosen.fit))
    inside = within_file(scored.fit)
    return scored if inside is scored.fit else replace(scored, fit=inside)


def _left(answer: Conclusion, written: Scored) -> Adequacy:
    """Whether noise alone is left beside the effects of the verdict."""
    return left_by_names(answer.partial.bench, written) if answer.partial else remains(answer.bench, written)


def _beside_a_remainder(partial: PartialDiagnosis, scored: Scored) -> Scored:
    """A set as it is handed over where something remains."""
    return partial.bench.handed_over(partial.bench.sized(scored))


def _place(answer: Conclusion, gap: Gap) -> Place:
    base = answer.base
    fit, kept = base.fit, ~ignored(base)
    error = distances(fit.chain.predict(fit.p, derivatives=False), fit.chain.data)
    data, group = answer.bench.data.subset(kept), answer.bench.group[kept]
    return localise(data, fit.residuals.r[kept], group, error[kept], gap.floor_m)


@dataclass(frozen=True, eq=False)
class Concluded:
    """What was found in measurements as they are, or with another homing from a slip on."""

    data: Measurements
    slip: Slip | None
    known: Candidates
    result: Conclusion

    @property
    def has_slip(self) -> bool:
        """Whether zeros that changed then are among what is told: the instant was only a place to look."""
        return self.result.interrupted or any(HomingShift.name in names for names in names_of(self.result.judgement))


AFTER_SLIP = "tighten that collar, home the drive and measure some of the first poses again"


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
    as_read: bool = True,
) -> Diagnosis:
    """Compares the whole chain with measurements and says which stage lacks what, if anything.

    `progress` is told the step and the share done. When `interrupted` is set, what was found so far is returned.
    `without` names effects to be left out of the catalogue. Whether the file means what it says is asked first, and
    said in `reading`; unless `as_read` nothing is fitted to one that does not, and MisreadError is raised. Raises
    InputError where `without` names another effect, where the data are too few, or neither the robot file states the
    noise nor the data have repeats.
    """
    began = time.monotonic()
    allowed = reduced(catalogue, without)
    reading = read_again(robot, data)
    if reading and not as_read:
        raise MisreadError(data, reading)
    teller = Teller(progress, interrupted)
    noise, about_noise = noise_floor(robot, data)
    usable = usable_poses(robot, data)
    checked_split(data, usable)  # before anything is asked

    def conclude_from(data: Measurements, slip: Slip | None = None) -> Concluded:
        known = candidates(robot, data, allowed, {HomingShift.name: slip.instants} if slip else {})
        return Concluded(data, slip, known, conclude(robot, data, usable, noise, known, teller))

    def after(slip: Slip | None) -> Concluded | None:
        concluded = conclude_from(after_slip(data, slip), slip) if slip and HomingShift.name in allowed else None
        if concluded is None or concluded.has_slip:
            return concluded
        needs_none = concluded.result.partial is None  # it was asked as any effect, and acts in no fit that is told
        return Concluded(data, None, candidates(robot, data, allowed), concluded.result) if needs_none else None

    concluded = after(found_slip(robot, data, noise)) or conclude_from(data)
    found = concluded.result
    if concluded.slip is None and found.judgement.verdict in ("partial", "unexplained") and found.compared:
        concluded = after(found_slip(robot, data, noise, found.compared.sets[0].terms)) or concluded
    data, slip, known, result = concluded.data, concluded.slip, concluded.known, concluded.result

    def tell(step: str) -> None:
        if progress:
            progress(step, HELD_OUT_SHARE)

    tell("asking the held-out set")
    outcome = opened(result, data)
    result = outcome.answer
    written, judgement = outcome.written, outcome.judgement
    sets = result.partial.compared if result.partial else result.compared
    poses = _marked(result, outcome, data)
    stated = replace(result.noise, discrepancy=None)
    sentence, proposed = next_experiment(result.chosen, judgement, result.bench.data, stated, list(known.not_testable))
    if slip:
        sentence = sentence.replace(HomingShift.experiment, AFTER_SLIP)
    return Diagnosis(
        verdict=judgement.verdict,
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
        noise=stated,
        coverage=float((usable & ~poses.left_out & ~result.wrong).mean()),
        outlier_rows=tuple((data.rows[poses.outlying] + 1).tolist()),
        interrupted=result.interrupted,
        time_s=time.monotonic() - began,
        partial=result.partial if judgement.verdict == "partial" else None,
        built=result.built,
        named_gap=outcome.named_gap,
        framed_gap=outcome.framed_gap,
        reading=reading,
        posterior=None if result.interrupted or sets is None else sets.posterior,
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
