"""Tasks with a time limit, in a process that is ended when it is over."""

from __future__ import annotations

from ctrplan.studies.child_process import ChildEnded, in_child
from ctrplan.studies.study.lines import Lines
from ctrplan.studies.study.task import Row, Status, Task
from ctrplan.studies.study.worker import Chunk, do_tasks, prepare, tasks_of


def do_limited(content: bytes, chunk: Chunk, limit_s: float) -> Lines:
    """Rows of tasks, each of which may take `limit_s`; one that did not live to answer has a row that says so."""
    rows: list[Row] = []
    for task in tasks_of(content, chunk):
        try:
            in_child(prepare, content)
            rows += in_child(do_tasks, content, [task], limit_s=limit_s)
        except TimeoutError:
            rows.append(unanswered(task, "timed out", f"took longer than the limit of {limit_s:g} s.", limit_s))
        except ChildEnded as error:
            rows.append(unanswered(task, "lost", f"{error}."))
    return Lines.of(rows)


def unanswered(task: Task, status: Status, sentence: str, elapsed_s: float = 0.0) -> Row:
    """The row of a task that gave no answer."""
    return Row(task.key, task.index, task.inputs, status, sentence, overrides=task.overrides, elapsed_s=elapsed_s)
