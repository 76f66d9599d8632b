"""The workflow, from measurements to a verdict: docs/diagnosis.md has the steps and their reasons."""

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
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.fit_warnings import (
    excused,
    gross_outliers,
    outlier_sentences,
    symptoms,
    too_many,
    unsolved_sentence,
)
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.built_term import Built, build, with_reach
from ctrplan.diagnosis.conclusion import Judgement, judge
from ctrplan.diagnosis.gap import (
    Fitted,
    Gap,
    Place,
    calibrated,
    chi_square,
    contradiction,
    handed_over,
    localise,
    measured_gap,
)
from ctrplan.diagnosis.hypotheses import Bench, Slip, bench, candidates, outliers, reduced, slips
from ctrplan.diagnosis.next_experiment import next_experiment
from ctrplan.diagnosis.posterior_search import Answer, Interrupted, search
from ctrplan.diagnosis.reading import Reading, how_taken, read_again
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.usable_poses import split, thinned, usable_poses
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.effects.learned.learned import Learned
from ctrplan.errors import InputError
from ctrplan.measurement.joint_path import joined_measurements
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot

HELD_OUT_SHARE = 0.95  # of the work done when the poses kept aside are asked
MOST_SLIPS = 40  # instants that are asked: more cost time, and neighbours say nearly the same
ROUNDS = 2  # of a search, where poses turn out to be right or wrong
GAP_CLOSED = 0.4  # of the squares that poses kept aside leave beyond noise, below which a built term is none


class Misread(InputError):
    """A file that does not mean what it says: nothing was fitted."""

    def __init__(self, readings: Sequence[Reading], data: Measurements) -> None:
        """readings: other ones of its columns, that explain what the file as it stands does not."""
        told = " ".join(reading.sentence for reading in readings)
        super().__init__(f"{told} Nothing was fitted; --as-read fits the file as it stands.", file=data.file)
        self.readings = tuple(readings)


def refuse_misread(robot: Robot, data: Measurements) -> None:
    """Raises Misread where another reading of the columns explains what the file as it stands does not."""
    if readings := read_again(robot, data):
        raise Misread(readings, data)


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
    deciding: Sequence[Measurements] = (),
) -> Diagnosis:
    """Compares the whole chain with measurements and says which stage lacks what, if anything.

    `progress` is told the step and the share done. When `interrupted` is set, what was found so far is returned.
    `without` names effects to be left out of the catalogue. `as_read`: also where the columns seem to be misread.
    `deciding`: poses that were proposed and measured since; none of them is kept aside. Raises InputError where
    `without` names another effect, where the data are too few, or neither the robot file states the noise nor the data
    have repeats; Misread where the file does not mean what it says.
    """
    began = time.monotonic()
    allowed = reduced(catalogue, without)
    readings = read_again(robot, data)
    if readings and not as_read:
        raise Misread(readings, data)
    data, own = _joined(data, deciding)
    teller = _Teller(progress, interrupted)
    noise, about_noise = noise_floor(robot, data)
    usable = usable_poses(robot, data)
    selection, aside, block = split(data, usable & own)
    selection = np.union1d(selection, np.flatnonzero(usable & ~own))
    known = candidates(robot, data, allowed)
    asked = thinned(data, selection)
    variants = (*known.terms, *([] if "slip" in without else slips(robot, data.subset(asked), MOST_SLIPS)))
    whole = bench(robot, data.subset(asked), noise, variants)
    far = gross_outliers(whole.robust, data, usable)
    far = np.zeros_like(far) if too_many(far, usable) else far
    answer, out = _answered(whole, far[asked], teller)
    judgement = judge(answer)
    if answer.interrupted:
        judgement = replace(judgement, verdict="unexplained")
    base = calibrated(answer.bench, answer.base)
    noise, told = _noise_shown(answer.bench.noise, judgement)
    there = _There(data, aside if len(aside) else selection, block, far, noise, bool(len(aside)))
    opened = _opened(answer, judgement, base, there)
    judgement, written = opened.judgement, opened.written
    place = _place(base, answer.bench.sound, noise)
    sentence, proposed = next_experiment(answer, judgement, answer.bench.noise, list(known.not_testable))
    outlying, unsolved, left_out = _marked(answer, out, base, written, opened.gap, data, aside if len(aside) else None)
    return Diagnosis(
        verdict=judgement.verdict,
        judgement=judgement,
        answer=answer,
        base=base,
        chosen=written,
        gap=opened.gap,
        place=place,
        remaining=chi_square(written.fit.residuals),
        next_experiment=sentence,
        proposals=proposed,
        not_testable=known.not_testable,
        without=tuple(without),
        notes=(
            *data.warnings,
            *how_taken(data),
            *_left_out(without),
            *([about_noise] if about_noise else []),
            *told,
            *([INTERRUPTED] if answer.interrupted else []),
            *opened.notes,
            *_about_slips(judgement),
            *_coverage(usable),
            *_thinned(data, selection, answer),
            *([] if len(aside) else [NONE_ASIDE]),
            *outlier_sentences(written.fit, data, outlying),
            *unsolved_sentence(data, unsolved, ~left_out, "calibrated or with the effects"),
        ),
        robot=robot,
        data=data,
        noise=noise,
        coverage=float((usable & ~left_out & ~outlying).mean()),
        outlier_rows=tuple((data.rows[outlying] + 1).tolist()),
        interrupted=answer.interrupted,
        time_s=time.monotonic() - began,
        readings=readings,
        built=opened.built,
        named_gap=opened.named_gap,
    )


INTERRUPTED = "Interrupted: this is what was found until then, not a verdict."
NONE_ASIDE = "There are too few configurations to keep some aside: errors are of the poses that were fitted."


@dataclass(eq=False)
class _Teller:
    """Names the steps to whoever watches, and stops between them when asked to."""

    progress: StageProgress | None
    interrupted: threading.Event | None
    share: float = 0.05

    def __call__(self, step: str) -> None:
        """A step begins."""
        if self.interrupted is not None and self.interrupted.is_set():
            raise Interrupted
        self.share += 0.08 * (HELD_OUT_SHARE - self.share)  # how many steps there will be is not known
        if self.progress:
            self.progress(step, self.share)


def _joined(data: Measurements, deciding: Sequence[Measurements]) -> tuple[Measurements, NDArray[np.bool_]]:
    """All poses, and (K,) whether each is of the first file."""
    if not deciding:
        return data, np.ones(data.count, bool)
    parts = [data, *deciding]
    whole = joined_measurements(parts, [""] * len(parts), [""] * len(parts))
    whole = replace(whole, is_stream=data.is_stream)
    return whole, np.arange(whole.count) < data.count


def _answered(whole: Bench, out: NDArray[np.bool_], teller: _Teller) -> tuple[Answer, NDArray[np.bool_]]:
    """Posterior probabilities beside poses (K,) that went wrong, as the most probable set of effects judges them.

    What an effect does is no outlier: with one that explains them, poses are asked again.
    """
    some = whole.without(out)
    for _ in range(ROUNDS):
        answer = search(some, teller)
        still = outliers(whole, some, answer.best, out)
        if answer.interrupted or np.array_equal(still, out):
            break
        out, some = still, whole.without(still)
    return answer, out


@dataclass(frozen=True, eq=False)
class _Opened:
    """The verdict after the poses kept aside were asked, and the model that is handed over."""

    judgement: Judgement
    written: Fitted
    gap: Gap
    named_gap: Gap | None
    built: Built | None
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _There:
    """Poses that the gap is shown on: numbers (V,) of all, blocks and what went wrong (K,)."""

    data: Measurements
    poses: NDArray[np.int_]
    block: NDArray[np.int_]
    far: NDArray[np.bool_]
    noise: Noise
    is_aside: bool

    def gap(self, base: Fitted, other: Fitted) -> Gap:
        """Of a model beside the calibrated one."""
        some, group = self.data.subset(self.poses), self.block[self.poses]
        result = measured_gap(base.fit, other.fit, some, group, self.noise, self.far[self.poses])
        return replace(result, is_aside=self.is_aside)


def _opened(answer: Answer, judgement: Judgement, base: Fitted, there: _There) -> _Opened:
    """Opens the poses kept aside, once: a built term has to close a part of the gap there, a name has to agree."""
    written = handed_over(answer.bench, judgement.chosen, judgement.unnamed)
    gap = there.gap(base, written)
    notes: list[str] = []
    built: Built | None = None
    named_gap: Gap | None = None
    if judgement.unnamed.is_large and not answer.interrupted and (built := build(answer.bench, judgement.chosen)):
        built = replace(built, hypothesis=with_reach(answer.bench, built.hypothesis))
        again = handed_over(answer.bench, built.hypothesis, judgement.unnamed)
        with_built = there.gap(base, again)
        rest, left = (max(g.after.rms_m**2 - g.floor_m**2, 0.0) for g in (gap, with_built))
        if rest - left >= GAP_CLOSED * rest:
            named_gap, gap, written = gap, with_built, again
        else:
            notes.append("A term was built and taken back: it is not good enough on the poses kept aside.")
            built = None
    if judgement.verdict not in ("partial", "unexplained") and (doubt := contradiction(gap)):
        judgement = replace(judgement, verdict="partial" if judgement.findings else "unexplained")
        notes.append(doubt)
    own = {t.name for t in written.terms if isinstance(t.effect, Learned)}
    notes += [symptom.sentence for symptom in symptoms(written.fit) if symptom.owner not in own]
    return _Opened(judgement, written, gap, named_gap, built, tuple(notes))


def _noise_shown(noise: Noise, judgement: Judgement) -> tuple[Noise, list[str]]:
    """The noise that poses are compared with: as estimated beside all else, where that is surely more than stated."""
    position, tangent = judgement.unnamed.noise
    if judgement.unnamed.is_large or max(position, tangent) < NOT_AS_STATED:
        return noise, []
    shown = Noise(noise.position_m * max(position, 1.0), noise.tangent_rad * max(tangent, 1.0))
    told = (
        f"The noise is not as stated: {shown.position_m * 1e3:.3g} mm and {np.degrees(shown.tangent_rad):.3g} deg fit "
        f"the data, {noise.position_m * 1e3:.3g} mm and {np.degrees(noise.tangent_rad):.3g} deg were stated."
    )
    return shown, [told]


NOT_AS_STATED = 1.25  # times; some hundred numbers know a deviation to a tenth


def _place(base: Fitted, sound: NDArray[np.bool_], noise: Noise) -> Place:
    """Where the calibrated model disagrees."""
    fit = base.fit
    kept = sound & ~base.failed
    error: Array = distances(fit.chain.predict(fit.p, derivatives=False), fit.chain.data)
    data = fit.chain.data.subset(kept)
    group = np.arange(data.count) // 10 if data.is_stream else data.configuration
    return localise(data, fit.residuals.r[kept], group, error[kept], noise.floor_m)


def _marked(
    answer: Answer,
    out: NDArray[np.bool_],
    base: Fitted,
    written: Fitted,
    gap: Gap,
    data: Measurements,
    aside: NDArray[np.int_] | None,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Poses (K,) of all data that went wrong, that were not solved, and that figures leave out for that."""
    outlying, unsolved, left_out = np.zeros((3, data.count), bool)
    points = _place_of(answer.bench.data, data)
    outlying[points] = out
    unsolved[points] = base.failed | written.failed
    left_out[points] = excused(base.failed) | excused(written.failed)
    if aside is not None:
        outlying[aside], unsolved[aside], left_out[aside] = gap.outlying, gap.failed, excused(gap.failed)
    return outlying, unsolved, left_out


def _place_of(some: Measurements, data: Measurements) -> NDArray[np.int_]:
    """Numbers of some poses among all; a waypoint may have several."""
    keys = {
        (row, marker): k
        for k, (row, marker) in enumerate(zip(data.rows.tolist(), data.seen_marker.tolist(), strict=True))
    }
    return np.array(
        [keys[pair] for pair in zip(some.rows.tolist(), some.seen_marker.tolist(), strict=True)], dtype=np.int_
    )


def _left_out(without: Sequence[str]) -> list[str]:
    return [f"Taken out of the catalogue, as asked: {', '.join(without)}."] if without else []


def _about_slips(judgement: Judgement) -> list[str]:
    if not any(isinstance(f.term.effect, Slip) for f in judgement.findings):
        return []
    return [
        "A slip is of this run alone: robot.toml is the robot before it. Home the joint again before others are run."
    ]


def _thinned(data: Measurements, selection: NDArray[np.int_], answer: Answer) -> list[str]:
    asked = answer.bench.data.count
    if asked == len(selection):
        return []
    return [f"{asked} of {len(selection)} poses that choose were compared: more stand near others and say the same."]


def _coverage(usable: NDArray[np.bool_]) -> list[str]:
    masked = int((~usable).sum())
    if not masked:
        return []
    return [f"{masked} of {len(usable)} poses were left out for all candidates alike: near snapping, or a run's start."]
