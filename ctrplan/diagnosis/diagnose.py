"""The workflow, from measurements to a verdict: docs/diagnosis.md has the steps and their reasons."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import EVENT, PROGRESS, Made, Texts, checked
from ctrplan.base.arrays import Array
from ctrplan.base.progress import StageProgress
from ctrplan.calibration.gross_outliers import gross_outliers, outlier_sentences, too_many
from ctrplan.calibration.pose_errors import distances
from ctrplan.calibration.residuals import Noise, Residuals
from ctrplan.calibration.robot_content import within_file
from ctrplan.calibration.symptoms import symptoms
from ctrplan.calibration.unsolved import excused, unsolved_sentence
from ctrplan.diagnosis.agreement import contradiction
from ctrplan.diagnosis.candidates import Candidates, candidates, reduced
from ctrplan.diagnosis.chi_square import ignored, remains
from ctrplan.diagnosis.gap import Gap, open_held_out_set
from ctrplan.diagnosis.localise import Place, localise
from ctrplan.diagnosis.next_experiment import next_experiment
from ctrplan.diagnosis.noise_floor import noise_floor
from ctrplan.diagnosis.rescaled_noise import held_out_probability, rescaled_noise
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.selection import Selector
from ctrplan.diagnosis.verdict import Finding, Judgement, judge, specific
from ctrplan.diagnosis.workbench import Scored, Workbench
from ctrplan.effects.catalogue import CATALOGUE
from ctrplan.effects.effect import Effect
from ctrplan.errors import InputError
from ctrplan.experiment.measurements import LONGEST_LAG_S, Measurements
from ctrplan.experiment.split import Split, groups, split
from ctrplan.mechanics.shapes import Status
from ctrplan.pipeline.tip_table import nested
from ctrplan.robot.robot import Robot

LEAST_STABILITY = 0.03  # of the believed robot: nearer to snapping no model is asked
LEAST_GROUPS = 12  # configurations, or blocks of a continuous motion
HELD_OUT_SHARE = 0.95  # of the work done when the held-out set is asked
HELD_OUT_REJECTED = 1e-4  # probability of the held-out set's residuals that takes a name back


class Interrupted(Exception):
    """Ctrl-C between two fits."""


@dataclass(eq=False)
class _Teller:
    """Names the steps to whoever watches, and stops between them when asked to."""

    progress: StageProgress | None
    interrupted: threading.Event | None
    share: float = 0.05

    def pause(self) -> None:
        """Where a run may stop."""
        if self.interrupted is not None and self.interrupted.is_set():
            raise Interrupted

    def __call__(self, step: str) -> None:
        self.pause()
        self.share += 0.25 * (HELD_OUT_SHARE - self.share)  # how many steps there will be is not known
        if self.progress:
            self.progress(step, self.share)


@checked(robot=Made("Robot"), data=Made("Measurements"), progress=PROGRESS, without=Texts(), interrupted=EVENT)
def diagnose(
    robot: Robot,
    data: Measurements,
    progress: StageProgress | None = None,
    *,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    without: Sequence[str] = (),
    interrupted: threading.Event | None = None,
) -> Diagnosis:
    """Compares the whole chain with measurements and says which stage lacks what, if anything.

    `progress` is told the step and the share done. When `interrupted` is set, what was found so far is returned.
    `without` names effects to be left out of the catalogue. Raises InputError where it names another, where the data
    are too few, or neither the robot file states the noise nor the data have repeats.
    """
    began = time.monotonic()
    allowed = reduced(catalogue, without)
    teller = _Teller(progress, interrupted)
    noise, about_noise = noise_floor(robot, data)
    usable = usable_poses(robot, data)
    _checked_split(data, usable)  # before anything is asked
    known = candidates(robot, data, allowed)
    wrong, parts, bench = _without_outliers(robot, data, usable, noise)
    selector, judgement, notes, stopped = _searched(bench, known, teller)
    more = gross_outliers(selector.found.chosen.fit, data, usable & ~wrong)  # that something missing had hidden
    if more.any() and not too_many(wrong | more, usable) and not stopped:
        wrong |= more
        parts = _checked_split(data, usable & ~wrong)
        bench = _bench(robot, data, parts, noise)
        selector, judgement, notes, stopped = _searched(bench, known, teller)
    selector.bench.pause = lambda: None  # what follows is short, and nothing is told without it
    chosen, base = selector.found.chosen, selector.bench.scored([])
    noise = selector.bench.noise
    if progress:
        progress("asking the held-out set", HELD_OUT_SHARE)
    group = groups(data)
    gap = open_held_out_set(base.fit, chosen.fit, data.subset(parts.held_out_set), group[parts.held_out_set], noise)
    place = _place(selector.bench, gap)
    estimated = noise.position_m < bench.noise.position_m
    judgement, note = _after_held_out_set(judgement, selector, gap, place, estimated)
    written = _written(selector.bench, chosen, judgement)
    if written is not chosen:  # errors are of the model that is handed over
        judgement = replace(judgement, adequacy=remains(selector.bench, written))
        gap = open_held_out_set(
            base.fit, written.fit, data.subset(parts.held_out_set), group[parts.held_out_set], noise
        )
        if doubt := contradiction(judgement.verdict, gap, place):
            judgement, note = replace(judgement, verdict="unexplained"), [*note, doubt]
    outlying = wrong.copy()
    outlying[parts.selection] = ignored(written) & ~excused(written.failed)
    outlying[parts.held_out_set] = gap.outlying
    unsolved = np.zeros(data.count, bool)
    unsolved[parts.selection], unsolved[parts.held_out_set] = base.failed | written.failed, gap.failed
    left_out = np.zeros(data.count, bool)
    left_out[parts.selection] = excused(base.failed) | excused(written.failed)
    left_out[parts.held_out_set] = excused(gap.failed)
    sentence, proposed = next_experiment(chosen, judgement, bench.data, noise, list(known.not_testable))
    return Diagnosis(
        verdict=judgement.verdict,
        judgement=judgement,
        base=base,
        chosen=written,
        gap=gap,
        place=place,
        next_experiment=sentence,
        proposals=proposed,
        path=tuple(selector.found.path),
        not_testable=known.not_testable,
        without=tuple(without),
        notes=(
            *data.warnings,
            *_left_out(without),
            *([about_noise] if about_noise else []),
            *notes,
            *judgement.notes,
            *note,
            *symptoms(chosen.fit),
            *_coverage(usable),
            *outlier_sentences(written.fit, data, outlying),
            *unsolved_sentence(data, unsolved, ~left_out, "calibrated or with the effects"),
        ),
        robot=robot,
        data=data,
        noise=noise,
        coverage=float((usable & ~left_out & ~wrong).mean()),
        outlier_rows=tuple((data.rows[outlying] + 1).tolist()),
        interrupted=stopped,
        time_s=time.monotonic() - began,
    )


def usable_poses(robot: Robot, data: Measurements) -> NDArray[np.bool_]:
    """(K,) poses that every candidate is asked about: the believed robot is stable there, clocks can be compared."""
    first = np.unique(data.configuration, return_index=True)[1]
    rows = data.rows[first]
    theta_b, l_b = robot.collars(data.theta_commanded[rows], data.l_commanded[rows])
    bounds = robot.bound_many(theta_b, nested(robot, l_b))
    sound = (bounds.status <= Status.MULTIPLE) & (bounds.stability > LEAST_STABILITY)
    usable: NDArray[np.bool_] = sound[data.configuration]
    if data.is_stream and data.time_s is not None:
        starts = {run: data.time_s[data.sequence == run][0] for run in np.unique(data.sequence).tolist()}
        begun = np.array([starts[run] for run in data.sequence[data.rows].tolist()])
        usable = usable & (data.time_s[data.rows] - begun >= LONGEST_LAG_S)
    return usable


def _checked_split(data: Measurements, usable: NDArray[np.bool_]) -> Split:
    count = len(np.unique(groups(data)[usable]))
    if count < LEAST_GROUPS:
        what = "blocks of a continuous motion" if data.is_stream else "configurations"
        rule = f"has {count} usable {what}, too few to fit a model and keep a quarter aside: at least {LEAST_GROUPS}"
        raise InputError(rule, file=data.file)
    return split(data, usable)


def _bench(robot: Robot, data: Measurements, parts: Split, noise: Noise) -> Workbench:
    return Workbench(robot, data.subset(parts.selection), noise, groups(data)[parts.selection], parts.fold)


def _without_outliers(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise
) -> tuple[NDArray[np.bool_], Split, Workbench]:
    """Poses (K,) that went wrong, and split and bench without them. Found by the calibrated model without effects."""
    wrong = np.zeros(data.count, bool)
    while True:
        parts = _checked_split(data, usable & ~wrong)
        bench = _bench(robot, data, parts, noise)
        more = gross_outliers(bench.scored([]).fit, data, usable & ~wrong)
        if not more.any() or too_many(wrong | more, usable):
            return wrong, parts, bench
        wrong |= more


def _searched(bench: Workbench, known: Candidates, teller: _Teller) -> tuple[Selector, Judgement, list[str], bool]:
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
        notes.append("Interrupted: this is what was found until then, not a verdict.")
        chosen = selector.found.chosen
        findings = tuple(Finding(t) for t in chosen.terms)
        return selector, Judgement("unexplained", findings, remains(bench, chosen), ()), notes, True
    return selector, judgement, notes, False


def _after_held_out_set(
    judgement: Judgement, selector: Selector, gap: Gap, place: Place, estimated: bool
) -> tuple[Judgement, list[str]]:
    """A verdict that the held-out set or any figure contradicts is taken back.

    estimated: the noise is smaller than stated.

    Noise that had to be enlarged may have taken in a misfit: no allowance is made for it.
    """
    residuals = _solved(selector.found.chosen)
    p = held_out_probability(gap.chi_square, judgement.adequacy.total, residuals, estimated=estimated)
    doubt = contradiction(judgement.verdict, gap, place)
    if judgement.verdict == "unexplained" or (p > HELD_OUT_REJECTED and not doubt):
        return judgement, []
    kept = specific(selector.bench, selector.found, judgement.findings, judgement.adequacy)
    note = f"The held-out set contradicts it: chi-square per degree of freedom {gap.chi_square.ratio:.2f}."
    return replace(judgement, verdict="unexplained", findings=kept), [doubt or note]


def _norms(scored: Scored) -> tuple[Array, Array]:
    """Of the residuals per pose, without outliers, and how many measured numbers each has."""
    parts, kept = scored.fit.residuals, ~ignored(scored)
    return parts.norm[kept], parts.given[kept].sum(axis=1)


def _solved(scored: Scored) -> Residuals:
    """Residuals of the poses that chi-squares are of, outliers among them."""
    parts, kept = scored.fit.residuals, ~excused(scored.failed)
    return Residuals(parts.r[kept], parts.J[kept], parts.weight[kept], parts.raw_norm[kept], parts.given[kept])


def _written(bench: Workbench, chosen: Scored, judgement: Judgement) -> Scored:
    """The model with the effects of the verdict alone, as large as the data say, in numbers a robot file may have."""
    listed = {finding.term.key for finding in judgement.findings}
    kept = [t for t in chosen.terms if t.key in listed]
    scored = bench.sized(chosen if len(kept) == len(chosen.terms) else bench.scored(kept, chosen.fit))
    inside = within_file(scored.fit)
    return scored if inside is scored.fit else replace(scored, fit=inside)


def _place(bench: Workbench, gap: Gap) -> Place:
    base = bench.scored([])
    fit, kept = base.fit, ~ignored(base)
    error = distances(fit.chain.predict(fit.p, derivatives=False), fit.chain.data)
    return localise(bench.data.subset(kept), fit.residuals.r[kept], bench.group[kept], error[kept], gap.floor_m)


def _left_out(without: Sequence[str]) -> list[str]:
    return [f"Taken out of the catalogue, as asked: {', '.join(without)}."] if without else []


def _coverage(usable: NDArray[np.bool_]) -> list[str]:
    masked = int((~usable).sum())
    if not masked:
        return []
    return [f"{masked} of {len(usable)} poses were left out for all candidates alike: near snapping, or a run's start."]
