"""Processes of this machine that call functions, ended when a call takes longer than it may, also as an executor.

Neither a thread nor a process of a pool can be ended from outside without those beside it; a child can. It is started
by `python -m`, so that scripts need no guard of their main module, and workers of a cluster may have one.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection, Pipe
from typing import Any, TypeVar
from weakref import WeakSet

from ctrplan.base.long_work import cores

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "CTRPLAN_THREADS")
START_S = 60.0  # for what it imports
READY = "ready"
_of_thread = threading.local()
_children: WeakSet[Child] = WeakSet()


class ChildEnded(Exception):
    """A child ended without an answer."""


class Child:
    """One such process, for the thread that made it; it ends with its parent, or when it is closed."""

    def __init__(self) -> None:
        """Starts it."""
        self.pipe, theirs = Pipe()
        environment = dict(os.environ) | dict.fromkeys(ONE_THREAD, "1")
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the parent, which ends it
            )
        _children.add(self)

    def call(self, function: Callable[..., Any], *arguments: Any, limit_s: float | None = None) -> Any:
        """What a function of some module returns. Raises what it raises, TimeoutError after `limit_s`, ChildEnded.

        After the latter two the child is gone. What is imported for the call does not count as its time.
        """
        try:
            self.pipe.send((function, arguments))
            if not (self.pipe.poll(START_S) and self.pipe.recv() == READY):
                raise EOFError
            if not self.pipe.poll(limit_s):
                raise TimeoutError
            is_result, answer = self.pipe.recv()
        except TimeoutError:
            self.close()
            raise
        except (OSError, EOFError) as error:
            self.close(patience_s=1.0)  # which it needs to be gone, and to say how
            raise ChildEnded(f"the process that did it ended ({self._fate})") from error
        except BaseException:
            self.close()
            raise
        if not is_result:
            raise answer
        return answer

    @property
    def _fate(self) -> str:
        code = self.process.poll()
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    @property
    def is_alive(self) -> bool:
        """Whether it can be called."""
        return not self.pipe.closed and self.process.poll() is None

    def close(self, patience_s: float = 0.0) -> None:
        """Ends it, at once or when it has not ended by itself."""
        try:
            self.process.wait(timeout=patience_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.wait()
        self.pipe.close()


def in_child(function: Callable[..., Any], *arguments: Any, limit_s: float | None = None) -> Any:
    """Calls a function as `Child.call`, in the child of this thread."""
    return child_of_thread().call(function, *arguments, limit_s=limit_s)


def child_of_thread() -> Child:
    """The child of this thread, which is started if need be."""
    child: Child | None = getattr(_of_thread, "child", None)
    if child is None or not child.is_alive:
        child = _of_thread.child = Child()
    return child


def close_children() -> None:
    """Ends the children of all threads of this process."""
    for child in list(_children):
        child.close()


def serve(descriptor: int) -> None:
    """What the child does until its parent is gone."""
    os.dup2(2, 1)  # what functions print is no answer
    with Connection(descriptor) as pipe:
        while True:
            try:
                function, arguments = pipe.recv()
            except (EOFError, OSError):
                return
            pipe.send(READY)
            try:
                answer = True, function(*arguments)
            except Exception as error:
                answer = False, error
            try:
                pipe.send(answer)
            except Exception as error:  # it can't be pickled
                pipe.send((False, TypeError(str(error))))


if __name__ == "__main__":
    serve(int(sys.argv[1]))

T = TypeVar("T")


class ChildExecutor(ThreadPoolExecutor):
    """An executor of as many processes as cores, or as stated; a child that dies takes its own task with it and no
    other's.
    """

    def __init__(self, workers: int | None = None) -> None:
        """Starts a process with its first task."""
        super().__init__(workers or cores())
        self.workers = workers or cores()
        self._is_left = False

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """A call of a function of some module; `limit_s` among the keywords is the time that it may take."""
        return super().submit(self._in_child, fn, *args, **kwargs)

    def _in_child(self, function: Callable[..., T], *arguments: Any, **limits: Any) -> T:
        """Calls it, unless the executor was left while the process was started, when there was none to end yet."""
        child = child_of_thread()
        if self._is_left:
            child.close()
            raise ChildEnded("the executor was left")
        answer: T = child.call(function, *arguments, **limits)
        return answer

    def __exit__(self, *_: object) -> None:
        """Ends the processes, whatever they are doing."""
        self._is_left = True
        self.shutdown(wait=False, cancel_futures=True)
        close_children()
        self.shutdown()
