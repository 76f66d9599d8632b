"""Workers of dask.distributed: any cluster by its scheduler's address.

dask hands tasks to workers that live, and again where one dies or another joins; nothing here does.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cached_property
from typing import Any

from ctrplan.base.package import __version__
from ctrplan.errors import InputError
from ctrplan.studies.study.engine import (
    AHEAD,
    Chunk,
    Chunks,
    Engine,
    answer,
    check_version,
    do_chunk,
    do_limited,
)
from ctrplan.studies.study.store import Lines

EXTRA = "pip install 'ctrplan[cluster]'"
CONNECT_S = 5.0
LOOK_S = 2.0  # between two looks at how many workers there are
LONGEST_PAGE = 10_000  # bytes that are looked at
FEWEST_AHEAD = 4  # chunks, where no worker has come yet


def is_installed() -> bool:
    """Whether the extra is there."""
    from importlib.util import find_spec

    return find_spec("distributed") is not None


class DaskEngine(Engine):
    """A cluster; one thread for each worker is all that ctrplan uses."""

    def __init__(self, *, scheduler: str | None = None, scheduler_file: str | None = None) -> None:
        """Connects within 5 s, by an address or a file that has it. Raises InputError."""
        if not is_installed():
            key = "--scheduler" if scheduler else "--scheduler-file"
            raise InputError(f"a cluster needs dask.distributed: {EXTRA}", key=key, value=scheduler or scheduler_file)
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what concerns the study is said by it
        self.opened = ExitStack()
        self.looked, self.count = -LOOK_S, 0
        try:
            self.client = self._client(scheduler, scheduler_file)
            self._check_versions()
        except BaseException:
            self.opened.close()
            raise

    def _client(self, scheduler: str | None, scheduler_file: str | None) -> Any:
        from distributed import Client

        key, value = ("--scheduler", scheduler) if scheduler else ("--scheduler-file", scheduler_file)
        if scheduler_file and not os.path.isfile(scheduler_file):  # for which dask would wait
            raise InputError("is not a file that exists", key=key, value=value)
        try:
            address = scheduler or _address_in(str(scheduler_file))
            answers_within(address, CONNECT_S)
            return self.opened.enter_context(Client(address, timeout=CONNECT_S))
        except Exception as error:  # whatever else listens there may answer anything
            raise InputError(f"no scheduler answered within {CONNECT_S:g} s", key=key, value=value) from error

    def _check_versions(self) -> None:
        """Raises VersionError for a worker that is there; those that join later say it with their first task."""
        try:
            self.client.run(check_version, __version__)
        except ModuleNotFoundError as error:
            raise InputError(f"the workers lack the module {error.name}: install ctrplan where they run") from error

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
        """Leaves the cluster."""
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
