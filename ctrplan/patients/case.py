"""`ctrplan.case`: from scans and points to a certified plan, in steps whose files can be edited between two runs."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import EVENT, PROGRESS, Choice, checked
from ctrplan.base.arrays import numbers
from ctrplan.base.long_work import StageProgress, interrupt_event
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.patients.request import STEP_NAMES, Options, Place, over, request_of
from ctrplan.patients.steps import BasesStep, PlacedStep, PlanStep, ScenarioStep, SlicerStep
from ctrplan.patients.work import FILE, CaseStep, MadeFile, Record, Work, key_of
from ctrplan.storage.output_folder import output_folder

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ctrplan.plans.plan import Plan

STEPS: tuple[type[CaseStep], ...] = (ScenarioStep, BasesStep, PlacedStep, PlanStep, SlicerStep)


@dataclass(frozen=True)
class StepReport:
    """What became of a step: made anew in `seconds`, or kept as it is or as people edited it."""

    name: str
    sentence: str
    seconds: float
    is_made: bool


@shown
@dataclass(frozen=True, eq=False)
class Case:
    """A case's folder after a run. plan is None where the plan that is there was kept."""

    folder: Path
    steps: tuple[StepReport, ...]
    plan: Plan | None
    interrupted: bool = False


@checked(
    Options,
    from_step=Choice(*STEP_NAMES),
    until=Choice(*STEP_NAMES),
    progress=PROGRESS,
    on_step=PROGRESS,
    note=PROGRESS,
    interrupted=EVENT,
)
def case(
    output: str | os.PathLike[str],
    inputs: Sequence[str | os.PathLike[str]] | None = None,
    *,
    targets: Sequence[str | ArrayLike] | None = None,
    entries: Sequence[str | ArrayLike] | None = None,
    phases: Sequence[Sequence[str | os.PathLike[str]]] | None = None,
    from_step: str | None = None,
    until: str | None = None,
    progress: StageProgress | None = None,
    on_step: Callable[[StepReport], object] | None = None,
    note: Callable[[str], object] | None = None,
    interrupted: threading.Event | None = None,
    **options: Unpack[Options],
) -> Case:
    """A patient's case in the folder `output`: a scenario of `inputs`, base poses, a certified plan, 3D Slicer's scene.

    `inputs` are images, meshes and files of markups, or folders of them. Targets and entries are places (3,) in mm in
    `frame`, or names of markups, of files of them, or of their points' labels; a target also the name of a structure,
    whose middle is meant. `lumens` and `avoids` name structures, `phases` the files of each that moves, with
    `motion_margin_mm` for places between its phases. Base poses lie within `radius_mm` and `cone_deg` of an entry, and
    the first `bases` of them are planned from until one has a plan. `ctrplan.patients.request` says what each of the
    options is. What is None or not given is as the run before had it, or as ctrplan chooses.

    Every step writes files into `output`. A step whose files and sources are as they were is not done again; files
    that were edited are kept and count for the steps after. `from_step` makes that step and all after it anew, `until`
    is the last one that is done. `on_step` is called with each step, `note` with warnings. Raises InputError
    for what can't be understood and for an edited file whose sources have changed, NoAnswerError where nothing is
    reached or no plan found.
    """
    moving = tuple(tuple(os.fspath(file) for file in group) for group in phases or ())
    named = dict.fromkeys([*(file for group in moving for file in group), *(os.fspath(path) for path in inputs or ())])
    places = {"targets": _places(targets), "entries": _places(entries)}
    request = request_of({"inputs": tuple(named) or None, "phases": moving or None, **places, **options})
    folder = output_folder(os.fspath(output), (FILE, *ScenarioStep.files, *BasesStep.files, *PlacedStep.files))
    record = Record(folder)
    with interrupt_event(interrupted) as stop:
        work = Work(
            folder=folder,
            request=over(request, record.request),
            record=record,
            stop=stop,
            progress=progress or (lambda _stage, _share: None),
            note=note or (lambda _sentence: None),
        )
        done = [*_done(work, from_step, until, on_step or (lambda _step: None))]
        return Case(folder, tuple(done), work.plan, stop.is_set())


def _places(places: Sequence[str | ArrayLike] | None) -> tuple[Place, ...] | None:
    """One place alone is meant as a list of it."""
    if places is None:
        return None
    if isinstance(places, str) or (len(places) == 3 and all(np.isscalar(x) and not isinstance(x, str) for x in places)):
        places = [places]  # type: ignore[list-item]
    return tuple(place if isinstance(place, str) else _numbers(place) for place in places)


def _numbers(place: ArrayLike) -> tuple[float, float, float]:
    point = numbers(place, "place")
    if point.shape != (3,):
        raise InputError("must be three numbers", key="place", value=place, unit="mm")
    x, y, z = point.tolist()
    return x, y, z


def _done(
    work: Work, from_step: str | None, until: str | None, on_step: Callable[[StepReport], object]
) -> Iterator[StepReport]:
    """Every step in its turn."""
    forced = False
    work.record.request = work.request
    for step in (kind() for kind in STEPS):
        forced = forced or step.name == from_step
        began = time.monotonic()
        kept = "" if forced else _kept(work, step)
        sentence = kept or _made(work, step)
        result = StepReport(step.name, sentence, time.monotonic() - began, not kept)
        on_step(result)
        yield result
        if work.stop.is_set() or step.name == until:
            return


def _kept(work: Work, step: CaseStep) -> str:
    """Why a step need not be done; empty where it has to be. Raises InputError where an edit would be lost."""
    made, edited = work.record.steps.get(step.name), work.record.edited(step.name)
    if made is None or made.pending:
        own = [name for name in step.files if made is None and work.file(name).exists()]
        if own and not work.request.get("inputs"):
            return f"{', '.join(own)} kept as it is there"
        if own and step.name == ScenarioStep.name:
            rule = f"is there and no run of ctrplan case wrote it: --from {step.name} replaces it"
            raise InputError(rule, file=work.file(own[0]))
        return ""
    missing = [name for name in made.files if not work.file(name).exists()]
    is_same = made.key == key_of(step.made_from(work))
    changed = [name for name in edited if name in step.files and name not in missing]
    if changed and not is_same:
        rule = f"was edited, and what it was made from has changed since: --from {step.name} makes it anew"
        raise InputError(rule, file=work.file(changed[0]))
    if missing or not is_same or (edited and not changed):
        return ""
    return f"{', '.join(changed)} kept as edited" if changed else f"kept: {made.sentence}"


def _made(work: Work, step: CaseStep) -> str:
    """Does the step. Where it fails, files and record are as they were."""
    before, had_folder = work.record.steps.get(step.name), work.folder.exists()
    work.folder.mkdir(parents=True, exist_ok=True)
    work.record.begin(step.name)
    try:
        sentence = step.make(work)
    except BaseException:
        _as_before(work, step, before, had_folder)
        raise
    chosen = work.record.steps[step.name].chosen
    work.end(step, sentence, chosen)
    return sentence


def _as_before(work: Work, step: CaseStep, before: MadeFile | None, had_folder: bool) -> None:
    if before is not None:
        work.record.steps[step.name] = before
    else:
        del work.record.steps[step.name]
    if not work.record.steps and work.record.is_new:
        work.file(FILE).unlink(missing_ok=True)
        if not had_folder:
            work.folder.rmdir()
    else:
        work.record.write()
