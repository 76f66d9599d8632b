"""Plans from the scenario's start to all targets with the best designs of a front, each with its certificate.

They end at the joints that a design was judged by: a plan to the tip alone weighs the way against the error at its end.
Only where there is no way to these joints is one sought to the tip.
"""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ctrplan.studies.design.definition import Definition
from ctrplan.studies.design.front import Looked
from ctrplan.studies.study.axes import goal_overrides
from ctrplan.studies.study.definition import KEPT
from ctrplan.studies.study.engine import Engine
from ctrplan.studies.study.run import Doing, Report
from ctrplan.studies.study.store import Store
from ctrplan.studies.study.table import write_table
from ctrplan.studies.study.task import KEY_DIGITS, Task

PLANS = "plans"  # folder below that of the search, which load_study reads
JOINTS, TIP = "joints", "tip"  # what a plan ends at


def confirm(definition: Definition, best: Sequence[Looked], search: Store, engine: Engine, report: Report) -> None:
    """Does those plans that are missing in the folder `plans`, and writes their table. Raises CtrplanError."""
    store = Store(search.folder / PLANS)
    store.open_for_work()
    try:
        job = replace(definition.job, task={"kind": "plan"}, keep=KEPT["all"])
        name = {"name": f"{definition.name}, plans", "version": job.version}
        store.write_definition({**name, "parts": [{"file": "..", "content": {}}]})
        asked = [(k, one, goal) for k, one in enumerate(best, start=1) for goal in definition.goals(one)]
        tasks = [_task(definition, k, *of) for k, of in enumerate(asked)]
        _do(tasks, pickle.dumps(job), store, engine, report)
        blocked = [of for task, of in zip(tasks, asked, strict=True) if _is_blocked(task, store)]
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


def _task(definition: Definition, index: int, number: int, looked: Looked, goal: Mapping[str, Any]) -> Task:
    """The plan to one target with the design that is `number` on the front."""
    given = {key: value for key, value in goal.items() if value is not None}
    overrides = (*looked.row["overrides"], *goal_overrides(given))
    text = json.dumps([definition.base, "plan", overrides, definition.entry.seed])
    key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
    tip = {f"target_{axis}_mm": value for axis, value in zip("xyz", goal["tip_mm"], strict=True)}
    inputs = {"design": number, **tip, "to": JOINTS if JOINTS in given else TIP}
    return Task(index, key, inputs, overrides, {"seed": definition.entry.seed})
