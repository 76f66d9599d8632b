"""The workflow, from measurements to a verdict: docs/diagnosis.md has the steps and their reasons.

The held-out set is opened, once: what a verdict is worth on poses that nothing has read, and what is handed over.

What happened once, at an instant that nobody wrote down, is asked first: a collar that slipped, a drive that lost
steps, a tracker that was knocked. From there on a joint's zero is off, or the tracker has another frame, which is a
homing or a set-up that the file does not tell of: the instant found, the rest of the diagnosis treats it as one
(`homing_shift`, `frame_shift`). It is looked for beside an ordinary calibration, and beside the most probable effects
where these leave something, linearised: of every joint that moves, of the tracker, and of every pose, what a constant
change from there on would explain. It is asked after where it leaves less than half of the error beyond the noise, as
another reading of the file does (`calibration/reading.py`), and less than anything smooth in time that the same could
do. Whether it is believed, the posterior says, as of any other effect, for which every instant is a variant.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, PROGRESS, Flag, Made, Texts, checked
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import StageProgress
from ctrplan.calibration.fit_warnings import excused, outlier_sentences, unsolved_sentence
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.reading import BETTER, MisreadError, read_again
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import ignored
from ctrplan.diagnosis.conclusion import Conclusion, conclude
from ctrplan.diagnosis.held_out import Opened, opened
from ctrplan.diagnosis.linear_fit import Linear, solved
from ctrplan.diagnosis.next_experiment import decision, next_experiment
from ctrplan.diagnosis.result import TRACKER, Diagnosis, Slip
from ctrplan.diagnosis.usable_poses import checked_split, usable_poses
from ctrplan.diagnosis.verdict import names_of
from ctrplan.diagnosis.workbench import (
    HELD_OUT_SHARE,
    Candidates,
    Linearisation,
    Teller,
    Workbench,
    candidates,
    reduced,
)
from ctrplan.effects.drive.homing_shift import HomingShift
from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.effects.sensor.frame_shift import FrameShift
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

LEAST_POSES = 5  # before and after a slip: fewer are outliers
SMOOTH = 4  # functions of time that a drift is made of besides a line: cosines of up to three half waves, and 1


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


AFTER_SLIP = {
    HomingShift: "tighten that collar, home the drive and measure some of the first poses again",
    FrameShift: "fasten the tracker and the robot's base and measure some of the first poses again",
}


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
        known = candidates(robot, data, allowed, {slip.effect: slip.instants} if slip else {})
        return Concluded(data, slip, known, conclude(robot, data, usable, noise, known, teller))

    def after(slip: Slip | None) -> Concluded | None:
        concluded = conclude_from(after_slip(data, slip), slip) if slip else None
        if concluded is None or concluded.has_slip:
            return concluded
        needs_none = concluded.result.partial is None  # it was asked as any effect, and acts in no fit that is told
        return Concluded(data, None, candidates(robot, data, allowed), concluded.result) if needs_none else None

    concluded = after(most_probable_slip(robot, data, noise, among=allowed)) or conclude_from(data)
    found = concluded.result
    if concluded.slip is None and found.judgement.verdict in ("partial", "unexplained") and found.compared:
        concluded = after(most_probable_slip(robot, data, noise, found.compared.sets[0].terms, allowed)) or concluded
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
        for effect, remedy in AFTER_SLIP.items():
            sentence = sentence.replace(effect.experiment, remedy)
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


def most_probable_slip(
    robot: Robot, data: Measurements, noise: Noise, beside: Sequence[Term] = (), among: Collection[str] = CATALOGUE
) -> Slip | None:
    """The slip that the poses show, if they show one; none on a continuous motion, of a joint where homings are given,
    or of a tracker where frames are.

    beside: effects that are fitted besides; among: names of those that may stand for a slip.
    """
    number = np.full(len(data.sequence), 2)
    after = replace(data, homing=number, frame=number)
    shifts = [term(e, e.variants(robot, after)[0], robot) for e in _asked(robot, data, after) if e.name in among]
    if data.is_stream or data.count < 2 * LEAST_POSES or not shifts:
        return None
    bench = Workbench(robot, data, noise, data.configuration)
    panel = replace(bench, data=after).panel(bench.scored(beside), shifts)
    moved = panel.places(shifts)
    rest = panel.whole.columns([k for k in range(len(panel.keys)) if k not in moved]).refitted()
    instants = slice(LEAST_POSES, data.count - LEAST_POSES + 1)
    best: tuple[float, float, str, int, list[int]] | None = None
    for joint, places in _events(panel, moved):
        gains, evidence = _gains(rest, panel.whole.columns(places))
        k = int(evidence[instants].argmax()) + LEAST_POSES
        if best is None or evidence[k] > best[0]:
            best = float(evidence[k]), float(gains[k]), joint, k, places
    assert best is not None
    _, gain, joint, pose, places = best
    times = np.linspace(-1, 1, data.count)
    drift = np.stack([times, *(np.cos(np.pi * wave * (times + 1) / 2) for wave in range(SMOOTH))], axis=1)
    drifting = panel.whole.J[:, :, places, None] * drift[:, None, None]
    before, left = rest.loss, rest.loss - gain
    smooth = rest.beside(drifting.reshape(*drifting.shape[:2], -1)).refitted().loss
    excess = [np.sqrt(max(value / rest.given.sum() - 1.0, 0.0)) for value in (before, left)]
    if excess[0] < 1.0 / BETTER or excess[1] * BETTER > excess[0] or left >= smooth:
        return None
    return Slip(pose, int(data.rows[pose]) + 1, joint, instants.stop - instants.start)


def _asked(robot: Robot, data: Measurements, after: Measurements) -> Iterator[Effect]:
    """Effects that treat a slip as what the file would tell: none of a drive whose collars were measured."""
    homing, frame = HomingShift(), FrameShift()
    if not data.of_collars and len(np.unique(data.homings)) == 1 and not homing.untestable(robot, after):
        yield homing
    if len(np.unique(data.frames)) == 1:
        yield frame


def _events(panel: Linearisation, moved: Sequence[int]) -> Iterator[tuple[str, list[int]]]:
    """What may have slipped, and the places of its parameters: a joint alone, a tracker as a whole."""
    tracker = [k for k in moved if panel.keys[k][0] == FrameShift.name]
    yield from (("_".join(panel.keys[k][1].split("_")[:2]), [k]) for k in moved if k not in tracker)
    if tracker:
        yield TRACKER, tracker


def _gains(rest: Linear, more: Linear) -> tuple[Array, Array]:
    """(K,) what further parameters take off a fit's loss if they act from each pose on only, and logarithms of how much
    more probable they make the poses.
    """
    root = np.sqrt(rest.weight)[:, None, None]
    c, r, J = more.J * root, rest.r[:, :, None] * root, rest.J * root
    along, square, shared = (
        np.cumsum((np.swapaxes(c, 1, 2) @ other)[::-1], axis=0)[::-1] for other in (r, c, J)
    )  # of all poses from each on
    free = square + np.diag(more.precision)
    inverse = solved(rest.information, np.eye(len(rest.precision)))
    free -= shared @ inverse @ np.swapaxes(shared, 1, 2)
    gains: Array = (np.swapaxes(along, 1, 2) @ np.linalg.solve(free, along))[:, 0, 0]
    return gains, (gains + np.log(more.precision).sum() - np.linalg.slogdet(free)[1]) / 2


def after_slip(data: Measurements, slip: Slip) -> Measurements:
    """The measurements with another homing, or another frame, from the slip on."""
    number = np.where(np.arange(len(data.sequence)) >= slip.row - 1, 2, 1)
    return replace(data, frame=number) if slip.joint == TRACKER else replace(data, homing=number)
