"""Searching for tube designs: proposals a batch at a time, steps down exact derivatives, plans with the best of the
front.

A step counts where the error at worst falls - that with tolerances, if it is an objective - and no target is lost.

They end at the joints that a design was judged by: a plan to the tip alone weighs the way against the error at its end.
Only where there is no way to these joints is one sought to the tip.

What was proposed follows from the seed and from the rows alone. A search that was ended asks the same again, finds the
answers in its folder, and goes on where there are none.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.studies.design.space import (
    Archive,
    Design,
    DesignDefinition,
    DesignSpace,
    EvaluatedDesign,
    judged,
    name_of,
)
from ctrplan.studies.study.axes import goal_overrides
from ctrplan.studies.study.engine import Engine, unanswered
from ctrplan.studies.study.store import Lines, Store
from ctrplan.studies.study.study import Doing, Report, Where
from ctrplan.studies.study.study_definition import KEPT
from ctrplan.studies.study.table import write_table
from ctrplan.studies.study.task import KEY_DIGITS, Task
from ctrplan.studies.target_set import LESS_IS_BETTER

FIRST, LEAST = 0.1, 0.01  # shares of the ranges
LONGER, SHORTER = 1.5, 0.4

Look = Callable[[Sequence[Design]], Sequence[EvaluatedDesign]]


@dataclass(eq=False)
class Descent:
    """Where one descent is."""

    at: EvaluatedDesign
    step: float = FIRST
    tried: set[tuple[object, ...]] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Where it begins is known."""
        self.tried.add(self.at.design.key)

    def proposal(self, space: DesignSpace) -> Design | None:
        """The next design, a step down that was not tried; None where there is no way down."""
        down = downhill(space, self.at)
        while self.step >= LEAST and down.any():
            shares = np.clip(np.array(self.at.design.shares) + self.step * down, 0.0, 1.0)
            result = space.design(shares.tolist())
            if result.key not in self.tried and space.strain(result) <= space.entry.made.most_strain:
                self.tried.add(result.key)
                return result
            self.step *= SHORTER
        return None

    def judge(self, looked: EvaluatedDesign, objective: str) -> None:
        """Goes on from a design that is better, else tries a shorter step."""
        if is_better(looked, self.at, objective):
            self.at, self.step = looked, self.step * LONGER
        else:
            self.step *= SHORTER


def descend(
    space: DesignSpace, best: Sequence[EvaluatedDesign], steps: int, objectives: Sequence[str], look: Look
) -> list[EvaluatedDesign]:
    """Designs that `steps` steps from each of the best ones lead to, evaluated together."""
    objective = judged(objectives)
    descents = [Descent(looked) for looked in best]
    for _ in range(steps):
        proposals = [(descent, made) for descent in descents if (made := descent.proposal(space))]
        if not proposals:
            break
        for (descent, _), looked in zip(proposals, look([made for _, made in proposals]), strict=True):
            descent.judge(looked, objective)
    return [descent.at for descent in descents]


def is_better(new: EvaluatedDesign, old: EvaluatedDesign, objective: str) -> bool:
    """Whether the error is less and as many targets are reached."""
    if not new.is_done:
        return False
    return bool(new.numbers[objective] < old.numbers[objective] and new.numbers["reach"] >= old.numbers["reach"])


def downhill(space: DesignSpace, looked: EvaluatedDesign) -> Array:
    """Direction in shares along which the error falls fastest, its largest part 1 or -1; zero where it can't fall.

    Tubes stay what they are. What is at an end of its range does not move beyond it.
    """
    widths = {side.name: side.width for side, _, _ in space.sides(looked.design)}
    by_share = np.zeros(len(looked.design.shares))
    for k, parameter in enumerate(space.parameters, start=space.tubes):
        slope = looked.numbers[f"slope.{name_of(parameter)}"] / widths[name_of(parameter)]
        by_share[k] = slope * (parameter.high - parameter.low)
    shares = np.array(looked.design.shares)
    at_end = ((shares <= 0) & (by_share > 0)) | ((shares >= 1) & (by_share < 0))
    down = np.where(at_end, 0.0, -by_share)
    largest = np.abs(down).max(initial=0.0)
    result: Array = down / largest if largest > 0 else down
    return result


EXTRA = "pip install 'ctrplan[design]'"
JOURNAL = "optuna.journal"  # for Optuna's own tools: `optuna-dashboard optuna.journal`
NAME = "design"


def check_installed() -> None:
    """Raises InputError without Optuna."""
    if find_spec("optuna") is None:
        raise InputError(f"a search of designs needs Optuna: {EXTRA}", key="design")


class Sampler:
    """A study of Optuna, whose trials are written into a folder as they are told."""

    def __init__(
        self,
        names: Sequence[str],
        less_is_better: Sequence[bool],
        kind: Literal["tpe", "nsga2", "random"],
        seed: int,
        folder: Path,
    ) -> None:
        """Begins anew: what a folder's rows answer is told again, which takes no time. Raises InputError."""
        check_installed()
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.optuna, self.names = optuna, list(names)
        journal = folder / JOURNAL
        journal.unlink(missing_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.study = optuna.create_study(
                study_name=NAME,
                storage=JournalStorage(JournalFileBackend(os.fspath(journal))),
                sampler=self._sampler(kind, seed),
                directions=["minimize" if less else "maximize" for less in less_is_better],
            )
        self.space = {name: optuna.distributions.FloatDistribution(0.0, 1.0) for name in self.names}

    def ask(self, count: int) -> list[tuple[Any, tuple[float, ...]]]:
        """The next `count` trials, each with its shares."""
        results = []
        for _ in range(count):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                trial = self.study.ask(self.space)
            results.append((trial, tuple(trial.params[name] for name in self.names)))
        return results

    def tell(self, trial: Any, values: Sequence[float] | None) -> None:
        """What came of a trial: its objectives, or that it was given up."""
        if values is None:
            self.study.tell(trial, state=self.optuna.trial.TrialState.PRUNED)
        else:
            self.study.tell(trial, list(values))

    def _sampler(self, kind: str, seed: int) -> Any:
        samplers = self.optuna.samplers
        if kind == "tpe":
            return samplers.TPESampler(seed=seed, constant_liar=True, multivariate=True)
        return samplers.NSGAIISampler(seed=seed) if kind == "nsga2" else samplers.RandomSampler(seed=seed)


PLANS = "plans"  # folder below that of the search, which load_study reads
JOINTS, TIP = "joints", "tip"  # what a plan ends at


def confirm(
    definition: DesignDefinition, best: Sequence[EvaluatedDesign], search: Store, engine: Engine, report: Report
) -> None:
    """Does those plans that are missing in the folder `plans`, and writes their table. Raises CtrplanError."""
    store = Store(search.folder / PLANS)
    store.open_for_work()
    try:
        job = replace(definition.job, task={"kind": "plan"}, keep=KEPT["all"])
        name = {"name": f"{definition.name}, plans", "version": job.version}
        store.write_definition({**name, "parts": [{"file": "..", "content": {}}]})
        cases = [(k, design, goal) for k, design in enumerate(best, start=1) for goal in definition.goals(design)]
        tasks = [_task(definition, k, *of) for k, of in enumerate(cases)]
        _do(tasks, pickle.dumps(job), store, engine, report)
        blocked = [of for task, of in zip(tasks, cases, strict=True) if _is_blocked(task, store)]
        tips = [(number, looked, {**goal, JOINTS: None}) for number, looked, goal in blocked]
        tasks += [_task(definition, len(tasks) + k, *of) for k, of in enumerate(tips)]
        _do(tasks, pickle.dumps(job), store, engine, report)
        write_table(store)
    finally:
        store.close()


def _do(tasks: Sequence[Task], content: bytes, store: Store, engine: Engine, report: Report) -> None:
    store.write_keys(task.key for task in tasks)
    missing = [[task] for task in tasks if _status(task, store) in (None, "lost")]
    for done, lines in enumerate(engine.rows(content, iter(missing), None), start=1):
        store.add(lines)
        report(Doing("plans", done, len(missing), None, engine.note))


def _is_blocked(task: Task, store: Store) -> bool:
    return task.inputs["to"] == JOINTS and _status(task, store) == "no answer"


def _status(task: Task, store: Store) -> str | None:
    """None where there is no row."""
    key = bytes.fromhex(task.key)
    return store.failed.get(key, "done") if key in store.offsets else None


def _task(
    definition: DesignDefinition, index: int, number: int, looked: EvaluatedDesign, goal: Mapping[str, Any]
) -> Task:
    """The plan to one target with the design that is `number` on the front."""
    given = {key: value for key, value in goal.items() if value is not None}
    overrides = (*looked.row["overrides"], *goal_overrides(given))
    text = json.dumps([definition.base, "plan", overrides, definition.entry.seed])
    key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
    tip = {f"target_{axis}_mm": value for axis, value in zip("xyz", goal["tip_mm"], strict=True)}
    inputs = {"design": number, **tip, "to": JOINTS if JOINTS in given else TIP}
    return Task(index, key, inputs, overrides, {"seed": definition.entry.seed})


SEARCH, LOCAL = "search", "local step"


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search left in its folder."""

    archive: Archive
    store: Store
    did: int  # designs looked at in this run
    interrupted: bool = False


def search(definition: DesignDefinition, folder: str | os.PathLike[str], where: Where, report: Report) -> SearchResult:
    """Looks at designs until all trials and local steps are done, or Ctrl-C. Raises CtrplanError."""
    check_installed()
    store = Store(folder)
    store.open_for_work()
    own = {"file": os.path.relpath(definition.document.file or "design.toml", store.folder)}
    parts = [{**own, "content": definition.document.content}]
    store.write_definition({"name": definition.name, "version": definition.job.version, "parts": parts})
    interrupted, archive = False, Archive(definition.entry.objectives)
    looking = SearchState(definition, store, archive, report)
    try:
        report(Doing("workers", 0, 1))
        with where.engine() as engine:
            looking.engine = engine
            _trials(definition, looking)
            best = sorted(archive.front, key=lambda looked: looked.numbers[judged(archive.objectives)])
            entry = definition.entry
            local = lambda designs: looking.look(designs, LOCAL, [])  # noqa: E731
            descend(definition.space, best[: entry.local.designs], entry.local.steps, entry.objectives, local)
            if entry.plans:
                confirm(definition, archive.front[: entry.plans], store, engine, report)
    except KeyboardInterrupt:
        interrupted = True
    try:
        looking.write_keys()
        write_table(store)
    finally:
        store.close()
    return SearchResult(archive, store, looking.did, interrupted)


def _trials(definition: DesignDefinition, looking: SearchState) -> None:
    """All trials of the sampler, a batch at a time."""
    entry, archive = definition.entry, looking.archive
    less = [LESS_IS_BETTER[name] for name in entry.objectives]
    sampler = Sampler(definition.space.names, less, entry.sampler, entry.seed, looking.store.folder)
    for first in range(0, entry.trials, entry.together):
        trials = sampler.ask(min(entry.together, entry.trials - first))
        front = [archive.values(looked) for looked in archive.front] if entry.prune else []
        looked = looking.look([definition.space.design(shares) for _, shares in trials], SEARCH, front)
        for (trial, _), design in zip(trials, looked, strict=True):
            sampler.tell(trial, list(archive.values(design).values()) if design.is_done else None)


class SearchState:
    """Looks at designs: what the folder has no row of is done by an engine."""

    engine: Engine

    def __init__(self, definition: DesignDefinition, store: Store, archive: Archive, report: Report) -> None:
        """Nothing is done yet."""
        self.definition, self.store, self.archive, self.report = definition, store, archive, report
        self.keys: dict[str, int] = {}  # of all tasks, in their order
        self.did, self.began = 0, time.monotonic()
        entry = definition.entry
        self.count = entry.trials + entry.local.designs * entry.local.steps

    def look(self, designs: Sequence[Design], stage: str, front: list[dict[str, float]]) -> list[EvaluatedDesign]:
        """The rows of designs, in their order; they join the archive."""
        tasks = [self._task(design, stage, front) for design in designs]
        missing = {
            task.key: (task, design) for task, design in zip(tasks, designs, strict=True) if self._is_missing(task)
        }
        self._do(missing.values())
        rows = [self.store.row(bytes.fromhex(task.key)) | {"index": task.index} for task in tasks]
        results = [EvaluatedDesign(*looked) for looked in zip(designs, rows, strict=True)]
        for looked in results:
            self.archive.add(looked)
        self.write_keys()
        return results

    def write_keys(self) -> None:
        """The order of all tasks so far, which tables have their rows in."""
        self.store.write_keys(self.keys)

    def _task(self, design: Design, stage: str, front: list[dict[str, float]]) -> Task:
        task = self.definition.task(0, design, stage, front)
        index = self.keys.setdefault(task.key, len(self.keys))
        return self.definition.task(index, design, stage, front)

    def _do(self, missing: Iterable[tuple[Task, Design]]) -> None:
        able = []
        for task, design in missing:
            if sentence := self._refusal(design):
                self.store.add(Lines.of([unanswered(task, "no answer", sentence)]))
            else:
                able.append([task])
        for lines in self.engine.rows(self.definition.content, iter(able), None) if able else ():
            self.store.add(lines)
            self.did += len(lines)
            done = min(len(self.archive.all) + self.did % len(able), self.count)
            self.report(Doing("designs", done, self.count, self._left_s(), self.engine.note))

    def _refusal(self, design: Design) -> str:
        """Why a design can't be made; empty where it can."""
        strain, most = self.definition.space.strain(design), self.definition.entry.made.most_strain
        if strain <= most:
            return ""
        return (
            f"can't be made: setting its precurvature strains a tube by {100 * strain:.1f} %, {100 * most:g} % at most."
        )

    def _left_s(self) -> float | None:
        left = self.count - len(self.archive.all)
        return (time.monotonic() - self.began) / self.did * left if self.did else None

    def _is_missing(self, task: Task) -> bool:
        key = bytes.fromhex(task.key)
        return key not in self.store.offsets or self.store.failed.get(key) == "lost"
