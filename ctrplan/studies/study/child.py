"""A process of its own that does tasks, and is ended when one takes longer than it may, whatever it is doing.

Neither a thread nor a process of a pool can be ended from outside without those beside it; a child can. It is started
by `python -m`, so that scripts need no guard of their main module, and so that workers of a cluster may have one.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from multiprocessing.connection import Connection, Pipe
from typing import Any
from weakref import WeakSet

from ctrplan.studies.study.task import Row, Task

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "CTRPLAN_THREADS")
PATIENCE_S = 60.0  # to start
_of_thread = threading.local()
_children: WeakSet[Child] = WeakSet()


class Child:
    """One such process, for the thread that made it; it ends with its parent, or when it is closed."""

    def __init__(self) -> None:
        """Starts it."""
        self.pipe, theirs = Pipe()
        environment = dict(os.environ) | dict.fromkeys(ONE_THREAD, "1")
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "ctrplan.studies.study.child", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the parent, which ends it
            )
        self.known: bytes | None = None

    def ask(self, content: bytes, tasks: Sequence[Task], limit_s: float | None) -> list[Row]:
        """The rows of tasks. Raises TimeoutError after `limit_s`, EOFError where the process died, and what it raised.

        After the first two the child is gone.
        """
        try:
            self.pipe.send((None if content == self.known else content, tasks))
            self.known = content
            if not self._started():
                raise EOFError
            if not self.pipe.poll(limit_s):
                raise TimeoutError
            answer: Any = self.pipe.recv()
        except TimeoutError:
            self.close()
            raise
        except (OSError, EOFError) as error:
            self.close(patience_s=1.0)  # which it needs to be gone, and to say how
            raise EOFError from error
        except BaseException:
            self.close()
            raise
        if isinstance(answer, Exception):
            raise answer
        rows: list[Row] = answer
        return rows

    def _started(self) -> bool:
        """Waits for the word that it has begun: what is imported does not count as a task's time."""
        return self.pipe.poll(PATIENCE_S) and self.pipe.recv() == "begun"

    @property
    def fate(self) -> str:
        """How it ended."""
        code = self.process.poll()
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    @property
    def is_alive(self) -> bool:
        """Whether it can be asked."""
        return not self.pipe.closed and self.process.poll() is None

    def close(self, patience_s: float = 0.0) -> None:
        """Ends it, at once or when it has not ended by itself."""
        try:
            self.process.wait(timeout=patience_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.wait()
        self.pipe.close()


def in_child(content: bytes, tasks: Sequence[Task], limit_s: float | None = None) -> list[Row]:
    """Rows of tasks, done by the child of this thread; a task that it did not live to answer has a row that says so."""
    child: Child | None = getattr(_of_thread, "child", None)
    if child is None or not child.is_alive:
        child = _of_thread.child = Child()
        _children.add(child)
    try:
        return child.ask(content, tasks, limit_s)
    except TimeoutError:
        sentence = f"took longer than the limit of {limit_s:g} s."
        return [unanswered(task, "timed out", sentence, limit_s or 0.0) for task in tasks]
    except EOFError:
        return [unanswered(task, "lost", f"the process that did it ended ({child.fate}).") for task in tasks]


def unanswered(task: Task, status: Any, sentence: str, elapsed_s: float = 0.0) -> Row:
    """The row of a task that gave no answer."""
    return Row(task.key, task.index, task.inputs, status, sentence, overrides=task.overrides, elapsed_s=elapsed_s)


def close_children() -> None:
    """Ends the children of all threads of this process."""
    for child in list(_children):
        child.close()


def serve(descriptor: int) -> None:
    """What the child does until its parent is gone."""
    from ctrplan.studies.study.worker import do_tasks

    known = b""
    os.dup2(2, 1)  # what tasks print is no answer
    with Connection(descriptor) as pipe:
        while True:
            try:
                content, tasks = pipe.recv()
            except (EOFError, OSError):
                return
            known = content or known
            pipe.send("begun")
            try:
                pipe.send(do_tasks(known, tasks))
            except Exception as error:
                pipe.send(error)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
