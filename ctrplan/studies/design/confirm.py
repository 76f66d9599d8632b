"""Plans from the scenario's start to all targets with the best designs of a front, each with its certificate."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace

from ctrplan.studies.design.definition import Definition
from ctrplan.studies.design.front import Looked
from ctrplan.studies.study.axes import TargetAxis
from ctrplan.studies.study.engine import Engine
from ctrplan.studies.study.run import Doing, Report
from ctrplan.studies.study.store import Store
from ctrplan.studies.study.table import write_table
from ctrplan.studies.study.task import KEY_DIGITS, Task

PLANS = "plans"  # folder below that of the search, which load_study reads


def confirm(definition: Definition, best: Sequence[Looked], search: Store, engine: Engine, report: Report) -> None:
    """Does those plans that are missing in the folder `plans`, and writes their table. Raises CtrplanError."""
    store = Store(search.folder / PLANS)
    store.open_for_work()
    try:
        job = replace(definition.job, task={"kind": "plan"})
        name = {"name": f"{definition.name}, plans", "version": job.version}
        store.write_definition({**name, "parts": [{"file": "..", "content": {}}]})
        tasks = list(_tasks(definition, best))
        store.write_keys(task.key for task in tasks)
        missing = [[task] for task in tasks if bytes.fromhex(task.key) not in store.offsets]
        for done, rows in enumerate(engine.rows(pickle.dumps(job), iter(missing), None), start=1):
            store.add(rows)
            report(Doing("plans", done, len(missing), None, engine.note))
        write_table(store)
    finally:
        store.close()


def _tasks(definition: Definition, best: Sequence[Looked]) -> Iterator[Task]:
    common = {"tolerance_mm": definition.job.task["tolerance_mm"]}
    targets = TargetAxis(definition.points_mm, common, of_scenario=True)
    index = 0
    for number, looked in enumerate(best, start=1):
        for k in range(len(targets)):
            target = targets.at(k)
            overrides = (*looked.row["overrides"], *target.overrides)
            text = json.dumps([definition.base, "plan", overrides, definition.entry.seed])
            key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
            settings = {"seed": definition.entry.seed, **target.settings}
            yield Task(index, key, {"design": number, **target.inputs}, overrides, settings)
            index += 1
