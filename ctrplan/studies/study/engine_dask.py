"""Workers of dask.distributed: a cluster of processes on this machine, or any cluster by its scheduler's address.

dask hands tasks to workers that live, and again where one dies or another joins; nothing here does.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from types import ModuleType
from typing import Any

from ctrplan.base.catalogue import code_version
from ctrplan.base.long_work import cores
from ctrplan.errors import CtrplanError, InputError
from ctrplan.studies.study.engine import (
    AHEAD,
    Chunk,
    Chunks,
    Engine,
    answer,
    check_version,
    do_chunk,
    do_limited,
    prepare,
)
from ctrplan.studies.study.store import Lines


@contextmanager
def no_main_module() -> Iterator[None]:
    """Meanwhile such processes import no main module, so that scripts need no guard of theirs.

    They would run a script without `if __name__ == "__main__":` from its beginning, and the study in it once more.
    """
    own = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = own


EXTRA = "pip install 'ctrplan[cluster]'"
CONNECT_S = 5.0
LOOK_S = 2.0  # between two looks at how many workers there are
LONGEST_PAGE = 10_000  # bytes that are looked at
FEWEST_AHEAD = 4  # chunks, where no worker has come yet
# On one machine workers and client share the cores, of which dask took 5 % to look at itself.
QUIET = {
    "distributed.worker.profile.enabled": False,  # samples the stack of every worker each 10 ms
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.low-level-log-length": 100,  # entries for each kind; 1,000 of them are 10 MB
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
}


def is_installed() -> bool:
    """Whether the extra is there."""
    from importlib.util import find_spec

    return find_spec("distributed") is not None


class DaskEngine(Engine):
    """A cluster; one thread for each worker is all that ctrplan uses."""

    def __init__(
        self, workers: int | None = None, *, scheduler: str | None = None, scheduler_file: str | None = None
    ) -> None:
        """Connects within 5 s, or starts `workers` processes here. Raises InputError, CtrplanError in one sentence."""
        if not is_installed():
            key = "--scheduler" if scheduler else "--scheduler-file"
            raise InputError(f"a cluster needs dask.distributed: {EXTRA}", key=key, value=scheduler or scheduler_file)
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what concerns the study is said by it
        self.opened = ExitStack()
        self.looked, self.count = -LOOK_S, 0
        self.is_own = not (scheduler or scheduler_file)
        try:
            self.client = self._client(workers, scheduler, scheduler_file)
            self._check_versions()
        except BaseException:
            self.opened.close()
            raise

    def _client(self, workers: int | None, scheduler: str | None, scheduler_file: str | None) -> Any:
        from distributed import Client

        if not (scheduler or scheduler_file):
            return self.opened.enter_context(Client(self._local(workers or cores())))
        key, value = ("--scheduler", scheduler) if scheduler else ("--scheduler-file", scheduler_file)
        if scheduler_file and not os.path.isfile(scheduler_file):  # for which dask would wait
            raise InputError("is not a file that exists", key=key, value=value)
        try:
            address = scheduler or _address_in(str(scheduler_file))
            answers_within(address, CONNECT_S)
            return self.opened.enter_context(Client(address, timeout=CONNECT_S))
        except Exception as error:  # whatever else listens there may answer anything
            raise InputError(f"no scheduler answered within {CONNECT_S:g} s", key=key, value=value) from error

    def _local(self, workers: int) -> Any:
        import dask
        from distributed import LocalCluster

        self.opened.enter_context(dask.config.set(QUIET))
        self.opened.enter_context(no_main_module())  # also where dask starts a worker anew
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any port that is free
                silence_logs=logging.CRITICAL,
                preload=["ctrplan.studies.study.engine_dask"],
            )
        except (OSError, RuntimeError) as error:
            raise CtrplanError(f"no cluster could be started on this machine: {error}.") from error
        return self.opened.enter_context(cluster)

    def _check_versions(self) -> None:
        """Raises VersionError for a worker that is there; those that join later say it with their first task."""
        from ctrplan.studies.study.engine import VersionError

        try:
            self.client.run(check_version, code_version())
        except VersionError:
            raise
        except ModuleNotFoundError as error:
            raise InputError(f"the workers lack the module {error.name}: install ctrplan where they run") from error

    def prepare(self, content: bytes) -> None:
        """Prepares the workers. Those of other clusters do it with their first task: some may not have joined yet."""
        if self.is_own:
            self.client.run(prepare, content)

    @property
    def workers(self) -> int:
        """How many threads there are now, of all workers."""
        if time.monotonic() - self.looked >= LOOK_S:
            self.looked, self.count = time.monotonic(), sum(self.client.nthreads().values())
        return self.count

    @cached_property
    def note(self) -> str:  # type: ignore[override]
        """Where dask shows what its workers do; empty where nothing is shown, for want of bokeh or of a dashboard."""
        link: str | None = self.client.dashboard_link  # of a usual port, where a scheduler has none
        return link if link and _shows_a_dashboard(link) else ""

    def rows(self, content: bytes, chunks: Chunks, limit_s: float | None) -> Iterator[Lines]:
        """Rows as chunks are done."""
        from distributed import as_completed

        # A task of its own, which any worker can do again, so that nothing is lost with the worker that had it.
        shared = self.client.submit(bytes, content, pure=False)
        given: dict[Any, Chunk] = {}
        done = as_completed()
        try:
            while True:
                for chunk in chunks:
                    future = self._submitted(shared, chunk, limit_s)
                    given[future.key] = chunk
                    done.add(future)
                    if len(given) >= max(FEWEST_AHEAD, AHEAD * self.workers):
                        break
                if not given:
                    return
                future = next(done)
                yield answer(future, content, given.pop(future.key))
                future.release()
        finally:
            done.clear()
            shared.release()

    def _submitted(self, shared: Any, chunk: Chunk, limit_s: float | None) -> Any:
        if limit_s is None:
            return self.client.submit(do_chunk, shared, chunk, pure=False)
        return self.client.submit(do_limited, shared, chunk, limit_s, pure=False)

    def __exit__(self, *_: object) -> None:
        """Leaves the cluster, and ends it where it was started here."""
        self.opened.close()


def _address_in(file: str) -> str:
    """The address that a dask scheduler wrote into a file. Raises ValueError, KeyError."""
    with open(file, encoding="utf-8") as content:
        address: str = json.load(content)["address"]
    return address


def answers_within(address: str, seconds: float) -> None:
    """Raises whatever error there is unless a dask scheduler is at an address.

    A client of dask waits without end, or asks for exabytes, where a web server is: at the dashboard's port, say.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as thread:  # this one may have an event loop at work, as in a notebook
        thread.submit(asyncio.run, asyncio.wait_for(_identity(address), seconds)).result()


async def _identity(address: str) -> None:
    from distributed import Security
    from distributed.core import rpc

    async with rpc(address, connection_args=Security().get_connection_args("client")) as scheduler:
        await scheduler.identity()


def _shows_a_dashboard(link: str) -> bool:
    """Whether there is a page other than the one that asks for bokeh."""
    from urllib.error import URLError
    from urllib.request import urlopen

    try:
        with urlopen(link, timeout=CONNECT_S) as page:
            return b"needs bokeh" not in page.read(LONGEST_PAGE)
    except (URLError, OSError, ValueError):
        return False


def dask_setup(worker: Any) -> None:
    """Leaves Ctrl-C, which a terminal sends to all, to the process of the study: it ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
